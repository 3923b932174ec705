"""The right camera, the tag and the kinematic error: what they add, and that they change nothing else."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from svmdist.errors import SimulationError, UsageError
from svmdist.kinematics.dh import forward_kinematics
from svmdist.kinematics.inverse import solve_position
from svmdist.profile import Profile
from svmdist.recording.log import open_recording
from svmdist.samples import CameraSample, ImageSample, JointSample, Sample, TransformsSample
from svmdist.simulation.extras import Extras
from svmdist.simulation.motion.scenarios import Scenario
from svmdist.simulation.nominal import draw_nominal_kinematics
from svmdist.simulation.scene import Scene, make_scene
from svmdist.transforms import Array, inverse, rotation_angle, transform_points

pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
from svmdist.simulation.clearance.meters import ClearanceMeter
from svmdist.simulation.renderer import Renderer
from svmdist.simulation.sensor import Sensor
from svmdist.simulation.simulate import simulate

SHORT = Scenario("sweep", 1, 0.2, 10.0)
EVERYTHING = Extras(stereo=True, tag=True, kinematic_error=1.0)
Stream = list[tuple[str, Sample]]


@pytest.fixture(scope="module")
def full(profile: Profile) -> Stream:
    return list(simulate(SHORT, profile, noise=2.0, extras=EVERYTHING))


def test_the_plain_recording_is_that_of_the_golden_log(golden: Path, profile: Profile) -> None:
    """Progress is part of the path: the whole sweep is planned, two of its frames are drawn."""
    recording = open_recording(golden / "sweep.mcap", profile)
    truth = recording.transform_track("camera", "tool", ground_truth=True)
    distances = recording.distance_track()
    nominal = recording.joint_track()
    images = recording.images()
    logged = [next(images), next(images)]
    drawn = 0
    for topic, sample in simulate(Scenario("sweep", 1), profile):
        if isinstance(sample, ImageSample):
            image = logged[drawn]
            assert isinstance(image, ImageSample)
            assert image.stamp_ns == sample.stamp_ns
            np.testing.assert_array_equal(image.image_bgr, sample.image_bgr)
            drawn += 1
            if drawn == len(logged):
                break
        elif topic == profile.topics.ground_truth_tf and isinstance(sample, TransformsSample):
            index = np.searchsorted(truth.stamps_ns, sample.stamp_ns)
            # The log keeps rotations as quaternions.
            np.testing.assert_allclose(
                truth.T_parent_child[index], sample.transforms[0].T_parent_child, atol=1e-15
            )
        elif topic == profile.topics.ground_truth_distance:
            index = np.searchsorted(distances.stamps_ns, sample.stamp_ns)
            assert distances.planar_m[index] == sample.planar_m
            assert distances.spatial_m[index] == sample.spatial_m
            assert distances.clearance_m[index] == sample.clearance_m
        elif isinstance(sample, JointSample):
            index = np.searchsorted(nominal.stamps_ns, sample.stamp_ns)
            np.testing.assert_array_equal(nominal.positions[index], sample.positions)
    assert drawn == len(logged)


def test_extras_leave_truth_and_left_camera_alone(full: Stream, profile: Profile) -> None:
    """Bit by bit: kinematic error, tag and second camera change neither truth nor the rest of the image."""
    plain = list(simulate(SHORT, profile, noise=2.0))
    with_error = list(simulate(SHORT, profile, noise=2.0, extras=Extras(kinematic_error=1.0)))
    for topic in (profile.topics.ground_truth_tf, profile.topics.ground_truth_distance):
        truths = [repr([s for t, s in stream if t == topic]) for stream in (plain, with_error, full)]
        assert truths[0] == truths[1] == truths[2]
    images = [
        [s.image_bgr for t, s in stream if t == profile.topics.image and isinstance(s, ImageSample)]
        for stream in (plain, with_error, full)
    ]
    np.testing.assert_array_equal(images[0], images[1])
    differs = np.any(images[0][0] != images[2][0], axis=-1)
    assert 0 < differs.sum() < 6000  # the plate and nothing else


def test_stereo_adds_a_rectified_pair(full: Stream, profile: Profile, scene: Scene) -> None:
    left, right = (
        next(s.camera for t, s in full if t == topic and isinstance(s, CameraSample))
        for topic in (profile.topics.camera_info, profile.topics.right_camera_info)
    )
    assert left.same_optics(right)
    assert left.P is not None
    assert right.P is not None
    assert right.P[0, 3] == pytest.approx(-left.K[0, 0] * 0.005)
    np.testing.assert_array_equal(right.P[:, :3], left.P[:, :3])
    stamps = [
        [s.stamp_ns for t, s in full if t == topic]
        for topic in (profile.topics.image, profile.topics.right_image)
    ]
    assert stamps[0] == stamps[1]
    nominal = next(s for t, s in full if t == profile.topics.tf and isinstance(s, TransformsSample))
    T_left_right = {item.child: item.T_parent_child for item in nominal.transforms}["camera_right"]
    np.testing.assert_allclose(T_left_right[:3, 3], [0.005, 0.0, 0.0])


def test_the_right_camera_sees_the_disparity_of_its_baseline(scene: Scene, profile: Profile) -> None:
    """The distal marker's silhouette moves by f b / z along the rows, to 0.15 px, and not across them."""
    q, p_camera_m = posed(scene, [0.005, -0.02, 0.0245])
    with Renderer(scene) as renderer:
        left, right = (marker_px(image) for image in (renderer.frame_of(q), renderer.right_frame()))
    expected_px = scene.camera.K[0, 0] * 0.005 / p_camera_m[2]
    np.testing.assert_allclose(left - right, [expected_px, 0.0], atol=0.15)


