"""The set `ReCoDE`: 50 stations of a dVRK instrument with two coloured balls on its shaft, and three joints.

Nothing in it says where the tool is in the images: rows and their stated deviations are counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.real_sets.figures import SetFigures, draw_overlays, measured, number
from benchmarks.real_sets.making import make_log, make_profile, run
from svmdist.importing.calibration import CalibrationOptions
from svmdist.recording.log import open_recording
from svmdist.workflows.import_log import ImportOptions, ViewOptions

NAME, KEY, REPOSITORY = "ReCoDE", "recode", "ImperialCollegeLondon/ReCoDE-HandEyeCalibration"
INPUT = Path("ReCoDE-HandEyeCalibration", "input")


def is_in(folder: Path) -> bool:
    """Whether the set has been fetched."""
    return (folder / INPUT / "RGB").is_dir()


def measure(folder: Path, out: Path, methods: Sequence[str]) -> SetFigures:
    """How many frames a method with one camera measures, and how certain it says they are."""
    K = np.loadtxt(folder / INPUT / "Acusense_RGB_K.txt")
    camera = (K[0, 0], K[1, 1], K[0, 2], K[1, 2])
    options = ImportOptions(
        ViewOptions(folder / INPUT / "RGB", rate_hz=1.0),
        CalibrationOptions(intrinsics=(camera, None)),
        joints={"PSM1": folder / INPUT / "q_history.txt"},
        joint_names=("yaw", "pitch", "insertion"),
    )
    log = make_log(options, out / "recode.mcap")
    profile = make_profile(log)
    figures = SetFigures(
        "ReCoDE: a dVRK instrument with two balls on its shaft, 50 images of 800x600",
        ("method", "rows", "stated deviation of the tool [mm], median"),
    )
    for method in methods:
        if method != "shaft":
            continue  # one camera, and three of six joints
        answer = run(log, profile, method)
        if isinstance(answer, str):
            figures.rows.append((f"`{method}`", answer, ""))
            continue
        rows, loaded = answer
        good = measured(rows)
        std_m = np.array([row.tool.pose.position_std_m for row in good if row.tool])
        figures.rows.append((f"`{method}`", f"{len(good)} of {len(rows)}", number(1e3 * std_m, digits=1)))
        draw_overlays(open_recording(log, loaded), rows, {}, out / "overlays" / method, 5)
    return figures
