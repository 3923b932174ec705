"""The robot's state, its poses and what a sample lacks; and inverse kinematics."""

import numpy as np
import pytest

from svmdist import kinematics
from svmdist.errors import KinematicsError
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile.robot import Joint
from svmdist.results import Failure
from svmdist.samples import JointSample
from svmdist.tracks import JointTrack
from svmdist.transforms import make_transform, rotation_of
from tests.shipped import CHAIN, POSTURE

T_CAMERA_BASE = make_transform(rotation_of([0.4, -0.7, 0.2]), [0.1, -0.2, 0.9])
JOINTS = JointSample(7, tuple(reversed(CHAIN.joint_names)), POSTURE[::-1])


def state_of(T_camera_base=T_CAMERA_BASE) -> RobotState:
    return RobotState.of(CHAIN, JOINTS, T_camera_base, 7)


def test_what_a_sample_lacks_is_told():
    """No sample, or one without the chain's joints: a failure in words."""
    assert RobotState.of(CHAIN, None, T_CAMERA_BASE, 0) == Failure("no joints near the image")
    few = RobotState.of(CHAIN, JointSample(0, ("elbow",), np.zeros(1)), T_CAMERA_BASE, 0)
    assert few.reason.startswith("the chain needs the joints")
    assert few.reason.endswith("the log has elbow")


def test_a_state_without_the_camera_still_knows_its_base_frame():
    """Poses in the base frame are there; what needs the camera raises ValueError with the reason."""
    state = state_of(T_camera_base=None)
    np.testing.assert_array_equal(state.T_base_tool, state_of().T_base_tool)
    with pytest.raises(ValueError, match="no transform from the camera to the base"):
        _ = state.T_camera_link(None)


BOUNDED = kinematics.DHChain(
    (
        Joint(name="arm", type="revolute", lower=-1.0, upper=1.0),
        Joint(name="insertion", type="prismatic", lower=0.0, upper=0.24),
    ),
    limit_tolerance_rad=0.1,
    limit_tolerance_m=0.01,
)


@pytest.mark.parametrize(
    ("positions", "said"),
    [
        ([0.5, 1e3], "joint insertion is at 1000 m, outside its limits 0 to 0.24 m and the tolerance 0.01 m"),
        ([0.5, 1e8], "joint insertion is at 1e+08 m"),
        ([-1.2, 0.1], "joint arm is at -1.2 rad, outside its limits -1 to 1 rad and the tolerance 0.1 rad"),
        ([1.05, 0.245], None),
        ([-1.05, -0.005], None),
    ],
)
def test_joints_outside_their_limits_are_not_believed(positions, said):
    """Beyond the limits by more than the tolerance, the first such joint is named."""
    joints = JointSample(0, ("arm", "insertion"), np.array(positions))
    state = RobotState.of(BOUNDED, joints, T_CAMERA_BASE, 0)
    assert isinstance(state, RobotState if said is None else Failure)
    assert said is None or state.reason.startswith(said)


def test_a_stray_sample_beside_the_image_is_left_out():
    """The joints at the stamp are sound: a sample of an impossible place near them has no part in their rates."""
    joints = JointSample(20, ("arm", "insertion"), np.array([0.5, 0.1]))
    positions = np.array([[0.5, 0.1], [0.5, 0.1], [0.5, 1e6]])
    track = JointTrack(np.array([10, 20, 30], np.int64), joints.names, positions)
    state = RobotState.of(BOUNDED, joints, T_CAMERA_BASE, 20, track)
    assert state.track.stamps_ns.tolist() == [10, 20]
    np.testing.assert_allclose(state.rates, 0.0)


FREE = ("yaw", "pitch", "insertion")


def test_solution_reaches_the_target_and_moves_only_free_joints():
    """FK of the solution is the target to 1e-9 m; yaw, pitch and insertion come back, the rest stays."""
    rng = np.random.default_rng(0)
    wanted = np.tile(POSTURE, (200, 1))
    free = [CHAIN.joint_names.index(name) for name in FREE]
    wanted[:, free] += rng.uniform(-1.0, 1.0, (200, 3)) * (0.3, 0.2, 0.04)
    wanted[:, -4:] += rng.uniform(-0.1, 0.1, (200, 4))
    targets_m = kinematics.forward_kinematics(CHAIN, wanted)[:, :3, 3]
    start = wanted.copy()
    start[:, free] = POSTURE[free]
    q = kinematics.solve_position(CHAIN, start, targets_m, FREE)
    np.testing.assert_allclose(kinematics.forward_kinematics(CHAIN, q)[:, :3, 3], targets_m, atol=1e-9)
    np.testing.assert_allclose(q, wanted, atol=1e-6)
    fixed = [index for index in range(13) if index not in free]
    assert np.array_equal(q[:, fixed], start[:, fixed])


def test_a_target_beyond_the_limits_or_out_of_reach_is_an_error():
    target_m = kinematics.forward_kinematics(CHAIN, POSTURE)[:3, 3] + [0.0, 0.0, -0.4]
    with pytest.raises(KinematicsError, match="outside its limits"):
        kinematics.solve_position(CHAIN, POSTURE[None], target_m[None], FREE)
    arm = kinematics.DHChain((Joint(name="a", type="revolute", a_m=0.5), Joint(name="b", type="revolute", a_m=0.5)))
    with pytest.raises(KinematicsError, match=r"out of reach: .* m are left"):
        kinematics.solve_position(arm, np.array([[0.1, 0.2]]), np.array([[2.0, 0.0, 0.0]]), ("a", "b"))