def posed(scene: Scene, p_world_m: list[float]) -> tuple[Array, Array]:
    target_m = transform_points(inverse(scene.T_world_base), np.array([p_world_m]))
    q = solve_position(scene.chain, scene.posture[None], target_m, ("yaw", "pitch", "insertion"))[0]
    return q, transform_points(inverse(scene.T_world_camera), np.array([p_world_m]))[0]


def marker_px(image: np.ndarray) -> np.ndarray:
    hsv = cv2.cvtColor(image, cv2.COLOR_BGR2HSV)
    mask = cv2.inRange(hsv, (80, 90, 40), (105, 255, 255))
    moments = cv2.moments(mask, binaryImage=True)
    return np.array([moments["m10"], moments["m01"]]) / moments["m00"]


def test_the_tag_is_decoded_where_the_profile_says(profile: Profile) -> None:
    """All over its field of view: OpenCV finds it, and every corner within 1 px of its projection."""
    scene = make_scene(profile, 1, Extras(tag=True))
    assert profile.fiducial is not None
    half_m = profile.fiducial.size_m / 2.0
    corners_m = half_m * np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.cornerRefinementWinSize = 3
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    detector = cv2.aruco.ArucoDetector(dictionary, parameters)
    errors_px = []
    with Renderer(scene) as renderer:
        for x_m in (-0.03, -0.01, 0.01):
            for y_m in (-0.022, 0.0, 0.022):
                q, _ = posed(scene, [x_m, y_m, 0.0245])
                corners, ids, _ = detector.detectMarkers(renderer.frame_of(q))
                assert ids is not None
                assert ids.ravel().tolist() == [profile.fiducial.id]
                T_world_tag = scene.link_poses(q)[profile.fiducial.link] @ profile.fiducial.T_link_tag
                T_camera_tag = inverse(scene.T_world_camera) @ T_world_tag
                expected_px = scene.camera.project(transform_points(T_camera_tag, corners_m))
                errors_px.append(corners[0][0] - expected_px)
    assert np.abs(errors_px).max() < 1.0
    assert np.abs(np.mean(errors_px, axis=(0, 1))).max() < 0.1


def test_the_plate_counts_in_the_clearance(profile: Profile) -> None:
    """A plate that reaches down to the tissue is the closest part."""
    assert profile.fiducial is not None
    hanging = profile.fiducial.model_copy(update={"position_m": (0.0, 0.0085, -0.012)})
    odd = profile.model_copy(update={"fiducial": hanging})
    clearances_m = []
    for extras, chosen in ((Extras(), profile), (Extras(tag=True), profile), (Extras(tag=True), odd)):
        scene = make_scene(chosen, 1, extras)
        q, _ = posed(scene, [-0.015, 0.0, 0.0245])
        with ClearanceMeter(scene) as meter:
            clearances_m.append(meter.clearance_m(q))
    assert clearances_m[0] == clearances_m[1] > clearances_m[2] + 1e-3


def test_kinematic_error_has_the_profiles_spread(scene: Scene, profile: Profile) -> None:
    """Over 400 seeds: the moving joints and T_camera_base are off by 1°, 1 mm, 2° and 5 mm; others are not."""
    nominals = [
        draw_nominal_kinematics(scene.chain, scene.T_camera_base, profile, seed, 1.0) for seed in range(400)
    ]
    plain = [draw_nominal_kinematics(scene.chain, scene.T_camera_base, profile, seed) for seed in range(400)]
    offsets = np.array([a.joint_offsets - b.joint_offsets for a, b in zip(nominals, plain, strict=True)])
    names = scene.chain.joint_names
    moving = names.index("yaw")
    assert not offsets[:, :moving].any()
    std = offsets.std(axis=0)[moving:]
    expected = [0.001 if name == "insertion" else np.radians(1.0) for name in names[moving:]]
    np.testing.assert_allclose(std, expected, rtol=0.15)
    np.testing.assert_allclose(offsets.mean(axis=0)[moving:] / expected, 0.0, atol=0.2)
    T = np.array([nominal.T_camera_base for nominal in nominals])
    shifts_m = T[:, :3, 3] - scene.T_camera_base[:3, 3]
    np.testing.assert_allclose(shifts_m.std(axis=0), 0.005, rtol=0.15)
    turns_rad = rotation_angle(T[:, :3, :3], scene.T_camera_base[:3, :3])
    assert np.sqrt(np.mean(turns_rad**2)) == pytest.approx(np.radians(2.0) * np.sqrt(3.0), rel=0.1)


