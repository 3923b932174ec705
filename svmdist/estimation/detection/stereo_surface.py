"""The tissue's surface from both views of a rectified pair, as points in the camera frame."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.profile.settings import StereoSettings
from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision.rectified import RectifiedPair
from svmdist.vision.stereo import DisparitySurface, fit_surface

DEFAULT = StereoSettings()
GRID_STEP_PX = 5


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
    settings: StereoSettings = DEFAULT,
) -> StereoSurface | None:
    """The tissue's surface inside its hull in the left image, under the instrument too; None if the views disagree.

    The grey images and the tissue's `masks` in both have shape (h, w); `hull` has shape (n, 1, 2) in px.
    """
    if pair.R_rows_left is not None:
        left_grey, right_grey, masks, hull = _turned(left_grey, right_grey, pair, hull, masks)
    far_px, near_px = (
        pair.disparity_at(depth_m) + pair.offset_px for depth_m in (settings.far_m, settings.near_m)
    )
    bounds = (int(np.floor(far_px)), int(np.ceil(near_px)))
    surface = fit_surface(left_grey, right_grey, *masks, *bounds, settings)
    if surface is None or surface.agreeing_fraction < settings.min_agreeing_matches:
        return None
    points_m = _cloud(surface, hull, pair, masks[0].shape, settings.far_m)
    depth_m = float(np.median(points_m[:, 2]))
    std_px = settings.surface_std_px * max(1.0, surface.mismatch_px / settings.clean_mismatch_px)
    return StereoSurface(points_m, depth_m / pair.disparity_at(depth_m) * std_px)


def _turned(
    left_grey: Image,
    right_grey: Image,
    pair: RectifiedPair,
    hull: NDArray[np.int32],
    masks: tuple[Image, Image],
) -> tuple[Image, Image, tuple[Image, Image], NDArray[np.int32]]:
    """Both views, their masks and the hull as cameras turned to the baseline would have them."""
    height, width = left_grey.shape
    at_left, at_right = pair.homography(), pair.homography(right=True)

    def warped(image: Image, H: Array, how: int) -> Image:
        return np.asarray(cv2.warpPerspective(image, H, (width, height), None, how), np.uint8)

    turned_px = cv2.perspectiveTransform(hull.reshape(-1, 1, 2).astype(np.float64), at_left)
    return (
        warped(left_grey, at_left, cv2.INTER_LINEAR),
        warped(right_grey, at_right, cv2.INTER_LINEAR),
        (warped(masks[0], at_left, cv2.INTER_NEAREST), warped(masks[1], at_right, cv2.INTER_NEAREST)),
        np.round(turned_px).astype(np.int32),
    )


def _cloud(
    surface: DisparitySurface,
    hull: NDArray[np.int32],
    pair: RectifiedPair,
    shape: tuple[int, ...],
    far_m: float,
) -> Array:
    inside = np.zeros(shape[:2], np.uint8)
    cv2.fillConvexPoly(inside, np.asarray(hull, np.int32), 255)
    rows, columns = np.nonzero(inside[::GRID_STEP_PX, ::GRID_STEP_PX])
    points_px = np.stack([columns, rows], -1).astype(np.float64) * GRID_STEP_PX
    disparity_px = surface.at(points_px) - pair.offset_px
    return pair.points(points_px, np.maximum(disparity_px, pair.disparity_at(far_m)))
