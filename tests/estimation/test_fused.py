"""`kinematic` and `fused`: nominal kinematics, and nominal kinematics corrected by the image."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from svmdist.errors import ProfileError
from svmdist.estimation.tissue import TissuePose
from svmdist.estimation.tissue_tracking import DEFAULT as TRACKING
from svmdist.estimation.tissue_tracking import TissueTracker
from svmdist.geometry.surfaces import Plane
from svmdist.profile import Profile
from svmdist.samples import JointSample, Observation, Status
from svmdist.transforms import Array
from tests.measuring import Measuring
from tests.synthetic import START_NS, SyntheticScene, make_scene


@pytest.fixture(scope="module")
def scene() -> SyntheticScene:
    return make_scene()


@pytest.fixture(scope="module")
def profile(scene: SyntheticScene) -> Profile:
    """The shipped profile with the plane that the synthetic disc lies on, and no wrist to bend."""
    tissue = scene.profile.tissue
    assert tissue is not None
    plane = tissue.model_copy(update={"plane_distance_m": 0.09, "dome": None})
    return scene.profile.model_copy(update={"tissue": plane})


def observe(
    scene: SyntheticScene, seconds: float, shift_m: Array | None = None, dark: bool = False
) -> Observation:
    """One frame of the synthetic scene; the nominal camera-to-base transform may be off by a shift."""
    T_camera_base = scene.T_camera_base.copy()
    if shift_m is not None:
        T_camera_base[:3, 3] += shift_m
    image = scene.frame_at(seconds)
    joints = JointSample(START_NS, scene.chain.joint_names, scene.joints_at(seconds))
    return Observation(
        START_NS + round(seconds * 1e9),
        np.full_like(image, 120) if dark else image,
        scene.camera,
        joints,
        None,
        T_camera_base,
    )


def test_kinematic_is_as_wrong_as_nominal_kinematics(scene: SyntheticScene, profile: Profile) -> None:
    """Right kinematics give the tool exactly; a shifted base shifts it, and the interval knows that."""
    estimator = Measuring("kinematic", profile)
    truth_m = scene.T_camera_tool_at(0.5)[:3, 3]
    row = estimator.estimate(observe(scene, 0.5))
    np.testing.assert_allclose(row.tool_position_m, truth_m, atol=1e-12)
    shift_m = np.array([0.003, -0.002, 0.004])
    off = estimator.estimate(observe(scene, 0.5, shift_m))
    np.testing.assert_allclose(off.tool_position_m, truth_m + shift_m, atol=1e-12)
    assert off.status is Status.OK
    assert off.spatial_m is not None
    assert row.spatial_m is not None
    assert off.spatial_std_m is not None
    assert abs(off.spatial_m - row.spatial_m) < 1.96 * off.spatial_std_m


def test_fused_corrects_nominal_kinematics_and_carries_on_in_the_dark(
    scene: SyntheticScene, profile: Profile
) -> None:
    """Across the viewing ray the shift is found to 0.3 mm; in the dark a row still comes, less sure."""
    estimator = Measuring("fused", profile)
    shift_m = np.array([0.004, -0.003, 0.0])
    for step in range(20):
        row = estimator.estimate(observe(scene, 0.1 * step, shift_m))
        assert row.status is Status.OK
    assert row.tool_position_m is not None
    error_m = np.array(row.tool_position_m) - scene.T_camera_tool_at(1.9)[:3, 3]
    assert np.hypot(*error_m[:2]) < 0.3e-3
    dark = estimator.estimate(observe(scene, 2.0, shift_m, dark=True))
    assert dark.status is Status.OK
    assert dark.match_count == 0
    assert dark.spatial_std_m is not None
    assert row.spatial_std_m is not None
    error_m = np.array(dark.tool_position_m) - scene.T_camera_tool_at(2.0)[:3, 3]
    assert np.hypot(*error_m[:2]) < 1e-3


@pytest.mark.parametrize("method", ["kinematic", "fused"])
def test_without_joints_or_transform_there_is_a_reason(
    scene: SyntheticScene, profile: Profile, method: str
) -> None:
    """A frame without joints or camera-to-base transform says which is missing, and is no exception."""
    estimator = Measuring(method, profile)
    whole = observe(scene, 0.0)
    for lacking in (replace(whole, joints=None), replace(whole, T_camera_base=None)):
        row = estimator.estimate(lacking)
        assert row.status is Status.NO_JOINTS
        assert row.detail


@pytest.mark.parametrize("method", ["kinematic", "fused"])
def test_a_profile_must_have_chain_and_tissue(profile: Profile, method: str) -> None:
    """Without [robot] or [tissue] the method says so at once."""
    for key in ("robot", "tissue"):
        with pytest.raises(ProfileError, match=key):
            Measuring(method, profile.model_copy(update={key: None}))


def fix_at(x_m: float) -> TissuePose:
    plane = Plane(np.array([0.0, 0.0, -1.0]), -0.1)
    return TissuePose(np.array([x_m, 0.0, 0.1]), 1e-8 * np.eye(3), plane)


def test_tissue_is_remembered_and_wild_fixes_are_not() -> None:
    """The mean of like fixes keeps their covariance; one far fix changes nothing, a row of them is a move."""
    tracker = TissueTracker()
    for x_m in (0.0, 1e-4, 0.0, 1e-4):
        known = tracker.add(fix_at(x_m))
    assert known is not None
    assert known.position_m[0] == pytest.approx(0.5e-4, abs=3e-6)
    assert known.covariance[0, 0] == pytest.approx(1e-8, rel=1e-3)
    assert tracker.add(None) is not None
    for _ in range(TRACKING.moved_count - 1):
        known = tracker.add(fix_at(0.01))
    assert known is not None
    assert known.position_m[0] < 1e-4
    known = tracker.add(fix_at(0.01))
    assert known is not None
    assert known.position_m[0] == pytest.approx(0.01)


def test_fixes_that_scatter_widen_the_tissues_interval() -> None:
    """Fixes that say 0.1 mm and scatter by 0.2 mm leave 0.2 mm in the mean; quiet ones stay at what they say."""
    rng = np.random.default_rng(3)
    loud, quiet = TissueTracker(), TissueTracker()
    for _ in range(40):
        for tracker, std_m in ((loud, 2e-4), (quiet, 2e-5)):
            fix = fix_at(0.0)
            known = tracker.add(
                replace(fix, position_m=fix.position_m + std_m * np.array([*rng.normal(size=2), 0.0]))
            )
            assert known is not None
    loud_fix, quiet_fix = loud.now(), quiet.now()
    assert loud_fix is not None
    assert quiet_fix is not None
    assert np.sqrt(loud_fix.covariance[0, 0]) == pytest.approx(2e-4, rel=0.25)
    assert np.sqrt(quiet_fix.covariance[0, 0]) == pytest.approx(1e-4, rel=1e-3)
