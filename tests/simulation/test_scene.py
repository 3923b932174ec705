"""The scene of a seed: where things stand, and that one extra moves nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.errors import SimulationError
from svmdist.kinematics.dh import frame_transforms
from svmdist.profile import Profile
from svmdist.simulation.scene import Extras
from svmdist.simulation.scene import TISSUE_SHIFT_M, Scene, make_floor, make_retractor, make_scene


def test_transforms_multiply(scene: Scene) -> None:
    """1e-15: products of rotations about z and flips."""
    np.testing.assert_allclose(scene.T_world_camera @ scene.T_camera_base, scene.T_world_base, atol=1e-15)
    np.testing.assert_allclose(scene.T_world_camera @ scene.T_camera_tissue, scene.T_world_tissue, atol=1e-15)
    poses = scene.link_poses(scene.posture)
    frames = frame_transforms(scene.chain, scene.posture)
    last = scene.chain.rows[-1].name
    np.testing.assert_allclose(poses[last], scene.T_world_base @ frames[-1], atol=1e-15)


@pytest.mark.parametrize("seed", range(5))
def test_the_tissue_stands_on_the_floor_near_the_axis(profile: Profile, seed: int) -> None:
    at_m = make_scene(profile, seed).T_world_tissue[:3, 3]
    assert at_m[2] == 0.0
    assert np.abs(at_m[:2]).max() <= TISSUE_SHIFT_M


def test_extras_move_nothing_else(profile: Profile, scene: Scene) -> None:
    other = make_scene(profile, 1, Extras(stereo=True, tag=True, relief_m=0.0005))
    np.testing.assert_array_equal(other.T_world_tissue, scene.T_world_tissue)
    np.testing.assert_array_equal(other.floor_texture, scene.floor_texture)
    assert other.plate is not None
    assert scene.plate is None


def test_floor_and_retractor(scene: Scene) -> None:
    floor, retractor = make_floor(), make_retractor()
    np.testing.assert_array_equal(floor.normals, np.tile([0.0, 0.0, 1.0], (len(floor.normals), 1)))
    assert retractor.vertices_m[:, 0].min() == 0.0  # its tip


def test_a_profile_without_a_robot_is_told(profile: Profile) -> None:
    with pytest.raises(SimulationError, match=r"it needs \[robot\], \[instrument\] and \[simulation\]"):
        make_scene(profile.model_copy(update={"robot": None}), 1)
