"""The stream of samples of a recording: complete, reproducible, true, and perturbed where it is asked to be."""

from __future__ import annotations

import itertools
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from packaging.requirements import Requirement

from svmdist import samples
from svmdist.camera import Camera, stereo_transform
from svmdist.kinematics import forward_kinematics
from svmdist.perturbations import TABLE, Place, World, draw_world, parse_perturbations
from svmdist.perturbations.apply import perturbed_image, perturbed_right_view
from svmdist.profile import Profile
from svmdist.recording.log import Recording, open_recording
from svmdist.simulation.bullet import how_to_install
from svmdist.simulation.motion import Scenario
from svmdist.simulation.plan import draw_nominal_kinematics
from svmdist.simulation.scene import Options, make_scene
from svmdist.transforms import inverse, rotation_angle
from svmdist.vision.degradations import Degradation, degrade
from tests.conftest import REPOSITORY
from tests.reading import read_images, read_observations
from tests.simulation.conftest import chosen, perturbed, simulate

pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
from svmdist.simulation.plan import Plan, make_plan
from svmdist.simulation.render import Renderer
from svmdist.simulation.simulate import FIELD_NS, Sensors, Simulator
from svmdist.workflows.record import Recipe, record

SHORT = Scenario("sweep", 2, 0.2, 10.0)
QUICK = Scenario("random", 2, 8.0, 10.0)
FULL = Options(stereo=True, tag=True, kinematic_error=1.0)
REPORTED = "backlash=0.5,joint_drift=0.2,joint_noise=0.02,quantisation=0.02,lag=30"
STATED = "focal=1,principal_point=2,baseline=0.2"
Stream = list[tuple[str, samples.Sample]]


def stream(profile: Profile, text: str = "", scenario: Scenario = SHORT, **options: object) -> Stream:
    return list(simulate(scenario, profile, perturbed(text, noise=1.0, **options)))


def of(found: Stream, topic: str | None) -> list:
    return [sample for name, sample in found if name == topic]


def images(found: Stream) -> list[np.ndarray]:
    return [sample.image_bgr for _, sample in found if isinstance(sample, samples.ImageSample)]


def planned(profile: Profile, text: str, **options: object) -> Plan:
    return make_plan(QUICK, profile, options=perturbed(text, **options))


@pytest.fixture(scope="module")
def plain(profile: Profile) -> Stream:
    return stream(profile, stereo=True, tag=True)


@pytest.fixture(scope="module")
def full(profile: Profile) -> Stream:
    return list(simulate(SHORT, profile, replace(FULL, noise=1.0)))


def test_a_dent_shows_frame_after_frame_and_goes(profile):
    """Where nothing else moves the tissue: after the touch an image is that of tissue that was never pressed."""
    plan = make_plan(Scenario("contact", 3, 2.0, 10.0), profile, options=perturbed("dent=1"))
    with Simulator(plan) as simulator:
        for frame in (9, 10, 14):
            block = plan.blocks[frame]
            (image,) = images(list(simulator.samples(block, (None,))))
            with Renderer([plan.scene]) as at_rest:
                at_rest.pose(plan.state(block.start))
                assert (image != at_rest.draw(0, frame)).any() == (frame != 14)


def test_every_topic_is_there_in_order_and_truth_with_every_image(profile):
    """Joints at 100 Hz about all images; eq. (35) and its 3D companion follow from the true transforms, exactly."""
    found, topics = stream(profile, scenario=Scenario("sweep", 1, 1.2, 3.0)), profile.topics
    stamps = [sample.stamp_ns for _, sample in found]
    assert stamps == sorted(stamps)
    right = {topics.right_image, topics.right_camera_info}
    assert {topic for topic, _ in found} == set(topics.model_dump().values()) - right
    joints = [sample.stamp_ns for sample in of(found, topics.joints)]
    at_ns = [sample.stamp_ns for sample in of(found, topics.image)]
    assert max(np.diff(joints)) <= 10_000_000
    assert joints[0] <= at_ns[0] < at_ns[-1] <= joints[-1]
    for topic in (topics.ground_truth_tf, topics.ground_truth_distance, topics.tf):
        assert [sample.stamp_ns for sample in of(found, topic)] == at_ns
    for truth, sample in zip(of(found, topics.ground_truth_tf), of(found, topics.ground_truth_distance), strict=True):
        tool, tissue = (item.T_parent_child[:3, 3] for item in truth.transforms)
        assert sample.planar_m == pytest.approx(np.hypot(*(tool - tissue)[:2]), abs=1e-15)
        assert sample.spatial_m == pytest.approx(np.linalg.norm(tool - tissue), abs=1e-15)


