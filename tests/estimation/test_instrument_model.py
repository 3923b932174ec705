"""The instrument's capsules against the meshes that the simulation draws, and the wrist on other chains."""

import numpy as np

from svmdist.estimation.instrument.model import capsules_about, wrist_in_tool
from svmdist.kinematics import forward_kinematics
from svmdist.simulation.scene import make_scene
from svmdist.transforms import inverse, transform_points
from tests.shipped import PROFILE

SCENE = make_scene(PROFILE, 3)


def test_capsules_reach_as_far_as_the_meshes():
    """Towards any plane before the tip; behind it the shaft leaves the scene, where its far end is not modelled."""
    rng, errors, q = np.random.default_rng(4), [], SCENE.posture.copy()
    for _ in range(60):
        q[-3:] = [*rng.uniform(-1.0, 1.0, 2), rng.uniform(0.0, 1.0)]
        wrist = wrist_in_tool(SCENE.chain, q)
        capsules = capsules_about(PROFILE.instrument, wrist)
        T_tool_world = inverse(SCENE.T_world_base @ forward_kinematics(SCENE.chain, q))
        posed = zip(SCENE.part_poses(q), SCENE.parts, strict=True)
        drawn = [transform_points(T_tool_world @ T, part.mesh.vertices_m) for T, part in posed]
        points = np.vstack(drawn)
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
