"""Coloured regions and dark pixels of a drawn mask: who owns what, and that nobody is told to ignore what is theirs."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from svmdist.estimation.coloured_regions import (
    GROWN_PX,
    LIKELY_DARK,
    UNLIKELY_DARK,
    ColouredRegions,
    DarkPixels,
    ShaftAxis,
)
from svmdist.profile import AreaGate
from svmdist.samples import Image

GATE = AreaGate(min_area_px=100)
SHAPE = (240, 320)
DISCS = [(80, 100, 15), (220, 140, 20)]
"""Column, row and radius in px."""
FRAGMENT, STRAY = (80 + 25, 100, 3), (150, 30, 3)
"""25 px from the first disc's centre, within 2.5 of its radii; and one near nobody."""


def drawn(*discs: tuple[int, int, int]) -> Image:
    mask = np.zeros(SHAPE, np.uint8)
    for x, y, radius in discs:
        cv2.circle(mask, (x, y), radius, 255, -1)
    return mask


@pytest.fixture
def regions() -> ColouredRegions:
    return ColouredRegions.of(drawn(*DISCS, FRAGMENT, STRAY), GATE)


def index_of(regions: ColouredRegions, disc: tuple[int, int, int]) -> int:
    """The region whose centre is the disc's, to the pixel."""
    gaps = [float(np.linalg.norm(blob.centre_px - disc[:2])) for blob in regions.blobs]
    assert min(gaps) < 1.0
    return int(np.argmin(gaps))


def test_labels_partition_the_mask(regions: ColouredRegions) -> None:
    """A pixel has a label where it is coloured; blobs and fragments are all labels, with their areas."""
    np.testing.assert_array_equal(regions.labels > 0, regions.mask > 0)
    names = [*regions.names, *(label for label, _ in regions.fragments)]
    assert sorted(names) == list(range(1, int(regions.labels.max()) + 1))
    blobs = [*regions.blobs, *(blob for _, blob in regions.fragments)]
    for name, blob in zip(names, blobs, strict=True):
        y, x = np.nonzero(regions.labels == name)
        assert blob.area_px == len(x)
        np.testing.assert_allclose(
            blob.centre_px, [x.mean(), y.mean()], atol=1e-9
        )  # both are means of integers


def test_the_gate_parts_regions_from_fragments(regions: ColouredRegions) -> None:
    """Regions are larger than the gate's area; a part of exactly that area is a fragment."""
    assert len(regions.blobs) == len(DISCS)
    assert len(regions.fragments) == 2
    assert all(blob.area_px > GATE.min_area_px for blob in regions.blobs)
    mask = np.zeros(SHAPE, np.uint8)
    mask[10:20, 10:20] = 255
    assert ColouredRegions.of(mask, GATE).blobs == ()
    assert len(ColouredRegions.of(mask, AreaGate(min_area_px=99)).blobs) == 1


@pytest.mark.parametrize("disc", DISCS)
def test_one_s_own_region_is_never_marked(regions: ColouredRegions, disc: tuple[int, int, int]) -> None:
    """`without` marks all of the rest, and a border about it, and nothing of the region itself."""
    at = index_of(regions, disc)
    others = regions.without(at)
    mine = regions.labels == regions.names[at]
    assert not others[mine].any()
    (other,) = (name for name in regions.names if name != regions.names[at])
    assert others[regions.labels == other].all()
    reach = GROWN_PX // 2
    rest = np.asarray(cv2.subtract(regions.mask, np.where(mine, regions.mask, 0).astype(np.uint8)))
    grown = cv2.dilate(rest, np.ones((2 * reach + 1,) * 2, np.uint8))
    assert not others[grown == 0].any()


def test_a_fragment_is_of_the_region_that_it_is_near(regions: ColouredRegions) -> None:
    """The first disc's fragment is its own, and another's for the second disc; a stray is another's for both."""
    first, second = (index_of(regions, disc) for disc in DISCS)
    near, stray = (drawn(part) > 0 for part in (FRAGMENT, STRAY))
    assert not regions.without(first)[near].any()
    assert regions.without(second)[near].all()
    assert regions.without(first)[stray].all()
    assert regions.without(second)[stray].all()


