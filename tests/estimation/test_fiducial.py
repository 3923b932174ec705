"""The tag's pose on images made from a known pose, and the tool behind it."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from svmdist import kinematics
from svmdist.camera import Camera
from svmdist.estimation.frame import Arm
from svmdist.estimation.frame_methods import tool_from_tag
from svmdist.estimation.instrument.measurement import EXACT
from svmdist.estimation.instrument.tag_pose import TagPose, find_tag_pose
from svmdist.kinematics import DHChain
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile import load_profile
from svmdist.profile.robot import KinematicError
from svmdist.samples import JointSample, Observation, Status
from svmdist.transforms import Array, inverse, make_transform, rotation_of, rotation_x, rotation_z
from svmdist.vision.tags import TagPattern, find_tags, square_corners_m
from svmdist.workflows.check import arms_of
from tests.measuring import Measuring
from tests.shipped import CHAIN, POSTURE, PROFILE

SIZE_M = 0.007
CAMERA = Camera.from_horizontal_fov(640, 480, np.pi / 3)
PATTERN = TagPattern("36h11", 0, SIZE_M)
SAMPLES = 3


def tilted(rng: np.random.Generator, tilt: tuple[float, float], depth_m: float) -> Array:
    """A pose that shows the tag's face: half a turn about x, a tilt, a turn in the image."""
    about = rng.uniform(0, 2 * np.pi)
    R = rotation_z(rng.uniform(-np.pi, np.pi)) @ rotation_x(np.pi)
    R = R @ rotation_z(about) @ rotation_of([0.0, rng.uniform(*tilt), 0.0]) @ rotation_z(-about)
    return make_transform(R, [*(depth_m * rng.uniform(-0.25, 0.25, 2)), depth_m])


