"""The parts of `auto`: bars on outlines, the evidence for them, and the table of colours."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from svmdist.profile.settings import AutoSettings
from svmdist.vision.instrument_bars import Zones, bars_in, best_bar, sharpened
from svmdist.vision.instrument_evidence import belonging, judged, with_missed_parts
from svmdist.vision.working_image import (
    MOST_RATIO,
    Example,
    WorkingImage,
    colour_logs,
    learnt_from,
    tissue_of,
)

SETTINGS = AutoSettings()
TISSUE = (90, 90, 190)
STEEL = (120, 120, 120)


def picture(
    width_px: float = 24.0,
    angle_deg: float = 20.0,
    colour: tuple[int, int, int] = STEEL,
    softness_px: float = 0.5,
) -> tuple[WorkingImage, np.ndarray]:
    """A bar from the left border into red tissue, 320x240, and its mask (h, w)."""
    bgr = np.full((240, 320, 3), TISSUE, np.uint8)
    along = np.array([np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))])
    normal = np.array([-along[1], along[0]])
    start, end = np.array([-40.0, 80.0]), np.array([-40.0, 80.0]) + 200.0 * along
    half = 0.5 * width_px * normal
    corners = np.rint([start + half, end + half, end - half, start - half]).astype(np.int32)
    mask = np.zeros((240, 320), np.uint8)
    cv2.fillConvexPoly(mask, corners, 255)
    weight = cv2.GaussianBlur(mask, (0, 0), softness_px)[..., None] / 255.0
    mixed = (1.0 - weight) * bgr + weight * np.array(colour)
    return WorkingImage.of(np.rint(mixed).astype(np.uint8), SETTINGS), mask


@pytest.mark.parametrize("angle_deg", [-15.0, 0.0, 8.0, 33.0])
@pytest.mark.parametrize("width_px", [12.0, 24.0, 50.0])
def test_a_bar_is_recovered(width_px: float, angle_deg: float) -> None:
    """Its width to 1.5 px, its direction to 1.5 degrees."""
    image, mask = picture(width_px, angle_deg)
    ((bar, part),) = list(bars_in(mask, image, 0.5, 1))
    assert bar.width_px == pytest.approx(width_px, abs=1.5)
    one = judged(bar, part, image)
    assert one is not None
    off = np.degrees(np.arctan2(one.bar.axis[1], one.bar.axis[0])) - angle_deg
    assert abs(off) < 1.5
    assert one.bar.middles[0, 0] < one.bar.middles[1, 0]  # from the border inwards


def test_a_blob_has_no_bar() -> None:
    """A disc cut off by the border has no two straight sides of any length."""
    mask = np.zeros((240, 320), np.uint8)
    cv2.circle(mask, (0, 120), 50, 255, cv2.FILLED)
    image, _ = picture()
    judgements = [judged(bar, part, image) for bar, part in bars_in(mask, image, 0.5, 3)]
    assert all(one is None for one in judgements)
    (contour,), _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    assert best_bar(contour[:20].reshape(-1, 2), np.ones(20, bool), 320) is None


def test_a_shadow_is_no_instrument() -> None:
    """Darker at the same colour, with an edge as soft as shadows have; nor is a red bar."""
    dimmed = tuple(int(0.75 * level) for level in TISSUE)
    for colour, softness_px in ((dimmed, 8.0), ((30, 30, 200), 0.5)):
        image, mask = picture(colour=(colour[0], colour[1], colour[2]), softness_px=softness_px)
        for bar, part in bars_in(mask, image, 0.5, 1):
            assert judged(bar, part, image) is None


def test_what_does_not_come_in_from_the_border() -> None:
    """A bar in the middle of the picture reaches no border."""
    image, _ = picture()
    mask = np.zeros((240, 320), np.uint8)
    mask[100:120, 100:200] = 255
    assert not list(bars_in(mask, image, 0.5, 1))


def test_light_does_not_change_colours() -> None:
    """Ratios stay where all channels are scaled alike; the mean logarithm moves by the logarithm of the scale."""
    bgr = np.array([[[40, 60, 120]]], np.uint8)
    dim, bright = colour_logs(bgr, 1e-3), colour_logs((2 * bgr).astype(np.uint8), 1e-3)
    assert bright[..., :2] == pytest.approx(dim[..., :2], abs=1e-4)
    assert bright[..., 2] - dim[..., 2] == pytest.approx(np.log(2.0), abs=1e-4)


def test_appearance_tells_what_it_was_taught() -> None:
    """Positive inside, negative outside, bounded; grey of another brightness counts as instrument."""
    image, mask = picture()
    inside = cv2.erode(mask, np.ones((5, 5), np.uint8))
    outside = cv2.bitwise_not(cv2.dilate(mask, np.ones((5, 5), np.uint8)))
    appearance = learnt_from([Example(image, np.asarray(inside, np.uint8), np.asarray(outside, np.uint8))])
    assert appearance is not None
    ratio = appearance.of(image)
    assert ratio[inside > 0].mean() > 1.0
    assert ratio[outside > 0].mean() < -1.0
    assert np.abs(ratio).max() <= MOST_RATIO + 1e-3
    bright = WorkingImage.of(np.full((240, 320, 3), 215, np.uint8), SETTINGS)
    assert appearance.of(bright).mean() > 0.5
    nothing = np.zeros_like(mask)
    assert learnt_from([Example(image, nothing, np.asarray(outside, np.uint8))]) is None
    assert learnt_from([]) is None


def test_zones_do_not_overlap_where_they_must_not() -> None:
    """The strip ends where the distal zone may begin, and holds the middle."""
    image, mask = picture()
    ((bar, part),) = list(bars_in(mask, image, 0.5, 1))
    one = judged(bar, part, image)
    assert one is not None
    zones = Zones.of(one.bar, image)
    assert not (zones.middle & ~zones.strip).any()
    assert (zones.strip[:, 2:60] & (mask[:, 2:60] > 0)).sum() > 0.9 * (mask[:, 2:60] > 0).sum()


def test_sides_move_to_the_steepest_change() -> None:
    """A bar of a mask that is 2 px too narrow on one side is put right to half a pixel."""
    image, mask = picture(30.0, 0.0)
    ((bar, _),) = list(bars_in(mask, image, 0.5, 1))
    off = replace(bar, sides=bar.sides + np.array([[[0.0, 2.0]], [[0.0, 0.0]]]))
    assert sharpened(off, image).width_px == pytest.approx(30.0, abs=1.0)
    plain = WorkingImage.of(np.full((240, 320, 3), 120, np.uint8), SETTINGS)
    assert np.array_equal(sharpened(off, plain).sides, off.sides)  # nothing changes anywhere: it stays


def test_what_goes_on_beyond_does_not_belong() -> None:
    """A strip of the same colour across the shaft's end is a thing behind it; a wrist is not."""
    image, mask = picture(20.0, 0.0)
    ((bar, part),) = list(bars_in(mask, image, 0.5, 1))
    one = judged(bar, part, image)
    assert one is not None
    zones = Zones.of(one.bar, image)
    likely = mask.copy()
    likely[:, 160:220] = 255
    ratio = np.where(likely > 0, 3.0, -3.0).astype(np.float32)
    own = belonging(zones, likely, ratio, image)
    assert np.count_nonzero(own & (mask == 0)) < 0.25 * np.count_nonzero((likely > 0) & (mask == 0))
    wrist = mask.copy()
    wrist[74:87, 160:200] = 255
    own = belonging(zones, wrist, np.where(wrist > 0, 3.0, -3.0).astype(np.float32), image)
    assert np.count_nonzero(own & (wrist > 0)) > 0.9 * np.count_nonzero(wrist[:, 4:])


