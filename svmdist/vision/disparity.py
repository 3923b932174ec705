"""A disparity map of a rectified pair: semi-global matching, then a sub-pixel fit with its standard deviation.

Matching (Hirschmüller 2008) finds what belongs together within a pixel. Around it, right(u - d, v) - left(u, v) is
linear in d: every pixel is a measurement of the disparity, as good as the image is steep there (Lucas and Kanade 1981).
Cells of pixels are fitted from the whole view down to a few pixels, by planes on what the coarser fit leaves; a finer
fit is followed as far as it differs from the coarser one by more than its noise does. So the surface may have any
shape, is smooth where nothing shows its detail, and continues below what hides it, with a deviation that says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.least_squares import scale_of
from svmdist.profile.settings import StereoSettings
from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision.stereo import reduced

Bools = NDArray[np.bool_]
Floats = NDArray[np.float32]

COARSE_PX = 160  # width of the views in which the range of disparities is found
MATCHED_PX = 400  # wider views are matched at half of it: a block shows twice as much, with less noise
MAX_SHARE = 0.6  # of the width: the largest disparity that is searched
RANGE_PERCENT = (2.0, 98.0)
RANGE_SHARE = 0.15  # by which that range is widened, at either end
UNIQUE_PERCENT = 5  # by which the best match must be better than any other
CELL_PX = 4  # side of a cell
SPECKLE_SHARE = 0.002  # of the view: smaller patches of matches that stand alone are mistakes
MARGIN_PX = 5  # matches as near to an instrument or to the view's border mix two surfaces within one block
CLIPPED = 250  # brighter pixels are highlights, which stand elsewhere in the other view
CLIPPED_PX = 7  # side of what is left out about each
SMOOTHING_PX = 1.2  # of both views, so that a step of a pixel stays on a slope
LEVELLING_SHARE = 0.025  # half of the window for contrast over the width
FLAT_LEVELS = 3.0  # contrast of mere noise
# How smoothly the views' brightness may differ, over the width: with the camera, light and gloss of wet tissue move.
# What changes no faster than that says nothing about disparity; else it is off by twice the standard deviation.
BRIGHTNESS_SHARE = 0.01
STEPS = 3
LEAST_LEVELS = 0.25  # noise of 8 bits, and its square
ROW_STRIDE = 4
# Of a cell's matches, in 1/px²: bounds, and as a share of its pixels' information. Both see the same texture
MATCH_INFORMATION, MATCH_SHARE = (0.02, 1.0), 0.3
STD_FACTOR, LEAST_STD_PX = 1.5, 0.06  # between deviations so found and errors on warped views; what all share
FILLED_FACTOR = 2.0  # the same where nothing matched, at rims and below instruments, beside that
MAX_OFF_PX = 1.5  # of matches from the fit, beside two of its deviations
MAX_STD_PX = 1.0  # beyond, a place is not matched
MIN_MATCHED = 0.25  # of a cell
LEAST_PATCH = 0.01  # of all that is seen: smaller patches are mistakes, or no tissue


@dataclass(frozen=True, slots=True)
class DisparityMap:
    """Disparity and its standard deviation, shape (h, w) in px, at pixels of the left view: columns (w,), rows (h,).

    It is fitted everywhere; `is_seen` where matches agree. Deviations are of matching alone.
    """

    columns_px: Array
    rows_px: Array
    disparity_px: Array
    std_px: Array
    is_seen: Bools


def disparity_map(
    views: Sequence[Image], masks: Sequence[Image], bounds_px: Sequence[float], settings: StereoSettings, most_px: int
) -> DisparityMap | None:
    """Match the left and the right grey view, shape (h, w), inside of masks; None where too little agrees.

    The views are reduced until the masked part has no more than `most_px` pixels. Bounds are of disparities.
    """
    x, y, width, height = cv2.boundingRect(_eroded(masks[0], 2 * MARGIN_PX + 1))  # without specks
    step = max(1, int(np.ceil(np.sqrt(width * height / most_px))))
    rows = slice(max(0, y - MARGIN_PX * step), y + height + MARGIN_PX * step)
    greys = [reduced(view[rows], step) for view in views]
    inside = [reduced(mask[rows], step, cv2.INTER_NEAREST) for mask in masks]
    whole_px = greys[0].shape[1]
    low, high = bounds_px[0] / step, min(bounds_px[1] / step, MAX_SHARE * whole_px)
    # A view that is too small, or a baseline in millimetres for metres: nothing could be seen so near.
    if min(greys[0].shape) <= 8 * CELL_PX or low >= high:
        return None
    found = _range(greys, inside, low, high)
    if found is None:
        return None
    low, high = found
    # Columns that matches can lie in
    first = max(0, int(x / step - max(high, 0.0)) - MARGIN_PX)
    last = int((x + width) / step - min(low, 0.0)) + MARGIN_PX
    greys, inside = ([np.ascontiguousarray(one[:, first:last]) for one in both] for both in (greys, inside))
    normalised = [_normalised(grey, mask, whole_px) for grey, mask in zip(greys, inside, strict=True)]
    matched = semi_global(normalised, low, high, settings.block_px, 2 if whole_px > MATCHED_PX else 1)
    fitted = _Fit(greys, inside, matched, BRIGHTNESS_SHARE * whole_px).run()
    if fitted is None or np.count_nonzero(fitted[2]) * CELL_PX**2 * step**2 < settings.min_matches:
        return None
    disparity_px, std_px, is_seen = fitted
    at = step * (CELL_PX * np.arange(max(is_seen.shape)) + 0.5 * (CELL_PX - 1)) + 0.5 * (step - 1)
    columns_px, rows_px = step * first + at[: is_seen.shape[1]], rows.start + at[: is_seen.shape[0]]
    return DisparityMap(columns_px, rows_px, step * disparity_px, step * std_px, is_seen)


def semi_global(views: Sequence[Image], low_px: float, high_px: float, block_px: int, step: int = 1) -> Floats:
    """Disparity of every left pixel, (h, w) in px, by semi-global matching of views reduced by `step`; NaN without.

    The best match must be unique, and be found from the right, too.
    """
    height, width = views[0].shape
    low_px, high_px = low_px / step, high_px / step
    low, count = int(np.floor(low_px)), 16 * int(np.ceil((high_px - low_px + 2.0) / 16))
    # Every column must have all disparities in the image, else OpenCV leaves it out.
    before, after = max(low + count, 0) + block_px, max(-low, 0) + block_px
    left, right = (
        np.asarray(cv2.copyMakeBorder(reduced(view, step), 0, 0, before, after, cv2.BORDER_REPLICATE), np.uint8)
        for view in views
    )
    matcher = cv2.StereoSGBM.create(
        minDisparity=low,
        numDisparities=count,
        blockSize=block_px,
        P1=8 * block_px**2,
        P2=32 * block_px**2,
        disp12MaxDiff=2,
        uniquenessRatio=UNIQUE_PERCENT,
        speckleWindowSize=max(1, round(SPECKLE_SHARE * left.size)),
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    fixed_point = np.asarray(matcher.compute(left, right), np.float32)[:, before:-after]
    matched = step * np.where(fixed_point >= 16 * low, fixed_point / 16.0, np.float32(np.nan))
    return _enlarged(np.asarray(matched, np.float32), (width, height), cv2.INTER_NEAREST, step)


def _range(greys: Sequence[Image], inside: Sequence[Image], low: float, high: float) -> tuple[float, float] | None:
    """The disparities that the scene has, in px, by matching small views over all that may be; None without any."""
    step = max(1, round(greys[0].shape[1] / COARSE_PX))
    inside = [reduced(mask, step, cv2.INTER_NEAREST) for mask in inside]
    normalised = [
        _normalised(reduced(grey, step), mask, mask.shape[1]) for grey, mask in zip(greys, inside, strict=True)
    ]
    if len(np.unique(normalised[1][inside[1] > 0])) < 2:  # a covered lens fits anything
        return None
    matched = semi_global(normalised, low / step, high / step, 5)
    seen = step * matched[np.isfinite(matched) & (inside[0] > 0)]
    if len(seen) < CELL_PX**2:
        return None
    least, most = np.percentile(seen, RANGE_PERCENT)
    more = RANGE_SHARE * (most - least) + 2.0 * step
    return max(low, float(least - more)), min(high, float(most + more))


def _normalised(grey: Image, inside: Image, width_px: int) -> Image:
    """The view at the same brightness and contrast everywhere inside of a mask: vignetting differs between views."""
    side = 2 * max(2, round(LEVELLING_SHARE * width_px)) + 1
    level, used = grey.astype(np.float32), (inside > 0).astype(np.float32)
    share, first, second = (cv2.blur(moment, (side, side)) for moment in (used, level * used, level * level * used))
    share = share + np.float32(1e-6)
    middle = first / share
    spread = np.sqrt(np.maximum(second / share - middle**2, 0.0) + FLAT_LEVELS**2)
    # Without what is outside, whose border would match at the disparity of the instrument there.
    smooth = blurred(level * used, SMOOTHING_PX) / np.maximum(blurred(used, SMOOTHING_PX), 1e-6)
    return np.asarray(cv2.addWeighted((smooth - middle) / spread * used, 40.0, used, 0.0, 128.0, dtype=cv2.CV_8U))


class _Fit:
    """The disparities of cells by matches, and by the brightness of both views along them."""

    def __init__(self, greys: Sequence[Image], inside: Sequence[Image], matched: Floats, brightness_px: float) -> None:
        self._left, self._right = (blurred(grey.astype(np.float32), SMOOTHING_PX) for grey in greys)
        self._brightness_px = brightness_px
        core, core_right = (_eroded(mask, 2 * MARGIN_PX + 1) for mask in inside)
        self._used_right = _without_highlights(greys[1], _eroded(inside[1], MARGIN_PX))
        height, width = matched.shape
        self._size = (width // CELL_PX, height // CELL_PX)
        self._columns, self._rows = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in (width, height)))
        # What an instrument hides from the right camera has no match, though blocks find one at its border.
        at = self._columns - np.nan_to_num(matched), self._rows
        is_matched = np.isfinite(matched) & (core > 0) & (cv2.remap(core_right, *at, cv2.INTER_NEAREST) > 0)
        share = self._cells(is_matched.astype(np.float32))
        value = self._cells(np.where(is_matched, matched, 0.0).astype(np.float32))
        self._is_matched = share > MIN_MATCHED
        self._share = np.asarray(np.where(self._is_matched, share, 0.0), np.float32)
        self._matches = np.where(self._is_matched, value / np.maximum(share, 1e-6), 0.0).astype(np.float32)
        near = _enlarged(self._is_matched.astype(np.float32), (width, height), cv2.INTER_NEAREST)
        self._used = _without_highlights(greys[0], core) * near
        self._turn: Array = np.zeros(3)  # what rows are off by: an offset, and its change along both axes

    def run(self) -> tuple[Array, Array, Bools] | None:
        """Disparities and deviations of the cells in px, and which are seen."""
        if np.count_nonzero(self._is_matched) < CELL_PX**2:
            return None
        fitted, variance = fit_cells(self._share, self._share * self._matches)
        is_near = self._is_matched
        for _ in range(STEPS):
            measured = self._by_brightness(fitted)
            if measured is None:
                return None
            by_matches = self._share * np.clip(MATCH_SHARE * measured[0], *MATCH_INFORMATION)
            information, total = measured[0] + by_matches, measured[1] + by_matches * self._matches
            fitted, variance = fit_cells(information * is_near, total * is_near)
            std_px = _std_px(variance)
            is_near = self._is_matched & (np.abs(self._matches - fitted) < MAX_OFF_PX + 2.0 * std_px)
            if not is_near.any():
                return None
        # Without what is a cell wide, or stands alone and is small.
        sure = (is_near & (std_px < MAX_STD_PX)).astype(np.uint8)
        opened = cv2.morphologyEx(sure, cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
        _, labels, statistics, _ = cv2.connectedComponentsWithStats(opened, connectivity=4)
        areas = statistics[:, cv2.CC_STAT_AREA]
        kept = areas >= LEAST_PATCH * max(int(areas[1:].sum()), 1)
        kept[0] = False
        is_seen = np.asarray(kept[labels])
        if not is_seen.any():
            return None
        # Continued below what hides it by what is seen alone.
        filled, variance = fit_cells(information * is_seen, total * is_seen)
        fitted = np.where(is_seen, fitted, filled)
        std_px = np.where(is_seen, std_px, FILLED_FACTOR * _std_px(variance))
        return fitted.astype(np.float64), std_px.astype(np.float64), is_seen

    def _by_brightness(self, fitted: Floats) -> tuple[Floats, Floats] | None:
        """Information of cells about disparity, and that times its value, linear about `fitted`; mends the rows."""
        height, width = self._left.shape
        u, v = (self._columns - 0.5 * width) / width, (self._rows - 0.5 * height) / width
        disparity = _enlarged(fitted, (width, height))
        rows = self._rows + self._turn[0] + self._turn[1] * u + self._turn[2] * v
        at = self._columns - disparity, rows.astype(np.float32)
        seen, used = (
            np.asarray(cv2.remap(one, *at, cv2.INTER_LINEAR, None, cv2.BORDER_CONSTANT, 0), np.float32)
            for one in (self._right, self._used_right)
        )
        usable = np.asarray(self._used * (used > 0.99), np.float32)
        error = seen - self._left
        error = error - _smooth_share(error, usable, self._brightness_px)
        few = np.s_[::ROW_STRIDE, ::ROW_STRIDE]
        some = error[few][usable[few] > 0]
        if len(some) < CELL_PX**2:
            return None
        noise = np.float32(scale_of(some.astype(np.float64)) + LEAST_LEVELS)
        weight = usable / (1.0 + (error / (2.0 * noise)) ** 2)
        # Rectified rows are a pixel or two off: by what offset and turn of the right ones the error is less.
        slope, pull, u, v = (one[few] for one in (_slope(self._left, 0, 1), weight, u, v))
        B, pull = np.stack([np.ones_like(u), u, v], -1).reshape(-1, 3), pull * slope
        normal = (B * (pull * slope).reshape(-1, 1)).T @ B
        normal += np.diag([1e-6, 0.01, 0.01]) * (normal[0, 0] + 1e-6)
        self._turn -= np.linalg.solve(normal, B.T @ (pull * error[few]).ravel())
        # left(u) = right(u - d), so that the right image's slope there is the left one's over 1 - d'.
        along = 0.5 * (_slope(self._left) + _slope(seen)) / np.maximum(1.0 - _slope(disparity), 0.5)
        along -= _smooth_share(along, usable, self._brightness_px)
        gain = weight * along
        information = self._cells(gain * along)
        total = self._cells(gain * error) + information * fitted
        square, share = (blurred(self._cells(one), SCALES[2]) for one in (weight * error**2, weight))
        # Smoothed noise is alike within some pixels: of a cell's so many count.
        independent = CELL_PX**2 / (4.0 * np.pi * SMOOTHING_PX**2)
        certainty = independent / np.maximum(square / np.maximum(share, 1e-6), LEAST_LEVELS)
        return np.asarray(information * certainty, np.float32), np.asarray(total * certainty, np.float32)

    def _cells(self, values: Floats) -> Floats:
        """Means over the cells."""
        width, height = self._size
        whole = np.ascontiguousarray(values[: height * CELL_PX, : width * CELL_PX])
        return np.asarray(cv2.resize(whole, self._size, interpolation=cv2.INTER_AREA), np.float32)


def _std_px(variance: Floats) -> Floats:
    return np.asarray(np.sqrt(STD_FACTOR**2 * variance + LEAST_STD_PX**2), np.float32)


def _smooth_share(error: Floats, weight: Floats, sigma_px: float) -> Floats:
    """What of an error changes but slowly over the view: brightness, shadow and gloss."""
    height, width = error.shape
    size = (max(1, width // 8), max(1, height // 8))
    small = (cv2.resize(one, size, interpolation=cv2.INTER_AREA) for one in (error * weight, weight))
    value, share = (blurred(np.asarray(one, np.float32), sigma_px / 8.0) for one in small)
    return np.asarray(cv2.resize(value / np.maximum(share, 1e-4), (width, height)), np.float32)


def _without_highlights(grey: Image, inside: Image) -> Floats:
    """Ones inside, but for highlights."""
    clipped = cv2.dilate((grey >= CLIPPED).astype(np.uint8), np.ones((CLIPPED_PX, CLIPPED_PX), np.uint8))
    return np.asarray((inside > 0) & (clipped == 0), np.float32)


def _eroded(mask: Image, side: int) -> Image:
    """The mask without its border; also where that is the view's."""
    return np.asarray(cv2.erode(mask, np.ones((side, side), np.uint8), borderValue=0), np.uint8)


