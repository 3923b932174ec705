"""The second instrument: what it adds to a recording, that it changes nothing else, and that its truth is true."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from svmdist.errors import SimulationError, UsageError
from svmdist.kinematics.dh import forward_kinematics
from svmdist.profile import Profile
from svmdist.samples import DistanceSample, ImageSample, JointSample, Sample, TransformsSample
from svmdist.simulation.scene import Extras
from svmdist.simulation.scenarios import SCENARIOS, Scenario
from svmdist.simulation.scene import Scene, make_scene
from svmdist.transforms import Array, transform_points

pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
from svmdist.simulation.clearance import BetweenMeter, ClearanceMeter
from svmdist.simulation.motion import make_trajectory
from svmdist.simulation.motion import CLEARANCE_M, make_other_arms
from svmdist.simulation.simulate import simulate

SHORT = Scenario("sweep", 1, 0.1, 10.0)
ARMS = Extras(arms=2, tag=True, kinematic_error=1.0)
Stream = list[tuple[str, Sample]]


@pytest.fixture(scope="module")
def two(profile: Profile) -> Stream:
    return list(simulate(SHORT, profile, noise=2.0, extras=ARMS))


def of_topic(stream: Stream, topic: str | None) -> list[Sample]:
    return [sample for name, sample in stream if name == topic]


def test_the_first_arm_does_what_it_does_alone(two: Stream, profile: Profile) -> None:
    """Bit by bit: joints, pose and distances of the first arm are those of a recording without the other."""
    alone = list(simulate(SHORT, profile, noise=2.0, extras=Extras(tag=True, kinematic_error=1.0)))
    for topic in (profile.topics.joints, profile.topics.pose, profile.topics.ground_truth_distance):
        assert repr(of_topic(two, topic)) == repr(of_topic(alone, topic))
    pictures = [s.image_bgr for stream in (two, alone) for _, s in stream if isinstance(s, ImageSample)]
    assert np.any(pictures[0] != pictures[1])


def test_the_second_arm_has_topics_and_frames_of_its_own(two: Stream, profile: Profile) -> None:
    """Its nominal transforms agree with its reported joints; its error is not the first one's; truth links up."""
    view = profile.for_instrument("PSM2")
    scene = make_scene(view, SHORT.seed, ARMS)
    joints = of_topic(two, "/PSM2/measured_js")[0]
    tf, truth = (of_topic(two, topic)[0] for topic in (profile.topics.tf, profile.topics.ground_truth_tf))
    assert isinstance(joints, JointSample)
    assert isinstance(tf, TransformsSample)
    assert isinstance(truth, TransformsSample)
    edges = {(one.parent, one.child): one.T_parent_child for one in tf.transforms}
    frame, T_base_tool = "PSM2_base", np.eye(4)
    while frame != "PSM2_tool":
        frame, T = next((child, T) for (parent, child), T in edges.items() if parent == frame)
        T_base_tool = T_base_tool @ T
    np.testing.assert_allclose(T_base_tool, forward_kinematics(scene.chain, joints.positions), atol=1e-12)
    wrong = edges["camera", "PSM2_base"] @ np.linalg.inv(scene.T_camera_base)
    first = edges["camera", "base"] @ np.linalg.inv(make_scene(profile, SHORT.seed).T_camera_base)
    assert np.abs(wrong[:3, :3] - first[:3, :3]).max() > 1e-3
    tool = next(one.T_parent_child for one in truth.transforms if one.child == "PSM2_tool")
    distance = of_topic(two, "/ground_truth/PSM2/distance")[0]
    assert isinstance(distance, DistanceSample)
    assert distance.spatial_m == pytest.approx(
        np.linalg.norm(tool[:3, 3] - scene.T_camera_tissue[:3, 3]), rel=1e-12
    )
    between = of_topic(two, "/ground_truth/PSM1/PSM2/distance")[0]
    assert isinstance(between, DistanceSample)
    other = truth.transforms[0].T_parent_child
    assert between.spatial_m == pytest.approx(np.linalg.norm(tool[:3, 3] - other[:3, 3]), rel=1e-12)


