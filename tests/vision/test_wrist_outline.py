"""The tool's origin in a wrist's outline: where the jaws are missed, it is farther on, and the deviation says so."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from svmdist.vision.silhouette import WristShape, wrist_point

SHAPE = WristShape(0.4, 2.0)
WIDTH_PX = 40.0
END_PX, ALONG = np.array([200.0, 150.0]), np.array([1.0, 0.0])
ORIGIN_PX = END_PX + SHAPE.tool_fraction * SHAPE.length_widths * WIDTH_PX * ALONG


def outlined(seen: float) -> tuple[np.ndarray, np.ndarray]:
    """A grey instrument, and the mask of its shaft and of a part of its wrist and jaws; the rest looks like tissue."""
    bgr = np.full((300, 400, 3), (90, 90, 180), np.uint8)
    length = int(seen * SHAPE.length_widths * WIDTH_PX)
    mask = np.zeros(bgr.shape[:2], np.uint8)
    mask[130:171, :201] = 255
    mask[138:163, 200 : 201 + length] = 255
    bgr[mask > 0] = 110
    return cv2.GaussianBlur(bgr, (0, 0), 0.8), mask


@pytest.mark.parametrize("seen", [1.0, 0.8, 0.6, 0.55])
def test_the_origin_is_within_what_is_stated(seen: float) -> None:
    bgr, mask = outlined(seen)
    found = wrist_point(bgr, mask, END_PX, ALONG, WIDTH_PX, SHAPE)
    assert found is not None
    assert np.linalg.norm(found.pixel - ORIGIN_PX) < 2.0 * found.std_px


def test_a_short_outline_tells_less_than_a_whole_one() -> None:
    whole, short = (wrist_point(*outlined(seen), END_PX, ALONG, WIDTH_PX, SHAPE) for seen in (1.0, 0.6))
    assert whole is not None
    assert short is not None
    assert short.std_px / 0.6 > 1.3 * whole.std_px
    assert np.linalg.norm(whole.pixel - ORIGIN_PX) < 2.0


@pytest.mark.parametrize("seen", [0.2, 0.4])
def test_another_tip_than_the_profiles_tells_no_origin(seen: float) -> None:
    """A stub where wrist and jaws should be: its middle is nowhere near the origin."""
    assert wrist_point(*outlined(seen), END_PX, ALONG, WIDTH_PX, SHAPE) is None
