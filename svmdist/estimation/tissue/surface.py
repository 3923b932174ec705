"""The tissue's surface by both views: points in the camera frame, with normals and deviations."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.camera import Camera
from svmdist.estimation.instrument.measurement import BiasTerm, disparity_biases
from svmdist.profile import Profile
from svmdist.profile.robot import CameraError
from svmdist.samples import Image, RightView
from svmdist.tracks import Mask
from svmdist.transforms import Array, inverse
from svmdist.vision.colour import Masks
from svmdist.vision.disparity import CLIPPED, MARGIN_PX, disparity_map
from svmdist.vision.frame_context import FrameContext
from svmdist.vision.stereo import RectifiedPair, RowAlignment

QUICK_PX, ALL_PX = 30_000, 2_100_000
"""Pixels of the tissue that are matched: for a distance in every frame, and for the surface itself (1920x1080)."""


@dataclass(frozen=True, slots=True)
class StereoSurface:
    """Points on a grid of the left view, all in the camera frame."""

    grid_m: Array  # shape (h, w, 3)
    normals: Array  # shape (h, w, 3), of length 1, towards the camera
    grid_std_m: Array  # standard deviation of matching along the line of sight, shape (h, w)
    is_seen: Mask  # where both views show it, (h, w); below instruments and over gaps it continues smoothly
    is_within: Mask  # the hull of what is seen, (h, w), beyond which it means nothing
    share: float  # of the tissue in the left view that is seen

    @property
    def points_m(self) -> Array:
        """The points that are seen, shape (n, 3)."""
        return np.asarray(self.grid_m[self.is_seen])

    @property
    def std_m(self) -> float:
        """The deviation of matching of half of them."""
        return float(np.median(self.grid_std_m[self.is_seen]))

    def deviations_m(self, camera: Camera, right: RightView, error: CameraError) -> Array:
        """Of every point of the grid, by matching and by the cameras' calibration, shape (h, w)."""
        biases = depth_biases(self.grid_m.reshape(-1, 3), camera, right, error)
        square = sum(np.sum(bias.jacobian**2, axis=(1, 2)) for bias in biases)
        return np.asarray(np.sqrt(self.grid_std_m**2 + np.reshape(square, self.grid_std_m.shape)))

    def colours(self, bgr: Image, camera: Camera) -> Image:
        """The colours, shape (n, 3), of the points that are seen, in the image of an ideal camera, (h, w, 3)."""
        columns, rows = np.rint(camera.project(self.points_m)).astype(np.intp).T
        height, width = bgr.shape[:2]
        return np.asarray(bgr[rows.clip(0, height - 1), columns.clip(0, width - 1)])


def depth_biases(points_m: Array, camera: Camera, right: RightView, error: CameraError) -> tuple[BiasTerm, ...]:
    """What errors of both cameras do to the depth in m that a surface by stereo has at points, shape (..., 3)."""
    T_right_left = inverse(right.T_left_right)
    disparity_px = np.asarray(camera.K[0, 0] * np.linalg.norm(T_right_left[:3, 3]) / points_m[..., 2])
    by_px = (points_m[..., 2] / disparity_px)[..., None, None]
    biases = disparity_biases(points_m, right.camera, disparity_px, T_right_left, error)
    return tuple(BiasTerm(bias.name, by_px * bias.jacobian, bias.correlation_time_s) for bias in biases)