def test_a_missed_part_is_added_where_nothing_else_looks_like_it() -> None:
    """A shaft beside the strip belongs to it; not where the background has that colour too, and no small shadow."""
    image, _ = picture()
    found = np.zeros((240, 320), bool)
    found[100:120, 20:120] = True
    beside = np.zeros_like(found)
    beside[120:150, 20:80] = True
    ratio = np.where(found | beside, 3.0, -3.0).astype(np.float32)
    (whole,) = with_missed_parts([found], ratio, image)
    assert np.count_nonzero(whole & beside) > 0.9 * np.count_nonzero(beside)
    elsewhere = ratio.copy()
    elsewhere[180:220, 150:300] = 3.0
    assert np.array_equal(with_missed_parts([found], elsewhere, image)[0], found)
    small = np.where(found, 3.0, -3.0).astype(np.float32)
    small[120:124, 20:60] = 3.0
    assert np.array_equal(with_missed_parts([found], small, image)[0], found)
    assert with_missed_parts([], ratio, image) == []


def test_tissue_is_what_is_red_where_that_is_distinct() -> None:
    """An organ on a drape is parted from it; tissue of one kind is all of the picture."""
    organ = np.full((240, 320, 3), (140, 140, 135), np.uint8)
    cv2.circle(organ, (160, 120), 60, TISSUE, cv2.FILLED)
    mask = tissue_of(WorkingImage.of(organ, SETTINGS))
    assert mask[120, 160] == 255
    assert mask[20, 20] == 0
    whole = tissue_of(picture(colour=TISSUE)[0])
    assert (whole == 255).all()