def test_the_plain_recording_is_that_of_the_golden_log(golden, profile):
    """Two frames of a log that was made long ago: each pixel and joint; clearances to what Bullet was off then."""
    recording = open_recording(golden / "sweep.mcap", profile)
    nominal, truth, logged = recording.joint_track(), recording.distance_track(), read_images(recording)
    drawn = 0
    for _, sample in simulate(Scenario("sweep", 1), profile):
        match sample:
            case samples.ImageSample():
                np.testing.assert_array_equal(next(logged).image_bgr, sample.image_bgr)
                drawn += 1
            case samples.JointSample():
                index = np.searchsorted(nominal.stamps_ns, sample.stamp_ns)
                np.testing.assert_array_equal(nominal.positions[index], sample.positions)
            case samples.DistanceSample():
                index = np.searchsorted(truth.stamps_ns, sample.stamp_ns)
                _, spatial_m, clearance_m = truth.distances_m[index]
                assert spatial_m == pytest.approx(sample.spatial_m, abs=1e-15)
                assert clearance_m == pytest.approx(sample.clearance_m, abs=1e-5)
        if drawn == 2:
            break


@pytest.mark.slow
def test_a_real_world_is_the_same_in_any_order_and_neutral_strengths_change_nothing(profile):
    """Blocks forth and back, as processes would make them: moving tissue, two fields and shadows among the rest."""
    simulation = profile.simulation.model_copy(update={"width_px": 160, "height_px": 120})
    small = profile.model_copy(update={"simulation": simulation})
    world = Options(stereo=True, tag=True, perturbations=draw_world(World.REAL, 5), world=World.REAL)
    plan = make_plan(Scenario("random", 5, 0.9, 3.4), small, replace(world, noise=1.0))
    found: list[list[list[np.ndarray]]] = []
    for backwards in (False, True):
        with Simulator(plan) as simulator:
            noises = [simulator.sensors.draw_noise() for _ in plan.blocks]
            blocks = list(zip(plan.blocks, noises, strict=True))
            drawn = [images(list(simulator.samples(*one))) for one in blocks[:: -1 if backwards else 1]]
            found.append(drawn[::-1] if backwards else drawn)
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)
    neutral = ",".join(f"{name}={entry.neutral}" for name, entry in TABLE.items())
    for one, other in zip(stream(small), stream(small, neutral), strict=True):
        assert repr(one) == repr(other)


