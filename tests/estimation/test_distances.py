"""Distances, their standard deviations, and what the tissue's fix and the instrument's model are made of."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.estimation.distances import measured
from svmdist.estimation.dome import DomeModel
from svmdist.estimation.frame import Frame, frame_of
from svmdist.estimation.instrument.model import InstrumentModel, wrist_in_tool
from svmdist.estimation.instrument.tag_pose import nudged
from svmdist.estimation.scene import Arm
from svmdist.estimation.tissue import TissuePose, detect_tissue, tissue_frame
from svmdist.geometry.distance import signed_distances
from svmdist.geometry.surfaces import Plane
from svmdist.kinematics.dh import forward_kinematics
from svmdist.profile import Dome
from svmdist.results import FrameResult, ToolEstimate, ToolPose
from svmdist.samples import JointSample, Observation, Status
from svmdist.transforms import inverse, make_transform, rotation_x, rotation_z
from svmdist.vision.frame_context import FrameContext
from svmdist.vision.segmentation import make_segmenter
from tests.measuring import flat
from tests.shipped import CHAIN, POSTURE, PROFILE

JOINTS = JointSample(0, CHAIN.joint_names, POSTURE)
MODEL = InstrumentModel.of(PROFILE)
assert MODEL is not None
CAMERA = Camera.from_horizontal_fov(640, 480, np.pi / 3)
FLOOR = tissue_frame(np.array([0.0, 0.0, 0.112]), np.array([0.0, 0.0, -1.0]))


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


def test_distances_are_those_of_the_two_points() -> None:
    found = measure(tool_pose(), fix(), JOINTS)
    offset = tool_pose().position_m - fix().position_m
    assert found.distance_m == pytest.approx(np.hypot(*offset[:2]), abs=1e-12)
    assert found.spatial_m == pytest.approx(np.linalg.norm(offset), abs=1e-12)
    assert found.clearance_m is not None
    assert found.clearance_m < found.spatial_m
    assert found.clearance_direction == pytest.approx((0.0, 0.0, 1.0), abs=1e-12)
    assert found.tool_x_px == pytest.approx(CAMERA.project(tool_pose().position_m)[0][0])


def test_without_a_model_there_is_no_clearance() -> None:
    bodiless = Arm(PROFILE.model_copy(update={"instrument": None}))
    found = measure(tool_pose(), fix(), arm=bodiless)
    assert found.status is Status.OK
    assert (found.clearance_m, found.clearance_std_m, found.clearance_direction) == (None, None, None)


def test_a_pose_that_is_no_number_rejects_the_frame() -> None:
    broken = ToolPose(np.full((4, 4), np.nan), np.eye(6), np.array([0.0, 0.0, 1.0]))
    assert measure(broken, fix()).status is Status.NOT_FINITE


def test_the_wrist_follows_the_joints() -> None:
    """The hinge is 9.1 mm behind the tool, on the shaft's line from the remote centre, however the wrist bends."""
    rng = np.random.default_rng(8)
    for _ in range(20):
        q = POSTURE.copy()
        q[-3:-1] = rng.uniform(-1.2, 1.2, 2)
        bent = wrist_in_tool(CHAIN, q)
        assert np.linalg.norm(bent.hinge_m) == pytest.approx(0.0091, abs=1e-12)
        # Insertion moves the whole wrist along the shaft.
        further = q.copy()
        further[-5] += 0.01
        step = inverse(forward_kinematics(CHAIN, q)) @ forward_kinematics(CHAIN, further)
        np.testing.assert_allclose(step[:3, 3], 0.01 * bent.shaft, atol=1e-12)


def test_without_joints_the_instrument_is_straight() -> None:
    pose = tool_pose()
    capsules = MODEL.posed(pose)
    along = (capsules.end_m - pose.position_m) @ pose.axis
    assert along.min() == pytest.approx(-0.28 - 0.0091 + 0.002, abs=1e-9)
    assert along.max() == pytest.approx(0.008, abs=4e-4)


def test_a_dome_is_closed_and_as_high_as_told() -> None:
    angle = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    outline = np.stack([0.028 * np.cos(angle), 0.022 * np.sin(angle), np.full(360, 0.112)], -1)
    for ring in (outline, outline[::-1]):
        mesh = DomeModel.over(ring, FLOOR, Dome(height_m=0.008)).mesh()
        points = np.array([[0.0, 0.0, 0.108], [0.0, 0.0, 0.1035], [0.0, 0.0, 0.113], [0.02, 0.0, 0.111]])
        np.testing.assert_array_equal(signed_distances(points, mesh)[1] < 0.0, [True, False, False, True])
        assert mesh.vertices_m[:, 2].min() == pytest.approx(0.104, abs=1e-12)


def test_the_tissue_is_found_where_it_lies() -> None:
    """A drawn ellipse of which a bar hides a part is fixed on the plane, within what the fix says of itself."""
    errors = []
    rng = np.random.default_rng(9)
    for _ in range(30):
        image = np.full((480, 640, 3), 120, np.uint8)
        centre = np.array([320.0, 240.0]) + rng.uniform(-20, 20, 2)
        ys, xs = np.mgrid[:480, :640]
        image[((xs - centre[0]) / 138) ** 2 + ((ys - centre[1]) / 109) ** 2 <= 1] = (70, 60, 200)
        end = centre + rng.uniform(-60, 60, 2)
        cv2.line(image, (639, int(rng.uniform(50, 430))), tuple(end.astype(int).tolist()), (40, 40, 40), 40)
        detected = detect_tissue(FrameContext(image, SEGMENTER).masks, PROFILE, CAMERA)
        assert detected is not None
        assert detected.pose is not None
        truth = np.append((centre - CAMERA.K[:2, 2]) / CAMERA.K[0, 0], 1.0) * 0.112
        error = (detected.pose.position_m - truth)[:2]
        errors.append(error / np.sqrt(np.diag(detected.pose.covariance)[:2]))
    assert np.sqrt(np.mean(np.square(errors))) < 2.0
    assert np.mean(np.abs(errors) < 1.96) > 0.85


@pytest.mark.parametrize("count", [5, 34, 71, 360])
def test_a_dome_stands_on_an_outline_of_any_number_of_corners(count: int) -> None:
    angles = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    ring = np.stack([0.02 * np.cos(angles), 0.02 * np.sin(angles), np.full(count, 0.112)], -1)
    mesh = DomeModel.over(ring, FLOOR, Dome(height_m=0.008)).mesh()
    assert mesh.vertices_m[:, 2].min() == pytest.approx(0.104)


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
