"""Sub-pixel edges: where brightness changes fastest across a rough line, and the straight line through that.

An edge blurred by a symmetric kernel has its steepest point where the sharp edge was, whatever the two
levels beside it. The steepest point of a sampled profile lies between samples; the logarithm of a Gaussian
is a parabola, so three samples of the slope place it exactly for a Gaussian blur (Fisher & Naidu 1996).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.camera import Camera
from svmdist.samples import Image
from svmdist.transforms import Array

STEP_PX = 0.5
"""Between samples across the edge: half a pixel loses nothing of what the pixels hold."""
SLOPE_SIGMA_PX = 1.2
"""Scale of the derivative of Gaussian: as wide as usual optics blur, so that noise is averaged but not shape."""
BLUR_SCALE = 0.8
"""A blurred edge is sought at this scale over its own: moved images have ramps, whose steepest point is anywhere."""
BLUR_PLACES, BLUR_STRIPS = 8, 7
"""An edge's blur is the median over so many places, each the mean of so many neighbouring profiles."""
CORRELATION_PX = 2.0
"""Neighbouring edge points share pixels: points closer than this along the edge err alike."""
MIN_POINT_STD_PX = 0.05
"""Pixel grid and interpolation leave this much even without noise."""
HUBER = 1.5
SEED = 7


@dataclass(frozen=True, slots=True)
class Line:
    """The points with `normal` · p = `offset`, in the unit of the points that were fitted.

    `normal` (2,) has length 1; `covariance` (2, 2) belongs to (turn in rad about `centre`, shift along the
    normal); `centre` (2,) is the points' middle, and `count` how many there were.
    """

    normal: Array
    offset: float
    centre: Array
    covariance: Array
    count: int

    @property
    def direction(self) -> Array:
        """Unit vector along the line, the normal turned by a quarter turn, shape (2,)."""
        return np.array([-self.normal[1], self.normal[0]])


def edge_points(
    brightness: Image,
    start_px: Array,
    end_px: Array,
    outward: Array,
    reach_px: float,
    min_contrast: float,
    blur_px: float = 0.0,
) -> Array:
    """Points of a dark-to-bright edge near the segment from `start_px` to `end_px`, shape (n, 2) in px.

    `brightness` has shape (h, w); `outward` (2,) points from dark to bright. Profiles stand 1 px apart and
    reach `reach_px` to both sides; a profile whose edge is lower than `min_contrast` levels, or which ends
    before the edge does, gives no point. `blur_px` is the standard deviation of the edge's own blur.
    """
    length_px = float(np.linalg.norm(end_px - start_px))
    if length_px < 2.0:
        return np.zeros((0, 2))
    sigma_px = max(SLOPE_SIGMA_PX, BLUR_SCALE * blur_px)
    at = np.arange(0.5, length_px, 1.0)
    feet_px, across = _feet(start_px, end_px, outward, at)
    profiles, offsets, inside = profiles_across(brightness, feet_px, across, reach_px + 3.0 * sigma_px)
    slope = profiles @ slope_filter(len(offsets), sigma_px)
    searched = (np.abs(offsets) <= reach_px) & inside
    slope = np.where(searched, slope, -np.inf)
    peak = np.argmax(slope, axis=1)
    rows = np.arange(len(peak))
    good = (peak > 0) & (peak < len(offsets) - 1)
    peak = np.clip(peak, 1, len(offsets) - 2)
    before, top, after = slope[rows, peak - 1], slope[rows, peak], slope[rows, peak + 1]
    good &= (top > _min_slope(min_contrast, sigma_px)) & (before > 0) & (after > 0)
    good &= (top >= before) & (top > after)
    log_before, log_top, log_after = (np.log(np.maximum(value, 1e-9)) for value in (before, top, after))
    bend = log_before - 2.0 * log_top + log_after
    good &= bend < -1e-9
    shift = 0.5 * (log_before - log_after) / np.where(good, bend, -1.0)
    found = offsets[peak] + np.clip(shift, -1.0, 1.0) * STEP_PX
    return np.asarray((feet_px + found[:, None] * across)[good])


