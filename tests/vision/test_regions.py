"""Regions: gates, pixel counts and centroids, held against NumPy on the same mask."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from svmdist.profile import ColourRegion
from svmdist.vision.regions import SPECK_FRACTION, find_region


def rule(min_area_px: int = 10, components: str = "all", occlusion: str = "none") -> ColourRegion:
    """A region rule of which only the gate and the two policies matter here."""
    return ColourRegion(hue=(0, 10), min_area_px=min_area_px, components=components, occlusion=occlusion)


def blank(height: int = 120, width: int = 160) -> np.ndarray:
    """An empty mask."""
    return np.zeros((height, width), np.uint8)


def mean_of_pixels(mask: np.ndarray) -> np.ndarray:
    """Mean x and y of the set pixels by definition: eqs. (1) and (2)."""
    return np.argwhere(mask)[:, ::-1].mean(0)


@pytest.mark.parametrize(("width", "passes"), [(9, False), (10, False), (11, True)])
def test_a_region_passes_its_gate_only_if_larger(width, passes):
    """The paper's "bigger than 50": 45 and 50 pixels are no region, 55 are."""
    mask = blank()
    mask[20:25, 30 : 30 + width] = 255
    region = find_region(mask, rule(min_area_px=50))
    assert (region is not None) is passes
    if region is not None:
        assert region.area_px == 55


def test_an_empty_mask_has_no_region():
    assert find_region(blank(), rule()) is None


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1))
def test_a_regions_count_and_centroid_are_those_of_its_pixels(seed):
    """For random blobs with all parts above the gate, count and centroid equal NumPy's, within 1e-9 px."""
    rng = np.random.default_rng(seed)
    mask = blank()
    for _ in range(rng.integers(1, 4)):
        centre = (int(rng.integers(0, 160)), int(rng.integers(0, 120)))
        cv2.ellipse(mask, centre, (int(rng.integers(9, 40)), int(rng.integers(9, 30))), 25, 0, 360, 255, -1)
    region = find_region(mask, rule(min_area_px=1))
    assert region is not None
    assert region.area_px == np.count_nonzero(mask)
    np.testing.assert_allclose(region.centroid_px, mean_of_pixels(mask), atol=1e-9)


def test_holes_do_not_count():
    """A ring's area is that of its pixels, and its polygon area the larger one inside its outer contour."""
    mask = blank()
    cv2.circle(mask, (60, 50), 30, 255, -1)
    cv2.circle(mask, (70, 50), 12, 0, -1)
    region = find_region(mask, rule())
    assert region is not None
    assert region.area_px == np.count_nonzero(mask)
    assert region.polygon_area_px2 > region.area_px + 200
    np.testing.assert_allclose(region.centroid_px, mean_of_pixels(mask), atol=1e-9)
    assert region.centroid_px[0] < 60  # the hole on the right pushes the centroid to the left


@pytest.mark.parametrize("corner", [(0, 0), (0, 150), (110, 0), (110, 150)])
def test_a_region_at_the_border_is_counted_whole(corner):
    """A square of 10 x 10 px in a corner of the image keeps its 100 pixels and its middle."""
    mask = blank()
    y, x = corner
    mask[y : y + 10, x : x + 10] = 255
    region = find_region(mask, rule(min_area_px=99))
    assert region is not None
    assert region.area_px == 100
    np.testing.assert_allclose(region.centroid_px, [x + 4.5, y + 4.5], atol=1e-9)


def test_several_parts_are_one_region_unless_only_the_largest_is_asked_for():
    """`all` pools the parts above the gate; `largest` takes one of them."""
    mask = blank()
    mask[10:40, 10:50] = 255
    mask[60:80, 100:120] = 255
    whole, largest = find_region(mask, rule()), find_region(mask, rule(components="largest"))
    assert whole is not None
    assert largest is not None
    assert (whole.area_px, largest.area_px) == (1600, 1200)
    np.testing.assert_allclose(whole.centroid_px, mean_of_pixels(mask), atol=1e-9)
    np.testing.assert_allclose(largest.centroid_px, [29.5, 24.5], atol=1e-9)


@pytest.mark.parametrize(("x", "y"), [(61.0, 47.0), (75.5, 60.3)])
def test_the_hull_completes_an_ellipse_that_a_bar_cuts(x, y):
    """With an instrument across the middle, the hull's centroid stays within 1 px of the ellipse's own.

    The mean of what is left to see is off by more than that when the bar lies to one side.
    """
    ys, xs = np.mgrid[:120, :160]
    mask = np.where(((xs - x) / 45) ** 2 + ((ys - y) / 35) ** 2 <= 1, 255, 0).astype(np.uint8)
    mask[:, round(x) + 8 : round(x) + 24] = 0
    hull, pixels = find_region(mask, rule(occlusion="hull")), find_region(mask, rule())
    assert hull is not None
    assert pixels is not None
    assert np.linalg.norm(hull.centroid_px - [x, y]) < 1.0
    assert np.linalg.norm(pixels.centroid_px - [x, y]) > 2.0
    assert hull.hull_area_px2 > hull.area_px


def test_specks_of_colour_elsewhere_are_ignored():
    """A speck above the gate but below 2 % of the largest part changes nothing, and a larger part does."""
    mask = blank()
    cv2.circle(mask, (50, 60), 30, 255, -1)
    clean = find_region(mask, rule(occlusion="hull"))
    assert clean is not None
    mask[5:10, 150:155] = 255
    assert SPECK_FRACTION * clean.area_px > 25
    speckled = find_region(mask, rule(occlusion="hull"))
    assert speckled is not None
    assert speckled.area_px == clean.area_px
    np.testing.assert_array_equal(speckled.centroid_px, clean.centroid_px)
    mask[5:20, 140:155] = 255
    larger = find_region(mask, rule(occlusion="hull"))
    assert larger is not None
    assert larger.area_px == clean.area_px + 225


def test_an_island_in_a_hole_and_a_neighbour_in_the_box_are_told_apart():
    """A part's count takes in what lies within its outer contour, and nothing else in its bounding box."""
    mask = blank()
    cv2.circle(mask, (60, 60), 40, 255, 3)
    cv2.circle(mask, (60, 60), 6, 255, -1)
    within = np.count_nonzero(mask)
    mask[20:28, 20:28] = 255  # inside the ring's box, outside the ring
    largest = find_region(mask, rule(components="largest"))
    whole = find_region(mask, rule())
    assert largest is not None
    assert whole is not None
    assert largest.area_px == within
    assert whole.area_px == np.count_nonzero(mask)


def test_a_line_one_pixel_wide_has_a_finite_hull_centroid():
    """A hull without area falls back to the mean of its points instead of dividing by zero."""
    mask = blank()
    mask[30, 20:81] = 255
    region = find_region(mask, rule(occlusion="hull"))
    assert region is not None
    np.testing.assert_allclose(region.centroid_px, [50.0, 30.0], atol=1e-9)
    assert region.hull_area_px2 == 0.0
