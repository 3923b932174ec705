"""Distances to tissue and between instruments, and the standard deviations that hold them."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.estimation.distances import between_std_m, measured, with_clearance_between
from svmdist.estimation.frame import Frame, frame_of
from svmdist.estimation.instrument.model import InstrumentModel, wrist_in_tool
from svmdist.estimation.instrument.tag_pose import nudged
from svmdist.estimation.scene import Arm
from svmdist.estimation.tissue import TissuePose
from svmdist.geometry import Plane
from svmdist.geometry.distance import capsule_separation
from svmdist.results import Distance, Distances, FrameResult, ToolEstimate, ToolPose
from svmdist.samples import JointSample, Observation, Status
from svmdist.transforms import Array, make_transform, rotation_of, rotation_x, rotation_z
from svmdist.vision.segmentation import make_segmenter
from tests.measuring import flat
from tests.shipped import CHAIN, POSTURE, PROFILE

JOINTS = JointSample(0, CHAIN.joint_names, POSTURE)
CAMERA = Camera.from_horizontal_fov(640, 480, np.pi / 3)
ARM = Arm(PROFILE)
SEGMENTER = make_segmenter(PROFILE.segmentation)


def frame(arm: Arm = ARM) -> Frame:
    """A frame of which only the arm and the camera matter."""
    return frame_of(Observation(0, np.zeros((480, 640, 3), np.uint8), CAMERA), arm, SEGMENTER)


def measure(pose: ToolPose, tissue: TissuePose, joints: JointSample | None = None, arm: Arm = ARM):
    """All that `measured` tells, flat."""
    return flat(measured(FrameResult(0, Status.OK), frame(arm), ToolEstimate(pose, joints), tissue))


def tool_pose(covariance: np.ndarray | None = None) -> ToolPose:
    bent = wrist_in_tool(CHAIN, POSTURE)
    T = make_transform(rotation_x(2.4) @ rotation_z(0.3), [0.012, -0.006, 0.088])
    return ToolPose(T, np.zeros((6, 6)) if covariance is None else covariance, T[:3, :3] @ bent.shaft)


def fix(covariance: np.ndarray | None = None) -> TissuePose:
    floor = Plane(np.array([0.0, 0.0, -1.0]), -0.125)  # 3 mm below the instrument
    return TissuePose(
        np.array([0.0, 0.001, 0.112]), np.zeros((3, 3)) if covariance is None else covariance, floor
    )


def test_an_overlap_is_a_deviation() -> None:
    """Soft tissue gives way: 2 mm inside its model, the interval reaches contact. Outside nothing is added."""
    rng = np.random.default_rng(3)
    A = rng.normal(0.0, 1.0, (6, 6)) * np.array([2e-4] * 3 + [8e-3] * 3)[:, None]
    apart = measure(tool_pose(A @ A.T), fix(), JOINTS)
    floor = fix().surface
    assert isinstance(floor, Plane)
    assert apart.clearance_m > 0.0
    for clearance_m in (0.0005, -1e-6, -0.002):
        risen = Plane(floor.normal, floor.offset_m + apart.clearance_m - clearance_m)
        found = measure(tool_pose(A @ A.T), TissuePose(fix().position_m, fix().covariance, risen), JOINTS)
        assert found.clearance_m == pytest.approx(clearance_m, abs=1e-9)
        expected_m = np.hypot(apart.clearance_std_m, max(-clearance_m, 0.0))
        assert found.clearance_std_m == pytest.approx(expected_m, rel=1e-6)


def test_stated_deviations_cover_the_truth() -> None:
    """Of 2000 draws of pose and tissue, the 95 % intervals hold 90 to 99 % of the true distances."""
    rng = np.random.default_rng(7)
    A = rng.normal(0.0, 1.0, (6, 6)) * np.array([2e-4] * 3 + [8e-3] * 3)[:, None]
    B = rng.normal(0.0, 1.5e-4, (3, 3))
    held = np.zeros(3)
    exact = measure(tool_pose(), fix(), JOINTS)
    truth = np.array([exact.distance_m, exact.spatial_m, exact.clearance_m])
    surface = fix().surface
    assert isinstance(surface, Plane)
    for _ in range(2000):
        true = tool_pose()
        T = nudged(true.T_camera_tool, A @ rng.normal(size=6))
        shift = B @ rng.normal(size=3)
        moved = Plane(surface.normal, surface.offset_m + float(shift @ surface.normal))
        tissue = TissuePose(fix().position_m + shift, B @ B.T, moved)
        found = measure(ToolPose(T, A @ A.T, true.axis), tissue, JOINTS)
        values = np.array([found.distance_m, found.spatial_m, found.clearance_m])
        stds = np.array([found.distance_std_m, found.spatial_std_m, found.clearance_std_m])
        held += np.abs(values - truth) < 1.96 * stds
    assert np.all((held / 2000 > 0.90) & (held / 2000 < 0.99)), held / 2000


@pytest.mark.parametrize("beside_mm", [2.0, 10.0, 40.0])
def test_a_distance_says_how_uncertain_it_is_where_the_depth_is_the_least_certain(beside_mm):
    """A tool 6 mm uncertain along the view: the true lengths scatter about the told one as much as is stated."""
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = np.diag([0.5e-3, 0.5e-3, 6e-3]) ** 2
    tissue = fix()
    pose = tool_pose(covariance)
    T = pose.T_camera_tool.copy()
    T[:3, 3] = tissue.position_m + beside_mm * 1e-3 * np.eye(3)[0]
    pose = ToolPose(T, covariance, pose.axis)
    told = measure(pose, tissue)
    errors_m = np.random.default_rng(4).multivariate_normal(np.zeros(3), covariance[:3, :3], 40_000)
    errors_m += np.random.default_rng(5).multivariate_normal(np.zeros(3), tissue.covariance, 40_000)
    lengths_m = np.linalg.norm(pose.position_m - tissue.position_m + errors_m, axis=1)
    rms_m = np.sqrt(np.mean((lengths_m - told.spatial_m) ** 2))
    # The second order sees all of it where the offset is as long as its error, and bounds it below that.
    assert rms_m * 0.97 <= told.spatial_std_m <= rms_m * 1.35


BODY = InstrumentModel.of(PROFILE)
SPATIAL = Distances(spatial=Distance(0.02, 1e-3))


def pose_at(
    x_m: float, covariance: Array | None = None, turn: tuple[float, float, float] = (0, 0, 0)
) -> ToolPose:
    """A tool beside the optical axis, whose shaft comes from the camera's side."""
    R = rotation_of(turn)
    covariance = 1e-8 * np.eye(6) if covariance is None else covariance
    return ToolPose(make_transform(R, [x_m, 0.002, 0.09]), covariance, R @ [0.0, 0.0, 1.0])


