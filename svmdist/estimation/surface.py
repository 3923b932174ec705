"""The tissue's surface from a rectified pair: one smooth disparity surface aligned to sub-pixels."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.least_squares import median, scale_of
from svmdist.profile.settings import StereoSettings
from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision.stereo import RectifiedPair, match_region

MIN_AGREEING_MATCHES = 0.8  # that lie on the surface: of matched noise two of three, of tissue nearly all
MARGIN_PX = 7  # matches this close to the tissue's edge mix two surfaces within one block
# Both views are smoothed before they are aligned, so that a step of a pixel stays on a slope
SMOOTHING_PX = 1.5
SURFACE_STD_PX = 0.12  # of an aligned low-order surface: measured 0.36 mm at 105 mm, 5 mm baseline
CLEAN_MISMATCH_PX = 0.36  # in those measurements; JPEG and noise shift pixels and surface in proportion

DEFAULT = StereoSettings()
GRID_STEP_PX = 5  # of the points that a surface is made of
DEGREE = 3
SCALE_PX = 100.0
TERMS = tuple((i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i))  # powers of u and v
BRIGHTNESS_TERMS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
"""Powers of u and v by which the views may differ in brightness."""
# Pixels used in the alignment: beyond some ten thousand, noise is no longer what limits it
MAX_SAMPLES = 15_000
MAX_START_SAMPLES = 1000  # matches that the alignment starts from: it must begin within a pixel, no better
START_STEPS, ALIGN_STEPS = 6, 12
SETTLED_PX = 0.005  # A step that moves no pixel by more ends the alignment
SCALE_STRIDE = 4
"""The offset and the spread of the images' difference are medians over every fourth pixel: right within a percent."""
RIDGE = 1e-3


@dataclass(frozen=True, slots=True)
class DisparitySurface:
    """Disparity in px as a polynomial of the left image's pixels about `centre_px`, and how well it aligns.

    `mismatch_px` is the robust spread of the images' difference along it over the slope of the image (rms, along x): by
    how much a pixel seems shifted. `agreeing_fraction` of the matches lie within two of matching's pixels of it.
    """

    coefficients: Array
    centre_px: Array
    mismatch_px: float
    agreeing_fraction: float

    def at(self, points_px: Array) -> Array:
        """Disparity in px, shape (n,), at pixels of the left image, shape (n, 2)."""
        return np.asarray(_basis(points_px, self.centre_px) @ self.coefficients)


