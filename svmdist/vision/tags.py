"""AprilTags in an image: corners to sub-pixels, poses that these allow, the plate around, and the pattern laid over.

The pattern has residuals in every pixel, and derivatives by pose, blur and light.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.least_squares import NormalEquations, huber_weights, scale_of
from svmdist.profile.settings import TagSettings
from svmdist.samples import Image
from svmdist.transforms import Array, cross, make_transform

CELL_SAMPLES = 6  # along a cell: of 47 small tags in photographs 44 are found, 41 with OpenCV's 4
CELL_MARGIN = 0.2  # share of a cell at each of its edges that is left out there
CORNER_WINDOW_CELLS = 0.6  # half the window at a corner: black and white are a cell wide beside an edge
MIN_EDGE_REACH_PX = 2.0  # the same in px, at least: a rough corner is off by a pixel or two
EDGE_STEPS = 2  # how often edges are measured anew along the corners that they gave

SAMPLE_PX = 0.25  # between samples across an edge
MIN_PROFILES = 6  # across each edge, of however small a tag
PART = 0.9  # of each side, in its middle, that is measured
LINE_STEPS, HUBER, MIN_SCALE_PX = 3, 1.5, 0.05


def refine_corners(image_grey: Image, corners_px: Array, cell_count: int) -> Array:
    """Corners (4, 2) of a roughly found black square of so many cells, moved to where its edges meet."""
    found_px = refined_px = corners_px
    # A slanting tag is narrow in one direction: what is a cell wide across a side follows from the sides next to it.
    side_px = np.linalg.norm(np.roll(found_px, -1, 0) - found_px, axis=1)
    cell_px = 0.5 * (np.roll(side_px, 1) + np.roll(side_px, -1)) / cell_count
    reach_px = np.maximum(CORNER_WINDOW_CELLS * cell_px, MIN_EDGE_REACH_PX)
    for _ in range(EDGE_STEPS):
        lines = _edge_lines(image_grey, refined_px, reach_px)
        if lines is None:
            return found_px
        # Side i runs from corner i to the next one: corner i lies on the sides i - 1 and i.
        meeting = cross(np.roll(lines, 1, 0), lines)
        if np.any(np.abs(meeting[:, 2]) < 1e-3):
            return found_px
        refined_px = meeting[:, :2] / meeting[:, 2:]
        if np.linalg.norm(refined_px - found_px, axis=1).max() > 2.0 * max(cell_px.max(), MIN_EDGE_REACH_PX):
            return found_px
    return refined_px


def _edge_lines(image_grey: Image, corners_px: Array, reach_px: Array) -> Array | None:
    """Lines n · x + c = 0 along the four sides, shape (4, 3), of unit normals; None where a side has no edge."""
    along_px = np.roll(corners_px, -1, 0) - corners_px
    length_px = np.linalg.norm(along_px, axis=1, keepdims=True)
    if not length_px.min() > 1.0:
        return None
    outward = along_px[:, ::-1] * [1.0, -1.0] / length_px
    if float(outward[0] @ (corners_px[0] - corners_px.mean(0))) < 0.0:
        outward = -outward
    count = max(MIN_PROFILES, int(np.ceil(float(length_px.max()))))
    # Near a corner the neighbouring edge bends the profile.
    at = np.linspace(0.5 - 0.5 * PART, 0.5 + 0.5 * PART, count)
    samples = 2 * int(np.ceil(float(reach_px.max()) / SAMPLE_PX)) + 3
    offset_px = np.linspace(-1.0, 1.0, samples) * reach_px[:, None]
    feet_px = corners_px[:, None] + at[:, None] * along_px[:, None]
    # Whole levels would round what lies between pixels; only what the edges reach is converted.
    x, y = (feet_px[..., axis, None] + offset_px[:, None] * outward[:, axis, None, None] for axis in (0, 1))
    x0, y0 = max(int(np.floor(x.min())), 0), max(int(np.floor(y.min())), 0)
    window = image_grey[y0 : max(int(y.max()) + 3, y0), x0 : max(int(x.max()) + 3, x0)].astype(np.float32)
    if window.size == 0:
        return None
    x, y = ((at_px - first).reshape(4 * count, samples).astype(np.float32) for at_px, first in ((x, x0), (y, y0)))
    brightness = cv2.remap(window, x, y, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE)
    # Black inside, white outside: what falls outward is an edge of something else.
    slope = np.maximum(brightness[:, 2:] - brightness[:, :-2], 0.0).astype(np.float64).reshape(4, count, -1)
    # The fourth power leaves out what changes slowly beside the edge, and is still smooth between samples.
    slope = slope**4
    weight = slope.sum(2)
    middle_px = np.einsum("ins,is->in", slope, offset_px[:, 1:-1]) / np.maximum(weight, 1e-9)
    # A profile that is much steeper than the others shows something else, and says no more than they do.
    weight = np.minimum(weight, np.median(weight, 1, keepdims=True))
    if np.any(weight.sum(1) < 1.0):
        return None
    return _lines(feet_px + middle_px[..., None] * outward[:, None], weight)


def _lines(points_px: Array, weight: Array) -> Array:
    """Lines n · x + c = 0 through points, shape (4, n, 2), with weights (4, n), by Huber's: (n, c), shape (4, 3)."""
    middle_px = points_px.mean((0, 1))
    x, y = np.moveaxis(points_px - middle_px, -1, 0)
    robust: Array = np.ones_like(weight)
    for _ in range(LINE_STEPS):
        share = weight * robust
        share = share / share.sum(1, keepdims=True)
        at_x, at_y = (np.sum(share * value, 1, keepdims=True) for value in (x, y))
        dx, dy = x - at_x, y - at_y
        xx, yy, xy = (np.sum(share * a * b, 1, keepdims=True) for a, b in ((dx, dx), (dy, dy), (dx, dy)))
        # The direction of largest scatter of a 2 x 2 covariance, turned by a right angle.
        angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
        nx, ny = -np.sin(angle), np.cos(angle)
        distance_px = nx * dx + ny * dy
        scale_px = 1.4826 * np.median(np.abs(distance_px), 1, keepdims=True)
        robust = huber_weights(distance_px, np.maximum(HUBER * scale_px, MIN_SCALE_PX)) ** 2
    offset_px = -nx * (at_x + middle_px[0]) - ny * (at_y + middle_px[1])
    return np.concatenate([nx, ny, offset_px], 1)


