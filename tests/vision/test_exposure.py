"""Normalising the exposure of images: what is undone, and what is left alone."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from svmdist.profile.settings import ExposureSettings
from svmdist.vision.colour import apply_exposure, exposure_of, percentiles

SETTINGS = ExposureSettings()


def normalised(image: np.ndarray) -> np.ndarray:
    return apply_exposure(image, exposure_of(image, SETTINGS))


def _scene(border: bool = False) -> np.ndarray:
    """A grey-brown floor, a red disc, a dark bar from the right, perhaps in an endoscope's round frame."""
    image = np.full((240, 320, 3), (104, 112, 132), np.uint8)
    cv2.circle(image, (150, 120), 60, (92, 84, 214), -1)
    cv2.rectangle(image, (180, 110), (319, 140), (30, 30, 32), -1)
    if border:
        view = cv2.circle(np.zeros((240, 320), np.uint8), (160, 120), 118, 1, -1)
        image *= view[..., None]
    return image


@pytest.mark.parametrize("border", [False, True])
def test_a_fair_exposure_is_left_alone(border: bool) -> None:
    """The same array comes back: nothing moves where nothing is wrong."""
    image = _scene(border)
    assert normalised(image) is image


@pytest.mark.parametrize("border", [False, True])
@pytest.mark.parametrize("light", [0.5, 0.35, 0.2])
def test_dim_light_is_raised(light: float, border: bool) -> None:
    """The floor comes back to a fair level whatever the light, and colours keep their ratios."""
    dim = np.rint(_scene(border) * light).astype(np.uint8)
    floor = normalised(dim)[60, 160 - 90].astype(float)
    assert 100 < floor.max() < 135
    assert floor[0] / floor[2] == pytest.approx(104 / 132, abs=0.06)


@pytest.mark.parametrize("share", [0.2, 0.4])
def test_a_veil_is_taken_off(share: float) -> None:
    """Under white haze the bar is as bright as the floor was; afterwards it is dark, and the disc red again."""
    veiled = np.rint(_scene() * (1 - share) + share * 205.0).astype(np.uint8)
    clear = normalised(veiled)
    assert clear[125, 250].max() < 70
    hsv = cv2.cvtColor(clear, cv2.COLOR_BGR2HSV)
    before = cv2.cvtColor(veiled, cv2.COLOR_BGR2HSV)
    assert hsv[120, 130, 1] > before[120, 130, 1] + np.uint8(10)


def test_without_anything_dark_a_veil_is_not_invented() -> None:
    """A pale image may be pale tissue: there is nothing to tell haze by."""
    assert exposure_of(np.full((240, 320, 3), 150, np.uint8), SETTINGS).is_plain
    image = _scene()[:, :180]
    assert exposure_of(image, SETTINGS).veil == 0.0
    assert exposure_of(np.zeros((240, 320, 3), np.uint8), SETTINGS).veil == 0.0


def test_percentiles_are_numpys() -> None:
    """Counted percentiles equal those of sorted values, to rounding, with and without a mask."""
    rng = np.random.default_rng(4)
    values = rng.integers(0, 256, (60, 80)).astype(np.uint8)
    mask = np.where(rng.uniform(size=values.shape) < 0.3, 255, 0).astype(np.uint8)
    wanted = (0.0, 0.5, 37.3, 50.0, 90.0, 100.0)
    assert percentiles(values, wanted) == pytest.approx(np.percentile(values, wanted), abs=1e-9)
    assert percentiles(values, wanted, mask) == pytest.approx(
        np.percentile(values[mask > 0], wanted), abs=1e-9
    )
