"""Rectified stereo: the pair's geometry, its row offset, semi-global matching, and the plane of most of a scene."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.camera import Camera
from svmdist.least_squares import median, scale_of
from svmdist.profile.settings import StereoSettings
from svmdist.results import Failure
from svmdist.samples import Image, RightView
from svmdist.transforms import Array
from svmdist.vision.colour import to_grey

MATCHED_DISPARITIES = 32  # views are reduced to so many: matching places the surface within a pixel or two
MIN_ROW_POINTS = 40  # points in all these pairs that must agree on an offset

MAX_OFF_AXIS = 0.02
"""How far off the left camera's x axis, over the baseline, a right camera counts as beside it: rows then differ by half
a pixel at a disparity of 25 px. Further off, both views are turned."""
MAX_TURN = 0.7  # the same beyond which it is no such pair: turned by 45 degrees, views share little


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

    def disparity_px(self, left_x_px: float, right_x_px: float) -> float:
        """Disparity of a point seen in both images, as if the principal points were one."""
        return left_x_px - right_x_px - self.offset_px

    def disparity_at(self, depth_m: float) -> float:
        """Disparity in px at a depth: f b / z."""
        return float(self.K[0, 0] * self.baseline_m / depth_m)

    def point(self, left_px: Array, disparity_px: float) -> tuple[Array, Array]:
        """The point of a left pixel (2,) and a disparity, (3,) in m, and its Jacobian by (u, v, d), (3, 3)."""
        fx, fy = self.K[0, 0], self.K[1, 1]
        z = fx * self.baseline_m / disparity_px
        u, v = self.to_rows(left_px)
        x, y = (u - self.K[0, 2]) / fx, (v - self.K[1, 2]) / fy
        p_rows_m = np.array([x * z, y * z, z])
        J = np.zeros((3, 3))
        J[0, 0], J[1, 1] = z / fx, z / fy
        J[:, 2] = -p_rows_m / disparity_px
        if self.R_rows_left is None:
            return p_rows_m, J
        moved = [self.to_rows(left_px + step) - self.to_rows(left_px - step) for step in 0.5 * np.eye(2)]
        J[:, :2] = J[:, :2] @ np.stack(moved, -1)
        return self.R_rows_left.T @ p_rows_m, self.R_rows_left.T @ J

    def depth_m(self, p_camera_m: Array) -> tuple[float, Array]:
        """A point's depth where rows correspond, which its disparity tells, and its derivative by the point, (3,)."""
        along = np.array([0.0, 0.0, 1.0]) if self.R_rows_left is None else self.R_rows_left[2]
        return float(along @ p_camera_m), along

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
    R_rows_left, baseline_m = None, float(np.linalg.norm(T[:3, 3]))
    if np.linalg.norm(T[1:3, 3]) > MAX_TURN * baseline_m:
        return Failure("the right camera is not beside the left one: it is above, below, before or behind it")
    if np.abs(T[1:3, 3]).max() > MAX_OFF_AXIS * T[0, 3]:  # as cameras with x along the baseline see it
        x = T[:3, 3] / baseline_m
        y = np.cross([0.0, 0.0, 1.0], x)
        y /= np.linalg.norm(y)
        R_rows_left = np.stack([x, y, np.cross(x, y)])
    along_m = float(T[0, 3]) if R_rows_left is None else baseline_m
    return RectifiedPair(K, along_m, float(K[0, 2] - right.camera.K[0, 2]), R_rows_left)


DEFAULT = StereoSettings()
# Of SIFT: wet tissue and paper have little contrast, and a point on an edge has no place along it
POINTS, CONTRAST, EDGE = 1000, 0.015, 8.0
RATIO = 0.8  # of the distances to the nearest and the next descriptor (Lowe 2004)
PEAK_PX = 1.5  # differences of rows this near to the most frequent one are of points that do correspond
MIN_PEAK_SHARE = 0.3  # of all matches, at the most frequent difference; without meaning it is a fifth
LEAST_STD_PX = 0.02


@dataclass(frozen=True, slots=True)
class RowOffset:
    """Row in the right view less that in the left one, in px, and its standard deviation."""

    px: float
    std_px: float


