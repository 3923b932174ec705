"""Tissue that gives way: nothing is left inside, what is far stays, and it never goes through its bed."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.simulation.organ import Organ, make_organ
from svmdist.simulation.organ import LIMIT, REACH_M, YieldingOrgan, bump
from svmdist.transforms import Array

BALL_M = 0.0015


@pytest.fixture(scope="module")
def organ() -> Organ:
    return make_organ(np.random.default_rng(2), is_soft=True)


@pytest.fixture(scope="module")
def soft(organ: Organ) -> YieldingOrgan:
    return YieldingOrgan(organ)


def pressed_ball(soft: YieldingOrgan, depth_m: float, x_m: float = 0.002) -> Array:
    """Points of a ball whose lowest one is so deep below the surface at rest: those that are inside it."""
    rng = np.random.default_rng(0)
    points = rng.normal(0.0, 1.0, (6000, 3))
    points *= BALL_M / np.linalg.norm(points, axis=1, keepdims=True)
    points += [x_m, 0.001, soft.inside_m(np.array([[x_m, 0.001, 0.0]]))[0] + BALL_M - depth_m]
    return np.asarray(points[soft.inside_m(points) > 0.0])


@pytest.mark.parametrize("depth_m", [1e-5, 5e-4, 4e-3])
def test_nothing_is_left_inside_and_the_deepest_touches(
    organ: Organ, soft: YieldingOrgan, depth_m: float
) -> None:
    """A ball pressed 0.01 to 4 mm deep has 2 µm inside at most, and the surface goes down as far, to 2 %."""
    points = pressed_ball(soft, depth_m)
    deepest_m = soft.inside_m(points).max()  # the surface is tilted
    assert depth_m < deepest_m < 1.2 * depth_m
    assert not soft.is_too_deep(points)
    dent = soft.dented(points)
    assert dent.left_m < 2e-6
    down_m = organ.mesh.vertices_m[:, 2] - dent.mesh.vertices_m[:, 2]
    assert down_m.min() >= 0.0
    assert down_m.max() < 1.02 * deepest_m + 2e-6
    pressed_m = YieldingOrgan(Organ(dent.mesh, organ.outline_m, organ.height_m)).inside_m(points)
    assert pressed_m.max() == pytest.approx(dent.left_m, abs=1e-12)
    assert pressed_m.max() > -1e-6


def test_what_is_far_stays_and_what_is_near_is_smooth(organ: Organ, soft: YieldingOrgan) -> None:
    """Beyond the reach nothing moves, bit by bit; along a line through the dent the slope has no jump."""
    points = pressed_ball(soft, 0.003)
    dent = soft.dented(points)
    away_m = np.linalg.norm(organ.mesh.vertices_m[:, None, :2] - points[None, ::20, :2], axis=2).min(axis=1)
    far = away_m > REACH_M + BALL_M
    assert far.any()
    np.testing.assert_array_equal(dent.mesh.vertices_m[far], organ.mesh.vertices_m[far])
    np.testing.assert_array_equal(dent.mesh.vertices_m[:, :2], organ.mesh.vertices_m[:, :2])
    at_rest = organ.mesh.normals
    turned = np.arccos(np.clip(np.einsum("ij,ij->i", dent.mesh.normals, at_rest), -1.0, 1.0))
    assert 0.3 < turned.max() < 0.8


def test_pressed_flat_it_gives_way_no_further(organ: Organ, soft: YieldingOrgan) -> None:
    """A ball deeper than four fifths of the height stays inside by the rest, and is said to be too deep."""
    height_m = soft.inside_m(np.array([[0.002, 0.001, 0.0]]))[0]
    points = pressed_ball(soft, 0.95 * height_m)
    assert soft.is_too_deep(points)
    dent = soft.dented(points)
    assert dent.left_m == pytest.approx((0.95 - LIMIT) * height_m, rel=0.1)
    assert (dent.mesh.vertices_m[:, 2] >= (1.0 - LIMIT) * organ.mesh.vertices_m[:, 2] - 1e-12).all()


def test_a_little_deeper_changes_a_little(soft: YieldingOrgan) -> None:
    """1 µm deeper moves no vertex by more than 3 µm: shapes are continuous in the depth."""
    before, after = (soft.dented(pressed_ball(soft, depth_m)).mesh for depth_m in (0.002, 0.002001))
    assert np.abs(after.vertices_m - before.vertices_m).max() < 3e-6


def test_the_bump_is_smooth() -> None:
    """1 with slope 0 in the middle, 0 with slope 0 from 1 on, and falling in between."""
    radius = np.linspace(0.0, 1.5, 3001)
    share = bump(radius)
    slope = np.diff(share) / np.diff(radius)
    assert share[0] == 1.0
    assert (share[radius >= 1.0] == 0.0).all()
    assert (slope <= 0.0).all()
    assert abs(slope[0]) < 0.01
    assert np.abs(np.diff(slope)).max() < 0.012
