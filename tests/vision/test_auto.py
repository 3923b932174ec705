"""Instruments in random pictures: found where there are any, none in bare tissue, whatever border and light."""

import cv2
import numpy as np
import pytest

from svmdist.samples import Image
from svmdist.vision.evidence import picture_of
from svmdist.vision.find_instruments import AutoSegmenter
from tests.pictures import BORDERS, surgery_image
from training.scene import iou


def instruments(bgr: Image) -> np.ndarray:
    """All instruments' pixels, shape (h, w)."""
    masks = [one.mask > 0 for one in AutoSegmenter().masks(bgr).seen]
    return np.any(masks, axis=0) if masks else np.zeros(bgr.shape[:2], np.bool_)


@pytest.mark.slow
def test_instruments_over_tissue():
    """Of each image alone: most of 16 pictures above 0.85, none below 0.6."""
    found = [iou(instruments(one.bgr), one.instruments > 0) for one in map(surgery_image, range(16))]
    assert np.median(found) > 0.88
    assert np.mean(np.array(found) > 0.85) >= 0.8
    assert min(found) > 0.6


@pytest.mark.slow
def test_bare_tissue_holds_no_instrument():
    """Vessels, fat, highlights, light that falls off and any border are no straight sides that come in."""
    counts = [len(AutoSegmenter().masks(surgery_image(seed, count=0).bgr).seen) for seed in range(24)]
    assert counts.count(0) >= 23


@pytest.mark.parametrize("border", BORDERS)
def test_the_picture_inside_its_border(border):
    """A border of any shape is found to a pixel or two, and is never shaft nor tissue."""
    for seed in range(3):
        one = surgery_image(seed, border=border)
        assert iou(picture_of(one.bgr) > 0, one.picture > 0) > 0.97
        masks = AutoSegmenter().masks(one.bgr)
        outside = cv2.dilate(one.picture, np.ones((9, 9), np.uint8)) == 0
        assert masks.shaft is not None
        assert not (masks.shaft[outside] > 0).any()
        assert not (masks.tissue[outside] > 0).any()
