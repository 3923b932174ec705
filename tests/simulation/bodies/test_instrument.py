"""The instrument's parts are closed where they meet, convex, and centred where the camera looks for them."""

from __future__ import annotations

import numpy as np

from svmdist.profile import Profile
from svmdist.simulation.instrument import MARKER_RGBA, make_parts
from svmdist.simulation.scene import Scene


def test_parts_are_convex(scene: Scene) -> None:
    """No vertex lies before the plane of a triangle, within 5 µm: Bullet's convex hulls are the meshes.

    The jaws need the 5 µm, for a slight waist. The bridge has one of 0.1 mm; it lies behind the jaws
    and the fork, which are nearer to the tissue.
    """
    for part in scene.parts:
        a, b, c = (part.mesh.vertices_m[part.mesh.faces[:, corner]] for corner in range(3))
        normals = np.cross(b - a, c - a)
        areas = np.linalg.norm(normals, axis=1)
        normals, a = normals[areas > 1e-12] / areas[areas > 1e-12, None], a[areas > 1e-12]
        before_m = (part.mesh.vertices_m @ normals.T - np.einsum("ij,ij->i", a, normals)).max()
        assert before_m < (1.1e-4 if part.name == "bridge" else 5e-6), part.name


def test_the_coloured_part_is_a_sphere_about_the_tools_origin(profile: Profile) -> None:
    instrument = profile.instrument
    assert instrument is not None
    parts = make_parts(instrument, ("roll", "wrist_pitch", "wrist_yaw", "jaw"), 0.009)
    (coloured,) = (part for part in parts if part.colour_rgba == MARKER_RGBA)
    assert coloured.link == "wrist_yaw"
    # 0.05 %: the profile is not quite closed at the poles.
    radii_m = np.linalg.norm(coloured.mesh.vertices_m, axis=1)
    sides = np.abs(coloured.mesh.vertices_m[:, 0]) < 0.99 * instrument.knuckle_radius_m
    np.testing.assert_allclose(radii_m[sides], instrument.knuckle_radius_m, rtol=5e-4)


def test_only_the_last_four_links_carry_parts(scene: Scene) -> None:
    names = [row.name for row in scene.chain.rows]
    assert {part.link for part in scene.parts} == set(names[-4:])
