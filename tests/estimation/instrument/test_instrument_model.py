"""The instrument's capsules against the meshes that the simulation draws, and the wrist on other chains."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.errors import KinematicsError
from svmdist.estimation.instrument.model import InstrumentModel, Rods, wrist_in_tool
from svmdist.geometry.surfaces import Capsules
from svmdist.kinematics.dh import DHChain, chain_of, forward_kinematics, wrist_rows
from svmdist.profile import load_profile
from svmdist.results import ToolPose
from svmdist.samples import JointSample
from svmdist.simulation.scene import Options, Scene, make_scene
from svmdist.transforms import inverse, transform_points

PROFILE = load_profile()
SCENE = make_scene(PROFILE, 3)
WRIST = slice(-3, None)


def bent(rng: np.random.Generator) -> np.ndarray:
    q = SCENE.posture.copy()
    q[WRIST] = [*rng.uniform(-1.0, 1.0, 2), rng.uniform(0.0, 1.0)]
    return q


def mesh_points_m(scene: Scene, q: np.ndarray) -> np.ndarray:
    """All vertices of the drawn instrument in the tool frame, shape (n, 3)."""
    T_tool_world = inverse(scene.T_world_base @ forward_kinematics(scene.chain, q))
    poses = scene.link_poses(q)
    return np.vstack([transform_points(T_tool_world @ poses[p.link], p.mesh.vertices_m) for p in scene.parts])


def test_capsules_reach_as_far_as_the_meshes() -> None:
    """Towards any plane before the tip; behind it the shaft leaves the scene, where its far end is not modelled."""
    assert PROFILE.instrument is not None
    rng = np.random.default_rng(4)
    errors = []
    for _ in range(60):
        q = bent(rng)
        wrist = wrist_in_tool(SCENE.chain, q)
        capsules = Rods.of(PROFILE.instrument).about(wrist)
        points = mesh_points_m(SCENE, q)
        for direction in rng.normal(size=(20, 3)):
            d = direction / np.linalg.norm(direction)
            d *= np.sign(d @ wrist.shaft)
            if d @ wrist.shaft < 0.1:
                continue
            reach = (np.maximum(capsules.start_m @ d, capsules.end_m @ d) + capsules.radius_m).max()
            errors.append(reach - (points @ d).max())
    assert len(errors) > 800
    assert np.sqrt(np.mean(np.square(errors))) < 6e-5
    assert np.abs(errors).max() < 4e-4


def test_a_tags_plate_is_a_part_of_the_instrument_where_it_was_seen() -> None:
    """Beside the shaft it reaches as far as the plate's mesh, to 0.05 mm along any direction that ends on it."""
    scene = make_scene(PROFILE, 3, Options(tag=True))
    plate = scene.parts[-1]
    model = InstrumentModel.of(PROFILE)
    assert model is not None
    q = bent(np.random.default_rng(6))
    T_camera_tool = scene.T_camera_base @ forward_kinematics(scene.chain, q)
    pose = ToolPose(T_camera_tool, np.zeros((6, 6)), T_camera_tool[:3, 0])
    joints = JointSample(0, scene.chain.joint_names, q)
    plain, plated = (model.posed(pose, joints, has_plate) for has_plate in (False, True))
    T_camera_plate = inverse(scene.T_world_camera) @ scene.part_poses(q)[-1]
    corners = transform_points(T_camera_plate, plate.mesh.vertices_m)

    def reach(capsules: Capsules, d: np.ndarray) -> float:
        return float((np.maximum(capsules.start_m @ d, capsules.end_m @ d) + capsules.radius_m).max())

    # Out of the plate, and along its sides: 6 directions, of which some end on the plate.
    ends_on_plate = 0
    for d in [*T_camera_plate[:3, :3].T, *-T_camera_plate[:3, :3].T]:
        if (corners @ d).max() > reach(plain, d):
            ends_on_plate += 1
            assert reach(plated, d) == pytest.approx((corners @ d).max(), abs=5e-5)
        else:
            assert reach(plated, d) == reach(plain, d)
    assert ends_on_plate >= 2


def test_open_jaws_stand_apart() -> None:
    """Each blade lies outside the plane through the hinge and its own direction, away from the other."""
    wrist = wrist_in_tool(SCENE.chain, np.array([*SCENE.posture[:-1], 0.6]))
    moving, fixed = wrist.jaws
    assert moving.along @ fixed.along == pytest.approx(np.cos(0.6), abs=1e-12)
    for jaw, other in ((moving, fixed), (fixed, moving)):
        assert jaw.outward @ jaw.along == pytest.approx(0.0, abs=1e-12)
        assert jaw.outward @ other.along < -0.5


def test_a_research_kit_arm_has_a_wrist_without_a_jaw() -> None:
    """Its tool's z points along the closed jaws, as the kit's manual draws it, however the wrist bends."""
    profile = load_profile("dvrk-psm")
    assert profile.robot is not None
    chain = chain_of(profile.robot)
    rows = wrist_rows(chain)
    assert rows is not None
    assert [chain.rows[row].name for row in (rows.roll, rows.pitch, rows.yaw)] == [
        "roll",
        "wrist_pitch",
        "wrist_yaw",
    ]
    assert rows.jaw is None
    for q in np.random.default_rng(5).uniform(-0.9, 0.9, (10, 6)):
        q[2] = 0.1
        wrist = wrist_in_tool(chain, q)
        for jaw in wrist.jaws:
            np.testing.assert_allclose(jaw.along, [0.0, 0.0, 1.0], atol=1e-12)
        assert wrist.jaws[0].outward @ wrist.jaws[1].outward == pytest.approx(-1.0)
        # Insertion moves the wrist along the shaft.
        further = q + 0.01 * np.eye(6)[2]
        step = inverse(forward_kinematics(chain, q)) @ forward_kinematics(chain, further)
        np.testing.assert_allclose(step[:3, 3], 0.01 * wrist.shaft, atol=1e-12)


def test_a_chain_without_a_wrist_says_so() -> None:
    rows = SCENE.chain.rows[:9]
    chain = DHChain(rows, SCENE.chain.convention, np.eye(4))
    assert wrist_rows(chain) is None
    with pytest.raises(KinematicsError, match="no wrist"):
        wrist_in_tool(chain, np.zeros(9))