def test_options_leave_truth_and_left_camera_alone(plain, full, profile):
    """Bit by bit; /tf and measured_js carry the drawn error on top of truth, and the pair is rectified."""
    topics, scene = profile.topics, make_scene(profile, SHORT.seed)
    for topic in (topics.ground_truth_tf, topics.ground_truth_distance):
        assert repr(of(plain, topic)) == repr(of(full, topic))
    for topic in (topics.image, topics.right_image):
        for one, other in zip(of(plain, topic), of(full, topic), strict=True):
            np.testing.assert_array_equal(one.image_bgr, other.image_bgr)
    bare = of(stream(profile), topics.image)[0].image_bgr
    assert 0 < (bare != of(plain, topics.image)[0].image_bgr).any(axis=-1).sum() < 6000  # the plate
    offsets, T_nominal = draw_nominal_kinematics(scene.chain, scene.T_camera_base, profile, SHORT.seed, 1.0)
    tf, joints = of(full, topics.tf)[0], of(full, topics.joints)[0]
    np.testing.assert_array_equal(tf.transforms[0].T_parent_child, T_nominal)
    true_q = joints.positions - offsets
    true_tool = scene.T_camera_base @ forward_kinematics(scene.chain, true_q)
    truth = of(full, topics.ground_truth_tf)[0].transforms[0].T_parent_child
    np.testing.assert_allclose(true_tool, truth, atol=1e-12)
    chain = [item.T_parent_child for item in tf.transforms if item.child != "camera_right"]
    pose = of(full, topics.pose)[0]
    np.testing.assert_allclose(np.linalg.multi_dot(chain[1:]), pose.T_frame_pose, atol=1e-12)
    left, right = (of(full, topic)[0].camera for topic in (topics.camera_info, topics.right_camera_info))
    T_left_right = stereo_transform(left, right)
    np.testing.assert_allclose(T_left_right[:3, 3], [0.005, 0.0, 0.0], atol=1e-12)


def test_kinematic_error_has_the_profiles_spread(scene, profile):
    """Over 400 seeds: moving joints and T_camera_base are off by 1°, 1 mm, 2° and 5 mm; twice at twice the scale."""
    world = scene.chain, scene.T_camera_base, profile
    drawn = [[draw_nominal_kinematics(*world, seed, scale) for seed in range(400)] for scale in (0.0, 1.0, 2.0)]
    zero, one, two = (np.array([offsets for offsets, _ in its]) for its in drawn)
    names = scene.chain.joint_names
    moving = names.index("yaw")
    assert not (one - zero)[:, :moving].any()
    expected = [0.001 if name == "insertion" else np.radians(1.0) for name in names[moving:]]
    np.testing.assert_allclose((one - zero).std(axis=0)[moving:], expected, rtol=0.15)
    np.testing.assert_allclose(two - zero, 2.0 * (one - zero), atol=1e-12)
    T = np.array([T_nominal for _, T_nominal in drawn[1]])
    np.testing.assert_allclose((T[:, :3, 3] - scene.T_camera_base[:3, 3]).std(axis=0), 0.005, rtol=0.15)
    turns_rad = rotation_angle(T[:, :3, :3], scene.T_camera_base[:3, :3])
    assert np.sqrt(np.mean(turns_rad**2)) == pytest.approx(np.radians(2.0) * np.sqrt(3.0), rel=0.1)


def test_a_second_arm_has_topics_frames_and_errors_of_its_own(full, profile):
    """The first arm does what it does alone, bit by bit; the second one's transforms agree with its joints."""
    topics = profile.topics
    two = list(simulate(SHORT, profile, Options(True, True, 1.0, arms=2, noise=1.0)))
    for topic in (topics.joints, topics.pose, topics.ground_truth_distance):
        assert repr(of(two, topic)) == repr(of(full, topic))
    scene = make_scene(profile.for_instrument("PSM2"), SHORT.seed)
    tf, truth = of(two, topics.tf)[0], of(two, topics.ground_truth_tf)[0]
    edges = {(one.parent, one.child): one.T_parent_child for one in tf.transforms}
    frame, T_base_tool = "PSM2_base", np.eye(4)
    while frame != "PSM2_tool":
        frame, T = next((child, T) for (parent, child), T in edges.items() if parent == frame)
        T_base_tool = T_base_tool @ T
    joints = of(two, "/PSM2/measured_js")[0]
    np.testing.assert_allclose(T_base_tool, forward_kinematics(scene.chain, joints.positions), atol=1e-12)
    errors = [
        edges["camera", base] @ inverse(its.T_camera_base)
        for base, its in (("PSM2_base", scene), ("base", make_scene(profile, SHORT.seed)))
    ]
    assert np.abs(errors[0][:3, :3] - errors[1][:3, :3]).max() > 1e-3
    tools = {item.child: item.T_parent_child[:3, 3] for item in truth.transforms}
    between = of(two, "/ground_truth/PSM1/PSM2/distance")[0]
    expected_m = np.linalg.norm(tools["PSM2_tool"] - tools[profile.frames.tool])
    assert between.spatial_m == pytest.approx(expected_m, rel=1e-12)


