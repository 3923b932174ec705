"""Instruments in random pictures: found where there are any, none in bare tissue, whatever border and light."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.profile.settings import AutoSettings
from svmdist.samples import Image
from svmdist.vision.find_instruments import find_instruments, learnt_appearance, outline_geometry, search_bars
from svmdist.vision.segmentation import AutoSegmenter
from svmdist.vision.working_image import WorkingImage, picture_of
from tests.surgery_images import BORDERS, surgery_image

SETTINGS = AutoSettings()


def iou(a: Image, b: Image) -> float:
    """Intersection over union of two masks, shape (h, w)."""
    union = np.count_nonzero((a > 0) | (b > 0))
    return np.count_nonzero((a > 0) & (b > 0)) / union if union else 1.0


def instruments(segmenter: AutoSegmenter, bgr: Image) -> Image:
    """All instruments' pixels, shape (h, w)."""
    masks = [one.mask for one in segmenter.masks(bgr).seen]
    return np.asarray(np.any(masks, axis=0), np.uint8) if masks else np.zeros(bgr.shape[:2], np.uint8)


def test_instruments_over_tissue() -> None:
    """Of each image alone: most of 16 pictures above 0.85, none below 0.6."""
    found = [
        iou(instruments(AutoSegmenter(), one.bgr), one.instruments) for one in map(surgery_image, range(16))
    ]
    assert np.median(found) > 0.88
    assert np.mean(np.array(found) > 0.85) >= 0.8
    assert min(found) > 0.6


def test_bare_tissue_holds_no_instrument() -> None:
    """Vessels, fat, highlights, light that falls off and any border are no straight sides that come in."""
    counts = [len(AutoSegmenter().masks(surgery_image(seed, count=0).bgr).seen) for seed in range(24)]
    assert counts.count(0) >= 23


def test_bare_paper_holds_no_instrument() -> None:
    """Nor does what is as achromatic as an instrument."""
    for seed in range(8):
        assert not AutoSegmenter().masks(surgery_image(seed, count=0, background="paper").bgr).seen


def test_a_log_teaches_what_one_image_hides() -> None:
    """Learnt from all of them, each image is segmented at least as well on the whole."""
    images = [surgery_image(seed, border="circle") for seed in range(6)]
    alone = [iou(instruments(AutoSegmenter(), one.bgr), one.instruments) for one in images[:3]]
    adapted = AutoSegmenter().adapted_to([one.bgr for one in images])
    together = [iou(instruments(adapted, one.bgr), one.instruments) for one in images[:3]]
    assert np.mean(together) > np.mean(alone) - 0.05
    assert np.mean(together) > 0.75


def test_the_same_image_gives_the_same_masks() -> None:
    """Nothing is random, and nothing is remembered between images."""
    one, other = surgery_image(3), surgery_image(4)
    segmenter = AutoSegmenter().adapted_to([one.bgr, other.bgr])
    first = segmenter.masks(one.bgr)
    _ = segmenter.masks(other.bgr).seen
    again = segmenter.masks(one.bgr)
    assert len(first.seen) == len(again.seen) > 0
    for a, b in zip(first.seen, again.seen, strict=True):
        assert np.array_equal(a.mask, b.mask)
        assert np.array_equal(a.sides, b.sides)


@pytest.mark.parametrize("border", BORDERS)
def test_the_picture_inside_its_border(border: str) -> None:
    """A border of any shape is found to a pixel or two, and is never shaft nor tissue."""
    for seed in range(3):
        one = surgery_image(seed, border=border)
        assert iou(picture_of(one.bgr), one.picture) > 0.97
        masks = AutoSegmenter().masks(one.bgr)
        outside = ~_near(one.picture)
        assert masks.shaft is not None
        assert not (masks.shaft[outside] > 0).any()
        assert not (masks.tissue[outside] > 0).any()


def _near(mask: Image) -> np.ndarray:
    import cv2

    return np.asarray(cv2.dilate(mask, np.ones((9, 9), np.uint8))) > 0


def test_sides_run_along_the_shaft() -> None:
    """Axes of single instruments within 3 degrees of what was drawn, on all pictures where one is found."""
    off_deg = []
    for seed in range(20, 36):
        one = surgery_image(seed, count=1)
        seen = AutoSegmenter().masks(one.bgr).seen
        if seen:
            drawn = one.axes[0][1] - one.axes[0][0]
            cosine = float(seen[0].axis @ drawn) / float(np.linalg.norm(drawn))
            off_deg.append(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
    assert len(off_deg) >= 14
    assert np.median(off_deg) < 1.5
    assert np.mean(np.array(off_deg) < 5.0) >= 0.9


def test_shaft_and_distal_part_are_the_instrument() -> None:
    """Both together are the mask, and share no pixel."""
    for seed in (0, 5, 9):
        for one in AutoSegmenter().masks(surgery_image(seed).bgr).seen:
            assert np.array_equal(one.shaft | one.distal, one.mask)
            assert not (one.shaft & one.distal).any()


def test_where_an_outline_stops_being_a_cylinder() -> None:
    """A bar of constant width ends where jaws begin to be narrower; the tip is the farthest of them."""
    mask = np.zeros((120, 200), bool)
    mask[50:71, 0:120] = True  # 21 px wide
    mask[57:64, 120:160] = True
    sides = np.array([[[0.0, 49.5], [80.0, 49.5]], [[0.0, 70.5], [80.0, 70.5]]])
    whole, end_px, tip_px = outline_geometry(mask, sides)
    assert end_px == pytest.approx([119.0, 60.0], abs=1.5)
    assert tip_px == pytest.approx([159.0, 60.0], abs=1.5)
    assert whole[:, 1, 0] == pytest.approx([119.0, 119.0], abs=1.5)
    assert whole[:, 0] == pytest.approx(sides[:, 0])


def test_without_an_instrument_nothing_is_learnt() -> None:
    """No bar is sure: the segmenter then looks at each image alone."""
    bare = WorkingImage.of(surgery_image(1, count=0).bgr, SETTINGS)
    assert learnt_appearance([bare]) is None
    assert learnt_appearance([]) is None
    segmenter = AutoSegmenter().adapted_to([surgery_image(1, count=0).bgr])
    one = surgery_image(8)
    assert iou(instruments(segmenter, one.bgr), one.instruments) > 0.8


def test_black_and_white_images_hold_nothing() -> None:
    """What has no picture, or no edge, gives empty masks and no error."""
    for level in (0, 255):
        masks = AutoSegmenter().masks(np.full((120, 160, 3), level, np.uint8))
        assert masks.seen == ()
        assert not masks.instrument.any()


def test_found_masks_hang_together_with_their_bars() -> None:
    """Every instrument found has a bar inside of its own mask."""
    image = WorkingImage.of(surgery_image(2).bgr, SETTINGS)
    appearance = learnt_appearance([image])
    assert appearance is not None
    found = find_instruments(image, appearance, search_bars(image))
    assert found
    for one in found:
        x, y = np.rint(one.bar.middles.mean(axis=0)).astype(int)
        assert one.mask[y, x]
