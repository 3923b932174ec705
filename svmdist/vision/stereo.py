"""Rectified stereo: the pair's geometry, points that correspond, and the offset between the rows of both views."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from svmdist.camera import Camera
from svmdist.least_squares import median
from svmdist.results import Failure
from svmdist.samples import Image, RightView
from svmdist.transforms import Array

MIN_ROW_POINTS = 40  # points in all these pairs that must agree on an offset
# How far off the left camera's x axis, over the baseline, a right camera counts as beside it: rows then differ by half
# a pixel at a disparity of 25 px. Further off, both views are turned.
MAX_OFF_AXIS = 0.02
MAX_TURN = 0.7  # the same beyond which it is no such pair: turned by 45 degrees, views share little


@dataclass(frozen=True, slots=True)
class RowAlignment:
    """By how many px the right view's rows lie below the left one's at the principal point, and the change per px.

    `slope` is that along x and along y. What bends rows so is a lens, or a rotation, other than the calibration's.
    """

    offset_px: float = 0.0
    slope: tuple[float, float] = (0.0, 0.0)

    @property
    def bends(self) -> bool:
        """Whether rows are more than moved."""
        return self.slope != (0.0, 0.0)

    def of_image(self, K: Array) -> Array:
        """Where the right view of K, (3, 3), shows what should be at (x, y, 1), shape (2, 3)."""
        along_x, along_y = self.slope
        offset_px = self.offset_px - along_x * K[0, 2] - along_y * K[1, 2]
        return np.array([[1.0, 0.0, 0.0], [along_x, 1.0 + along_y, offset_px]])

    def std_px(self, pixels: Array, disparity_px: Array, K: Array) -> Array:
        """Deviation of disparities, (...), at pixels (..., 2) by either lens: what bends rows does so to columns."""
        x, y = np.moveaxis(np.abs(pixels - K[:2, 2]), -1, 0)
        furthest = np.maximum(x, np.abs(pixels[..., 0] - disparity_px - K[0, 2]))
        along_x, along_y = self.slope
        return np.asarray(np.hypot(along_y * furthest, along_x * y))


LEVEL = RowAlignment()


@dataclass(frozen=True, slots=True)
class RectifiedPair:
    """The left camera's K, shape (3, 3), the baseline, and how far the principal points stand apart.

    Rows correspond in views turned by `R_rows_left`, shape (3, 3), None where they do as they are. Points are in the
    left camera's frame, and pixels those of the left view, in any case.
    """

    K: Array
    baseline_m: float
    offset_px: float
    R_rows_left: Array | None = None

    def homography(self, *, right: bool = False) -> Array:
        """What turns a view's pixels into those whose rows correspond, shape (3, 3)."""
        if self.R_rows_left is None:
            return np.eye(3)
        K = self.K.copy()
        K[0, 2] -= self.offset_px * right
        return np.asarray(K @ self.R_rows_left @ np.linalg.inv(K))

    def to_rows(self, pixel: Array, *, right: bool = False) -> Array:
        """A pixel (2,) of a view where rows correspond."""
        x, y, w = self.homography(right=right) @ np.array([pixel[0], pixel[1], 1.0])
        return np.array([x / w, y / w])

    def disparity_at(self, depth_m: float) -> float:
        """Disparity in px at a depth: f b / z."""
        return float(self.K[0, 0] * self.baseline_m / depth_m)

    def point(self, left_px: Array, disparity_px: float) -> tuple[Array, Array]:
        """The point of a left pixel (2,) and a disparity, (3,) in m, and its Jacobian by (u, v, d), (3, 3)."""
        p_m = self.points(self.to_rows(left_px)[None], np.array([disparity_px]))[0]
        moved = [self.to_rows(left_px + step) - self.to_rows(left_px - step) for step in 0.5 * np.eye(2)]
        R_left_rows = np.eye(3) if self.R_rows_left is None else self.R_rows_left.T
        m_per_px = self.K[0, 0] * self.baseline_m / disparity_px / np.diag(self.K)[:2]
        return p_m, np.column_stack([R_left_rows[:, :2] * m_per_px @ np.stack(moved, -1), -p_m / disparity_px])

    def points(self, rows_px: Array, disparity_px: Array) -> Array:
        """Points of pixels of the left view where rows correspond, shape (n, 2), and disparities (n,): (n, 3) in m."""
        depth_m = self.K[0, 0] * self.baseline_m / disparity_px
        x = (rows_px[:, 0] - self.K[0, 2]) / self.K[0, 0]
        y = (rows_px[:, 1] - self.K[1, 2]) / self.K[1, 1]
        points_m = np.stack([x * depth_m, y * depth_m, depth_m], -1)
        return points_m if self.R_rows_left is None else np.asarray(points_m @ self.R_rows_left)


def rectified_pair(left: Camera, right: RightView) -> RectifiedPair | Failure:
    """The geometry of a pair of parallel ideal cameras, as `as_pinholes` gives; or what is wrong with it."""
    T, K = right.T_left_right, left.K
    if T[0, 3] <= 0.0:
        return Failure("the right camera is not to the right of the left one: are the topics swapped?")
    baseline_m, offset_px = float(np.linalg.norm(T[:3, 3])), float(K[0, 2] - right.camera.K[0, 2])
    if np.linalg.norm(T[1:3, 3]) > MAX_TURN * baseline_m:
        return Failure("the right camera is not beside the left one: it is above, below, before or behind it")
    if np.abs(T[1:3, 3]).max() <= MAX_OFF_AXIS * T[0, 3]:
        return RectifiedPair(K, float(T[0, 3]), offset_px)
    x = T[:3, 3] / baseline_m  # as cameras with x along the baseline see it
    y = np.cross([0.0, 0.0, 1.0], x)
    y /= np.linalg.norm(y)
    return RectifiedPair(K, baseline_m, offset_px, np.stack([x, y, np.cross(x, y)]))


