"""Tags in photographs against the corners that a public set gives: `uv run python -m benchmarks.tags FOLDER`.

FOLDER is `test/data` of the public repository AprilRobotics/apriltag: photographs `*.jpg`, beside each a file `*.txt`
with a line per tag, `id, (x y), (x y), (x y), (x y)`. These corners count from the corner of a pixel, ours from its
middle. They are those of AprilTag without its refinement of edges, so that they have errors of their own.
"""

from __future__ import annotations

import re
import sys
from itertools import product
from pathlib import Path

import cv2
import numpy as np

from svmdist.vision.tags import FoundTag, find_every_tag

PIXEL_CORNER = 0.5
NUMBER = re.compile(r"-?\d+\.\d+")


def corner_errors_px(path: Path) -> tuple[int, list[float]]:
    """How many tags a file of corners has, and the distances of those found from it, whichever corner is the first."""
    image = np.asarray(cv2.imread(str(path.with_suffix(".jpg")), cv2.IMREAD_GRAYSCALE), np.uint8)
    found = find_every_tag(image, "36h11")
    known = 0
    errors_px: list[float] = []
    for line in path.read_text().splitlines():
        numbers = NUMBER.findall(line)
        if len(numbers) != 8:
            continue
        known += 1
        tag = FoundTag(int(line.split(",")[0]), np.array(numbers, float).reshape(4, 2))
        side_px = np.linalg.norm(tag.corners_px - np.roll(tag.corners_px, 1, 0), axis=1).mean()
        alike = [other.corners_px + PIXEL_CORNER for other in found if other.number == tag.number]
        near = [c for c in alike if np.linalg.norm(np.mean(c - tag.corners_px, 0)) <= 0.3 * side_px]
        orders = [np.roll(c, k, 0) for one in near for c, k in product((one, one[::-1]), range(4))]
        if orders:
            errors_px += min(
                (np.linalg.norm(o - tag.corners_px, axis=1) for o in orders), key=np.sum
            ).tolist()
    return known, errors_px


def main(folder: Path) -> None:
    """Print how many tags are found, and how near their corners are."""
    counts, errors = zip(*map(corner_errors_px, sorted(folder.glob("*.txt"))), strict=True)
    corners = np.concatenate(errors)
    print(f"{len(corners) // 4} of {sum(counts)} tags found")
    print(f"{np.mean(corners < 0.5):.0%} of corners within 0.5 px, median {np.median(corners):.2f} px")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(Path(sys.argv[1]))