def _slope(values: Floats, x: int = 1, y: int = 0) -> Floats:
    return np.asarray(cv2.Sobel(values, cv2.CV_32F, x, y, ksize=3), np.float32) / 8.0


def _enlarged(cells: Floats, size: tuple[int, int], how: int = cv2.INTER_LINEAR, by: int = CELL_PX) -> Floats:
    height, width = cells.shape
    whole = cv2.resize(cells, (width * by, height * by), interpolation=how)
    right, below = size[0] - whole.shape[1], size[1] - whole.shape[0]
    return np.asarray(cv2.copyMakeBorder(whole, 0, below, 0, right, cv2.BORDER_REPLICATE), np.float32)


SCALES = (24.0, 12.0, 6.0, 3.0, 1.5)  # deviations of the windows of fits, in cells
CORRELATED = 2.0  # of the variance of a fit by its pixels' noise: JPEG's blocks and highlights span many
MOST_ASIDE = 1.5  # of the middle of what a window holds, over its deviation
ALIKE_CELLS = 25.0  # over which what a quadric leaves is alike
UNKNOWN_PX2, LEAST_WEIGHT = 1e4, 1e-3


def fit_cells(information: Floats, total: Floats) -> tuple[Floats, Floats]:
    """Values and variances of cells, shape (h, w), by the information in each, and by information times value.

    A quadric of all, then planes on what is left of it in smaller and smaller windows. How far a finer fit differs by
    more than its variance is found around each place (empirical Bayes), and as much of it is taken.
    """
    information, total = (np.ascontiguousarray(one, np.float32) for one in (information, total))
    size = (information.shape[1], information.shape[0])
    fitted, variance = _quadric(information, total)
    for scale in SCALES:
        step = max(1, int(scale / 3.0))
        few, sigma = (max(1, size[0] // step), max(1, size[1] // step)), scale / step
        of_cells = (information, step**2), (total - information * fitted, step**2), (variance, 1)
        weight, left, before = (
            np.asarray(cv2.resize(one, few, interpolation=cv2.INTER_AREA), np.float32) * factor
            for one, factor in of_cells
        )
        found, own, is_near = _planes(weight, left, sigma)
        certainty = 1.0 / own
        beyond = blurred((found**2 - own) * certainty, 2.0 * sigma)
        change = np.maximum(beyond / blurred(certainty, 2.0 * sigma), 0.0)
        taken = change / (change + own)
        filled = taken * own + (1.0 - taken) * (np.minimum(before, change + own) + change)
        variance = cv2.resize(np.where(is_near, filled, np.maximum(filled, before)), size)
        fitted = fitted + cv2.resize(taken * found, size, interpolation=cv2.INTER_CUBIC)
    return fitted, np.asarray(variance, np.float32)


def _planes(weight: Floats, total: Floats, sigma: float) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """The value and its variance at each cell of the plane that fits best in a Gaussian window about it.

    Where all of what the window holds is to one side, its variance is no less than before: those are not near.
    """
    reach = int(np.ceil(3.0 * sigma))
    t = np.arange(-reach, reach + 1, dtype=np.float32)
    powers = [np.asarray(np.exp(-0.5 * (t / sigma) ** 2) * t**power, np.float32) for power in range(3)]

    def moment(values: Floats, i: int, j: int) -> Floats:
        found = cv2.sepFilter2D(values, cv2.CV_32F, powers[i], powers[j], borderType=cv2.BORDER_CONSTANT)
        return np.asarray(found, np.float32)

    W, X, Y, T = moment(weight, 0, 0), moment(weight, 1, 0), moment(weight, 0, 1), moment(total, 0, 0)
    inverse = 1.0 / np.maximum(W, 1e-12)
    x, y, middle = X * inverse, Y * inverse, T * inverse
    xx, xy, yy = moment(weight, 2, 0) - X * x, moment(weight, 1, 1) - X * y, moment(weight, 0, 2) - Y * y
    xt, yt = moment(total, 1, 0) - X * middle, moment(total, 0, 1) - Y * middle
    level = 1e-3 * sigma**2 * W + 1e-12  # of points in a line, one slope is not known
    xx, yy = xx + level, yy + level
    size = xx * yy - xy * xy
    found = middle - ((yy * xt - xy * yt) * x + (xx * yt - xy * xt) * y) / size
    own = CORRELATED * (inverse + (x * x * yy - 2.0 * x * y * xy + y * y * xx) / size) + 1e-5
    is_known = (W > LEAST_WEIGHT) & np.isfinite(found) & np.isfinite(own)
    return (
        np.asarray(np.where(is_known, found, 0.0), np.float32),
        np.asarray(np.where(is_known, np.clip(own, 1e-5, UNKNOWN_PX2), UNKNOWN_PX2), np.float32),
        np.asarray(x * x + y * y < (MOST_ASIDE * sigma) ** 2),
    )


def _quadric(information: Floats, total: Floats) -> tuple[Floats, Floats]:
    """The quadric that most cells agree on, and its variance: what it leaves, and more away from those; both (h, w)."""
    height, width = information.shape
    x, y = (np.linspace(-1.0, 1.0, count) for count in (width, height))
    stride = max(1, min(height, width) // 16)
    if not information[::stride, ::stride].any():  # a few cells, between these
        stride = 1
    few = np.s_[::stride, ::stride]
    weight = information[few].ravel().astype(np.float64)
    value = total[few].ravel() / np.maximum(weight, 1e-12)
    X, Y = np.meshgrid(x[::stride], y[::stride])
    terms = np.stack([np.ones_like(X), X, Y, X * X, X * Y, Y * Y], -1)
    B, trust = terms.reshape(-1, 6), np.ones_like(weight)
    for _ in range(5):
        pull = B * (weight * trust)[:, None]
        normal = pull.T @ B
        c = np.linalg.solve(normal + 1e-6 * np.trace(normal) * np.eye(6), pull.T @ value)
        error = value - B @ c
        known = np.abs(error[weight > 0.0])
        trust = 1.0 / (1.0 + (error / (3.0 * float(np.median(known)) + 1e-3)) ** 2)
    surface = c[0] + c[1] * x + c[3] * x * x + (c[2] * y + c[5] * y * y)[:, None] + c[4] * np.outer(y, x)
    pull = weight * trust
    spread = max(float(pull @ error**2 / pull.sum()), 1e-2)
    # What it leaves is alike over some cells: of the used ones so many err independently.
    apart = max(float(pull.sum()) ** 2 / float(pull @ pull) * stride**2 / ALIKE_CELLS, 1.0)
    C = spread / apart * np.linalg.inv(normal / pull.sum() + 1e-6 * np.eye(6))
    own = np.asarray(np.einsum("hwi,ij,hwj->hw", terms, C, terms), np.float32)
    return surface.astype(np.float32), np.asarray(spread + cv2.resize(own, (width, height)), np.float32)


def blurred(values: Floats, sigma: float) -> Floats:
    """Gaussian means about each place."""
    return np.asarray(cv2.GaussianBlur(values, (0, 0), sigma), np.float32)
