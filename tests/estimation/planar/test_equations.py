"""Eqs. (3) to (6) and (21) to (27) in both readings, from numbers written out here."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from svmdist.estimation.plane_mapping import (
    PUBLISHED_MAPPING,
    PUBLISHED_X,
    PUBLISHED_Y,
    PlaneMapping,
    Quadratic,
    degeneracies,
    planar_distance_m,
    screen_cm_as_published,
    screen_cm_corrected,
)

CORRECTED = PlaneMapping("corrected", PUBLISHED_X, PUBLISHED_Y)
"""The published quadratics of the corrected screen coordinate: what eq. (6) would mean if only (4) were fixed."""


@pytest.mark.parametrize(("pixel", "screen_cm"), [(0, 0.01), (1, -0.0154), (100, -2.53), (640, -16.246)])
def test_eqs_3_4_as_published_run_backwards(pixel, screen_cm):
    """(1 - T * 2.54) / 100 is +0.01 at pixel 0 and -16.2 at pixel 640, and nowhere 0.0245."""
    assert float(screen_cm_as_published(pixel)) == pytest.approx(screen_cm, abs=1e-12)


@pytest.mark.parametrize(("pixel", "screen_cm"), [(0, 0.0), (1, 0.0254), (100, 2.54), (640, 16.256)])
def test_eqs_3_4_corrected_are_pixels_at_100_dpi(pixel, screen_cm):
    """S = 0.0254 T cm: a hundred pixels are an inch."""
    assert float(screen_cm_corrected(pixel)) == pytest.approx(screen_cm, abs=1e-12)


@pytest.mark.parametrize("screen_cm", [-16.2, 0.0, 0.01, 2.9, 16.2])
def test_eqs_5_6_are_the_published_quadratics(screen_cm):
    """The shipped constants are those of the paper, evaluated here term by term."""
    x = -0.0036 * screen_cm**2 + 0.7938 * screen_cm - 0.0403
    y = -0.0068 * screen_cm**2 + 0.0395 * screen_cm - 0.4439
    assert PUBLISHED_X(screen_cm) == pytest.approx(x, abs=1e-14)
    assert PUBLISHED_Y(screen_cm) == pytest.approx(y, abs=1e-14)


def test_eq_6_turns_around_at_row_114_of_the_corrected_screen():
    """dy/dS = 0 at S = 2.904 cm, row 114; the rows on both sides are mapped alike and span 0.58 cm only."""
    turning_cm = PUBLISHED_Y.turning_point_cm()
    assert turning_cm == pytest.approx(0.0395 / 0.0136)
    assert round(turning_cm / 0.0254) == 114
    assert PUBLISHED_Y(turning_cm - 1.0) == pytest.approx(PUBLISHED_Y(turning_cm + 1.0))
    y_cm = np.asarray(PUBLISHED_Y(screen_cm_corrected(np.arange(480))))
    assert int(np.argmax(y_cm)) == 114
    assert np.ptp(y_cm) == pytest.approx(0.58, abs=0.005)


def test_a_straight_line_turns_around_nowhere():
    """Without a quadratic term the turning point is at infinity, and no warning mentions it."""
    line = Quadratic(0.0, 0.8, 0.1)
    assert line.turning_point_cm() == float("inf")
    for reading in ("corrected", "printed"):
        assert not any(
            "turn around" in text for text in degeneracies(PlaneMapping(reading, line, line), 640, 480)
        )


def test_a_mapping_gives_metres_for_any_number_of_points():
    """Pixels of shape (..., 2) become metres of the same shape, each axis by its own quadratic."""
    mapping = PlaneMapping("corrected", Quadratic(0.0, 1.0, 0.0), Quadratic(0.0, 2.0, 1.0))
    points_px = np.array([[[0.0, 0.0], [100.0, 0.0]], [[0.0, 100.0], [100.0, 100.0]]])
    expected_m = [[[0.0, 0.01], [0.0254, 0.01]], [[0.0, 0.0608], [0.0254, 0.0608]]]
    np.testing.assert_allclose(mapping.to_plane_m(points_px), expected_m, atol=1e-15)
    np.testing.assert_allclose(mapping.to_plane_m(points_px[1, 1]), expected_m[1][1], atol=1e-15)


def test_the_published_mapping_uses_the_published_screen():
    """At pixel (100, 50) the published reading puts S = -2.53 and -1.26 into eqs. (5) and (6)."""
    found_m = PUBLISHED_MAPPING.to_plane_m(np.array([100.0, 50.0]))
    np.testing.assert_allclose(found_m * 100.0, [PUBLISHED_X(-2.53), PUBLISHED_Y(-1.26)], atol=1e-12)
    assert not np.allclose(found_m, CORRECTED.to_plane_m(np.array([100.0, 50.0])))


places_m = st.tuples(st.floats(-1, 1), st.floats(-1, 1)).map(np.array)


@settings(deadline=None, max_examples=50)
@given(places_m, places_m, places_m)
def test_the_planar_distance_is_a_metric(a, b, c):
    """It is symmetric, zero only from a place to itself, and obeys the triangle inequality within 1e-15."""
    assert planar_distance_m(a, b) == planar_distance_m(b, a) >= 0.0
    assert planar_distance_m(a, a) == 0.0
    assert planar_distance_m(a, c) <= planar_distance_m(a, b) + planar_distance_m(b, c) + 1e-15


def test_eqs_25_to_27_are_the_euclidean_distance():
    """3 mm and 4 mm apart is 5 mm, and the quadratics' constants cancel in the difference."""
    assert planar_distance_m(np.array([0.003, 0.0]), np.array([0.0, -0.004])) == pytest.approx(0.005)
    shifted = PlaneMapping("corrected", Quadratic(-0.0036, 0.7938, 7.0), Quadratic(-0.0068, 0.0395, -9.0))
    a_px, b_px = np.array([10.0, 20.0]), np.array([300.0, 400.0])
    distances_m = [
        planar_distance_m(mapping.to_plane_m(a_px), mapping.to_plane_m(b_px))
        for mapping in (CORRECTED, shifted)
    ]
    assert distances_m[0] == pytest.approx(distances_m[1], rel=1e-12)


def test_the_published_mode_says_what_its_screen_coordinate_does():
    """The published reading warns of S running from +0.01 to -16.2 cm over 640 px.

    With that S neither quadratic turns around inside the image, so there is no second sentence.
    """
    warnings = degeneracies(PUBLISHED_MAPPING, 640, 480)
    assert len(warnings) == 1
    assert "S runs from +0.01 to -16.2 cm over 640 px" in warnings[0]


def test_a_mapping_that_turns_around_says_where():
    """The published quadratics of the corrected screen warn of row 114 of 480, for the y axis only."""
    warnings = degeneracies(CORRECTED, 640, 480)
    assert warnings == [
        "eqs. (6), (24) turn around at pixel 114 of 480: positions on both sides of it are mapped to the same place"
    ]
    assert degeneracies(CORRECTED, 640, 114) == []


def test_a_sound_mapping_has_nothing_to_say():
    """A monotone corrected mapping gives no warning."""
    assert degeneracies(PlaneMapping("corrected", PUBLISHED_X, PUBLISHED_X), 640, 480) == []
