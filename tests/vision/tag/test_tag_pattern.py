"""The pattern under a blur against OpenCV's blur of the printed cells, and its derivatives against differences."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from svmdist.vision.tag_overlay import TagPattern
from svmdist.vision.tags import DICTIONARIES

PATTERN = TagPattern("36h11", 3, 0.007)
POINTS = np.random.default_rng(0).uniform(-4.5, 4.5, (2, 5000))


@pytest.mark.parametrize(("blur_cells", "within"), [(0.1, 0.02), (0.15, 0.01), (0.4, 4e-3), (1.0, 2e-3)])
def test_brightness_is_that_of_the_blurred_cells(blur_cells: float, within: float) -> None:
    """Bilinear interpolation of 16 samples a cell is what differs: by the second derivative, 1 over blur squared."""
    cells = cv2.aruco.generateImageMarker(
        cv2.aruco.getPredefinedDictionary(DICTIONARIES["36h11"]), 3, PATTERN.cell_count
    )
    samples = 40
    dense = np.kron(np.pad(cells / 255.0, 4, constant_values=1.0), np.ones((samples, samples)))
    dense = cv2.GaussianBlur(dense, (0, 0), blur_cells * samples)
    at = (np.array([POINTS[0], -POINTS[1]]) + PATTERN.cell_count / 2 + 4) * samples - 0.5
    column, row = np.round(at).astype(int)
    exact = np.array([column + 0.5, row + 0.5]) / samples - PATTERN.cell_count / 2 - 4
    found = PATTERN.sample(np.array([exact[0], -exact[1]]), blur_cells)[0]
    np.testing.assert_allclose(found, dense[row, column], atol=within)


@pytest.mark.parametrize("blur_cells", [0.15, 0.4])
def test_the_derivatives_are_those_of_the_brightness(blur_cells: float) -> None:
    """Central differences over a quarter of a cell's sample agree in the mean; OpenCV rounds places to 1/32 sample."""
    step = 0.02
    _, by_x, by_y, by_blur = PATTERN.sample(POINTS, blur_cells)
    for axis, derivative in ((0, by_x), (1, by_y)):
        shift = np.zeros((2, 1))
        shift[axis] = step
        more, less = (PATTERN.sample(POINTS + s, blur_cells)[0] for s in (shift, -shift))
        assert (
            np.sqrt(np.mean(((more - less) / (2 * step) - derivative) ** 2)) < 0.03 * np.abs(derivative).max()
        )
    more, less = (PATTERN.sample(POINTS, blur_cells + s)[0] for s in (0.002, -0.002))
    assert np.sqrt(np.mean(((more - less) / 0.004 - by_blur) ** 2)) < 0.03 * np.abs(by_blur).max()


def test_between_the_blurs_of_two_textures_brightness_goes_on_evenly() -> None:
    """Past the change from one texture to the next, at any of 200 blurs, it changes by 1e-4 of the contrast at most."""
    blurs = np.linspace(0.2, 0.22, 200)
    values = np.array([PATTERN.sample(POINTS[:, :200], float(blur))[0] for blur in blurs])
    slope = np.abs(PATTERN.sample(POINTS[:, :200], 0.2)[3]).max()
    assert np.abs(np.diff(values, axis=0)).max() < 1.1 * slope * (blurs[1] - blurs[0]) + 1e-4
