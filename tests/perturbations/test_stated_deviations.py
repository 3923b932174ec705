"""A profile states the deviations of real worlds: neither too sure of itself, nor so unsure that it says nothing."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.perturbations.calibration import TURN_DEG_PER_MM
from svmdist.perturbations.table import TABLE, Uniform, real_std
from svmdist.profile import Profile, load_profile


def stated(profile: Profile) -> dict[str, float]:
    """The deviations that a profile states, in the units of the table."""
    camera, robot = profile.camera_error, profile.kinematic_error
    instrument, tag, tissue, simulation = (
        profile.instrument,
        profile.fiducial,
        profile.tissue,
        profile.simulation,
    )
    assert instrument is not None
    assert tag is not None
    assert tissue is not None
    assert simulation is not None
    right_deg = float(np.degrees(camera.right_rotation_std_rad))
    return {
        "focal": 100.0 * camera.focal_std_fraction,
        "principal_point": camera.centre_std_px,
        "baseline": 1e3 * camera.baseline_std_fraction * simulation.stereo_baseline_m,
        "right_yaw": right_deg,
        "right_pitch": right_deg,
        "right_roll": right_deg,
        "plane": 1e3 * tissue.plane_distance_std_m,
        "plane_tilt": float(np.degrees(tissue.plane_tilt_std_rad)),
        "shaft_radius": 100.0 * instrument.shaft_radius_std_fraction,
        "knuckle_radius": 100.0 * instrument.knuckle_radius_std_fraction,
        "wrist_length": 1e3 * robot.length_std_m,
        "tag_size": 100.0 * tag.size_std_fraction,
        "tag_mount": 1e3 * tag.position_std_m,
        "lag": 1e3 * robot.time_offset_std_s,
    }


@pytest.mark.parametrize("name", sorted(stated(load_profile())))
def test_a_stated_deviation_is_that_of_real_worlds(name: str) -> None:
    """At least as large, at most three times."""
    said = stated(load_profile())[name]
    assert 0.999 * real_std(name) <= said <= 3.0 * real_std(name)


def test_backlash_and_a_turned_tag_are_stated() -> None:
    """Backlash has no deviation: what is stated of the joints' play lies within its range."""
    profile = load_profile()
    law = TABLE["backlash"].real
    assert isinstance(law, Uniform)
    assert law.low <= np.degrees(profile.kinematic_error.play_std_rad) <= law.high
    assert profile.fiducial is not None
    turn_deg = TURN_DEG_PER_MM * real_std("tag_mount")
    assert np.degrees(profile.fiducial.rotation_std_rad) == pytest.approx(turn_deg, rel=0.25)
