"""The stream of samples: its order, its truth, and that a seed settles all of it."""

from __future__ import annotations

import hashlib
import subprocess
import sys

import numpy as np
import pytest

from svmdist.errors import UsageError
from svmdist.kinematics.dh import forward_kinematics
from svmdist.profile import Profile
from svmdist.samples import DistanceSample, ImageSample, JointSample, PoseSample, TransformsSample
from svmdist.simulation.scenarios import cubic_spline, smooth_step
from svmdist.simulation.scenarios import SCENARIOS, Scenario, Stage, plan_motion
from svmdist.simulation.scene import make_scene

pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
from svmdist.simulation.clearance import ClearanceMeter
from svmdist.simulation.motion import make_trajectory
from svmdist.simulation.simulate import simulate

WORKING_HEIGHT_M = 0.0245
STAGE = Stage(np.array([0.001, -0.001]), 0.008, WORKING_HEIGHT_M, 8.0)
SEEDS = range(6)
DIGEST = """
import hashlib
from svmdist.profile import load_profile
from svmdist.simulation.scenarios import Scenario
from svmdist.simulation.simulate import simulate
digest = hashlib.sha256()
for topic, sample in simulate(Scenario("sweep", 3, 0.3, 10.0), load_profile(), noise=2.0):
    digest.update(repr((topic, sample.stamp_ns)).encode())
    digest.update(getattr(sample, "image_bgr", b""))
    digest.update(getattr(sample, "positions", b""))
    digest.update(repr(getattr(sample, "clearance_m", "")).encode())
print(digest.hexdigest())
"""


@pytest.fixture(scope="module")
def stream(profile: Profile) -> list:
    return list(simulate(Scenario("sweep", 1, 1.2, 3.0), profile))


def test_stamps_never_go_back_and_every_topic_is_there(stream: list, profile: Profile) -> None:
    stamps = [sample.stamp_ns for _, sample in stream]
    assert stamps == sorted(stamps)
    right = {profile.topics.right_image, profile.topics.right_camera_info}
    assert {topic for topic, _ in stream} == set(profile.topics.model_dump().values()) - right
    joints = [sample.stamp_ns for _, sample in stream if isinstance(sample, JointSample)]
    assert max(np.diff(joints)) <= 10_000_000
    images = [sample.stamp_ns for _, sample in stream if isinstance(sample, ImageSample)]
    assert len(images) == 4
    assert joints[0] <= images[0]
    assert images[-1] <= joints[-1]
    truth = {sample.stamp_ns for topic, sample in stream if topic == profile.topics.ground_truth_distance}
    assert truth.issuperset(images)


def test_distances_follow_from_the_true_transforms(stream: list, profile: Profile) -> None:
    """eq. (35) and its 3D companion, exactly."""
    transforms = {s.stamp_ns: s for t, s in stream if t == profile.topics.ground_truth_tf}
    for _, sample in stream:
        if isinstance(sample, DistanceSample):
            tool, tissue = (item.T_parent_child[:3, 3] for item in transforms[sample.stamp_ns].transforms)
            assert sample.planar_m == pytest.approx(np.hypot(*(tool - tissue)[:2]), abs=1e-15)
            assert sample.spatial_m == pytest.approx(np.linalg.norm(tool - tissue), abs=1e-15)


def test_the_robot_believes_its_encoders(stream: list, profile: Profile) -> None:
    """measured_cp and the chain of /tf are FK of the reported joints; truth is near, and not the same."""
    chain = make_scene(profile, 1).chain
    joints = {s.stamp_ns: s.positions for _, s in stream if isinstance(s, JointSample)}
    truth = {s.stamp_ns: s for t, s in stream if t == profile.topics.ground_truth_tf}
    for topic, sample in stream:
        if isinstance(sample, PoseSample):
            expected = forward_kinematics(chain, joints[sample.stamp_ns])
            np.testing.assert_allclose(sample.T_frame_pose, expected, atol=1e-12)
        if topic == profile.topics.tf and isinstance(sample, TransformsSample) and sample.stamp_ns in joints:
            T_camera_tool = np.linalg.multi_dot([item.T_parent_child for item in sample.transforms])
            true = truth[sample.stamp_ns].transforms[0].T_parent_child
            error_m = np.linalg.norm(T_camera_tool[:3, 3] - true[:3, 3])
            assert 1e-6 < error_m < 2e-3


