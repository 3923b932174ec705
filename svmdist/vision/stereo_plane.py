"""The plane that most of a scene lies on, from the disparities of a rectified pair."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from svmdist.samples import Image
from svmdist.transforms import Array

NEAREST_M, FURTHEST_M = 0.04, 0.5
"""Where tissue lies in front of an endoscope, with room on both sides."""
WIDTH_PX = 640
"""Images are matched at about this width: a plane needs no more."""
MAX_DISPARITIES = 256
ROW_OFFSETS_PX = (-2, -1, 0, 1, 2)
"""Rows of a pair that is called rectified were found 1.5 px apart."""
SAMPLE_COUNT = 20_000
INLIER_PX = 1.5
MIN_INLIER_FRACTION, MIN_MATCHED_FRACTION = 0.4, 0.1
TRIALS = 200


@dataclass(frozen=True, slots=True)
class StereoPlane:
    """A plane n · p = -d as a pair shows it: unit normal (3,) towards the camera, and d in m.

    `surface_std_m` is how far what is on it stands off it; `row_offset_px` how far right rows are above left ones.
    """

    normal: Array
    distance_m: float
    surface_std_m: float
    row_offset_px: int


def fit_plane(left_bgr: Image, right_bgr: Image, K: Array, baseline_m: float) -> StereoPlane | None:
    """The plane of a rectified pair of images, both with K; None where too little matches, or lies on no one plane.

    1 / depth is linear in the pixel on a plane, and so is the disparity f b / depth: three numbers are fitted robustly
    (RANSAC, then Geman and McClure's loss) to the disparities of semi-global matching.
    """
    step = max(1, round(left_bgr.shape[1] / WIDTH_PX))
    left, right = (_small_grey(image, step) for image in (left_bgr, right_bgr))
    fb_px_m = float(K[0, 0]) / step * baseline_m
    low = max(1, int(fb_px_m / FURTHEST_M))
    high = min(int(np.ceil(fb_px_m / NEAREST_M)), low + MAX_DISPARITIES, left.shape[1] // 2)
    if high - low < 3:
        return None
    found = [(_disparities(left, np.roll(right, offset, 0), low, high), offset) for offset in ROW_OFFSETS_PX]
    disparity_px, offset = max(found, key=lambda one: int(np.isfinite(one[0]).sum()))
    rows, columns = np.nonzero(np.isfinite(disparity_px))
    if len(rows) < MIN_MATCHED_FRACTION * disparity_px.size:
        return None
    rng = np.random.default_rng(0)
    kept = rng.choice(len(rows), min(len(rows), SAMPLE_COUNT), replace=False)
    rows, columns = rows[kept], columns[kept]
    rays = np.column_stack(
        [
            (columns * step - K[0, 2]) / K[0, 0],
            (rows * step - K[1, 2]) / K[1, 1],
            np.ones(len(rows)),
        ]
    )
    values = disparity_px[rows, columns]
    q = _robust_plane(rays, values, rng)
    off_px = rays @ q - values
    on_it = np.abs(off_px) < INLIER_PX
    normal_length = float(np.linalg.norm(q))
    if on_it.mean() < MIN_INLIER_FRACTION or q[2] <= 0.0:
        return None
    distance_m = fb_px_m / normal_length
    # A residual of disparity over the depth's slope, at the scene's middle: δz = z² δd / (f b).
    surface_std_m = distance_m**2 / fb_px_m * float(np.std(off_px[on_it]))
    return StereoPlane(-q / normal_length, distance_m, surface_std_m, offset * step)


def _robust_plane(rays: Array, values: Array, rng: np.random.Generator) -> Array:
    """q, shape (3,), with values = rays · q for most of them."""
    best: Array = np.zeros(3)
    least = np.inf
    for _ in range(TRIALS):
        three = rng.choice(len(values), 3, replace=False)
        if abs(np.linalg.det(rays[three])) < 1e-6:
            continue
        q: Array = np.asarray(np.linalg.solve(rays[three], values[three]), np.float64)
        cost = float(np.minimum(np.abs(rays @ q - values), 2 * INLIER_PX).sum())
        if cost < least:
            best, least = q, cost
    for _ in range(10):
        weights = (1.0 + ((rays @ best - values) / INLIER_PX) ** 2) ** -2
        weighted = rays * weights[:, None]
        best = np.asarray(np.linalg.solve(weighted.T @ rays, weighted.T @ values), np.float64)
    return best


def _disparities(left: Image, right: Image, low: int, high: int) -> Array:
    """Disparity of each left pixel in px; NaN where nothing matched."""
    block = 7
    matcher = cv2.StereoSGBM.create(
        minDisparity=low,
        numDisparities=16 * int(np.ceil((high - low) / 16)),
        blockSize=block,
        P1=8 * block**2,
        P2=32 * block**2,
        disp12MaxDiff=1,
        uniquenessRatio=10,
        speckleWindowSize=100,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    fixed_point = np.asarray(matcher.compute(left, right), np.float64)
    return np.where(fixed_point >= 16 * low, fixed_point / 16.0, np.nan)


def _small_grey(image: Image, step: int) -> Image:
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    size = (image.shape[1] // step, image.shape[0] // step)
    return np.asarray(grey if step == 1 else cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.uint8)