def edge_blur_px(
    brightness: Image, start_px: Array, end_px: Array, outward: Array, reach_px: float, min_contrast: float
) -> float:
    """The blur of an edge near a segment: the deviation in px of the Gaussian as wide at half its height as its slope.

    0 for an edge as sharp as the derivative's own scale, and where none is found; arguments as in `edge_points`.
    """
    length_px = float(np.linalg.norm(end_px - start_px))
    if length_px < 2.0 * BLUR_STRIPS:
        return 0.0
    middles = np.linspace(0.5 * BLUR_STRIPS, length_px - 0.5 * BLUR_STRIPS, BLUR_PLACES)
    at = (middles[:, None] + np.arange(BLUR_STRIPS) - BLUR_STRIPS // 2).ravel()
    feet_px, across = _feet(start_px, end_px, outward, at)
    profiles, offsets, inside = profiles_across(brightness, feet_px, across, reach_px + 3.0 * SLOPE_SIGMA_PX)
    whole = inside.all(1).reshape(BLUR_PLACES, BLUR_STRIPS).all(1)
    mean = profiles.reshape(BLUR_PLACES, BLUR_STRIPS, -1).mean(1)[whole]
    slope = (mean @ slope_filter(len(offsets), SLOPE_SIGMA_PX))[:, np.abs(offsets) <= reach_px]
    widths_px = []
    for values in slope:
        peak = int(np.argmax(values))
        # A ramp of the contrast over the whole reach is the slowest rise that counts.
        if values[peak] < min_contrast / (2.0 * reach_px):
            continue
        low = values < 0.5 * values[peak]
        below, above = np.flatnonzero(low[:peak]), np.flatnonzero(low[peak:])
        if len(below) and len(above):
            widths_px.append((peak + above[0] - below[-1] - 1) * STEP_PX)
    if not widths_px:
        return 0.0
    sigma_px = float(np.median(widths_px)) / np.sqrt(
        8.0 * np.log(2.0)
    )  # of a Gaussian's width at half its height
    return float(np.sqrt(max(0.0, sigma_px**2 - SLOPE_SIGMA_PX**2)))


def straightened(camera: Camera, points_px: Array) -> Array:
    """Points, shape (n, 2) in px, on the plane z = 1 of the camera frame, without distortion."""
    if len(points_px) == 0:
        return np.zeros((0, 2))
    if not np.any(camera.D):
        homogeneous = np.column_stack([points_px, np.ones(len(points_px))]) @ np.linalg.inv(camera.K).T
        return np.asarray(homogeneous[:, :2])
    criteria = (cv2.TERM_CRITERIA_MAX_ITER | cv2.TERM_CRITERIA_EPS, 60, 1e-12)
    points = cv2.undistortPoints(
        np.ascontiguousarray(points_px, np.float64).reshape(-1, 1, 2),
        camera.K,
        camera.D,
        None,
        None,
        None,
        criteria,
    )
    return np.asarray(points, np.float64).reshape(-1, 2)


def fit_line(
    points: Array,
    unit: float,
    min_count: int = 8,
    inlier_px: float = 1.0,
    systematic_px: float = 0.0,
    correlation_px: float = CORRELATION_PX,
) -> Line | None:
    """The line through most of the points, shape (n, 2): RANSAC, then total least squares with Huber's weights.

    `unit` is the size of a pixel in the unit of the points. None where fewer than `min_count` points agree
    within `inlier_px`, or less than half of them. `systematic_px` is an error that the points share: it shifts
    the line, and may shift its two ends differently. Points closer than `correlation_px` err alike.
    """
    chosen = _consensus(points, inlier_px * unit)
    if np.count_nonzero(chosen) < max(min_count, len(points) // 2):
        return None
    points = points[chosen]
    weight = np.ones(len(points))
    floor = MIN_POINT_STD_PX * unit
    for _ in range(6):
        centre = weight @ points / weight.sum()
        _, _, axes = np.linalg.svd((points - centre) * np.sqrt(weight)[:, None], full_matrices=False)
        direction, normal = axes[0], axes[1]
        residual = (points - centre) @ normal
        scale = max(1.4826 * float(np.median(np.abs(residual))), floor)
        weight = np.minimum(1.0, HUBER * scale / np.maximum(np.abs(residual), 1e-30))
    position = (points - centre) @ direction
    # Points err alike over the correlation length: as if there were fewer of them.
    spacing = np.ptp(position) / unit / max(len(points) - 1, 1)
    alike = max(1.0, correlation_px / max(spacing, 1e-6))
    variance = scale**2 * alike
    shared = (systematic_px * unit) ** 2
    turn = (variance / weight.sum() + shared) / max(float(weight @ position**2 / weight.sum()), 1e-30)
    shift = variance / weight.sum() + shared
    return Line(
        normal,
        float(normal @ centre),
        centre,
        np.diag([turn, shift]),
        len(points),
    )


def _consensus(points: Array, tolerance: float) -> NDArray[np.bool_]:
    """The largest set of points, shape (n,), that lie within a tolerance of a line through two of them."""
    count = len(points)
    best = np.zeros(count, np.bool_)
    if count < 2:
        return best
    rng = np.random.default_rng(SEED)
    first = rng.integers(0, count, 120)
    second = (first + rng.integers(1, count, 120)) % count
    along = points[second] - points[first]
    length = np.linalg.norm(along, axis=1)
    usable = length > 0
    across = np.stack([-along[:, 1], along[:, 0]], -1)[usable] / length[usable, None]
    distance = np.abs(across @ points.T - np.sum(across * points[first][usable], 1)[:, None])
    close = distance <= tolerance
    if len(close) == 0:
        return best
    return np.asarray(close[np.argmax(close.sum(1))])


def _feet(start_px: Array, end_px: Array, outward: Array, at: Array) -> tuple[Array, Array]:
    """Points on a segment at distances `at`, shape (n,), from its start, and the unit vector across it outward."""
    along = (end_px - start_px) / np.linalg.norm(end_px - start_px)
    across = np.array([-along[1], along[0]])
    return start_px + at[:, None] * along, across if across @ outward > 0 else -across


def profiles_across(
    brightness: Image, feet_px: Array, across: Array, half_px: float
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Brightness across an edge, shape (n, k), at offsets, shape (k,) in px, and whether each is in the image."""
    offsets = np.arange(-half_px, half_px + STEP_PX / 2, STEP_PX)
    places = feet_px[:, None, :] + offsets[None, :, None] * across
    height, width = brightness.shape
    inside = (places >= 0).all(-1) & (places <= [width - 1, height - 1]).all(-1)
    return _sampled(brightness, places), offsets, np.asarray(inside)


def _min_slope(min_contrast: float, sigma_px: float) -> float:
    """A step of height c smoothed by σ has slope c / (σ √(2π)) at its steepest; the image's blur doubles σ."""
    return float(min_contrast / (np.sqrt(2.0 * np.pi) * 2.0 * sigma_px))


def _sampled(brightness: Image, places: Array) -> Array:
    """Brightness at places, shape (..., 2) in px, with cubic interpolation; the border is repeated."""
    x, y = places[..., 0].astype(np.float32), places[..., 1].astype(np.float32)
    values = cv2.remap(brightness.astype(np.float32), x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(values, np.float64)


def slope_filter(count: int, sigma_px: float) -> Array:
    """Matrix, shape (count, count), that turns profiles into their slopes per px, smoothed."""
    offset = (np.arange(count)[:, None] - np.arange(count)[None, :]) * STEP_PX
    kernel = np.exp(-0.5 * (offset / sigma_px) ** 2) * STEP_PX / (np.sqrt(2.0 * np.pi) * sigma_px)
    return np.asarray(kernel * offset / sigma_px**2)
