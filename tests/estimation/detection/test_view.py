"""A view hides the pixels of other instruments from every mask that an instrument may own, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.estimation.frame import View
from svmdist.estimation.scene import Arm
from svmdist.samples import Image
from svmdist.vision.frame_context import FrameContext
from svmdist.vision.segmentation import make_segmenter
from tests.shipped import PROFILE

CAMERA = Camera.from_horizontal_fov(120, 80, np.pi / 3)
RED, CYAN, DARK = (60, 50, 200), (180, 180, 20), (30, 28, 28)
LEFT, RIGHT = slice(0, 60), slice(60, 120)


@pytest.fixture
def context() -> FrameContext:
    """Two halves alike: tissue above, a coloured part and a dark shaft below."""
    image = np.full((80, 120, 3), 150, np.uint8)
    for half in (0, 60):
        image[0:20, half + 10 : half + 50] = RED
        image[30:50, half + 10 : half + 50] = CYAN
        image[60:80, half + 10 : half + 50] = DARK
    return FrameContext(image, make_segmenter(PROFILE.segmentation))


def right_half() -> Image:
    others = np.zeros((80, 120), np.uint8)
    others[:, RIGHT] = 255
    return others


def test_one_instrument_sees_the_context_itself(context: FrameContext) -> None:
    view = View(Arm(PROFILE), CAMERA, context)
    assert view.masks is context.masks
    assert view.masks_as_recorded is context.masks_as_recorded


@pytest.mark.parametrize("name", ["masks", "masks_as_recorded"])
def test_others_pixels_are_nobodys(context: FrameContext, name: str) -> None:
    """Own half as it was, the other half empty, in the coloured part and the shaft; the tissue is everybody's."""
    whole = getattr(context, name)
    masks = getattr(View(Arm(PROFILE), CAMERA, context, right_half()), name)
    np.testing.assert_array_equal(masks.tissue, whole.tissue)
    assert whole.tissue.any()
    for part in ("instrument", "shaft"):
        mine, both = getattr(masks, part), getattr(whole, part)
        assert both[:, RIGHT].any()
        assert not mine[:, RIGHT].any()
        np.testing.assert_array_equal(mine[:, LEFT], both[:, LEFT])


def test_two_views_share_an_image_and_divide_its_instruments(context: FrameContext) -> None:
    """With opposite pixels hidden, two views own every pixel of the instruments between them, and none both."""
    others = right_half()
    first, second = (
        View(Arm(PROFILE), CAMERA, context, others),
        View(Arm(PROFILE), CAMERA, context, 255 - others),
    )
    mine, other = first.masks.instrument, second.masks.instrument
    assert not (mine & other).any()
    np.testing.assert_array_equal(mine | other, context.masks.instrument)
