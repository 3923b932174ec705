"""A tag as it is printed, under any blur, with its derivatives: what an image of the tag is compared with."""

from __future__ import annotations

import math
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.transforms import Array
from svmdist.vision.tag.detection import DICTIONARIES

CELL_SAMPLES = 16
"""Texture samples per cell: three for each pixel of a tag that is seen 40 px wide."""
PAD_CELLS = 2
"""Of white around the black square. What is further off is as white as its rim."""
SHEET_COLUMNS = 64
BLUR_RATIO = 1.01
"""Textures are made for blurs at powers of this ratio and kept. Between them the brightness follows the derivative by
the blur, which is right within 1e-5 of the contrast."""
KEPT_TEXTURES = 48
"""Of 0.6 MB each: tags from 30 to 60 px wide at one blur of the image need no more."""
SMALLEST_BLUR_CELLS = 0.3 / CELL_SAMPLES


class TagPattern:
    """The tag as it is printed, white 1 and black 0, on its plane."""

    def __init__(self, family: str, tag_id: int, size_m: float) -> None:
        dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARIES[family])
        self.size_m = size_m
        self.cell_count = dictionary.markerSize + 2
        cells = cv2.aruco.generateImageMarker(dictionary, tag_id, self.cell_count)
        self._ink: NDArray[np.float32] = (1.0 - cells / 255.0).astype(np.float32)
        self._texture = lru_cache(KEPT_TEXTURES)(self._make_texture)

    def sample(self, xy_cells: Array, blur_cells: float) -> Array:
        """Brightness and its derivatives by x, y and blur, shape (4, n), under a Gaussian blur in cells.

        The points, shape (2, n), are in cells about the tag's middle: x to the right and y up as one reads the tag.
        """
        blur_cells = max(blur_cells, SMALLEST_BLUR_CELLS)
        level = round(math.log(blur_cells) / math.log(BLUR_RATIO))
        # OpenCV remaps images of at most 32767 columns: the points go in as rows of a sheet.
        count = xy_cells.shape[1]
        sheet = np.zeros((2, -(-count // SHEET_COLUMNS) * SHEET_COLUMNS), np.float32)
        middle = (self.cell_count / 2.0 + PAD_CELLS) * CELL_SAMPLES - 0.5
        sheet[0, :count] = middle + CELL_SAMPLES * xy_cells[0]
        sheet[1, :count] = middle - CELL_SAMPLES * xy_cells[1]
        columns, rows = sheet.reshape(2, -1, SHEET_COLUMNS)
        texture = self._texture(level)
        values = cv2.remap(texture, columns, rows, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE)
        sampled = np.array(values.reshape(-1, 4)[:count].T, np.float64, order="C")
        sampled[0] += (blur_cells - BLUR_RATIO**level) * sampled[3]
        return sampled

    def _make_texture(self, level: int) -> NDArray[np.float32]:
        """Brightness and its three derivatives, shape (h, w, 4), under one of the blurs that textures are made for."""
        along, by_place, by_blur = self._profiles(BLUR_RATIO**level)
        # A blurred cell is the product of a profile along the rows and one along the columns; y points up.
        ink = self._ink
        across = ink @ along.T
        planes = (
            1.0 - along @ across,
            -(along @ (ink @ by_place.T)),
            by_place @ across,
            -(by_blur @ across) - along @ (ink @ by_blur.T),
        )
        return np.asarray(cv2.merge(planes), np.float32)

    def _profiles(
        self, blur_cells: float
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        """How much of each sample is each cell's, and the derivatives by place and blur, shape (samples, cells) each.

        A step under a Gaussian blur is the normal distribution's integral, a cell is the difference of two steps.
        """
        samples = (self.cell_count + 2 * PAD_CELLS) * CELL_SAMPLES
        place = (np.arange(samples) + 0.5) / CELL_SAMPLES - PAD_CELLS
        u = (place[:, None] - np.arange(self.cell_count + 1)) / blur_cells
        integral = np.interp(u, NORMAL_AT, NORMAL_INTEGRAL)
        density = np.exp(-0.5 * u * u) / (math.sqrt(2.0 * math.pi) * blur_cells)
        steps = (integral, density, -u * density)
        along, by_place, by_blur = ((s[:, :-1] - s[:, 1:]).astype(np.float32) for s in steps)
        return along, by_place, by_blur


NORMAL_AT = np.linspace(-6.0, 6.0, 12001)
NORMAL_INTEGRAL = np.array([0.5 + 0.5 * math.erf(u / math.sqrt(2.0)) for u in NORMAL_AT])
"""The normal distribution's integral, right within 1e-7 between its entries."""
