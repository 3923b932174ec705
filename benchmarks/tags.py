"""Tags in photographs against the corners that a public set gives: `uv run python -m benchmarks.tags FOLDER`.

FOLDER holds the pictures `*.jpg` and beside each a file `*.txt` with a line per tag, `id, (x y), (x y), (x y), (x y)`,
as `test/data` of the public repository AprilRobotics/apriltag does: three photographs with 47 tags of 12 to 50 px.
These corners count from the corner of a pixel, ours from its middle: half a pixel is added to ours. They are those of
AprilTag without its refinement of edges, so that they have errors of their own.
"""

from __future__ import annotations

import re
import sys
from itertools import product
from pathlib import Path

import cv2
import numpy as np

from svmdist.transforms import Array
from svmdist.vision.tags import FoundTag, find_every_tag

PIXEL_CORNER = 0.5
NUMBER = re.compile(r"-?\d+\.\d+")


def reference(path: Path) -> list[FoundTag]:
    """The tags of a file of corners."""
    lines = [(line.split(",")[0], NUMBER.findall(line)) for line in path.read_text().splitlines()]
    return [FoundTag(int(tag), np.array(at, float).reshape(4, 2)) for tag, at in lines if len(at) == 8]


def errors_px(known: list[FoundTag], found: list[FoundTag]) -> list[Array]:
    """The corners' distances, shape (4,) each, for every known tag that was found, whichever corner is the first."""
    errors = []
    for tag in known:
        side_px = np.linalg.norm(tag.corners_px - np.roll(tag.corners_px, 1, 0), axis=1).mean()
        alike = [other for other in found if other.number == tag.number]
        away_px = [np.linalg.norm(np.mean(other.corners_px - tag.corners_px, 0)) for other in alike]
        if not alike or min(away_px) > 0.3 * side_px:
            continue
        corners = alike[int(np.argmin(away_px))].corners_px
        orders = [np.roll(c, k, 0) for c, k in product((corners, corners[::-1]), range(4))]
        errors.append(min((np.linalg.norm(o - tag.corners_px, axis=1) for o in orders), key=np.sum))
    return errors


def main(folder: Path) -> None:
    """Print how many tags are found, and how near their corners are."""
    known, every, errors = 0, 0, []
    for path in sorted(folder.glob("*.jpg")):
        image = np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), np.uint8)
        if not path.with_suffix(".txt").is_file():
            continue
        tags = reference(path.with_suffix(".txt"))
        found = [
            FoundTag(tag.number, tag.corners_px + PIXEL_CORNER) for tag in find_every_tag(image, "36h11")
        ]
        known, every = known + len(tags), every + len(found)
        errors += errors_px(tags, found)
    if not errors:
        sys.exit(f"{folder}: expected pictures .jpg with corners in .txt beside them")
    corners = np.concatenate(errors)
    print(f"{len(errors)} of {known} tags found, {every - len(errors)} others")
    print(f"{np.mean(corners < 0.5):.0%} of corners within 0.5 px, median {np.median(corners):.2f} px")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(Path(sys.argv[1]))
