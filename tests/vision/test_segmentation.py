"""Colour masks: HSV boxes, held against plain comparisons in NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from svmdist.profile import ColourRegion
from svmdist.vision.colour import colour_mask
from svmdist.vision.frame_context import to_hsv

hues = st.integers(0, 179)
bounds = st.tuples(st.integers(0, 255), st.integers(0, 255)).map(sorted).map(tuple)


def brute_force(image_hsv: np.ndarray, region: ColourRegion) -> np.ndarray:
    """The mask by the definition: hue inside the range, or outside the gap where the range wraps."""
    h, s, v = np.moveaxis(image_hsv.astype(int), -1, 0)
    first, last = region.hue
    in_hue = (h >= first) & (h <= last) if first <= last else (h >= first) | (h <= last)
    in_s = (s >= region.saturation[0]) & (s <= region.saturation[1])
    in_v = (v >= region.value[0]) & (v <= region.value[1])
    return np.where(in_hue & in_s & in_v, 255, 0)


@settings(deadline=None, max_examples=80)
@given(hues, hues, bounds, bounds, st.integers(0, 99))
def test_a_mask_equals_the_definition(first, last, saturation, value, seed):
    """Every box, wrapped or not, selects exactly the pixels that its bounds include."""
    region = ColourRegion(hue=(first, last), saturation=saturation, value=value, min_area_px=1)
    image_hsv = np.random.default_rng(seed).integers(0, [180, 256, 256], (24, 24, 3)).astype(np.uint8)
    np.testing.assert_array_equal(colour_mask(image_hsv, region), brute_force(image_hsv, region))


def test_red_on_both_sides_of_zero_is_one_colour():
    """A hue of 350° and one of 10° both pass a range that wraps around 0; green does not."""
    bgr = np.array([[[43, 0, 255], [0, 43, 255], [0, 255, 0]]], np.uint8)
    region = ColourRegion(hue=(170, 8), saturation=(110, 255), value=(60, 255), min_area_px=1)
    np.testing.assert_array_equal(colour_mask(to_hsv(bgr), region), [[255, 255, 0]])


@pytest.mark.parametrize(
    ("bgr", "hsv"),
    [
        ((0, 0, 255), (0, 255, 255)),
        ((0, 255, 0), (60, 255, 255)),
        ((255, 0, 0), (120, 255, 255)),
        ((255, 0, 255), (150, 255, 255)),
        ((128, 128, 128), (0, 0, 128)),
    ],
)
def test_hue_is_in_half_degrees(bgr, hsv):
    """Red, green, blue and magenta lie at 0, 60, 120 and 150: the paper's 0 to 360 does not fit a byte."""
    assert tuple(to_hsv(np.array([[bgr]], np.uint8))[0, 0]) == hsv