# A code of 4 x 4 cells is too short to correct as many bits: every sixth image without one showed some tag of 16h5
LONG_CODE_CELLS, SHORT_CODE_RATE = 5, 0.6


def tag_dictionary(family: str) -> cv2.aruco.Dictionary:
    """The tags of a family, `36h11` and the like."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_APRILTAG_{family}"))


def find_tags(image_grey: Image, family: str, settings: TagSettings) -> dict[int, Array]:
    """Corners, (4, 2) in px, of a family's tags by number: upper left first, clockwise as one reads; the largest."""
    dictionary, parameters = tag_dictionary(family), cv2.aruco.DetectorParameters()
    is_long = dictionary.markerSize >= LONG_CODE_CELLS
    parameters.errorCorrectionRate = min(settings.error_correction_rate, 1.0 if is_long else SHORT_CODE_RATE)
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    parameters.perspectiveRemovePixelPerCell = CELL_SAMPLES
    parameters.perspectiveRemoveIgnoredMarginPerCell = CELL_MARGIN
    # OpenCV takes the smallest perimeter relative to the image's longer side.
    parameters.minMarkerPerimeterRate = 4.0 * settings.min_side_px / max(image_grey.shape)
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(image_grey)
    cell_count = dictionary.markerSize + 2
    refined = [refine_corners(image_grey, np.asarray(seen, np.float64).reshape(4, 2), cell_count) for seen in corners]
    numbered = zip(() if ids is None else map(int, ids.ravel()), refined, strict=True)
    return dict(sorted(numbered, key=lambda tag: cv2.contourArea(tag[1].astype(np.float32))))


def square_corners_m(size_m: float) -> Array:
    """The tag's corners in its frame, shape (4, 3), in the order of `find_tags`."""
    h = size_m / 2.0
    return np.array([[-h, h, 0.0], [h, h, 0.0], [h, -h, 0.0], [-h, -h, 0.0]])


def pose_candidates(corners_px: Array, size_m: float, K: Array, D: Array) -> list[Array]:
    """Both poses that four corners allow, shape (4, 4) each, the better one first (Collins and Bartoli 2014)."""
    seen = (np.ascontiguousarray(corners_px), K, D if len(D) else None)
    _, rotations, translations, _ = cv2.solvePnPGeneric(square_corners_m(size_m), *seen, flags=cv2.SOLVEPNP_IPPE_SQUARE)
    found = zip(rotations, translations, strict=True)
    poses = [make_transform(cv2.Rodrigues(turn)[0], np.asarray(place).ravel()) for turn, place in found]
    return [T for T in poses if np.all(np.isfinite(T)) and T[2, 3] > 0.0]