def result_at(x_m: float, covariance: Array | None = None, status: Status = Status.OK) -> FrameResult:
    tool = ToolEstimate(pose_at(x_m, covariance, (0.2 * x_m / 0.01, 0.3, 0.0)))
    return FrameResult(7, status, tool=tool, distances=SPATIAL)


def between(*results: FrameResult) -> list[Distance | None]:
    filled = with_clearance_between(results, [BODY] * len(results))
    return [result.distances.to_instrument for result in filled]


def test_everyone_is_told_the_nearest() -> None:
    """Of three in a row the outer ones are told of the middle one; the middle one of the nearer of them."""
    first, middle, last = between(result_at(-0.03), result_at(0.0), result_at(0.02))
    assert first is not None
    assert middle is not None
    assert last is not None
    assert middle.value_m == last.value_m < first.value_m
    alone = between(result_at(-0.03), result_at(0.0))
    assert alone[0] == first


def test_the_deviation_is_that_of_two_poses_that_err_alone() -> None:
    """Against 1,500 pairs of drawn poses, within 8 %.

    As many samples settle a deviation to 1.8 % (1/√(2n)); 0.2 mm and 0.5° about tools whose closest points are 20 mm
    apart leave terms of second order of some percent.
    """
    assert BODY is not None
    rng = np.random.default_rng(5)
    roots = [rng.normal(size=(6, 6)) * np.array([[1e-4] * 3 + [4e-3] * 3]).T for _ in range(2)]
    poses = [
        pose_at(x_m, root @ root.T, turn)
        for x_m, root, turn in ((-0.012, roots[0], (0.2, 0.3, 0.0)), (0.012, roots[1], (-0.1, 0.1, 0.4)))
    ]
    gap = capsule_separation(BODY.posed(poses[0]), BODY.posed(poses[1]))
    told_m = between_std_m(gap, *poses)
    found_m = []
    for _ in range(1500):
        drawn = []
        for pose, root in zip(poses, roots, strict=True):
            step = root @ rng.normal(size=6)
            turn = rotation_of(step[3:])
            T = make_transform(turn @ pose.T_camera_tool[:3, :3], pose.position_m + step[:3])
            drawn.append(ToolPose(T, pose.covariance, turn @ pose.axis))
        found_m.append(capsule_separation(BODY.posed(drawn[0]), BODY.posed(drawn[1])).distance_m)
    assert told_m == pytest.approx(float(np.std(found_m)), rel=0.08)
