"""The set `SuPer Deep`: 20 stereo frames of two da Vinci instruments over tissue, keypoints labelled in the left view.

No calibration comes with it: f = 800 px is assumed, so that figures are pixels.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.real_sets.figures import SetFigures, draw_overlays, measured, number
from benchmarks.real_sets.making import make_log, make_profile, run
from svmdist.importing.calibration import CalibrationOptions
from svmdist.importing.images import list_images
from svmdist.recording.log import open_recording
from svmdist.transforms import Array
from svmdist.workflows.import_log import ImportOptions, ViewOptions

NAME, KEY, REPOSITORY = "SuPer Deep", "superdeep", "ambareeshsrja16/Surgical_Tool_Tracking"
IMAGES = Path(
    "Surgical_Tool_Tracking", "ForwardPassDeepLabCut", "DaVinci-Ambar-2019-10-31", "labeled-data", "video_1"
)
LABELS = "CollectedData_Ambar.csv"
WRISTS = {"left": "left_logobody_head_tip", "right": "right_logobody_head_tip"}
"""The label at the distal end of the wrist's body, where the jaws' joint begins, of each instrument."""
CAMERA = (800.0, 800.0, 359.5, 287.5)


def is_in(folder: Path) -> bool:
    """Whether the set has been fetched."""
    return (folder / IMAGES / LABELS).is_file()


def measure(folder: Path, out: Path, methods: Sequence[str]) -> SetFigures:
    """Methods that need no scale against the labelled wrists: frames, pixels, and names that stay."""
    views = ViewOptions(folder / IMAGES, side_by_side=True, rate_hz=1.0)
    log = make_log(
        ImportOptions(views, CalibrationOptions(intrinsics=(CAMERA, None))), out / "superdeep.mcap"
    )
    profile = make_profile(log)
    wrists = _wrists(folder / IMAGES)
    figures = SetFigures(
        "SuPer Deep: two da Vinci instruments over tissue, 20 frames of 720x576",
        (
            "method",
            "rows, left",
            "rows, right",
            "both",
            "px to the wrist, median",
            "p95",
            "rows under the other name",
        ),
    )
    for method in methods:
        if method != "shaft":
            continue  # no baseline, and no joints
        answer = run(log, profile, method)
        if isinstance(answer, str):
            figures.rows.append((f"`{method}`", answer, *[""] * 5))
            continue
        rows, loaded = answer
        good = measured(rows)
        sides = {loaded.instrument_name: loaded.entry or "left"}
        sides |= {other.name: other.entry or "right" for other in loaded.other_instruments}
        frames = {side: {row.stamp_ns for row in good if sides[row.instrument] == side} for side in WRISTS}
        off_px, swapped = [], 0
        for row in good:
            labelled = wrists.get(row.stamp_ns // 10**9, {})
            own, other = labelled.get(sides[row.instrument]), labelled.get(_other(sides[row.instrument]))
            assert row.image.tool_px is not None
            px = np.array(row.image.tool_px)
            if own is not None:
                off_px.append(float(np.linalg.norm(px - own)))
                swapped += other is not None and np.linalg.norm(px - other) < np.linalg.norm(px - own)
        total = len({row.stamp_ns for row in rows})
        figures.rows.append(
            (
                f"`{method}`",
                *(f"{len(frames[side])} of {total}" for side in ("left", "right")),
                f"{len(frames['left'] & frames['right'])} of {total}",
                number(np.array(off_px), digits=1),
                number(np.array(off_px), 95.0, digits=1),
                f"{swapped} of {len(off_px)}",
            )
        )
        references = {place * 10**9: list(found.values()) for place, found in wrists.items()}
        draw_overlays(open_recording(log, loaded), rows, references, out / "overlays" / method, 1)
    return figures


def _other(side: str) -> str:
    return "right" if side == "left" else "left"


def _wrists(folder: Path) -> dict[int, dict[str, Array]]:
    """Labelled wrists by the image's place in the log, in px of the left view; frames without labels are left out."""
    places = {path.name: place for place, path in enumerate(list_images(folder, "img*.png"))}
    with (folder / LABELS).open(newline="", encoding="utf-8") as file:
        _, parts, axes, *rows = list(csv.reader(file))
    found: dict[int, dict[str, Array]] = {}
    for row in rows:
        name = row[0].replace("\\", "/").rpartition("/")[2]
        cells = {(part, axis): value for part, axis, value in zip(parts, axes, row, strict=True)}
        for side, part in WRISTS.items():
            if cells[part, "x"] and cells[part, "y"] and name in places:
                px = np.array([float(cells[part, "x"]), float(cells[part, "y"])])
                found.setdefault(places[name], {})[side] = px
    return found