def test_who_has_no_region_owns_no_colour(regions: ColouredRegions) -> None:
    """For None everything coloured is another's, with its border."""
    others = regions.without(None)
    assert others[regions.mask > 0].all()
    assert np.count_nonzero(others) > np.count_nonzero(regions.mask)


def test_regions_that_nearly_touch_keep_their_own() -> None:
    """Two regions 2 px apart: the border about one ends where the other begins."""
    mask = np.zeros(SHAPE, np.uint8)
    mask[50:80, 50:80] = 255
    mask[50:80, 82:112] = 255
    regions = ColouredRegions.of(mask, GATE)
    for at, name in enumerate(regions.names):
        assert not regions.without(at)[regions.labels == name].any()


AXIS = ShaftAxis(np.array([60.0, 120.0]), np.array([1.0, 0.0]), 60.0, 8.0)
"""A shaft to the right; it begins 60 px from the tool, and the ray is asked from 75 px to 132 px."""


def bar(x: slice, y: slice) -> DarkPixels:
    mask = np.zeros(SHAPE, np.uint8)
    mask[y, x] = 255
    return DarkPixels.of(mask, np.zeros(SHAPE, np.uint8))


def test_evidence_is_the_two_logarithms_at_its_ends() -> None:
    """All dark: log(0.85 / 0.3); all light: log(0.15 / 0.7). No approximation lies between: 1e-12."""
    likely, unlikely = LIKELY_DARK, UNLIKELY_DARK
    dark, light = bar(slice(100, 220), slice(112, 128)), bar(slice(100, 220), slice(20, 36))
    assert dark.evidence(AXIS) == pytest.approx(np.log(likely / unlikely), abs=1e-12)
    assert light.evidence(AXIS) == pytest.approx(np.log((1 - likely) / (1 - unlikely)), abs=1e-12)


def test_evidence_grows_with_the_dark_part() -> None:
    """The longer the bar, the surer: from against to for."""
    found = [bar(slice(130, end), slice(112, 128)).evidence(AXIS) for end in (134, 150, 165, 180, 195)]
    assert found == sorted(found)
    assert found[0] < 0.0 < found[-1]


def test_a_line_outside_of_the_image_says_nothing() -> None:
    """Of an axis that leaves the image at once, too few points are inside."""
    axis = ShaftAxis(np.array([315.0, 120.0]), np.array([1.0, 0.0]), 60.0, 8.0)
    assert bar(slice(100, 220), slice(112, 128)).evidence(axis) == 0.0


def test_a_dark_pixel_is_the_nearer_axis_s() -> None:
    """Two parallel shafts: each bar to its own axis, what is beyond 2.5 radii to nobody, light pixels to nobody."""
    mask = np.zeros(SHAPE, np.uint8)
    mask[60:76, 100:220] = 255
    mask[112:128, 100:220] = 255
    mask[200:216, 100:220] = 255
    dark = DarkPixels.of(mask, np.zeros(SHAPE, np.uint8))
    upper = ShaftAxis(np.array([60.0, 68.0]), np.array([1.0, 0.0]), 60.0, 8.0)
    owner = dark.by_axis([upper, None, AXIS])
    assert set(np.unique(owner[61:75, 101:219])) == {0}
    assert set(np.unique(owner[113:127, 101:219])) == {2}
    assert set(np.unique(owner[201:215, 101:219])) == {-1}
    assert set(np.unique(owner[dark.mask == 0])) == {-1}
    assert set(np.unique(dark.by_axis([None, None]))) == {-1}


def test_owners_do_not_depend_on_the_order_of_the_axes() -> None:
    """Swapped axes swap the owners, apart from pixels that are as near to both, of which this mask has none."""
    mask = np.zeros(SHAPE, np.uint8)
    mask[60:76, 100:220] = 255
    mask[112:128, 100:220] = 255
    dark = DarkPixels.of(mask, np.zeros(SHAPE, np.uint8))
    upper = ShaftAxis(np.array([60.0, 68.0]), np.array([1.0, 0.0]), 60.0, 8.0)
    there, back = dark.by_axis([upper, AXIS]), dark.by_axis([AXIS, upper])
    swap = np.array([1, 0, -1], np.int8)
    np.testing.assert_array_equal(swap[there], back)