def test_kinematic_error_grows_with_its_scale(scene: Scene, profile: Profile) -> None:
    """The same seed errs in the same direction, twice as much at twice the scale."""
    zero, one, two = (
        draw_nominal_kinematics(scene.chain, scene.T_camera_base, profile, 3, scale)
        for scale in (0.0, 1.0, 2.0)
    )
    np.testing.assert_array_equal(zero.T_camera_base, scene.T_camera_base)
    np.testing.assert_allclose(
        two.joint_offsets - zero.joint_offsets, 2.0 * (one.joint_offsets - zero.joint_offsets)
    )
    np.testing.assert_allclose(
        two.T_camera_base[:3, 3] - zero.T_camera_base[:3, 3],
        2.0 * (one.T_camera_base[:3, 3] - zero.T_camera_base[:3, 3]),
    )


def test_the_log_carries_the_error(full: Stream, profile: Profile, scene: Scene) -> None:
    """/tf and measured_js give what was drawn, on top of truth."""
    nominal = draw_nominal_kinematics(scene.chain, scene.T_camera_base, profile, SHORT.seed, 1.0)
    tf = next(s for t, s in full if t == profile.topics.tf and isinstance(s, TransformsSample))
    np.testing.assert_array_equal(tf.transforms[0].T_parent_child, nominal.T_camera_base)
    joints = next(s for _, s in full if isinstance(s, JointSample) and s.stamp_ns == tf.stamp_ns)
    truth = next(
        s
        for t, s in full
        if t == profile.topics.ground_truth_tf
        and isinstance(s, TransformsSample)
        and s.stamp_ns == tf.stamp_ns
    )
    true_joints = joints.positions - nominal.joint_offsets
    np.testing.assert_allclose(
        scene.T_camera_base @ forward_kinematics(scene.chain, true_joints),
        truth.transforms[0].T_parent_child,
        atol=1e-12,
    )


def test_degradations_come_behind_the_noise_and_by_frame(profile: Profile) -> None:
    """Both cameras look through the same smoke, other smoke in the next frame; noise is each camera's own."""
    grey = np.full((120, 640, 3), 128, np.uint8)

    def frames(camera: int, *degradations: tuple[str, int], noise: float = 0.0) -> list[np.ndarray]:
        sensor = Sensor(camera, 1, noise, Extras(degradations=degradations))
        return [sensor.expose(grey, sensor.draw_noise(640, 120), frame) for frame in range(2)]

    left, right = (frames(camera, ("smoke", 3)) for camera in (0, 1))
    np.testing.assert_array_equal(left[0], right[0])
    assert (left[0] != left[1]).any()
    left, right = (frames(camera, ("noise", 3)) for camera in (0, 1))
    assert (left[0] != right[0]).any()
    # A blur behind the noise takes most of it away.
    assert frames(0, ("defocus", 4), noise=10.0)[0].std() < 3.0


def test_metadata_names_what_is_set() -> None:
    assert Extras().metadata() == {}
    spoilt = Extras(degradations=(("smoke", 3), ("jpeg", 1)))
    assert spoilt.metadata() == {"degrade": "smoke=3,jpeg=1"}
    assert EVERYTHING.metadata() == {"stereo": "yes", "tag": "yes", "kinematic_error": "1"}


def test_what_cannot_be_is_told(profile: Profile) -> None:
    with pytest.raises(UsageError, match="from 0 to 20"):
        Extras(kinematic_error=-1.0)
    with pytest.raises(UsageError, match="did you mean smoke"):
        Extras(degradations=(("smok", 3),))
    with pytest.raises(UsageError, match="1 to 5"):
        Extras(degradations=(("smoke", 6),))
    with pytest.raises(SimulationError, match=r"\[fiducial\]"):
        make_scene(profile.model_copy(update={"fiducial": None}), 1, Extras(tag=True))
    assert profile.fiducial is not None
    unknown = profile.fiducial.model_copy(update={"id": 587})
    with pytest.raises(SimulationError, match="0 to 586"):
        make_scene(profile.model_copy(update={"fiducial": unknown}), 1, Extras(tag=True))