@pytest.mark.parametrize("name", SCENARIOS)
def test_pictures_cross_and_bodies_keep_apart(name: str, profile: Profile) -> None:
    """In every scenario the distal markers come within their own diameter in the image, the surfaces never touch."""
    seed = 7 + len(name)
    scene, progress = make_scene(profile, seed), np.linspace(0.0, 1.0, 61)
    with ClearanceMeter(scene) as meter:
        q = make_trajectory(scene, Scenario(name, seed), 0.0245, progress, meter).q
    (arm,) = make_other_arms(profile, scene, seed, Extras(arms=2), q, progress, 8.0)
    pixels = [
        view.camera.project((view.T_camera_base @ forward_kinematics(view.chain, at))[:, :3, 3])
        for view, at in ((scene, q), (arm.scene, arm.q))
    ]
    assert np.linalg.norm(pixels[0] - pixels[1], axis=1).min() < 22.0
    assert np.all((pixels[1] > 0.0) & (pixels[1] < [640.0, 480.0]))
    with BetweenMeter(scene, arm.scene) as between:
        for index in range(0, len(q), 4):
            assert between.clearance_m(q[index], arm.q[index]) >= 0.9 * CLEARANCE_M


def test_clearance_between_is_that_of_the_meshes(profile: Profile) -> None:
    """Against samples of one surface and trimesh's closest points on the other: within 0.05 mm."""
    scene, progress = make_scene(profile, 3), np.linspace(0.0, 1.0, 3)
    with ClearanceMeter(scene) as meter:
        q = make_trajectory(scene, Scenario("sweep", 3), 0.0245, progress, meter).q
    (arm,) = make_other_arms(profile, scene, 3, Extras(arms=2), q, progress, 8.0)
    with BetweenMeter(scene, arm.scene) as between:
        measured_m = between.clearance_m(q[1], arm.q[1])
    assert measured_m == pytest.approx(independent_between_m(scene, q[1], arm.scene, arm.q[1]), abs=5e-5)


def independent_between_m(first: Scene, q_first: Array, second: Scene, q_second: Array) -> float:
    """The nearest pairs of parts by samples of both, then the nearest samples to the other's triangles."""
    clouds, meshes = [], []
    for scene, q in ((first, q_first), (second, q_second)):
        poses = scene.link_poses(q)
        posed = [
            trimesh.Trimesh(
                transform_points(poses[part.link], part.mesh.vertices_m), part.mesh.faces, process=False
            )
            for part in scene.parts
        ]
        meshes.append(posed)
        clouds.append(
            [np.vstack([m.vertices, trimesh.sample.sample_surface(m, 4000, seed=0)[0]]) for m in posed]
        )
    trees = [cKDTree(cloud) for cloud in clouds[1]]
    rough = {
        (i, j): trees[j].query(cloud[::9])[0].min()
        for i, cloud in enumerate(clouds[0])
        for j in range(len(trees))
    }
    smallest = np.inf
    for i, j in sorted(rough, key=lambda pair: rough[pair])[:3]:
        near = clouds[0][i][np.argsort(trees[j].query(clouds[0][i])[0])[:100]]
        smallest = min(smallest, trimesh.proximity.closest_point(meshes[1][j], near)[1].min())
    return float(smallest)


def test_arms_that_cannot_be_are_refused(profile: Profile) -> None:
    with pytest.raises(UsageError, match="a recording has 1 to 2 arms, found 3"):
        Extras(arms=3)
    lonely = profile.model_copy(update={"other_instruments": ()})
    with pytest.raises(SimulationError, match=r"places 1 of 2 arms: it needs \[\[other_instruments\]\]"):
        list(simulate(SHORT, lonely, extras=Extras(arms=2)))