def corresponding_points(
    left_grey: Image,
    right_grey: Image,
    max_rows_px: float,
    disparities_px: tuple[float, float] = (-np.inf, np.inf),
    step: int = 2,
) -> tuple[Array, Array]:
    """Pixels in both views, (n, 2) each, of points that look alike (SIFT, Lowe 2004) and differ little in their rows.

    In views that are reduced by `step`; offsets of halved ones agree with those of whole ones to 0.03 px.
    """
    sift = cv2.SIFT.create(POINTS // step, 3, CONTRAST, EDGE)
    at_left, left = sift.detectAndCompute(_reduced(left_grey, step), None)
    at_right, right = sift.detectAndCompute(_reduced(right_grey, step), None)
    if left is None or right is None or len(at_right) < 2:
        return np.zeros((0, 2)), np.zeros((0, 2))
    left_px, right_px = (
        step * np.array([point.pt for point in points]) + 0.5 * (step - 1) for points in (at_left, at_right)
    )
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


def agreed_offset(differences_px: Array) -> RowOffset | None:
    """The offset that most differences, shape (n,), agree on; None where too few do."""
    if len(differences_px) < MIN_ROW_POINTS:
        return None
    ordered = np.sort(differences_px)
    inside = np.searchsorted(ordered, ordered + 2.0 * PEAK_PX, "right") - np.arange(len(ordered))
    first = int(np.argmax(inside))
    peak = ordered[first : first + int(inside[first])]
    if len(peak) < max(MIN_ROW_POINTS, MIN_PEAK_SHARE * len(ordered)):
        return None
    middle_px = median(peak)
    # Points of one texture err alike: a tenth of them count.
    std_px = float(np.hypot(LEAST_STD_PX, scale_of(peak - middle_px) / np.sqrt(0.1 * len(peak))))
    return RowOffset(middle_px, std_px)


SPECKLE_PX2 = 100  # patches of matches that stand alone up to this area in the image as recorded are mistakes


@dataclass(frozen=True, slots=True)
class Matches:
    """Disparities on a grid of pixels of the left image: columns (w,), rows (h,), values (h, w), all in px.

    A value stands for a cell of `step_px` squared about its pixel; it is NaN outside the region, which `is_core`,
    shape (h, w), holds, and where nothing matched.
    """

    columns_px: Array
    rows_px: Array
    disparity_px: Array
    is_core: NDArray[np.bool_]
    step_px: int


def match_region(
    left_grey: Image, right_grey: Image, core: Image, min_px: int, max_px: int, settings: StereoSettings
) -> Matches | None:
    """Matches in the region's core, on images reduced until the search spans the settings' number of disparities."""
    # Matching costs most of all; only the region's rows, and the columns that its matches can lie in, are needed.
    x, y, width, height = cv2.boundingRect(core)
    step = max(1, round((max_px - min_px) / MATCHED_DISPARITIES))
    low, high = int(np.floor(min_px / step)), int(np.ceil(max_px / step))
    least_px = step * _least_width_px(low, high, settings.block_px)
    left_px = max(0, min(x - max(max_px, 0), core.shape[1] - least_px))
    right_px = min(max(x + width - min(min_px, 0), left_px + least_px), core.shape[1])
    shape = (height // step, (right_px - left_px) // step)
    if min(shape) == 0:
        return None
    window = np.s_[y : y + step * shape[0], left_px : left_px + step * shape[1]]
    left, right = (_reduced(image[window], step) for image in (left_grey, right_grey))
    disparity_px = np.full(left.shape, np.nan)
    if left.shape[1] >= _least_width_px(low, high, settings.block_px):
        rules = (64, 2, 3, max(1, SPECKLE_PX2 // step**2))
        disparity_px = step * _matched(left, right, low, high, settings.block_px, rules)
    middle = (step - 1) // 2
    is_core = core[window][middle::step, middle::step] > 0
    columns_px = left_px + step * np.arange(shape[1], dtype=np.float64) + 0.5 * (step - 1)
    rows_px = y + step * np.arange(shape[0], dtype=np.float64) + 0.5 * (step - 1)
    return Matches(columns_px, rows_px, np.where(is_core, disparity_px, np.nan), is_core, step)


def _matched(
    left: Image, right: Image, min_px: int, max_px: int, block_px: int, rules: tuple[int, int, int, int]
) -> Array:
    """Disparity of every left pixel by semi-global matching, shape (h, w) in px; NaN where there is none.

    The rules are the smoothness over the block's area, the largest difference in px of a match from right to left,
    by how many percent the best match is better, and the area in px² of patches that are left out.
    """
    smoothness, max_difference_px, uniqueness, speckle_px2 = rules
    matcher = cv2.StereoSGBM.create(
        minDisparity=min_px,
        numDisparities=16 * int(np.ceil((max_px - min_px) / 16)),
        blockSize=block_px,
        P1=8 * block_px**2,
        P2=smoothness * block_px**2,
        disp12MaxDiff=max_difference_px,
        uniquenessRatio=uniqueness,
        speckleWindowSize=speckle_px2,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    fixed_point = np.asarray(matcher.compute(left, right), np.float64)
    return np.where(fixed_point >= 16 * min_px, fixed_point / 16.0, np.nan)


def _least_width_px(min_px: int, max_px: int, block_px: int) -> int:
    """Width below which OpenCV's matcher has no column with all disparities in it, and fails."""
    return max(abs(min_px), abs(max_px)) + (max_px - min_px) + 16 + 2 * block_px


def _reduced(image: Image, step: int) -> Image:
    size = (image.shape[1] // step, image.shape[0] // step)
    return image if step == 1 else np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


NEAREST_M, FURTHEST_M = 0.04, 0.5  # where tissue lies in front of an endoscope, with room on both sides
WIDTH_PX = 640  # images are matched at about this width: a plane needs no more
MAX_DISPARITIES = 256
ROW_OFFSETS_PX = (-2, -1, 0, 1, 2)  # rows of a pair that is called rectified were found 1.5 px apart
SAMPLE_COUNT = 20_000
INLIER_PX = 1.5
MIN_INLIER_FRACTION, MIN_MATCHED_FRACTION = 0.4, 0.1
TRIALS = 200
MAX_RELIEF = 0.2  # of tissue off its plane, over the distance


@dataclass(frozen=True, slots=True)
class StereoPlane:
    """A plane n · p = -d: unit normal (3,), d in m, what stands off it, and by how much right rows are above left."""

    normal: Array
    distance_m: float
    surface_std_m: float
    row_offset_px: int


def fit_plane(left_bgr: Image, right_bgr: Image, K: Array, baseline_m: float) -> StereoPlane | None:
    """The plane of a rectified pair, by RANSAC and Geman and McClure's loss on disparities; None where none fits."""
    step = max(1, round(left_bgr.shape[1] / WIDTH_PX))
    left, right = _reduced(to_grey(left_bgr), step), _reduced(to_grey(right_bgr), step)
    fb_px_m = float(K[0, 0]) / step * baseline_m
    low = max(1, int(fb_px_m / FURTHEST_M))
    high = min(int(np.ceil(fb_px_m / NEAREST_M)), low + MAX_DISPARITIES, left.shape[1] // 2)
    if high - low < 3:
        return None
    raised = [np.roll(right, offset, 0) for offset in ROW_OFFSETS_PX]
    found = [_matched(left, one, low, high, 7, (32, 1, 10, 100)) for one in raised]
    best = int(np.argmax([np.isfinite(one).sum() for one in found]))
    disparity_px = found[best]
    rows, columns = np.nonzero(np.isfinite(disparity_px))
    if len(rows) < MIN_MATCHED_FRACTION * disparity_px.size:
        return None
    rng = np.random.default_rng(0)
    kept = rng.choice(len(rows), min(len(rows), SAMPLE_COUNT), replace=False)
    rows, columns = rows[kept], columns[kept]
    x, y = (columns * step - K[0, 2]) / K[0, 0], (rows * step - K[1, 2]) / K[1, 1]
    rays = np.column_stack([x, y, np.ones(len(rows))])
    values = disparity_px[rows, columns]
    q = _robust_plane(rays, values, rng)
    off_px = rays @ q - values
    on_it = np.abs(off_px) < INLIER_PX
    normal_length = float(np.linalg.norm(q))
    if on_it.mean() < MIN_INLIER_FRACTION or q[2] <= 0.0:
        return None
    distance_m = fb_px_m / normal_length
    # A residual of disparity over the depth's slope, at the scene's middle: δz = z² δd / (f b). Not only of those on
    # the plane: what stands off it is what a tool works at; what is farther off than that is matched wrongly.
    near_px = np.abs(off_px)[np.abs(off_px) < MAX_RELIEF * values]
    surface_std_m = distance_m**2 / fb_px_m * float(np.percentile(near_px, 68.0))
    return StereoPlane(-q / normal_length, distance_m, surface_std_m, ROW_OFFSETS_PX[best] * step)


def _robust_plane(rays: Array, values: Array, rng: np.random.Generator) -> Array:
    """q, shape (3,), with values = rays · q for most of them."""
    best: Array = np.zeros(3)
    least = np.inf
    for _ in range(TRIALS):
        three = rng.choice(len(values), 3, replace=False)
        if abs(np.linalg.det(rays[three])) < 1e-6:
            continue
        q = np.asarray(np.linalg.solve(rays[three], values[three]), np.float64)
        cost = float(np.minimum(np.abs(rays @ q - values), 2 * INLIER_PX).sum())
        if cost < least:
            best, least = q, cost
    for _ in range(10):
        weights = (1.0 + ((rays @ best - values) / INLIER_PX) ** 2) ** -2
        weighted = rays * weights[:, None]
        best = np.asarray(np.linalg.solve(weighted.T @ rays, weighted.T @ values), np.float64)
    return best
