"""A frame's context: every form of an image is made once, when it is first asked for."""

from __future__ import annotations

import gc
import weakref

import cv2
import numpy as np
import pytest

from svmdist.profile import load_profile
from svmdist.vision.frame_context import FrameContext, to_hsv
from svmdist.vision.segmentation import InstrumentMasks, make_segmenter

SEGMENTER = make_segmenter(load_profile().segmentation)


def scene(light: float = 1.0) -> np.ndarray:
    """A grey floor, a red disc, a dark bar, a cyan spot, in some light."""
    image = np.full((240, 320, 3), (104, 112, 132), np.uint8)
    cv2.circle(image, (150, 120), 60, (92, 84, 214), -1)
    cv2.rectangle(image, (180, 110), (319, 140), (30, 30, 32), -1)
    cv2.circle(image, (170, 125), 12, (200, 190, 30), -1)
    return np.rint(image * light).astype(np.uint8)


def test_nothing_is_made_before_it_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_args: object) -> None:
        raise AssertionError("converted")

    monkeypatch.setattr(cv2, "cvtColor", refuse)
    context = FrameContext(scene(), SEGMENTER)
    assert context.shape == (240, 320)
    with pytest.raises(AssertionError, match="converted"):
        _ = context.grey


def test_each_form_is_made_once() -> None:
    context = FrameContext(scene(), SEGMENTER)
    for name in ("bgr", "hsv", "hsv_as_recorded", "brightness", "grey", "masks", "masks_as_recorded"):
        assert getattr(context, name) is getattr(context, name), name


def test_a_well_exposed_image_has_one_hsv_and_one_segmentation() -> None:
    """Where the exposure is fair, normalised forms are the recorded ones, whichever is asked for first."""
    context = FrameContext(scene(), SEGMENTER)
    assert context.exposure.is_plain
    assert context.bgr is context.bgr_as_recorded
    assert context.hsv is context.hsv_as_recorded
    assert context.masks is context.masks_as_recorded
    other = FrameContext(scene(), SEGMENTER)
    assert other.masks_as_recorded is other.masks


def test_a_dim_image_is_segmented_at_normalised_exposure() -> None:
    """The organ is found in a third of the light; the masks as recorded stay what they are."""
    fair, dim = FrameContext(scene(), SEGMENTER), FrameContext(scene(0.3), SEGMENTER)
    assert not dim.exposure.is_plain
    assert dim.masks is not dim.masks_as_recorded
    whole = np.count_nonzero(fair.masks.tissue)
    assert np.count_nonzero(dim.masks.tissue) == pytest.approx(whole, rel=0.05)
    np.testing.assert_array_equal(dim.hsv_as_recorded, to_hsv(dim.bgr_as_recorded))


def test_brightness_is_the_brightest_channel() -> None:
    context = FrameContext(scene(), SEGMENTER)
    np.testing.assert_array_equal(context.brightness, context.bgr.max(-1))


def test_other_instruments_are_taken_off_but_not_off_the_tissue() -> None:
    """What belongs to another instrument is no part of this one's masks; the tissue is everybody's."""
    masks = FrameContext(scene(), SEGMENTER).masks
    others = np.zeros((240, 320), np.uint8)
    others[100:150, 160:250] = 255
    own = InstrumentMasks(masks, others)
    assert own.tissue is masks.tissue
    assert not (own.instrument & others).any()
    assert own.shaft is not None
    assert not (own.shaft & others).any()
    np.testing.assert_array_equal(own.shaft | (masks.shaft & others), masks.shaft)


def test_a_context_is_freed_at_once() -> None:
    """Without the collector of circles: it looks for them by the number of objects, of which an image is one."""
    gc.disable()
    try:
        context = FrameContext(np.full((48, 64, 3), 90, np.uint8), SEGMENTER)
        for masks in (context.masks, context.masks_as_recorded):
            assert not masks.tissue.any()
        del masks
        gone = weakref.ref(context)
        del context
        assert gone() is None
    finally:
        gc.enable()
