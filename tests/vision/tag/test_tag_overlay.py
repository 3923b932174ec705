"""The derivatives of the pattern laid over pixels against differences, and the losses."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.estimation.instrument.tag_pose import on_tag
from svmdist.transforms import Array, make_transform, rotation_of
from svmdist.vision.tag_overlay import (
    GREY,
    LaidPattern,
    Loss,
    Overlay,
    TagPattern,
    TagPixels,
    lay_pattern,
    start_overlay,
)

PATTERN = TagPattern("36h11", 0, 0.007)
T = make_transform(rotation_of([2.8, 0.3, 0.2]), [0.004, -0.003, 0.09])
FOCAL_PX = 554.0
EVEN = Loss(1e9, is_biweight=False)


def grid() -> TagPixels:
    """Pixels about the tag, all black."""
    x, y = np.meshgrid(np.arange(-10, 60), np.arange(-60, 20))
    rays = np.stack([x.ravel() / FOCAL_PX, y.ravel() / FOCAL_PX, np.ones(x.size)])
    return TagPixels(np.zeros(x.size), rays, FOCAL_PX)


def inner() -> TagPixels:
    """Those of them that are on the black square and stay there, whatever small step is taken."""
    pixels = grid()
    inside = np.all(np.abs(on_tag(pixels.rays.T, T)) < 0.49 * PATTERN.size_m, axis=1)
    return TagPixels(pixels.brightness[inside], pixels.rays[:, inside], FOCAL_PX)


def laid(overlay: Overlay, pixels: TagPixels) -> LaidPattern:
    found = lay_pattern(pixels, overlay, PATTERN, EVEN)
    assert found is not None
    return found


def moved(overlay: Overlay, step: Array) -> Overlay:
    """An overlay after a step over all nine parameters, the pose's in the tag's frame."""
    R = overlay.T_camera_tag[:3, :3]
    pose = make_transform(
        R @ rotation_of(step[3:6]), overlay.T_camera_tag[:3, 3] + PATTERN.size_m * R @ step[:3]
    )
    return Overlay(
        pose, overlay.blur_px + step[6], overlay.offset + GREY * step[7], overlay.contrast + GREY * step[8]
    )


@pytest.mark.parametrize("parameter", range(9))
def test_the_derivatives_are_those_of_the_model(parameter: int) -> None:
    """Within 3 % of the largest, in the mean: bilinear interpolation has steps in its slope."""
    overlay = Overlay(T, 1.5, 20.0, 200.0)
    step = np.zeros(9)
    step[parameter] = 2e-3
    middle, more, less = (laid(moved(overlay, s), inner()) for s in (0.0 * step, step, -step))
    difference = -(more.residual - less.residual) / (2.0 * step[parameter])
    derivative = middle.derivatives[parameter]
    assert np.sqrt(np.mean((difference - derivative) ** 2)) < 0.03 * np.abs(derivative).max()


def test_a_pattern_on_itself_leaves_nothing_over() -> None:
    """An image made by the model: blur, brightness and contrast are found to start from, and fit within 1 %."""
    truth = Overlay(T, 0.8, 20.0, 200.0)
    pixels = grid()
    image = np.full(len(pixels.brightness), 220.0)
    inside = laid(truth, pixels)
    shown = np.flatnonzero(np.isin(np.arange(len(image)), _indices(pixels)))
    image[shown] = -inside.residual
    start = start_overlay(TagPixels(image, pixels.rays, FOCAL_PX), T, PATTERN)
    assert start is not None
    overlay, std = start
    assert overlay.blur_px == pytest.approx(0.8)
    assert overlay.contrast == pytest.approx(200.0, rel=0.01)
    assert std < 1.0


def _indices(pixels: TagPixels) -> Array:
    """Which pixels are on the tag, by their brightness: each gets its number."""
    numbered = TagPixels(np.arange(len(pixels.brightness), dtype=np.float64), pixels.rays, FOCAL_PX)
    found = lay_pattern(numbered, Overlay(T, 0.8, 0.0, 200.0), PATTERN, EVEN)
    black = lay_pattern(grid(), Overlay(T, 0.8, 0.0, 200.0), PATTERN, EVEN)
    assert found is not None
    assert black is not None
    return np.round(found.residual - black.residual)


def test_where_there_is_no_tag_nothing_is_laid() -> None:
    behind = make_transform(np.eye(3), [0.0, 0.0, -0.1])
    beside = make_transform(T[:3, :3], [0.2, 0.0, 0.09])
    for pose in (behind, beside):
        assert lay_pattern(grid(), Overlay(pose, 0.8, 0.0, 100.0), PATTERN, EVEN) is None
        assert start_overlay(grid(), pose, PATTERN) is None
    assert lay_pattern(grid(), Overlay(T, 0.8, 0.0, 1.0), PATTERN, EVEN) is None


@pytest.mark.parametrize("is_biweight", [False, True])
def test_weights_are_the_loss_s_slope_over_the_residual(is_biweight: bool) -> None:
    """w = ρ'(r) / r, by central differences; both losses are r²/2 for small residuals."""
    loss, step, share = Loss(10.0, is_biweight), 1e-4, np.ones(1)
    for residual in (0.1, 3.0, 9.0, 25.0):
        weight, _ = loss(np.array([residual]), share)
        more, less = (loss(np.array([residual + s]), share)[1] for s in (step, -step))
        assert weight[0] * residual == pytest.approx((more - less) / (2.0 * step), abs=1e-5)
    assert loss(np.array([0.01]), share)[1] == pytest.approx(0.5e-4, rel=1e-4)
