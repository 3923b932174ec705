"""SuPer Deep (ambareeshsrja16/Surgical_Tool_Tracking): two da Vinci instruments over tissue, labelled in the left view.

No calibration comes with it: f = 800 px is assumed, so that figures are pixels.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks import masks
from benchmarks.real import common, peer
from svmdist.profile import load_profile
from svmdist.transforms import Array

SET = Path("Surgical_Tool_Tracking", masks.SUPER_DEEP)
LABELS = "CollectedData_Ambar.csv"
WRISTS = {"left": "left_logobody_head_tip", "right": "right_logobody_head_tip"}
"""The label at the distal end of the wrist's body, where the jaws' joint begins, of each instrument."""
K = common.K_of(800.0, 800.0, 359.5, 287.5)
RADIUS_M, WIDTH_PX = 0.0042, 720
LABEL_STD_PX = 5.0
"""Of a label, and of what is a few millimetres from the tool's origin."""


def measure(folder: Path, out: Path) -> Iterator[common.Line]:
    """Rows of `shaft` for both instruments against the labelled wrists of their own side."""
    images = folder / SET
    log, path = common.make_log(
        out / "superdeep.mcap", images, "--side-by-side", "--rate", 1, "--camera", "800,800,359.5,287.5"
    )
    profile = load_profile(path)
    sides = {profile.instrument_name: profile.entry or "left"}
    sides |= {other.name: other.entry or "right" for other in profile.other_instruments}
    rows, total = common.rows_of(log, profile, "shaft")
    pictures = [common.read(image)[:, :WIDTH_PX] for image in in_order(images)]
    wrists, seen = labelled_wrists(images), [common.by_network(bgr) for bgr in pictures]
    errors, inside, on = [], [], []
    for row in rows:
        on.append(common.on_instrument(common.pose_of(row), K, seen[row.number], RADIUS_M))
        if (wrist := wrists.get(row.number, {}).get(sides[row.instrument])) is not None:
            off_px = np.array(row.image.tool_px) - wrist
            errors.append(float(np.linalg.norm(off_px)))
            inside.append(common.within_px(row, off_px, K, LABEL_STD_PX))
    found = peer.found(pictures, K, RADIUS_M, 2)
    near = [min(float(np.linalg.norm(rod.end_px - px)) for px in wrists[n].values()) for n, rod in found if n in wrists]
    other = peer.figures(found, seen, "px", near)
    yield common.Line(
        "SuPer Deep",
        "`shaft`",
        "wrist",
        common.Figures(f"{len(rows)}/{total}", "px", errors, on, inside),
        other,
    )


def in_order(images: Path) -> list[Path]:
    """The images by their numbers, as `svmdist import` takes them."""
    return sorted(images.glob("img*.png"), key=lambda path: int("".join(filter(str.isdigit, path.stem))))


def labelled_wrists(folder: Path) -> dict[int, dict[str, Array]]:
    """Wrists by the image's place in the log, in px of the left view; frames without labels are left out."""
    places = {path.name: place for place, path in enumerate(in_order(folder))}
    with (folder / LABELS).open(newline="", encoding="utf-8") as file:
        _, parts, axes, *rows = list(csv.reader(file))
    found: dict[int, dict[str, Array]] = {}
    for row in rows:
        name = row[0].replace("\\", "/").rpartition("/")[2]
        cells = {(part, axis): value for part, axis, value in zip(parts, axes, row, strict=True)}
        for side, part in WRISTS.items():
            px = [float(cells[part, axis] or np.nan) for axis in "xy"]
            if name in places and np.isfinite(px).all():
                found.setdefault(places[name], {})[side] = np.array(px)
    return found