# Of SIFT: wet tissue and paper have little contrast, and a point on an edge has no place along it
POINTS, CONTRAST, EDGE = 1000, 0.015, 8.0
RATIO = 0.8  # of the distances to the nearest and the next descriptor (Lowe 2004)
PEAK_PX = 1.5  # differences of rows this near to the most frequent one are of points that do correspond
MIN_PEAK_SHARE = 0.3  # of all matches, at the most frequent difference; without meaning it is a fifth


def corresponding_points(
    views: tuple[Image, Image],
    pair: RectifiedPair,
    max_rows_px: float,
    disparities_px: tuple[float, float] = (-np.inf, np.inf),
    step: int = 2,
) -> tuple[Array, Array]:
    """Pixels in both grey views of points that look alike (SIFT, Lowe 2004), where their rows differ little.

    They are those of views whose rows correspond, (n, 2) each. Points are found in views reduced by `step`: offsets of
    halved ones agree with those of whole ones to 0.03 px.
    """
    sift = cv2.SIFT.create(POINTS // step, 3, CONTRAST, EDGE)
    found = [sift.detectAndCompute(reduced(one, step), None) for one in views]
    (_, left), (_, right) = found
    if left is None or right is None or len(right) < 2:
        return np.zeros((0, 2)), np.zeros((0, 2))
    left_px, right_px = (step * np.array([one.pt for one in points]) + 0.5 * (step - 1) for points, _ in found)
    if pair.R_rows_left is not None:
        turns = zip((left_px, right_px), (pair.homography(), pair.homography(right=True)), strict=True)
        left_px, right_px = (cv2.perspectiveTransform(px[:, None], H)[:, 0].astype(np.float64) for px, H in turns)
    allowed = np.abs(right_px[None, :, 1] - left_px[:, None, 1]) <= max_rows_px
    disparity_px = left_px[:, None, 0] - right_px[None, :, 0]
    allowed &= (disparity_px > disparities_px[0]) & (disparity_px < disparities_px[1])
    square = np.sum(left**2, 1)[:, None] + np.sum(right**2, 1)[None] - 2.0 * left @ right.T
    square = np.where(allowed, np.maximum(square, 0.0), np.inf)
    nearest, back = np.argmin(square, 1), np.argmin(square, 0)
    index = np.arange(len(left))
    best = square[index, nearest]
    square[index, nearest] = np.inf
    is_match = (back[nearest] == index) & np.isfinite(best) & (best < RATIO**2 * square.min(1))
    return left_px[is_match], right_px[nearest[is_match]]


def agreed_offset(differences_px: Array) -> float | None:
    """The offset in px that most differences, shape (n,), agree on; None where too few do."""
    ordered = np.sort(differences_px)
    inside = np.searchsorted(ordered, ordered + 2.0 * PEAK_PX, "right") - np.arange(len(ordered))
    if inside.max(initial=0) < max(MIN_ROW_POINTS, MIN_PEAK_SHARE * len(ordered)):
        return None
    first = int(np.argmax(inside))
    return median(ordered[first : first + int(inside[first])])


def reduced(image: Image, step: int, how: int = cv2.INTER_AREA) -> Image:
    """An image, shape (h, w), at a `step`-th of its size, by OpenCV's interpolation `how`."""
    size = (max(1, image.shape[1] // step), max(1, image.shape[0] // step))
    return image if step == 1 else np.asarray(cv2.resize(image, size, interpolation=how), np.uint8)


MOST_ROWS_PX = 2  # by which rows may differ
LEAST_LIKENESS, LEAST_LEAD = 0.6, 0.05  # correlation of a match, and how much better than any elsewhere
SAME_PX = 3.0  # what is so near to the best match is the same


def matched_place(views: tuple[Image, Image], at_px: Array, half_px: float, places_px: Array) -> int | None:
    """Which of the right view's places, (n, 2), looks like a pixel of the left one, (2,); None where several do.

    `views` are grey, (h, w), of cameras turned alike, and what is compared reaches `half_px` to every side.
    """
    half = max(3, round(half_px))
    patch = cv2.getRectSubPix(views[0], (2 * half + 1,) * 2, (float(at_px[0]), float(at_px[1])))
    ours = patch.astype(np.float32) - float(patch.mean())
    across, down = np.arange(-half, half + 1), np.arange(-half - MOST_ROWS_PX, half + MOST_ROWS_PX + 1)
    x = (places_px[:, :1] + across).astype(np.float32)
    maps = (np.repeat(y[:, None], len(across), 1).astype(np.float32) for y in (places_px[:, 1:] + down).T)
    rows = [cv2.remap(views[1], x, y, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE) for y in maps]
    around = np.stack(rows, 1).astype(np.float32)  # (n, rows, columns)
    likeness = np.full(len(places_px), -1.0)
    for first in range(2 * MOST_ROWS_PX + 1):
        seen = around[:, first : first + len(across)].reshape(len(places_px), -1)
        theirs = seen - seen.mean(1, keepdims=True)
        scale = np.sqrt(float((ours**2).sum()) * (theirs**2).sum(1)) + 1.0
        likeness = np.maximum(likeness, (theirs @ ours.ravel()) / scale)
    best = int(np.argmax(likeness))
    is_away = np.linalg.norm(places_px - places_px[best], axis=1) > SAME_PX
    lead = likeness[best] - np.max(likeness[is_away], initial=-1.0)
    return best if likeness[best] > LEAST_LIKENESS and lead > LEAST_LEAD else None
