"""The network's hint beside learnt colours: where instruments are, and nothing where it is not asked for."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.profile.settings import AutoSettings
from svmdist.vision.segmentation import MOST_RATIO, AutoSegmenter, network_hint
from svmdist.vision.working_image import WorkingImage
from tests.surgery_images import surgery_image

SEEDS = range(8)


@pytest.mark.parametrize("seed", SEEDS)
def test_it_speaks_for_instruments_and_against_tissue(seed: int) -> None:
    """On drawn operations that it was not trained on, in the image's own size, with bounded odds."""
    drawn = surgery_image(seed)
    hint = network_hint(drawn.bgr)
    assert hint.shape == drawn.bgr.shape[:2]
    assert hint.dtype == np.float32
    assert np.abs(hint).max() <= MOST_RATIO
    assert (
        hint[drawn.instruments > 0].mean() > hint[(drawn.instruments == 0) & (drawn.picture > 0)].mean() + 1.0
    )


def test_its_weight_scales_it_and_zero_leaves_it_out() -> None:
    bgr = surgery_image(2).bgr
    asked = 0

    def hinting(image: np.ndarray) -> np.ndarray:
        nonlocal asked
        asked += 1
        return np.full(image.shape[:2], 2.0, np.float32)

    assert not WorkingImage.of(bgr, AutoSettings(network_weight=0.0), hinting).hint.any()
    assert not WorkingImage.of(bgr, AutoSettings()).hint.any()
    assert asked == 0
    half = WorkingImage.of(bgr, AutoSettings(network_weight=0.5), hinting)
    assert (half.hint == 1.0).all()
    assert half.hint is half.hint
    assert asked == 1


def test_masks_are_no_worse_with_it() -> None:
    """Over the drawn operations, mean IoU of all instruments with and without."""
    ious = []
    for weight in (0.0, 1.0):
        segmenter = AutoSegmenter(AutoSettings(network_weight=weight))
        found = []
        for seed in SEEDS:
            drawn = surgery_image(seed)
            seen = segmenter.masks(drawn.bgr).seen
            union = (
                np.any([one.mask > 0 for one in seen], axis=0)
                if seen
                else np.zeros(drawn.instruments.shape, bool)
            )
            truth = drawn.instruments > 0
            found.append(np.count_nonzero(union & truth) / np.count_nonzero(union | truth))
        ious.append(np.mean(found))
    assert ious[1] > ious[0] - 0.02
    assert ious[1] > 0.8
