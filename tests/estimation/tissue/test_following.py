"""The tissue as `fused` follows it: its height is a state that stereo tells, and distances know of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from svmdist.estimation.frame import Frame, frame_of
from svmdist.estimation.instrument.kinematic_error_filter import KinematicErrorFilter
from svmdist.estimation.scene import Arm
from svmdist.estimation.tissue_tracking import FollowedTissue
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile import Profile, load_profile
from svmdist.recording.log import open_recording
from svmdist.samples import Observation
from svmdist.vision.segmentation import make_segmenter

PROFILE = load_profile()


def frames(golden: Path, profile: Profile, count: int) -> list[Frame]:
    recording = open_recording(golden / "3d" / "contact.mcap", profile)
    arm, segmenter = Arm(profile), make_segmenter(profile.segmentation)
    seen = [each for each in recording.observations() if isinstance(each, Observation)][:count]
    return [frame_of(each, arm, segmenter) for each in seen]


def followed(golden: Path, profile: Profile, count: int = 6):
    """The tissue's place, its covariance and that with the tool's pose after some frames, and the true place."""
    arm = Arm(profile)
    tissue = FollowedTissue(arm)
    kalman = KinematicErrorFilter(arm.required_chain, profile.kinematic_error)
    results = []
    for frame in frames(golden, profile, count):
        assert isinstance(frame.robot, RobotState)
        known = tissue.see(frame)
        kalman.predict(frame.robot)
        results.append(tissue.measure_height(frame, kalman))
        assert known is not None
    placed, coupling = tissue.placed(known, frame, kalman)
    return placed, coupling, results


def with_plane(distance_m: float) -> Profile:
    assert PROFILE.tissue is not None
    return PROFILE.model_copy(
        update={"tissue": PROFILE.tissue.model_copy(update={"plane_distance_m": distance_m})}
    )


def test_stereo_brings_back_a_plane_that_the_profile_has_wrong(golden: Path) -> None:
    """Two millimetres off: a good part of it comes back, by a pair that is itself uncertain, and the rest is stated."""
    true_m = 0.112
    for wrong_m in (0.110, 0.112, 0.114):
        placed, _, results = followed(golden, with_plane(wrong_m))
        assert all(result is not None and result.is_accepted for result in results)
        off_m = abs(float(placed.position_m[2]) - true_m)
        assert off_m < 0.75 * abs(wrong_m - true_m) + 4e-4
        assert off_m < 2.0 * np.sqrt(placed.covariance[2, 2])


def test_less_is_known_of_it_without_the_right_view(golden: Path) -> None:
    """With one camera the plane is as the profile states it, and as uncertain."""
    both, _, _ = followed(golden, PROFILE)
    arm = Arm(PROFILE)
    tissue = FollowedTissue(arm)
    kalman = KinematicErrorFilter(arm.required_chain, PROFILE.kinematic_error)
    frame = frames(golden, PROFILE, 1)[0]
    object.__setattr__(frame.scene.observation, "right", None)
    assert isinstance(frame.robot, RobotState)
    known = tissue.see(frame)
    kalman.predict(frame.robot)
    assert tissue.measure_height(frame, kalman) is None
    assert known is not None
    placed, coupling = tissue.placed(known, frame, kalman)
    assert placed.position_m[2] == pytest.approx(0.112, abs=1e-9)
    assert placed.covariance[2, 2] > 1.5 * both.covariance[2, 2]
    assert PROFILE.tissue is not None
    assert np.sqrt(placed.covariance[2, 2]) > PROFILE.tissue.plane_distance_std_m
    np.testing.assert_allclose(coupling, 0.0, atol=1e-12)
