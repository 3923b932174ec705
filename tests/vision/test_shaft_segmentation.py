"""The shaft's region in a mask: its sides, its end, and what is not one."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from svmdist.profile import AreaGate
from svmdist.samples import Image
from svmdist.vision.colour import field_of_view
from svmdist.vision.shaft_segmentation import bright_fraction, find_shaft

RULE = AreaGate(min_area_px=400)
HEIGHT, WIDTH = 480, 640


def bar(length: int = 220, speck: bool = False) -> Image:
    """A bar 40 px wide that comes in from the left, its middle on row 240."""
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[220:260, :length] = 255
    if speck:
        mask[30:33, 500:503] = 255
        mask[221:259, 100:104] = 0
    return mask


@pytest.mark.parametrize("speck", [False, True])
def test_a_bar_has_two_sides_and_an_end(speck: bool) -> None:
    """Sides on its first and last rows within a pixel, through glare and specks; corners are rounded by some pixels."""
    region = find_shaft(bar(speck=speck), RULE)
    assert region is not None
    rows = sorted(float(side.end_px[1]) for side in (region.first, region.second))
    np.testing.assert_allclose(rows, [220.0, 259.0], atol=1.0)
    assert region.end_px is not None
    np.testing.assert_allclose(region.end_px, [219.0, 239.5], atol=5.0)
    assert region.end_is_free
    assert not region.is_stub
    assert region.first.direction[0] == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("turn", [cv2.ROTATE_90_CLOCKWISE, cv2.ROTATE_180, cv2.ROTATE_90_COUNTERCLOCKWISE])
def test_a_turned_image_gives_a_turned_region(turn: int) -> None:
    """From any border, with any box about it, the same region is found, pixel by pixel."""
    region, turned = find_shaft(bar(), RULE), find_shaft(np.asarray(cv2.rotate(bar(), turn), np.uint8), RULE)
    assert region is not None
    assert turned is not None
    back = {cv2.ROTATE_90_CLOCKWISE: cv2.ROTATE_90_COUNTERCLOCKWISE, cv2.ROTATE_180: cv2.ROTATE_180}
    same = cv2.rotate(turned.mask, back.get(turn, cv2.ROTATE_90_CLOCKWISE))
    # Scales go with the image's width: a portrait one leaves out a narrower border.
    assert np.count_nonzero(same != region.mask) < 0.02 * np.count_nonzero(region.mask)


def test_what_is_mounted_at_the_end_is_told() -> None:
    """A covered patch beyond the end makes it no free end, one far from it does not."""
    near, far = np.zeros((2, HEIGHT, WIDTH), np.uint8)
    near[220:260, 225:260] = 255
    far[20:60, 500:560] = 255
    for covered, is_free in ((near, False), (far, True)):
        region = find_shaft(bar(), RULE, covered)
        assert region is not None
        assert region.end_is_free is is_free


def test_what_does_not_come_in_from_the_border_is_none() -> None:
    """A dark patch in the middle, and an empty mask, are no shaft."""
    patch = np.zeros((HEIGHT, WIDTH), np.uint8)
    patch[200:260, 300:400] = 255
    assert find_shaft(patch, RULE) is None
    assert find_shaft(np.zeros_like(patch), RULE) is None


def test_bright_fraction_counts_what_is_not_dark() -> None:
    """A tenth of the inside painted bright counts as a tenth, within its border of 2 px."""
    region = find_shaft(bar(), RULE)
    assert region is not None
    dark = bar()
    dark[220:260, 100:120] = 0
    assert bright_fraction(region, dark) == pytest.approx(20.0 / 212.0, abs=0.01)


def test_the_field_of_view_is_convex() -> None:
    """A bar that cuts a round picture leaves it round."""
    bright = np.zeros((HEIGHT, WIDTH), np.uint8)
    cv2.circle(bright, (320, 240), 200, 255, -1)
    dark = 255 - bright
    dark[:, 300:330][:240] = 255
    view = field_of_view(np.asarray(dark, np.uint8))
    assert np.count_nonzero(view) == pytest.approx(np.pi * 199**2, rel=0.02)