def tag_plate(corners_px: Array, shape: tuple[int, ...], settings: TagSettings) -> Image:
    """Mask, of `shape` (h, w), of the plate around a tag with these corners, shape (4, 2)."""
    middle_px = corners_px.mean(0)
    plate_px = middle_px + settings.plate_ratio * (corners_px - middle_px)
    mask = np.zeros(shape, np.uint8)
    cv2.fillConvexPoly(mask, np.round(plate_px).astype(np.int32), 255)
    return mask


MARGIN_CELLS = 0.6  # of the white margin that is compared; what lies behind shines into the rest
BLUR_STARTS_PX = (0.8, 1.6, 3.2)  # of the image's blur, the best one starts the search: sharp, soft, moving
EDGE_SLOPE = 0.2  # of the pattern's largest: residuals on edges give the standard deviation
MIN_PIXELS = 50  # pixels on the tag below which there is no pose
MIN_CONTRAST = 4.0  # grey levels between black and white below which there is no pattern to compare

TEXTURE_SAMPLES = 16  # texture samples per cell: three for each pixel of a tag that is seen 40 px wide
PAD_CELLS = 2  # of white around the black square. What is further off is as white as its rim
SHEET_COLUMNS = 64
# Textures are made and kept for blurs at powers of this ratio. Between them brightness follows the derivative by the
# blur, which is right within 1e-5 of the contrast.
BLUR_RATIO = 1.01
KEPT_TEXTURES = 48  # of 0.6 MB each: tags from 30 to 60 px wide at one blur of the image need no more
SMALLEST_BLUR_CELLS = 0.3 / TEXTURE_SAMPLES


