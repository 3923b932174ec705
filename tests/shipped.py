"""The robot that ships, in the posture that its profile gives it: what many tests measure with."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from svmdist.kinematics import chain_of
from svmdist.profile import load_profile, profile_path

PSM13 = profile_path("psm13").read_text("utf-8")
PROFILE = load_profile()
assert PROFILE.robot is not None
assert PROFILE.simulation is not None
assert PROFILE.tissue is not None
CHAIN = chain_of(PROFILE.robot)
POSTURE = np.array([PROFILE.simulation.posture[name] for name in CHAIN.joint_names])
"""Joint values, shape (n_joints,), in rad and m; to be copied before they are changed."""
POSTURE.setflags(write=False)
CONSTANT_ERROR = PROFILE.kinematic_error.model_copy(
    update={"play_std_rad": 0.0, "play_std_m": 0.0, "time_offset_std_s": 0.0, "length_std_m": 0.0}
)
"""A robot whose errors never change: with it a filter can be held to what constant errors leave."""


def write_profile(path: Path, *changes: tuple[str, str]) -> Path:
    """Write the profile with other text for some patterns, and without the calibration that stands beside it."""
    text = PSM13
    for pattern, new in ((r"(?m)^calibration = .*\n", ""), *changes):
        text, count = re.subn(pattern, new.replace("\\", r"\\"), text)
        assert count, pattern
    path.write_text(text, "utf-8")
    return path


def _with(part: Any, **zeros: Any) -> Any:
    return part.model_copy(update=zeros)


EXACT_PROFILE = PROFILE.model_copy(
    update={
        "kinematic_error": CONSTANT_ERROR,
        "camera_error": _with(
            PROFILE.camera_error,
            focal_std_fraction=0.0,
            centre_std_px=0.0,
            baseline_std_fraction=0.0,
            right_rotation_std_rad=0.0,
        ),
        "instrument": _with(
            PROFILE.instrument,
            shaft_radius_std_fraction=0.0,
            knuckle_radius_std_fraction=0.0,
            knuckle_position_std_m=0.0,
            body_std_m=0.0,
        ),
        "fiducial": _with(PROFILE.fiducial, size_std_fraction=0.0, position_std_m=0.0, rotation_std_rad=0.0),
        "tissue": _with(
            PROFILE.tissue,
            plane_distance_std_m=0.0,
            plane_tilt_std_rad=0.0,
            motion_std_m=0.0,
            dome=_with(
                PROFILE.tissue.dome,
                gauge_exponent_std=0.0,
                height_exponent_std=0.0,
            ),
        ),
    }
)
"""A profile that takes every constant to be exact: what is left is what measurements err by."""
