"""Drawing on an image so that it can be read: lines with a dark edge, text on dark ground, and a caption below."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from svmdist.samples import Image
from svmdist.transforms import Array

Colour = tuple[int, int, int]
FONT = cv2.FONT_HERSHEY_SIMPLEX
LEAST_WIDTH_PX = 900
"""Smaller images are enlarged by a whole number, so that letters stay smaller than what they name."""
DARK: Colour = (20, 20, 20)
WHITE: Colour = (240, 240, 240)


@dataclass
class Canvas:
    """An enlarged copy of an image, shape (h, w, 3) in BGR; places are given in pixels of the image."""

    pixels: Image
    enlarged: int

    @classmethod
    def of(cls, bgr: Image) -> Canvas:
        """A canvas with an image, shape (h, w, 3), on it."""
        times = max(1, -(-LEAST_WIDTH_PX // bgr.shape[1]))
        size = (bgr.shape[1] * times, bgr.shape[0] * times)
        return cls(np.ascontiguousarray(cv2.resize(bgr, size, interpolation=cv2.INTER_NEAREST)), times)

    @property
    def unit_px(self) -> int:
        """The width of a line on the canvas."""
        return max(2, int(self.pixels.shape[1]) // 500)

    def fill(self, mask: Image, colour: Colour, strength: float) -> None:
        """Tint what is under a mask, shape (h, w), of the image."""
        height, width = self.pixels.shape[:2]
        under = cv2.resize(mask, (width, height), interpolation=cv2.INTER_NEAREST) > 0
        tinted = (1.0 - strength) * self.pixels[under] + strength * np.array(colour, np.float64)
        self.pixels[under] = tinted.astype(np.uint8)

    def contour(self, mask: Image, colour: Colour, thickness: int = 1) -> None:
        """Draw the borders of a mask, shape (h, w), of the image."""
        height, width = self.pixels.shape[:2]
        large = cv2.resize(mask, (width, height), interpolation=cv2.INTER_NEAREST)
        contours, _ = cv2.findContours(large, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
        cv2.drawContours(self.pixels, contours, -1, colour, thickness * self.unit_px, cv2.LINE_AA)

    def line(self, start_px: Array, end_px: Array, colour: Colour) -> None:
        """Draw a line between two places, shape (2,) each."""
        start, end = self._on(start_px), self._on(end_px)
        cv2.line(self.pixels, start, end, DARK, 3 * self.unit_px, cv2.LINE_AA)
        cv2.line(self.pixels, start, end, colour, self.unit_px, cv2.LINE_AA)

    def cross(self, place_px: Array, colour: Colour) -> None:
        """Mark a place, shape (2,)."""
        at, size = self._on(place_px), 8 * self.unit_px
        cv2.drawMarker(self.pixels, at, DARK, cv2.MARKER_CROSS, size + 4, 3 * self.unit_px)
        cv2.drawMarker(self.pixels, at, colour, cv2.MARKER_CROSS, size, self.unit_px)

    def label(self, text: str, place_px: Array, colour: Colour) -> None:
        """Write beside a place, shape (2,), and inside of the image."""
        scale, thickness = self._letters
        (width, height), below = cv2.getTextSize(text, FONT, scale, thickness)
        x, y = self._on(place_px)
        x = int(np.clip(x + 6 * self.unit_px, 2, max(2, self.pixels.shape[1] - width - 6)))
        y = int(np.clip(y - 4 * self.unit_px, height + 4, self.pixels.shape[0] - below - 4))
        cv2.rectangle(self.pixels, (x - 3, y - height - 3), (x + width + 3, y + below + 1), DARK, cv2.FILLED)
        cv2.putText(self.pixels, text, (x, y), FONT, scale, colour, thickness, cv2.LINE_AA)

    def with_caption(self, lines: Sequence[tuple[str, Colour] | str]) -> Image:
        """The canvas with lines of text below it, each in its colour."""
        scale, thickness = self._letters
        (_, height), below = cv2.getTextSize("Mg", FONT, scale, thickness)
        step = height + below + 8
        strip = np.full((step * len(lines) + 8, self.pixels.shape[1], 3), DARK, np.uint8)
        for at, line in enumerate(lines):
            text, colour = line if isinstance(line, tuple) else (line, WHITE)
            cv2.putText(strip, text, (8, at * step + height + 6), FONT, scale, colour, thickness, cv2.LINE_AA)
        return np.vstack([self.pixels, strip])

    @property
    def _letters(self) -> tuple[float, int]:
        scale = max(0.55, self.pixels.shape[1] / 1700.0)
        return scale, max(1, round(1.4 * scale))

    def _on(self, place_px: Array) -> tuple[int, int]:
        x, y = (np.asarray(place_px, np.float64) + 0.5) * self.enlarged
        limit = 1 << 20
        return int(np.clip(x, -limit, limit)), int(np.clip(y, -limit, limit))
