"""What an arm reports follows from its joints, and many stamps at once give what each gives alone."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.kinematics.dh import forward_kinematics
from svmdist.profile import Profile
from svmdist.samples import JointSample, PoseSample
from svmdist.simulation.arm import Arm, distances
from svmdist.simulation.scene import Extras
from svmdist.simulation.scenarios import Scenario
from svmdist.simulation.plan import make_plan


@pytest.fixture(scope="module")
def arm(profile: Profile) -> Arm:
    plan = make_plan(Scenario("sweep", 1, 1.0, 5.0), profile, extras=Extras(kinematic_error=1.0))
    return plan.arms[0]


def test_many_stamps_are_what_each_is_alone(arm: Arm) -> None:
    """Bit by bit, so that the length of a block leaves no trace in a recording."""
    together = arm.poses(3, 40)
    for index in (3, 17, 39):
        alone = arm.poses(index, index + 1)
        for name in ("reported", "T_base_tool", "T_camera_tool"):
            np.testing.assert_array_equal(getattr(together, name)[index - 3], getattr(alone, name)[0])


def test_reports_carry_the_offsets_and_truth_does_not(arm: Arm) -> None:
    poses, chain = arm.poses(0, 5), arm.scene.chain
    (_, joints), (_, pose) = arm.reports(1, poses, 2)
    assert isinstance(joints, JointSample)
    assert isinstance(pose, PoseSample)
    np.testing.assert_array_equal(joints.positions, arm.q[2] + arm.nominal.joint_offsets)
    # 1e-12 m and rad: two orders of summation.
    np.testing.assert_allclose(pose.T_frame_pose, forward_kinematics(chain, joints.positions), atol=1e-12)
    true = arm.scene.T_camera_base @ forward_kinematics(chain, arm.q[2])
    np.testing.assert_allclose(arm.true_transform(1, poses, 2).T_parent_child, true, atol=1e-12)


def test_the_nominal_chain_ends_at_the_reported_pose(arm: Arm) -> None:
    """/tf from base to tool multiplies to measured_cp; 1e-12 m and rad as above."""
    poses = arm.poses(0, 2)
    camera_base, *links = arm.nominal_transforms(1, poses, 1)
    np.testing.assert_array_equal(camera_base.T_parent_child, arm.nominal.T_camera_base)
    assert [link.parent for link in links[1:]] == [link.child for link in links[:-1]]
    product = np.linalg.multi_dot([link.T_parent_child for link in links])
    np.testing.assert_allclose(product, poses.T_base_tool[1], atol=1e-12)


def test_three_distances() -> None:
    sample = distances(7, np.array([0.003, -0.004, 0.012]), 0.001)
    assert sample.planar_m == pytest.approx(0.005, abs=1e-15)
    assert sample.spatial_m == pytest.approx(0.013, abs=1e-15)
    assert (sample.stamp_ns, sample.clearance_m) == (7, 0.001)