def fit_surface(
    left_grey: Image,
    right_grey: Image,
    region: Image,
    right_region: Image,
    min_px: int,
    max_px: int,
    settings: StereoSettings = DEFAULT,
) -> DisparitySurface | None:
    """Fit the disparity surface of a region, a mask of shape (h, w); None with too few matches to fit or to align."""
    side_px = 2 * MARGIN_PX + 1
    core = np.asarray(cv2.erode(region, np.ones((side_px, side_px), np.uint8)), np.uint8)
    matches = match_region(left_grey, right_grey, core, min_px, max_px, settings)
    if matches is None:
        return None
    is_matched = np.isfinite(matches.disparity_px)
    count = int(np.count_nonzero(is_matched))
    if count * matches.step_px**2 < settings.min_matches:
        return None
    rows, columns = np.nonzero(is_matched)
    points_px = np.stack([matches.columns_px[columns], matches.rows_px[rows]], -1)
    centre_px = points_px.mean(0)
    few = slice(None, None, max(1, count // MAX_START_SAMPLES))
    B, seen_px = _basis(points_px[few], centre_px), matches.disparity_px[is_matched][few]
    thinned = slice(None, None, max(1, int(np.ceil(np.sqrt(count / MAX_SAMPLES)))))
    coefficients, mismatch_px = _align(
        left_grey,
        right_grey,
        right_region,
        np.floor(matches.columns_px[thinned]).astype(np.intp),
        np.floor(matches.rows_px[thinned]).astype(np.intp),
        is_matched[thinned, thinned],
        centre_px,
        _fit_robustly(B, seen_px),
    )
    if not np.isfinite(mismatch_px):  # of a black or plain right view no pixel could be aligned
        return None
    agreeing = float(np.mean(np.abs(seen_px - B @ coefficients) < 2.0 * matches.step_px))
    return DisparitySurface(coefficients, centre_px, mismatch_px, agreeing)


def _basis(points_px: Array, centre_px: Array) -> Array:
    u, v = ((points_px - centre_px) / SCALE_PX).T
    return np.stack([u**i * v**j for i, j in TERMS], -1)


def _fit_robustly(B: Array, disparity_px: Array) -> Array:
    weight: Array = np.ones(len(disparity_px))
    coefficients: Array = np.zeros(B.shape[1])
    for _ in range(START_STEPS):
        weighted = B * weight[:, None]
        normal = weighted.T @ B + RIDGE * np.eye(B.shape[1])
        coefficients = np.asarray(np.linalg.solve(normal, weighted.T @ disparity_px), np.float64)
        error = disparity_px - B @ coefficients
        weight = np.asarray(1.0 / (1.0 + (error / (2.0 * scale_of(error) + 1e-3)) ** 2), np.float64)
    return coefficients


def _align(
    left_grey: Image,
    right_grey: Image,
    right_region: Image,
    columns: NDArray[np.intp],
    rows: NDArray[np.intp],
    is_used: NDArray[np.bool_],
    centre_px: Array,
    coefficients: Array,
) -> tuple[Array, float]:
    """Gauss–Newton on right(u - d(u, v), v) - left(u, v) on a grid, brightness free: coefficients, mismatch in px."""
    left, slope = _smoothed_with_slope(left_grey, columns, rows)
    right, first_row = _smoothed_where_seen(right_grey, right_region, rows)
    u, v = (
        np.vander((px - middle) / SCALE_PX, 2 * DEGREE + 1, increasing=True)
        for px, middle in ((columns, centre_px[0]), (rows, centre_px[1]))
    )
    # left(u) = right(u - d), so that the right image's slope there is the left one's over 1 - d'.
    by_u = _matrix(TERMS, coefficients)[1:] * np.arange(1, DEGREE + 1)[:, None] / SCALE_PX
    slope = slope / np.maximum(1.0 - _values(by_u, u, v), 0.5)
    at_columns, at_rows = np.meshgrid(columns.astype(np.float32), (rows - first_row).astype(np.float32))
    residual, slope_rms, damping = np.inf, 1.0, 1e-5 * int(np.count_nonzero(is_used))
    for _ in range(ALIGN_STEPS):
        at = (at_columns - _values(_matrix(TERMS, coefficients), u, v)).astype(np.float32)
        value = cv2.remap(right, at, at_rows, cv2.INTER_LINEAR, None, cv2.BORDER_CONSTANT, np.nan)
        error: Array = np.asarray(value, np.float64) - left
        usable = is_used & np.isfinite(error)
        count = int(np.count_nonzero(usable))
        if count < 10 * len(TERMS):
            break
        field, seen = _brightness_field(error, usable, u, v)
        residual = scale_of(seen)
        error = np.asarray(np.where(usable, error - field, 0.0), np.float64)
        slope_rms = float(np.sqrt(np.mean(slope[usable] ** 2)))
        weight = np.asarray(usable * slope / (1.0 + (error / (2.0 * residual + 0.5)) ** 2), np.float64)
        # Least squares by moments of the grid's coordinates.
        i, j = np.transpose(TERMS)
        moments = u.T @ (weight * slope).T @ v
        pull = (u[:, : DEGREE + 1].T @ (weight * error).T @ v[:, : DEGREE + 1])[i, j]
        normal = moments[i[:, None] + i, j[:, None] + j] + damping * np.eye(len(TERMS))
        step = np.asarray(np.linalg.solve(normal, pull), np.float64)
        coefficients = coefficients + step
        if np.abs(_values(_matrix(TERMS, step), u, v))[is_used].max() < SETTLED_PX:
            break
    return coefficients, float(residual) / max(slope_rms, 1e-6)


def _brightness_field(error: Array, usable: NDArray[np.bool_], u: Array, v: Array) -> tuple[Array, Array]:
    """What differs in brightness between the views smoothly, shape (h, w), and what of a sample it leaves, (k,)."""
    rows, columns = np.nonzero(usable)
    few = slice(None, None, SCALE_STRIDE)
    rows, columns = rows[few], columns[few]
    B = np.stack([u[columns, i] * v[rows, j] for i, j in BRIGHTNESS_TERMS], -1)
    raw = error[rows, columns]
    seen = raw - median(raw)
    weight = 1.0 / (1.0 + (seen / (2.0 * scale_of(seen) + 0.5)) ** 2)
    weighted = B * weight[:, None]
    terms = np.linalg.solve(weighted.T @ B + RIDGE * np.eye(len(BRIGHTNESS_TERMS)), weighted.T @ raw)
    return _values(_matrix(BRIGHTNESS_TERMS, terms), u, v), np.asarray(raw - B @ terms)


def _smoothed_with_slope(
    grey: Image, columns: NDArray[np.intp], rows: NDArray[np.intp]
) -> tuple[Array, Array]:
    """The smoothed image and its slope along x in levels per px on a grid, shape (h, w) each."""
    margin = int(4 * SMOOTHING_PX) + 2
    top, left = max(int(rows[0]) - margin, 0), max(int(columns[0]) - margin, 0)
    window = grey[top : int(rows[-1]) + margin + 1, left : int(columns[-1]) + margin + 1]
    smooth = np.asarray(cv2.GaussianBlur(window, (0, 0), SMOOTHING_PX), np.uint8)
    slope = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, ksize=3)
    grid = np.ix_(rows - top, columns - left)
    return smooth[grid].astype(np.float64), slope[grid].astype(np.float64) / 8.0


def _smoothed_where_seen(
    grey: Image, region: Image, rows: NDArray[np.intp]
) -> tuple[NDArray[np.float32], int]:
    """Rows of the smoothed image, NaN where the region's edge is near or passed, and which row is the first."""
    margin = max(int(4 * SMOOTHING_PX) + 2, MARGIN_PX)
    top, bottom = max(int(rows[0]) - margin, 0), int(rows[-1]) + margin + 1
    smooth = cv2.GaussianBlur(grey[top:bottom], (0, 0), SMOOTHING_PX).astype(np.float32)
    smooth[cv2.erode(region[top:bottom], np.ones((MARGIN_PX, MARGIN_PX), np.uint8)) == 0] = np.nan
    return np.asarray(smooth, np.float32), top


def _matrix(terms: tuple[tuple[int, int], ...], coefficients: Array) -> Array:
    """Coefficients by their powers of u and v."""
    size = 1 + max(i for i, _ in terms)
    C = np.zeros((size, size))
    C[tuple(np.transpose(terms))] = coefficients
    return C


def _values(C: Array, u: Array, v: Array) -> Array:
    """A polynomial on a grid, shape (h, w); `u` and `v` hold powers of its coordinates, shape (w, k) and (h, k)."""
    return np.asarray(v[:, : C.shape[1]] @ C.T @ u[:, : C.shape[0]].T)


@dataclass(frozen=True, slots=True)
class StereoSurface:
    """Points of the surface in the camera frame, shape (n, 3), and the standard deviation of their depth."""

    points_m: Array
    std_m: float


def detect_stereo_surface(
    left_grey: Image,
    right_grey: Image,
    pair: RectifiedPair,
    hull: NDArray[np.int32],
    masks: tuple[Image, Image],
    settings: StereoSettings,
) -> StereoSurface | None:
    """The tissue's surface inside its hull in the left image, under the instrument too; None if the views disagree."""
    if pair.R_rows_left is not None:
        # As cameras turned to the baseline would have them.
        H_left, H_right = pair.homography(), pair.homography(right=True)
        left_grey, right_grey = _turned(left_grey, H_left), _turned(right_grey, H_right)
        masks = (_turned(masks[0], H_left, cv2.INTER_NEAREST), _turned(masks[1], H_right, cv2.INTER_NEAREST))
        turned_px = cv2.perspectiveTransform(hull.reshape(-1, 1, 2).astype(np.float64), H_left)
        hull = np.round(turned_px).astype(np.int32)
    far_px, near_px = (pair.disparity_at(at_m) + pair.offset_px for at_m in (settings.far_m, settings.near_m))
    bounds = (int(np.floor(far_px)), int(np.ceil(near_px)))
    surface = fit_surface(left_grey, right_grey, *masks, *bounds, settings)
    if surface is None or surface.agreeing_fraction < MIN_AGREEING_MATCHES:
        return None
    inside = np.zeros_like(masks[0])
    cv2.fillConvexPoly(inside, hull, 255)
    rows, columns = np.nonzero(inside[::GRID_STEP_PX, ::GRID_STEP_PX])
    points_px = np.stack([columns, rows], -1).astype(np.float64) * GRID_STEP_PX
    disparity_px = surface.at(points_px) - pair.offset_px
    points_m = pair.points(points_px, np.maximum(disparity_px, pair.disparity_at(settings.far_m)))
    depth_m = float(np.median(points_m[:, 2]))
    std_px = SURFACE_STD_PX * max(1.0, surface.mismatch_px / CLEAN_MISMATCH_PX)
    return StereoSurface(points_m, depth_m / pair.disparity_at(depth_m) * std_px)


def _turned(image: Image, H: Array, how: int = cv2.INTER_LINEAR) -> Image:
    height, width = image.shape
    return np.asarray(cv2.warpPerspective(image, H, (width, height), None, how), np.uint8)