def draw(T_camera_tag: Array, noise: float, seed: int) -> np.ndarray:
    """The tag on a grey ground, by a homography, each pixel the mean of nine samples, blurred and noisy."""
    cells = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11), 0, 8)
    plate = np.kron(np.pad(cells, 1, constant_values=255), np.ones((24, 24), np.uint8)).astype(np.uint8)
    half = SIZE_M / 2 * 10 / 8
    corners_px = CAMERA.project(square_corners_m(2 * half) @ T_camera_tag[:3, :3].T + T_camera_tag[:3, 3])
    # Texture pixel 0 spans from -0.5 to 0.5; the same of the image, whose samples are SAMPLES times as dense.
    side = plate.shape[0] - 0.5
    source = np.float32([[-0.5, -0.5], [side, -0.5], [side, side], [-0.5, side]])
    H = cv2.getPerspectiveTransform(source, ((corners_px + 0.5) * SAMPLES - 0.5).astype(np.float32))
    size = (640 * SAMPLES, 480 * SAMPLES)
    values = 22.0 + 203.0 / 255.0 * plate.astype(np.float32)
    dense = cv2.warpPerspective(values, H, size, borderMode=cv2.BORDER_CONSTANT, borderValue=-1.0)
    inside = cv2.warpPerspective(np.ones_like(values), H, size) > 0.999
    dense = np.where(inside, dense, 110.0).astype(np.float32)
    image = cv2.GaussianBlur(cv2.resize(dense, (640, 480), interpolation=cv2.INTER_AREA), (0, 0), 0.8)
    image = image + np.random.default_rng(seed).normal(0, noise, image.shape)
    return np.clip(np.round(image), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("is_shown", [False, True])
def test_one_tag_says_that_all_instruments_carry_theirs(is_shown):
    """Blood may hide the other one's throughout a log."""
    grey = draw(tilted(np.random.default_rng(1), (0.3, 0.8), 0.08), 2.0, 0)
    bgr = np.dstack([grey if is_shown else np.full_like(grey, 110)] * 3)
    spread = [SimpleNamespace(decoded=SimpleNamespace(seen=(Observation(0, bgr, CAMERA),)))]
    log = SimpleNamespace(instruments=("PSM1", "PSM2"))
    assert [arm.has_plate for arm in arms_of(log, PROFILE, spread)] == [is_shown, is_shown]


@pytest.mark.parametrize("depth_m", [0.06, 0.09, 0.12])
@pytest.mark.parametrize("noise", [0.0, 2.0, 6.0])
def test_a_tag_is_placed_to_a_tenth_of_a_millimetre(depth_m, noise):
    """At all depths and with noise: within 0.03 mm across, 0.3 mm in depth, 0.8° of tilt, and as good as it says."""
    rng, squared = np.random.default_rng(round(1000 * depth_m)), []
    for seed in range(6):
        T = tilted(rng, (0.3, 0.8), depth_m)
        # Small and noisy tags need nominal kinematics to tell which of the two poses it is.
        image = draw(T, noise, seed)
        corners = find_tags(image, "36h11", PROFILE.settings.tag)[0]
        pose = find_tag_pose(image, corners, CAMERA, PATTERN, rotation_x(0.05) @ T[:3, :3])
        error_m = pose.T_camera_tag[:3, 3] - T[:3, 3]
        turn = cv2.Rodrigues(T[:3, :3] @ pose.T_camera_tag[:3, :3].T)[0].ravel()
        assert np.linalg.norm(error_m[:2]) < 1e-4
        assert abs(error_m[2]) < 3e-4
        assert np.linalg.norm(turn) < 0.015
        error = np.concatenate([-error_m, turn])
        floor = np.diag([1e-5] * 3 + [5e-4] * 3) ** 2
        assert error @ np.linalg.solve(pose.covariance + floor, error) < 40.0  # six degrees of freedom
        squared.append(error @ np.linalg.solve(pose.covariance, error) / 6.0)
    # Pixels that integrate over their area do better than stated, by their noise; never worse.
    assert 0.1 < np.mean(squared) < (1.5 if noise == 0.0 else 1.0)


@pytest.mark.parametrize("name", ["psm13", "dvrk-psm"])
def test_a_length_moves_the_tool_along_its_own_axis(name):
    """In both conventions: the covariance is that of the derivatives by differences of the chain's lengths."""
    profile, mounting = load_profile(name), PROFILE.fiducial
    chain = kinematics.chain_of(profile.robot)
    link = chain.rows[kinematics.rows_behind_insertion(chain)[0]].name
    exact = {"size_std_fraction": 0.0, "position_std_m": 0.0, "rotation_std_rad": 0.0}
    fiducial = mounting.model_copy(update={"link": link, **exact})
    q = 0.4 * chain.lower + 0.6 * chain.upper
    tag = TagPose(make_transform(rotation_x(2.0), [0.0, 0.0, 0.09]), np.zeros((6, 6)))
    error = KinematicError(joint_std_rad=0.0, joint_std_m=0.0, play_std_rad=0.0, length_std_m=4e-4)
    arm = Arm(profile.model_copy(update={"fiducial": fiducial, "kinematic_error": error, "camera_error": EXACT}))

    def tool_m(chain: DHChain) -> Array:
        return tool_from_tag(arm, CAMERA, tag, RobotState(chain, 0, q)).position_m

    expected = np.zeros((3, 3))
    for index in range(kinematics.row_index(chain, fiducial.link) + 1, len(chain.rows)):
        if chain.rows[index].a_m != 0.0:
            rows = list(chain.rows)
            rows[index] = rows[index].model_copy(update={"a_m": rows[index].a_m + 1e-6})
            longer = DHChain(tuple(rows), chain.convention, chain.T_last_tool)
            moved_m = (tool_m(longer) - tool_m(chain)) / 1e-6 * 4e-4
            expected += np.outer(moved_m, moved_m)
    assert np.trace(expected) > 0.0
    found = tool_from_tag(arm, CAMERA, tag, RobotState(chain, 0, q)).position_covariance
    np.testing.assert_allclose(found, expected, atol=1e-14)


def observation(joints: bool = True, tag: bool = True) -> tuple[Observation, Array]:
    """A drawn scene: the red organ, the tag over it; and the true pose of the tool."""
    fiducial = PROFILE.fiducial
    T = make_transform(rotation_x(np.pi + 0.5) @ rotation_of([0.0, 0.2, 0.0]), [0.02, 0.01, 0.085])
    grey = draw(T, 2.0, 3) if tag else np.full((480, 640), 110, np.uint8)
    image = np.repeat(grey[..., None], 3, axis=2)
    ys, xs = np.mgrid[:480, :640]
    image[((xs - 150.0) / 110) ** 2 + ((ys - 200.0) / 90) ** 2 <= 1] = (70, 60, 200)
    T_base_tag = (
        kinematics.frame_transforms(CHAIN, POSTURE)[kinematics.row_index(CHAIN, fiducial.link)] @ fiducial.T_link_tag
    )
    T_camera_tool = T @ inverse(T_base_tag) @ kinematics.forward_kinematics(CHAIN, POSTURE)
    sample = JointSample(5, CHAIN.joint_names, POSTURE) if joints else None
    return Observation(5, image, CAMERA, sample), T_camera_tool


def test_a_frame_is_measured():
    """Tool within 0.2 mm, all three distances, and the interval holds the spatial distance."""
    seen, T_camera_tool = observation()
    row = Measuring("fiducial", PROFILE).estimate(seen)
    assert row.status is Status.OK
    np.testing.assert_allclose(row.tool_position_m, T_camera_tool[:3, 3], atol=2e-4)
    tissue = np.append((np.array([150.0, 200.0]) - CAMERA.K[:2, 2]) / CAMERA.K[0, 0], 1.0) * 0.112
    truth = float(np.linalg.norm(T_camera_tool[:3, 3] - tissue))
    assert abs(row.spatial_m - truth) < 3.0 * row.spatial_std_m < 4e-3
    assert None not in (row.distance_m, row.clearance_m, row.clearance_std_m, row.tool_axis)


@pytest.mark.parametrize(
    ("joints", "tag", "status"), [(True, False, Status.NO_FIDUCIAL), (False, True, Status.NO_JOINTS)]
)
def test_what_is_missing_is_the_reason(joints, tag, status):
    row = Measuring("fiducial", PROFILE).estimate(observation(joints, tag)[0])
    assert row.status is status
    assert (row.distance_m, row.spatial_m) == (None, None)
    assert row.tissue_x_px == pytest.approx(150.0, abs=1.0)
