"""The instrument's capsules against the meshes that the simulation draws, and the wrist on other chains."""

from __future__ import annotations

import numpy as np

from svmdist.estimation.instrument.model import Rods, wrist_in_tool
from svmdist.kinematics import forward_kinematics
from svmdist.profile import load_profile
from svmdist.simulation.scene import Scene, make_scene
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
