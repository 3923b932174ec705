"""Heights of the organ over its plane, against rays through its triangles."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from svmdist.simulation.organ import HeightField
from svmdist.simulation.organ import Organ, make_organ
from svmdist.simulation.organ import make_tissue_shape


@pytest.fixture(params=[False, True], ids=["dome", "lobes"])
def organ(request: pytest.FixtureRequest) -> Organ:
    shape = make_tissue_shape(np.random.default_rng(3), 0.4, 0.5) if request.param else None
    return make_organ(np.random.default_rng(2), None, shape, is_soft=True)


def test_heights_are_those_of_the_triangles(organ: Organ) -> None:
    """Within 1 nm of where a ray from above meets the mesh; -inf where none does."""
    low, high = organ.outline_m.min(0), organ.outline_m.max(0)
    xy_m = np.random.default_rng(1).uniform(low, high, (400, 2))
    found_m = HeightField(organ).heights_m(xy_m, organ.mesh.vertices_m[:, 2])
    mesh = trimesh.Trimesh(organ.mesh.vertices_m * 1e3, organ.mesh.faces, process=False)
    starts = np.column_stack([xy_m * 1e3, np.full(len(xy_m), 50.0)])
    hits, ray, _ = mesh.ray.intersects_location(starts, np.tile([0.0, 0.0, -1.0], (len(starts), 1)))
    expected_m = np.full(len(xy_m), -np.inf)
    expected_m[ray] = hits[:, 2] * 1e-3
    np.testing.assert_allclose(found_m, expected_m, atol=1e-9)
    assert 0.6 < np.isfinite(found_m).mean() < 0.9


def test_vertices_have_their_own_heights(organ: Organ) -> None:
    """Those of all rings but the outline, on which rounding decides; other heights may stand in their place."""
    inner = slice(0, len(organ.mesh.vertices_m) - len(organ.outline_m))
    z_m = np.random.default_rng(5).uniform(0.0, 0.01, len(organ.mesh.vertices_m))
    found_m = HeightField(organ).heights_m(organ.mesh.vertices_m[inner, :2], z_m)
    np.testing.assert_allclose(found_m, z_m[inner], atol=1e-9)