def detect_stereo_surface(
    views: tuple[FrameContext, FrameContext], pair: RectifiedPair, profile: Profile, rows: RowAlignment, most_px: int
) -> StereoSurface | None:
    """The surface of the tissue that both views show; None where they show too little of it, or do not agree.

    Up to `most_px` pixels are matched. What `rows`, by which views were aligned, says of columns is in the deviations.
    """
    field = profile.field
    greys = [view.grey for view in views]
    masks = [_tissue_mask(view.masks, view.grey) for view in views]
    first_px, offset_px = np.zeros(2), pair.offset_px
    if pair.R_rows_left is not None:
        # As cameras turned to the baseline would have them, with what a turn moves out of the picture.
        turns = [pair.homography(), pair.homography(right=True)]
        corners_px = np.array([_corners(grey, H) for grey, H in zip(greys, turns, strict=True)])
        shifts = np.floor(corners_px.min(1))
        shifts[:, 1] = shifts[:, 1].min()  # rows correspond
        reach_px = (corners_px.max(1) - shifts).max(0)
        size = np.minimum(np.ceil(reach_px), 2 * np.array(greys[0].shape[::-1])).astype(int)
        turns = [np.array([[1, 0, -x], [0, 1, -y], [0, 0, 1]]) @ H for (x, y), H in zip(shifts, turns, strict=True)]
        greys = [_turned(grey, H, size) for grey, H in zip(greys, turns, strict=True)]
        masks = [_turned(mask, H, size, cv2.INTER_NEAREST) for mask, H in zip(masks, turns, strict=True)]
        first_px, offset_px = shifts[0], offset_px - float(shifts[0][0] - shifts[1][0])
    bounds_px = [pair.disparity_at(at_m) + offset_px for at_m in (field.depth_m, field.least_depth_m)]
    found = disparity_map(greys, masks, bounds_px, profile.settings.stereo, most_px)
    if found is None:
        return None
    rows_px = np.stack(np.meshgrid(found.columns_px, found.rows_px), -1) + first_px
    # Continued beyond what is seen, a disparity may be that of no point.
    disparity_px = np.maximum(found.disparity_px - offset_px, pair.disparity_at(field.depth_m))
    grid_m = pair.points(rows_px.reshape(-1, 2), disparity_px.ravel()).reshape(*disparity_px.shape, 3)
    along = np.cross(np.gradient(grid_m, axis=0), np.gradient(grid_m, axis=1))
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    normals = along / np.where(length > 0.0, length, 1.0)
    normals *= -np.sign(np.sum(normals * grid_m, -1, keepdims=True))
    slope_m = np.linalg.norm(grid_m, axis=-1) / disparity_px
    cell_px2 = float(np.diff(found.columns_px[:2])[0] * np.diff(found.rows_px[:2])[0])
    share = np.count_nonzero(found.is_seen) * cell_px2 / max(cv2.countNonZero(masks[0]), 1)
    std_m = slope_m * np.hypot(found.std_px, rows.std_px(rows_px, disparity_px, pair.K))
    # The convex hull of cells, and two cells about it: matches near a border are left out.
    hull = np.zeros(found.is_seen.shape, np.uint8)
    cv2.fillConvexPoly(hull, cv2.convexHull(np.argwhere(found.is_seen)[:, ::-1].astype(np.int32)), 1)
    is_within = np.asarray(cv2.dilate(hull, np.ones((5, 5), np.uint8)) > 0)
    return StereoSurface(grid_m, normals, std_m, found.is_seen, is_within, min(share, 1.0))


def _tissue_mask(masks: Masks, grey: Image) -> Image:
    """The tissue with the highlights on it, shape (h, w)."""
    shining = masks.tissue | ((grey >= CLIPPED).astype(np.uint8) * np.uint8(255))
    closed = cv2.morphologyEx(masks.tissue, cv2.MORPH_CLOSE, np.ones((MARGIN_PX, MARGIN_PX), np.uint8))
    around = cv2.morphologyEx(masks.tissue, cv2.MORPH_CLOSE, np.ones((5 * MARGIN_PX, 5 * MARGIN_PX), np.uint8))
    return np.asarray(closed | (shining & around), np.uint8)


def _corners(image: Image, H: Array) -> Array:
    """The image's corners, shape (4, 2), where a homography takes them."""
    height, width = image.shape
    corners = np.array([[0, 0, 1], [width, 0, 1], [0, height, 1], [width, height, 1]]) @ H.T
    return np.asarray(corners[:, :2] / np.maximum(corners[:, 2:], 0.1))


def _turned(image: Image, H: Array, size: NDArray[np.int_], how: int = cv2.INTER_LINEAR) -> Image:
    return np.asarray(cv2.warpPerspective(image, H, (int(size[0]), int(size[1])), None, how), np.uint8)