def test_sensors_add_noise_then_degrade():
    """NumPy's own noise, rounded and saturated; both cameras look through the same smoke, with noise of their own."""
    camera = Camera.from_horizontal_fov(640, 480, 1.0)
    generator, sensors = np.random.default_rng([5, 11]), Sensors(camera, 5, Options(noise=2.0))
    for frame, level in enumerate((0, 1, 127, 254, 255)):
        image = np.full((480, 640, 3), level, np.uint8)
        expected = np.clip(np.rint(image + generator.normal(0.0, 2.0, image.shape)), 0, 255).astype(np.uint8)
        np.testing.assert_array_equal(sensors.expose(0, image, *sensors.draw_noise(), frame), expected)
    grey = np.full((480, 640, 3), 128, np.uint8)

    def frames(eye: int, *degradations: tuple[str, int], noise: float = 0.0) -> list[np.ndarray]:
        sensors = Sensors(camera, 1, Options(stereo=True, degradations=degradations, noise=noise))
        return [sensors.expose(eye, grey, sensors.draw_noise()[eye], frame) for frame in range(2)]

    left, right = (frames(camera, ("smoke", 3)) for camera in (0, 1))
    np.testing.assert_array_equal(left[0], right[0])
    assert (left[0] != left[1]).any()
    assert (frames(0, ("noise", 3))[0] != frames(1, ("noise", 3))[0]).any()
    assert frames(0, ("defocus", 4), noise=10.0)[0].std() < 3.0  # a blur behind the noise


@pytest.mark.slow
def test_unstated_zoom_rotation_and_lens_are_drawn(plain, profile):
    """Calibrations are those of the plain log; the rotated right image is what a replay makes, to interpolation."""
    topics, text = profile.topics, "right_yaw=0.3,right_pitch=-0.2,right_roll=1"
    for other in ("zoom=1.1", text, "lens_untold=0.8"):
        found = stream(profile, other, stereo=True, tag=True)
        for one, expected in zip(of(found, topics.camera_info), of(plain, topics.camera_info), strict=True):
            assert one.camera.same_optics(expected.camera)
        assert (images(found)[1] != images(plain)[1]).any()
        if other == text:
            np.testing.assert_array_equal(images(found)[0], images(plain)[0])
            right = planned(profile, "").scene.right_camera
            made = perturbed_right_view(samples.RightView(images(plain)[1], right, np.eye(4)), chosen(text)).image_bgr
            inside = (slice(20, -20), slice(20, -20))
            assert np.abs(images(found)[1][inside].astype(float) - made[inside]).mean() < 2.0
        if other == "lens_untold=0.8":
            stated = stream(profile, "lens=0.8", stereo=True, tag=True)
            np.testing.assert_array_equal(images(stated), images(found))
            np.testing.assert_allclose(of(stated, topics.camera_info)[0].camera.D[:2], [-0.16, 0.04])


