"""A tag as it is printed, as a texture that can be blurred and sampled."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.transforms import Array
from svmdist.vision.tag.detection import DICTIONARIES

CELL_SAMPLES = 16
"""Texture samples to a cell: three for each pixel of a tag that is seen 40 px wide."""
SHEET_COLUMNS = 64


class TagPattern:
    """The tag as it is printed, to be laid over an image."""

    def __init__(self, family: str, tag_id: int, size_m: float) -> None:
        dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARIES[family])
        self.size_m = size_m
        self.cell_count = dictionary.markerSize + 2
        cells = cv2.aruco.generateImageMarker(dictionary, tag_id, self.cell_count).astype(np.float32) / 255.0
        self.scale = np.array([size_m, size_m, size_m, 1.0, 1.0, 1.0])
        self._pad = 4
        padded = np.pad(cells, self._pad, constant_values=1.0)
        self._texture: NDArray[np.float32] = np.kron(
            padded, np.ones((CELL_SAMPLES, CELL_SAMPLES), np.float32)
        ).astype(np.float32)

    def blurred(self, blur_cells: float) -> NDArray[np.float32]:
        """The pattern under a Gaussian blur in cells."""
        sigma = max(blur_cells * CELL_SAMPLES, 0.3)
        return np.asarray(cv2.GaussianBlur(self._texture, (0, 0), sigma), np.float32)

    def sample(self, texture: NDArray[np.float32], xy_m: Array) -> Array:
        """Brightness between 0 and 1 at points of the tag's plane, shape (n, 2) in m: shape (n,)."""
        cell_m = self.size_m / self.cell_count
        middle = self._pad + self.cell_count / 2.0
        column = (middle + xy_m[:, 0] / cell_m) * CELL_SAMPLES - 0.5
        row = (middle - xy_m[:, 1] / cell_m) * CELL_SAMPLES - 0.5
        places = np.stack([column, row]).astype(np.float32)
        # OpenCV remaps images of at most 32767 columns: the points go in as rows of a sheet.
        sheet = np.pad(places, ((0, 0), (0, -len(xy_m) % SHEET_COLUMNS))).reshape(2, -1, SHEET_COLUMNS)
        values = cv2.remap(texture, sheet[0], sheet[1], cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE)
        return np.asarray(values, np.float64).ravel()[: len(xy_m)]
