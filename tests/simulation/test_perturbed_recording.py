"""Recordings of perturbed worlds: what is off is off by the strength, truth is that of what is built."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from svmdist.camera import stereo_transform
from svmdist.kinematics.dh import forward_kinematics
from svmdist.perturbations.chosen import UNPERTURBED, Perturbations, World, draw_world, parse_perturbations
from svmdist.perturbations.images import perturbed_right_view
from svmdist.perturbations.shape import plane_tilt, stated_profile
from svmdist.profile import Profile
from svmdist.recording.log import Recording, open_recording
from svmdist.samples import CameraSample, ImageSample, Observation, RightView, Sample, TransformsSample
from svmdist.simulation.extras import Extras
from svmdist.simulation.motion.scenarios import Scenario
from svmdist.simulation.plan import Plan, make_plan
from svmdist.simulation.reports import reported_joints
from svmdist.transforms import inverse, transform_points
from svmdist.workflows.record import record

pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
from svmdist.simulation.simulate import simulate

SHORT = Scenario("sweep", 2, 0.2, 10.0)
QUICK = Scenario("random", 2, 8.0, 10.0)
REPORTED = "backlash=0.5,joint_drift=0.2,joint_noise=0.02,quantisation=0.02,lag=30"
STATED = "focal=1,principal_point=2,baseline=0.2"
Stream = list[tuple[str, Sample]]


def stream(profile: Profile, text: str = "") -> Stream:
    return list(
        simulate(SHORT, profile, noise=1.0, extras=Extras(stereo=True, tag=True, perturbations=chosen(text)))
    )


def chosen(text: str) -> Perturbations:
    return parse_perturbations(text) if text else UNPERTURBED


def planned(profile: Profile, text: str, **extras: object) -> Plan:
    return make_plan(QUICK, profile, extras=Extras(perturbations=chosen(text), **extras))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def plain(profile: Profile) -> Stream:
    return stream(profile)


def of(found: Stream, topic: str | None) -> list[Sample]:
    return [sample for name, sample in found if name == topic]


def test_images_and_truth_do_not_know_what_is_reported_and_stated(plain: Stream, profile: Profile) -> None:
    """Bit by bit: joints, clock and calibration that are told wrongly leave everything else as it is."""
    topics = profile.topics
    told = stream(profile, f"{REPORTED},{STATED}")
    for topic in (topics.ground_truth_tf, topics.ground_truth_distance):
        assert repr(of(told, topic)) == repr(of(plain, topic))
    for topic in (topics.image, topics.right_image):
        for one, other in zip(of(told, topic), of(plain, topic), strict=True):
            assert isinstance(one, ImageSample)
            assert isinstance(other, ImageSample)
            np.testing.assert_array_equal(one.image_bgr, other.image_bgr)
    assert [(t, s.stamp_ns) for t, s in told] == [(t, s.stamp_ns) for t, s in plain]
    for topic in (topics.joints, topics.pose, topics.tf, topics.camera_info, topics.right_camera_info):
        assert repr(of(told, topic)) != repr(of(plain, topic))


def test_the_log_states_other_cameras(profile: Profile) -> None:
    told = stream(profile, STATED)
    left, right = (
        sample.camera
        for topic in (profile.topics.camera_info, profile.topics.right_camera_info)
        for sample in of(told, topic)[:1]
        if isinstance(sample, CameraSample)
    )
    true = planned(profile, "").scene.camera
    assert left.K[0, 0] == pytest.approx(1.01 * true.K[0, 0])
    T = stereo_transform(left, right)
    assert T is not None
    np.testing.assert_allclose(T[:3, 3], [0.0052, 0.0, 0.0], atol=1e-9)
    tf = of(told, profile.topics.tf)[0]
    assert isinstance(tf, TransformsSample)
    (in_tf,) = (item.T_parent_child for item in tf.transforms if item.child == "camera_right")
    np.testing.assert_array_equal(in_tf, T)


def test_a_zoom_is_drawn_and_not_told(plain: Stream, profile: Profile) -> None:
    zoomed = stream(profile, "zoom=1.1")
    told, plainly = (of(found, profile.topics.camera_info)[0] for found in (zoomed, plain))
    assert isinstance(told, CameraSample)
    assert isinstance(plainly, CameraSample)
    assert told.camera.same_optics(plainly.camera)
    assert planned(profile, "zoom=1.1").scene.camera.K[0, 0] == pytest.approx(1.1 * plainly.camera.K[0, 0])
    one, other = (of(found, profile.topics.image)[0] for found in (zoomed, plain))
    assert isinstance(one, ImageSample)
    assert isinstance(other, ImageSample)
    assert (one.image_bgr != other.image_bgr).any()


def test_a_right_camera_is_turned_and_not_told(plain: Stream, profile: Profile) -> None:
    """What is drawn is what a replay makes of the plain right image, to interpolation; the left one stays."""
    text = "right_yaw=0.3,right_pitch=-0.2,right_roll=1"
    turned = stream(profile, text)
    for topic in (profile.topics.camera_info, profile.topics.right_camera_info, profile.topics.tf):
        assert repr(of(turned, topic)) == repr(of(plain, topic))
    left, right = (
        next(sample.image_bgr for sample in of(found, topic) if isinstance(sample, ImageSample))
        for found, topic in ((turned, profile.topics.image), (turned, profile.topics.right_image))
    )
    plainly, plain_right = (
        of(plain, topic)[0] for topic in (profile.topics.image, profile.topics.right_image)
    )
    assert isinstance(plainly, ImageSample)
    assert isinstance(plain_right, ImageSample)
    np.testing.assert_array_equal(left, plainly.image_bgr)
    scene = planned(profile, "").scene
    made = perturbed_right_view(RightView(plain_right.image_bgr, scene.right_camera, np.eye(4)), chosen(text))
    inside = (slice(20, -20), slice(20, -20))
    off = [
        np.abs(right[inside].astype(float) - other[inside]).mean()
        for other in (made.image_bgr, plain_right.image_bgr)
    ]
    assert off[0] < 0.5 * off[1]
    assert off[0] < 2.0


def test_plane_and_tilt_are_built_and_the_profile_is_wrong_about_them(profile: Profile) -> None:
    """In the camera's frame the true floor is the stated one less the strength; the tool is still over it."""
    text = "plane=1,plane_tilt=2"
    scene = planned(profile, text).scene
    floor_m = transform_points(inverse(scene.T_world_camera), np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    normal = floor_m[1] - floor_m[0]
    assert -normal @ floor_m[0] == pytest.approx(0.111)
    np.testing.assert_allclose(plane_tilt(chosen(text), QUICK.seed) @ normal, [0.0, 0.0, -1.0], atol=1e-12)
    np.testing.assert_allclose(floor_m[0][:2], 0.0, atol=1e-12)  # still in the middle of the image


def test_sizes_are_built_and_the_robot_believes_its_profile(profile: Profile) -> None:
    """The wrist is 1 mm shorter than is said: the tool is 1 mm off where the robot puts it, along the wrist."""
    plan = planned(profile, "wrist_length=1,shaft_radius=5,knuckle_radius=5,tag_size=2", tag=True)
    arm, scene = plan.arms[0], plan.scene
    exact = forward_kinematics(arm.nominal.chain, arm.q[:5])
    true = forward_kinematics(scene.chain, arm.q[:5])
    np.testing.assert_allclose(np.linalg.norm(exact[:, :3, 3] - true[:, :3, 3], axis=1), 0.001, rtol=1e-6)
    poses = arm.poses(0, 5)
    np.testing.assert_allclose(poses.T_camera_tool, scene.T_camera_base @ true)
    np.testing.assert_array_equal(poses.T_base_tool, forward_kinematics(arm.nominal.chain, poses.reported))
    radii = {part.name: np.ptp(part.mesh.vertices_m, axis=0) / 2.0 for part in scene.parts}
    assert radii["knuckle"].max() == pytest.approx(0.00175 / 1.05, rel=1e-3)
    assert np.sort(radii["shaft"])[:2] == pytest.approx([0.004 / 1.05] * 2, rel=1e-3)
    assert scene.plate is not None
    assert np.ptp(scene.plate.mesh.vertices_m[:, 0]) == pytest.approx(0.007 * 10 / 8 / 1.02)


def test_the_second_arm_is_perturbed_alike(profile: Profile) -> None:
    plan = planned(profile, "shaft_radius=5,plane=1,joint_noise=0.1,wrist_length=1", arms=2)
    first, second = plan.arms
    np.testing.assert_array_equal(second.scene.T_world_camera, first.scene.T_world_camera)
    for one, other in zip(first.scene.parts, second.scene.parts, strict=True):
        np.testing.assert_array_equal(one.mesh.vertices_m, other.mesh.vertices_m)
    moving = slice(first.scene.chain.joint_names.index("yaw"), None)
    noise = [
        (arm.reported - arm.q - arm.nominal.joint_offsets)[plan.with_joints][:, moving] for arm in plan.arms
    ]
    assert noise[0].std() == pytest.approx(noise[1].std(), rel=0.1)
    assert abs(np.corrcoef(noise[0].ravel(), noise[1].ravel())[0, 1]) < 0.05
    assert second.nominal.chain.rows == first.nominal.chain.rows != first.scene.chain.rows


def test_a_real_world_is_drawn_whole_and_named(profile: Profile, tmp_path: Path) -> None:
    """Every value is in the metadata, and makes the same recording again without the word real."""
    drawn = draw_world(World.REAL, SHORT.seed)
    path, again = tmp_path / "real.mcap", tmp_path / "again.mcap"
    record(
        SHORT,
        profile,
        path,
        extras=Extras(stereo=True, tag=True, perturbations=drawn, world=World.REAL),
        jobs=1,
    )
    metadata = open_recording(path, profile).metadata
    assert metadata["world"] == "real"
    assert parse_perturbations(metadata["perturb"]) == drawn
    by_hand = Extras(stereo=True, tag=True, perturbations=parse_perturbations(metadata["perturb"]))
    record(SHORT, profile, again, extras=by_hand, jobs=1)
    one, other = (
        [(raw.topic, raw.data) for raw in open_recording(file, profile).raw_messages()]
        for file in (path, again)
    )
    assert one == other


def test_an_ideal_world_names_nothing() -> None:
    assert Extras(world=World.IDEAL, perturbations=draw_world(World.IDEAL, 1)).metadata() == {}


def test_between_samples_reports_lie_on_a_line(profile: Profile) -> None:
    """Images at 30 Hz come between joints at 100 Hz: the transforms then written have no noise of their own."""
    plan = make_plan(
        Scenario("random", 1, 1.0, 30.0), profile, extras=Extras(perturbations=chosen("joint_noise=0.1"))
    )
    (arm,) = plan.arms
    at = plan.with_joints
    stamps_s = 1e-9 * (plan.stamps_ns - plan.stamps_ns[0])
    for joint in arm.reported.T:
        np.testing.assert_allclose(joint, np.interp(stamps_s, stamps_s[at], joint[at]), atol=1e-12)
    assert not at.all()
    q = arm.q + arm.nominal.joint_offsets
    assert reported_joints(q, plan.stamps_ns, at, profile, chosen("focal=1"), 1, 0) is q


def seen(recording: Recording) -> list[Observation]:
    found = list(recording.observations())
    assert all(isinstance(item, Observation) for item in found)
    return [item for item in found if isinstance(item, Observation)]


@pytest.mark.parametrize("text", [REPORTED, STATED, f"{STATED},{REPORTED}", "lag=-20", "lag_drift=5"])
def test_a_log_of_a_perturbed_world_is_the_plain_log_perturbed_at_replay(
    profile: Profile, tmp_path: Path, text: str
) -> None:
    """Joints at every image, cameras, and where the right one stands: recording and replay agree."""
    paths = [tmp_path / "plain.mcap", tmp_path / "told.mcap"]
    for path, its in zip(paths, ("", text), strict=True):
        extras = Extras(stereo=True, kinematic_error=1.0, perturbations=chosen(its))
        record(SHORT, profile, path, extras=extras, jobs=1)
    plain, told = (open_recording(path, profile) for path in paths)
    replayed = plain.perturbed(chosen(text), profile)
    assert plain.logged_camera.same_optics(replayed.logged_camera)
    for one, other in zip(seen(told), seen(replayed), strict=True):
        assert one.joints is not None
        assert other.joints is not None
        assert one.right is not None
        assert other.right is not None
        np.testing.assert_allclose(other.joints.positions, one.joints.positions, atol=1e-6)
        np.testing.assert_allclose(other.camera.K, one.camera.K, atol=1e-9)
        np.testing.assert_allclose(other.right.camera.K, one.right.camera.K, atol=1e-9)
        np.testing.assert_allclose(other.right.T_left_right, one.right.T_left_right, atol=1e-12)
        np.testing.assert_array_equal(other.image_bgr, one.image_bgr)
    first, second = told.joint_track(), replayed.joint_track()
    shared = np.isin(second.stamps_ns, first.stamps_ns)
    if text == REPORTED:
        assert shared.sum() == len(first.stamps_ns)
        np.testing.assert_allclose(second.positions[shared], first.positions, atol=1e-9)


def test_a_profile_is_as_wrong_about_a_built_world_as_one_that_is_perturbed_about_a_plain_one(
    profile: Profile,
) -> None:
    """Said minus true is the strength in both: of the floor's distance and of the wrist's length."""
    text = "plane=1,wrist_length=1"
    built, plain = planned(profile, text).scene, planned(profile, "").scene
    said = stated_profile(profile, chosen(text), QUICK.seed)
    assert said.tissue is not None
    assert profile.tissue is not None
    assert said.robot is not None
    assert said.tissue.plane_distance_m - plain.T_world_camera[2, 3] == pytest.approx(
        profile.tissue.plane_distance_m - built.T_world_camera[2, 3]
    )
    lengths = [sum(row.a_m for row in scene.chain.rows) for scene in (built, plain)]
    assert sum(joint.a_m for joint in said.robot.joints) - lengths[1] == pytest.approx(
        lengths[1] - lengths[0]
    )