def test_a_seed_gives_the_same_samples_in_every_process() -> None:
    """Stamps, joints, clearances and noisy pixels are bit-identical; another seed differs."""
    runs = [
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        ).stdout.strip()
        for code in (DIGEST, DIGEST, DIGEST.replace('"sweep", 3', '"sweep", 4'))
    ]
    assert len(runs[0]) == hashlib.sha256().digest_size * 2
    assert runs[0] == runs[1] != runs[2]


@pytest.mark.parametrize("seed", SEEDS)
def test_clearances_keep_their_promise(seed: int, profile: Profile) -> None:
    """approach ends 2 mm from the tissue, contact touches by at most 0.5 mm, all others stay clear."""
    scene = make_scene(profile, seed)
    progress = np.linspace(0.0, 1.0, 61)
    with ClearanceMeter(scene) as meter:
        for name in SCENARIOS:
            trajectory = make_trajectory(scene, Scenario(name, seed), WORKING_HEIGHT_M, progress, meter)
            smallest_m = min(meter.clearance_m(q) for q in trajectory.q)
            if name == "approach":
                assert smallest_m == pytest.approx(0.002, abs=1e-4)
            elif name == "contact":
                assert -0.0005 < smallest_m <= 0.0
            else:
                assert smallest_m > 0.0005, name


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", SCENARIOS)
def test_motions_stay_where_they_are_told(name: str, seed: int) -> None:
    """Heights and boxes of each scenario, for any seed; and no motion jumps."""
    s = np.linspace(0.0, 1.0, 1601)
    p_m = plan_motion(Scenario(name, seed), s, STAGE).p_world_tool_m
    if name in ("sweep", "calibration"):
        assert np.abs(p_m[:, 2] - WORKING_HEIGHT_M).max() <= 0.002
    if name == "sweep":
        assert np.abs(p_m[:, :2]).max(axis=0) == pytest.approx([0.034, 0.024], abs=2e-4)
    if name == "calibration":
        assert np.abs(p_m[:, :2]).max(axis=0) == pytest.approx([0.0455, 0.0335], abs=2e-4)
    if name == "random":
        assert np.ptp(p_m, axis=0) == pytest.approx([0.040, 0.030, 0.020], abs=5e-4)
    if name == "approach":
        assert np.hypot(*(p_m[0, :2])) > 0.04
    # Half the step halves the change of velocity: the velocity is continuous.
    assert np.abs(np.diff(p_m, 2, axis=0)).max() < 0.6 * np.abs(np.diff(p_m[::2], 2, axis=0)).max()


def test_curves_are_smooth_and_pass_their_knots() -> None:
    knots = np.random.default_rng(0).uniform(-1, 1, (7, 3))
    np.testing.assert_allclose(cubic_spline(knots, np.linspace(0, 1, 7)), knots, atol=1e-12)
    assert smooth_step(np.array([-1.0, 0.0, 0.5, 1.0, 2.0])) == pytest.approx([0.0, 0.0, 0.5, 1.0, 1.0])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("sweeep",), "did you mean sweep"),
        (("sweep", -1), "whole number"),
        (("sweep", 0, 0.0), "duration"),
        (("sweep", 0, 1.0, -5.0), "rate"),
        (("sweep", 0, 0.1, 1.0), "hold no frame"),
    ],
)
def test_a_wrong_scenario_is_told(arguments: tuple, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        Scenario(*arguments)


def test_noise_out_of_range_is_told(profile: Profile) -> None:
    with pytest.raises(UsageError, match="standard deviation"):
        next(simulate(Scenario("sweep"), profile, noise=-1.0))
