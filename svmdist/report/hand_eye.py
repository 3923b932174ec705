"""The camera-to-base transform that was fitted, as lines for a person, a row, and a file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from svmdist.profile.hand_eye import FORMAT, HandEyeFile, Source
from svmdist.recording.reader import Recording
from svmdist.report.table import Cell
from svmdist.transforms import quaternion_xyzw_from_rotation
from svmdist.workflows.hand_eye import HandEyeResult

HAND_EYE_KEYS = (
    "instrument",
    "camera",
    "base",
    "x_m",
    "y_m",
    "z_m",
    "qx",
    "qy",
    "qz",
    "qw",
    "x_std_m",
    "y_std_m",
    "z_std_m",
    "turn_x_std_rad",
    "turn_y_std_rad",
    "turn_z_std_rad",
    "tool_std_m",
    "method",
    "reference",
    "frame_count",
    "inlier_count",
    "residual_rms_m",
    "log_turn_rad",
    "log_shift_m",
)


def hand_eye_row(result: HandEyeResult) -> dict[str, Cell]:
    """One instrument, flat, with the keys of `HAND_EYE_KEYS`."""
    found = result.hand_eye
    T = found.T_camera_base
    std = np.sqrt(np.maximum(np.diag(np.array(found.covariance)), 0.0))
    turn_rad, shift_m = result.from_log if result.from_log is not None else (None, None)
    values: tuple[Cell, ...] = (
        found.instrument,
        found.camera,
        found.base,
        *(float(value) for value in T[:3, 3]),
        *(float(value) for value in quaternion_xyzw_from_rotation(T[:3, :3])),
        *(float(value) for value in std),
        result.tool_std_m,
        found.method,
        found.reference,
        found.frame_count,
        found.inlier_count,
        found.residual_rms_m,
        turn_rad,
        shift_m,
    )
    return dict(zip(HAND_EYE_KEYS, values, strict=True))


def hand_eye_lines(result: HandEyeResult) -> Iterator[str]:
    """For a person: the transform with its deviations, and what it rests on."""
    found, row = result.hand_eye, hand_eye_row(result)
    std = np.sqrt(np.maximum(np.diag(np.array(found.covariance)), 0.0))
    yield f"{found.instrument}: {found.base} in {found.camera}, by {found.method} against {found.reference}\n"
    place = ", ".join(
        f"{axis} {value * 1e3:.1f} ± {deviation * 1e3:.1f}"
        for axis, value, deviation in zip("xyz", found.translation_m, std[:3], strict=True)
    )
    yield f"  translation [mm]     {place}\n"
    quaternion = ", ".join(f"{row[key]:.5f}" for key in ("qx", "qy", "qz", "qw"))
    yield f"  rotation (xyzw)      {quaternion}\n"
    turn = ", ".join(f"{axis} ± {np.degrees(value):.2f}" for axis, value in zip("xyz", std[3:], strict=True))
    yield f"  about the axes [°]   {turn}\n"
    yield f"  at the tool [mm]     ± {result.tool_std_m * 1e3:.2f} in the worst direction\n"
    yield (
        f"  frames               {found.inlier_count} of {found.frame_count} agree, within"
        f" {found.residual_rms_m * 1e3:.2f} mm rms; squared residuals over expected {result.fit.ratio:.2f}\n"
    )
    if result.from_log is not None:
        turn_rad, shift_m = result.from_log
        yield f"  the log's transform  {np.degrees(turn_rad):.2f}° and, at the tool, {shift_m * 1e3:.1f} mm off it\n"


def hand_eye_file(results: Sequence[HandEyeResult], recording: Recording) -> HandEyeFile:
    """What a profile names."""
    source = Source(name=recording.path.name, sha256=recording.sha256())
    return HandEyeFile(
        format=FORMAT, sources=(source,), transforms=tuple(result.hand_eye for result in results)
    )
