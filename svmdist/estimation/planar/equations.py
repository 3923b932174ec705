"""The paper's mapping from screen to plane, eqs. (3)–(6) and (21)–(27): as published, and corrected.

Each function is one equation; `docs/equations.md` lists what differs between the readings and why. The
numbers of the tissue's equations are cited; (21)–(24) repeat them for the marker's outline.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from svmdist.transforms import Array

Equations = Literal["corrected", "printed"]

CM_PER_PIXEL = 0.0254
"""One pixel at 100 dpi: 2.54 cm / 100, which eqs. (3) and (4) give as 0.0245 cm."""


@dataclass(frozen=True, slots=True)
class Quadratic:
    """q S² + l S + c: from screen to plane along one axis, both in cm."""

    quadratic_per_cm: float
    linear: float
    constant_cm: float

    def __call__(self, screen_cm: Array | float) -> Array | float:
        """Evaluate at screen coordinates in cm."""
        return (self.quadratic_per_cm * screen_cm + self.linear) * screen_cm + self.constant_cm

    def turning_point_cm(self) -> float:
        """The screen coordinate in cm where the mapping turns around; infinite for a straight line."""
        if self.quadratic_per_cm == 0.0:
            return float("inf")
        return -self.linear / (2.0 * self.quadratic_per_cm)


PUBLISHED_X = Quadratic(-0.0036, 0.7938, -0.0403)
"""eq. (5), and (23). Its slope near S = 0 fits the authors' camera; units are unstated, cm is assumed."""

PUBLISHED_Y = Quadratic(-0.0068, 0.0395, -0.4439)
"""eq. (6), and (24). Not monotone over the screen: with corrected S it turns around at row 114."""


def screen_cm_as_published(pixel: Array | float) -> Array | float:
    """eqs. (3) and (4) as published: S = (1 - T * 2.54) / 100, from +0.01 to -16.2 over 640 px."""
    return (1.0 - np.asarray(pixel) * 2.54) / 100.0


def screen_cm_corrected(pixel: Array | float) -> Array | float:
    """eqs. (3) and (4) corrected: S = 0.0254 T cm, one pixel at 100 dpi."""
    return CM_PER_PIXEL * np.asarray(pixel)


@dataclass(frozen=True, slots=True)
class PlaneMapping:
    """From pixels to the camera's xy plane: eqs. (3)–(6) in one reading, with one quadratic per axis."""

    equations: Equations
    x: Quadratic
    y: Quadratic

    def to_plane_m(self, point_px: Array) -> Array:
        """Map pixels, shape (..., 2), to plane coordinates in m, shape (..., 2)."""
        screen = screen_cm_as_published if self.equations == "printed" else screen_cm_corrected
        x_cm = self.x(screen(point_px[..., 0]))
        y_cm = self.y(screen(point_px[..., 1]))
        return np.stack([x_cm, y_cm], -1) / 100.0


PUBLISHED_MAPPING = PlaneMapping("printed", PUBLISHED_X, PUBLISHED_Y)


def planar_distance_m(tool_m: Array, tissue_m: Array) -> float:
    """eqs. (25)–(27): Euclidean distance in the plane, m, between points of shape (2,).

    The constants of the quadratics cancel in the difference. Depth is not in it: see `spatial_m`.
    """
    x_e, y_e = tool_m - tissue_m  # eqs. (25), (26); "GC" there is "GP"
    return float(np.hypot(x_e, y_e))


def degeneracies(mapping: PlaneMapping, width_px: int, height_px: int) -> list[str]:
    """Say in sentences where a mapping cannot be right for an image of this size."""
    warnings = []
    if mapping.equations == "printed":
        low, high = float(screen_cm_as_published(width_px - 1)), float(screen_cm_as_published(0))
        warnings.append(
            f"eqs. (3), (4) as printed: S runs from {high:+.2f} to {low:+.1f} cm over {width_px} px;"
            " a pixel is 0.0254 cm there, not 0.0245"
        )
    for name, quadratic, size_px in (("(5), (23)", mapping.x, width_px), ("(6), (24)", mapping.y, height_px)):
        row = _turning_pixel(mapping, quadratic)
        if 0 <= row < size_px:
            warnings.append(
                f"eqs. {name} turn around at pixel {row:.0f} of {size_px}: positions on both sides of it"
                " are mapped to the same place"
            )
    return warnings


def _turning_pixel(mapping: PlaneMapping, quadratic: Quadratic) -> float:
    turning_cm = quadratic.turning_point_cm()
    if mapping.equations == "printed":
        return (1.0 - turning_cm * 100.0) / 2.54
    return turning_cm / CM_PER_PIXEL