class TagPattern:
    """The tag as it is printed, white 1 and black 0, on its plane."""

    def __init__(self, family: str, tag_id: int, size_m: float) -> None:
        dictionary = tag_dictionary(family)
        self.size_m = size_m
        self.cell_count = dictionary.markerSize + 2
        cells = cv2.aruco.generateImageMarker(dictionary, tag_id, self.cell_count)
        self._ink: NDArray[np.float32] = (1.0 - cells / 255.0).astype(np.float32)
        self._texture = lru_cache(KEPT_TEXTURES)(self._make_texture)

    def sample(self, xy_cells: Array, blur_cells: float) -> Array:
        """Brightness and derivatives by x, y, blur, (4, n), under a blur in cells, at points (2, n) in cells, y up."""
        blur_cells = max(blur_cells, SMALLEST_BLUR_CELLS)
        level = round(math.log(blur_cells) / math.log(BLUR_RATIO))
        # OpenCV remaps images of at most 32767 columns: the points go in as rows of a sheet.
        count = xy_cells.shape[1]
        sheet = np.zeros((2, -(-count // SHEET_COLUMNS) * SHEET_COLUMNS), np.float32)
        middle = (self.cell_count / 2.0 + PAD_CELLS) * TEXTURE_SAMPLES - 0.5
        sheet[0, :count] = middle + TEXTURE_SAMPLES * xy_cells[0]
        sheet[1, :count] = middle - TEXTURE_SAMPLES * xy_cells[1]
        columns, rows = sheet.reshape(2, -1, SHEET_COLUMNS)
        values = cv2.remap(self._texture(level), columns, rows, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE)
        sampled = np.array(values.reshape(-1, 4)[:count].T, np.float64, order="C")
        sampled[0] += (blur_cells - BLUR_RATIO**level) * sampled[3]
        return sampled

    def _make_texture(self, level: int) -> NDArray[np.float32]:
        """Brightness and its three derivatives, shape (h, w, 4), under one of the blurs that textures are made for."""
        blur_cells = BLUR_RATIO**level
        place = (np.arange((self.cell_count + 2 * PAD_CELLS) * TEXTURE_SAMPLES) + 0.5) / TEXTURE_SAMPLES - PAD_CELLS
        u = (place[:, None] - np.arange(self.cell_count + 1)) / blur_cells
        density = np.exp(-0.5 * u * u) / (math.sqrt(2.0 * math.pi) * blur_cells)
        steps = (np.interp(u, NORMAL_AT, NORMAL_INTEGRAL), density, -u * density)
        # How much of each sample is each cell's, and its derivatives, (samples, cells) each.
        along, by_place, by_blur = ((s[:, :-1] - s[:, 1:]).astype(np.float32) for s in steps)
        # A blurred cell is the product of a profile along the rows and one along the columns; y points up.
        ink = self._ink
        across = ink @ along.T
        planes = (
            1.0 - along @ across,
            -(along @ (ink @ by_place.T)),
            by_place @ across,
            -(by_blur @ across) - along @ (ink @ by_blur.T),
        )
        return np.asarray(cv2.merge(planes), np.float32)


# The normal distribution's integral, right within 1e-7 between its entries
NORMAL_AT = np.linspace(-6.0, 6.0, 12001)
NORMAL_INTEGRAL = np.array([0.5 + 0.5 * math.erf(u / math.sqrt(2.0)) for u in NORMAL_AT])

GREY = 100.0  # levels that count as one in a step of brightness or contrast: its elements are then alike
RIDGE = 1e-9 * np.eye(9)
FADE_CELLS = 0.2  # from the rim over which pixels count less: the loss does not jump when they leave
TINY_LEVEL = 1e-6  # in grey levels; keeps weights finite on an image that the pattern fits exactly


@dataclass(frozen=True, slots=True)
class TagPixels:
    """n pixels around a tag: brightness, shape (n,), rays in the camera frame, shape (3, n), and the focal length."""

    brightness: Array
    rays: Array
    focal_px: float

    def thinned(self, count: int) -> TagPixels:
        """About so many of them, or up to twice as many, evenly spread."""
        every = max(1, len(self.brightness) // count)
        return TagPixels(self.brightness[::every], np.ascontiguousarray(self.rays[:, ::every]), self.focal_px)


@dataclass(frozen=True, slots=True)
class Overlay:
    """How the pattern is laid over an image: pose, blur, and the grey levels offset + contrast · pattern."""

    T_camera_tag: Array
    blur_px: float
    offset: float
    contrast: float


@dataclass(frozen=True, slots=True)
class Loss:
    """A robust loss of residuals in grey levels: Huber's, or Tukey's biweight, beyond `limit`."""

    limit: float
    is_biweight: bool

    def __call__(self, residual: Array, share: Array) -> tuple[Array, float]:
        """Weights, shape (n,), and the mean loss, of pixels that count by their share, shape (n,)."""
        if self.is_biweight:
            inlier = np.maximum(0.0, 1.0 - (residual / self.limit) ** 2)
            weight = share * inlier * inlier
            return weight, self.limit**2 / 6.0 * (1.0 - float(weight @ inlier) / float(share.sum()))
        within = huber_weights(residual, self.limit)
        weight = share * within
        return weight, float(weight @ (residual * residual * (1.0 - 0.5 * within))) / float(share.sum())


@dataclass(frozen=True, slots=True)
class LaidPattern(NormalEquations):
    """The pattern laid over n pixels: residual (n,), weights (n,), and the residual's derivatives (9, n).

    These are by the pose in the tag's frame, in tag sides and rad, by the blur in px, and by offset and contrast in
    GREY. `xy_cells` are the pixels' feet, (2, n), and `slope` is the pattern's there by x and by y, (n,).
    """

    overlay: Overlay
    residual: Array
    derivatives: Array
    weight: Array
    xy_cells: Array
    slope: tuple[Array, Array]
    clusters_across: int

    @property
    def std(self) -> float:
        """The residual's standard deviation on the pattern's edges, in grey levels."""
        return _std_on_edges(self.residual, *self.slope)

    @property
    def misfit(self) -> float:
        """The root mean square of the residual, with its weights, over the contrast."""
        return math.sqrt(self.variance) / self.overlay.contrast

    @property
    def variance(self) -> float:
        """The mean square of the residual, with its weights."""
        return float((self.weight * self.residual) @ self.residual) / max(len(self.residual) - 9, 1)

    def covariance(self, cluster_inflation: float) -> Array:
        """Covariance of the parameters (9, 9), by clusters of pixels (White 1980; Liang and Zeger 1986)."""
        inverse = np.linalg.inv(self.information)
        weighted = self.weight * self.residual
        # Clusters have a cell's size and lie about the cells' corners, where no edge divides them.
        column, row = (self.xy_cells + 0.5 * self.clusters_across).astype(np.int64)
        cell = row * self.clusters_across + column
        scores = np.stack([np.bincount(cell, weighted * d) for d in self.derivatives])
        count = int(np.count_nonzero(np.bincount(cell)))
        spread = scores @ scores.T * (count / max(count - 9, 1))
        return np.asarray(cluster_inflation * (inverse @ spread @ inverse) + self.variance * inverse)


def start_overlay(pixels: TagPixels, T_camera_tag: Array, pattern: TagPattern) -> tuple[Overlay, float] | None:
    """Blur, brightness and contrast that fit best at a first pose, and the deviation; None beside the tag."""
    on_tag = _pixels_on_tag(pixels, T_camera_tag, pattern)
    if on_tag is None:
        return None
    recorded, xy_cells, _, _ = on_tag
    px_per_cell = _px_per_cell(pixels, T_camera_tag, pattern)
    brightness = recorded - recorded.mean()
    starts = []
    for blur_px in BLUR_STARTS_PX:
        model, by_x, by_y, _ = pattern.sample(xy_cells, blur_px / px_per_cell)
        centred = model - model.mean()
        contrast = float(centred @ brightness) / max(float(centred @ centred), 1e-12)
        residual = brightness - contrast * centred
        overlay = Overlay(T_camera_tag, blur_px, float(recorded.mean() - contrast * model.mean()), contrast)
        starts.append((float(residual @ residual), overlay, _std_on_edges(residual, by_x, by_y)))
    return min(starts, key=lambda start: start[0])[1:]


def lay_pattern(pixels: TagPixels, overlay: Overlay, pattern: TagPattern, loss: Loss) -> LaidPattern | None:
    """Residual and derivatives of the pattern laid so; None where it is off the pixels or has no contrast."""
    T, contrast = overlay.T_camera_tag, overlay.contrast
    on_tag = _pixels_on_tag(pixels, T, pattern)
    if on_tag is None or not contrast >= MIN_CONTRAST:
        return None
    recorded, xy_cells, slope, share = on_tag
    px_per_cell = _px_per_cell(pixels, T, pattern)
    model, by_x, by_y, by_blur = pattern.sample(xy_cells, overlay.blur_px / px_per_cell)
    residual = recorded - overlay.offset - contrast * model

    # A ray meets the plane z = 0 at (x, y). A tag that moves by m = δp + δθ x (x, y, 0) moves the foot, in its own
    # frame, by slope · m_z - (m_x, m_y).
    x, y = xy_cells / pattern.cell_count
    per_side = contrast * pattern.cell_count
    J = np.empty((9, len(residual)))
    J[0], J[1] = -per_side * by_x, -per_side * by_y
    J[2] = -(J[0] * slope[0] + J[1] * slope[1])
    J[3], J[4], J[5] = y * J[2], -x * J[2], x * J[1] - y * J[0]
    J[6], J[7], J[8] = contrast / px_per_cell * by_blur, GREY, GREY * model

    weight, cost = loss(residual, share)
    weighted = weight * J
    # The ridge keeps the blur's row regular where an image is sharper than any blur is seen.
    information = weighted @ J.T + RIDGE
    laid = (overlay, residual, J, weight, xy_cells, (by_x, by_y), pattern.cell_count + 3 + 2 * int(MARGIN_CELLS))
    return LaidPattern(cost, weighted @ residual, information, *laid)


def _std_on_edges(residual: Array, by_x: Array, by_y: Array) -> float:
    steepness = by_x * by_x + by_y * by_y
    return scale_of(residual[steepness > EDGE_SLOPE**2 * steepness.max()]) + TINY_LEVEL


def _pixels_on_tag(
    pixels: TagPixels, T_camera_tag: Array, pattern: TagPattern
) -> tuple[Array, Array, Array, Array] | None:
    """Brightness (n,), feet (2, n), their slope by depth (2, n), shares (n,) of pixels on the tag; None of too few."""
    if T_camera_tag[2, 3] <= 0.0:
        return None
    R_tag_camera = T_camera_tag[:3, :3].T
    t_cells = R_tag_camera @ T_camera_tag[:3, 3] * (pattern.cell_count / pattern.size_m)
    rays = R_tag_camera @ pixels.rays
    depth_cells = t_cells[2] / rays[2]
    x, y = rays[0] * depth_cells - t_cells[0], rays[1] * depth_cells - t_cells[1]
    inward_cells = pattern.cell_count / 2.0 + MARGIN_CELLS - np.maximum(np.abs(x), np.abs(y))
    inside = np.flatnonzero(inward_cells > 0.0)
    if len(inside) < MIN_PIXELS:
        return None
    share = np.minimum(1.0, inward_cells[inside] / FADE_CELLS)
    xy_cells = np.stack([x[inside], y[inside]])
    slope = (xy_cells + t_cells[:2, None]) / t_cells[2]
    return pixels.brightness[inside], xy_cells, slope, share


def _px_per_cell(pixels: TagPixels, T_camera_tag: Array, pattern: TagPattern) -> float:
    return pattern.size_m / pattern.cell_count * pixels.focal_px / float(T_camera_tag[2, 3])
