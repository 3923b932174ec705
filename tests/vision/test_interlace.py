"""Interlaced images: the first field where something moved, and not a pixel else."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from svmdist.profile.settings import InterlaceSettings
from svmdist.samples import Image, Observation, RightView
from svmdist.vision.frame_context import first_field, with_first_fields
from tests.synthetic import make_scene

CAMERA = make_scene().camera


def with_disc(x_px: float, noise: float = 2.0, seed: int = 1) -> Image:
    """A bright disc of 30 px radius over a textured ground, with sensor noise."""
    rng = np.random.default_rng(5)
    ground = cv2.GaussianBlur(rng.uniform(60, 120, (480, 640, 3)).astype(np.float32), (0, 0), 2.0)
    image = ground.copy()
    cv2.circle(image, (round(16 * x_px), 240 * 16), 30 * 16, (230.0, 220.0, 90.0), -1, cv2.LINE_AA, 4)
    image += np.random.default_rng(seed).normal(0.0, noise, image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def woven(first: Image, second: Image) -> Image:
    image = first.copy()
    image[1::2] = second[1::2]
    return image


def centre_x_px(image: Image) -> float:
    inside = image[..., 0] > 180
    return float(np.mean(np.nonzero(inside)[1]))


@pytest.mark.parametrize("moved_px", [3.0, 8.0, 20.0])
def test_what_moves_is_where_the_first_field_shows_it(moved_px: float) -> None:
    """Its middle within 0.3 px; as woven it is off by half of the motion between both fields."""
    image = woven(with_disc(300.0), with_disc(300.0 + moved_px, seed=2))
    assert centre_x_px(image) > 300.0 + 0.4 * moved_px
    mended = first_field(image)
    assert centre_x_px(mended) == pytest.approx(300.0, abs=0.3)
    np.testing.assert_array_equal(mended[::2], image[::2])
    np.testing.assert_array_equal(mended[:, 500:], image[:, 500:])


@pytest.mark.parametrize("noise", [0.0, 2.0, 4.0])
def test_what_holds_still_is_the_same_array(noise: float) -> None:
    """Neither texture nor edges nor noise count as combed."""
    image = woven(with_disc(300.0, noise), with_disc(300.0, noise, seed=2))
    assert first_field(image) is image


def test_fine_stripes_are_no_comb() -> None:
    """Stripes two rows high stand out as motion does, and on the same field's rows, too."""
    image = with_disc(300.0)
    image[100:160:4, 100:300] = 240
    image[101:160:4, 100:300] = 240
    assert first_field(image) is image


def test_settings_say_what_counts_as_combed() -> None:
    """With a threshold above its contrast a moving disc is left as it is woven."""
    image = woven(with_disc(300.0), with_disc(310.0))
    assert first_field(image, InterlaceSettings(comb_levels=200.0)) is image


def test_both_views_are_mended() -> None:
    still, moving = with_disc(300.0), woven(with_disc(300.0), with_disc(310.0))
    seen = Observation(0, still, CAMERA, right=RightView(moving, CAMERA, np.eye(4)))
    mended = with_first_fields(seen)
    assert mended.image_bgr is still
    assert mended.right is not None
    assert centre_x_px(mended.right.image_bgr) == pytest.approx(300.0, abs=0.3)
    plain = replace(seen, right=None)
    assert with_first_fields(plain) is plain
