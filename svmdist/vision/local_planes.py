"""A smooth field over cells of an image by planes in smaller and smaller windows, and its variance at each cell."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]

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
    B = terms.reshape(-1, 6)
    trust, c, error = np.ones_like(weight), np.zeros(6), value
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