def test_odd_rows_are_a_field_later_and_replay_makes_the_same_border(profile):
    """Even rows show the stamp's instant, odd ones that of 2/60 s later; border and colour replay bit by bit."""
    plan = make_plan(Scenario("sweep", 1, 2.0, 2.0), profile, options=perturbed("interlace=2,breathing=2"))
    block, fields = plan.blocks[1], []
    with Simulator(plan) as simulator:
        (frame,) = images(list(simulator.samples(block, (None,))))
    with Renderer([plan.scene]) as renderer:
        for number, after_ns in enumerate((0.0, 2.0 * FIELD_NS)):
            renderer.pose(plan.state(block.start, after_ns))
            fields.append(renderer.draw(0, 2 + number))
    np.testing.assert_array_equal(frame[::2], fields[0][::2])
    np.testing.assert_array_equal(frame[1::2], fields[1][1::2])
    options = perturbed("interlace=2,breathing=2", degradations=(("defocus", 3),))
    blurred = Sensors(plan.scene.camera, 1, options).focus(0, fields, 0)
    for rows, field in enumerate(fields):  # what falls on the sensor is blurred before it is read
        np.testing.assert_array_equal(blurred[rows::2], degrade(field, Degradation.DEFOCUS, 3, 0)[rows::2])
    np.testing.assert_array_equal(Sensors(plan.scene.camera, 1, options).expose(0, blurred, None, 0), blurred)
    text, drawn = "border=0.8,vignette=0.3,chroma=1", []
    for each in ("", text):
        plan = make_plan(Scenario("sweep", 1, 0.2, 5.0), profile, options=perturbed(each))
        with Simulator(plan) as simulator:
            drawn += images(list(simulator.samples(plan.blocks[0], (None,))))
    np.testing.assert_array_equal(perturbed_image(drawn[0], chosen(text)), drawn[1])


def recorded_in(folder: Path, profile: Profile, text: str) -> Recording:
    options = perturbed(text, stereo=True, kinematic_error=1.0)
    record(Recipe(SHORT, profile, options), folder / "log.mcap", jobs=1)
    return open_recording(folder / "log.mcap", profile)


@pytest.fixture(scope="module")
def ideal(profile: Profile, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return recorded_in(tmp_path_factory.mktemp("ideal"), profile, "")


@pytest.mark.parametrize("text", [REPORTED, f"{STATED},{REPORTED}", "lag=-20", "lag_drift=5"])
def test_a_log_of_a_perturbed_world_is_the_plain_log_perturbed_at_replay(profile, ideal, tmp_path, text):
    """Joints at every image, cameras, and where the right one stands: recording and replay agree."""
    recorded, replayed = recorded_in(tmp_path, profile, text), ideal.perturbed(chosen(text))
    for one, other in zip(read_observations(recorded), read_observations(replayed), strict=True):
        np.testing.assert_allclose(other.joints.positions, one.joints.positions, atol=1e-6)
        np.testing.assert_allclose(other.camera.K, one.camera.K, atol=1e-9)
        np.testing.assert_allclose(other.right.T_left_right, one.right.T_left_right, atol=1e-12)
        np.testing.assert_array_equal(other.image_bgr, one.image_bgr)
    found, truth = (each.distance_track().distances_m for each in (recorded, ideal))
    np.testing.assert_array_equal(found, truth)


def test_metadata_name_what_is_set_so_that_a_world_can_be_recorded_again():
    assert Options().metadata() == {}
    options = Options(stereo=True, kinematic_error=1.0, degradations=(("smoke", 3), ("jpeg", 1)))
    assert options.metadata() == {"stereo": "yes", "kinematic_error": "1", "degrade": "smoke=3,jpeg=1"}
    drawn = draw_world(World.REAL, SHORT.seed)
    metadata = Options(perturbations=drawn, world=World.REAL).metadata()
    assert (metadata["world"], parse_perturbations(metadata["perturb"])) == ("real", drawn)
    assert all(drawn.changes(place) for place in Place)


def test_what_is_said_of_missing_pybullet_agrees_with_the_extra():
    """With the marker of `sim`."""
    extras = tomllib.loads((REPOSITORY / "pyproject.toml").read_text("utf-8"))["project"]
    (requirement,) = map(Requirement, extras["optional-dependencies"]["sim"])
    places = itertools.product([(3, 11), (3, 12)], ["linux", "darwin", "win32"], ["x86_64", "aarch64"])
    for version, system, machine in places:
        python = ".".join(map(str, version))
        where = {"python_version": python, "sys_platform": system, "platform_machine": machine}
        said = how_to_install(version, system, machine)
        assert "pip install 'svmdist[sim]'" in said
        assert ("installs nothing here" in said) != requirement.marker.evaluate(where)
