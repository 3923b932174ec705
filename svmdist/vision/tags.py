"""AprilTags in an image: their corners to sub-pixels, the poses that four corners allow, and the plate around them."""

from __future__ import annotations

from functools import lru_cache
from threading import get_ident

import cv2
import numpy as np

from svmdist.least_squares import huber_weights
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
    # OpenCV takes the smallest perimeter relative to the image's longer side.
    min_perimeter = 4.0 * settings.min_side_px / max(image_grey.shape)
    detector = _detector(family, settings.error_correction_rate, min_perimeter, get_ident())
    corners, ids, _ = detector.detectMarkers(image_grey)
    cell_count = detector.getDictionary().markerSize + 2
    refined = [refine_corners(image_grey, np.asarray(seen, np.float64).reshape(4, 2), cell_count) for seen in corners]
    numbered = zip(() if ids is None else map(int, ids.ravel()), refined, strict=True)
    return dict(sorted(numbered, key=lambda tag: cv2.contourArea(tag[1].astype(np.float32))))


@lru_cache(maxsize=32)
def _detector(family: str, error_correction_rate: float, min_perimeter: float, _thread: int) -> cv2.aruco.ArucoDetector:
    """The detector of a family; each thread has its own, since it keeps state while it works."""
    dictionary = tag_dictionary(family)
    if dictionary.markerSize < LONG_CODE_CELLS:
        error_correction_rate = min(error_correction_rate, SHORT_CODE_RATE)
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    parameters.errorCorrectionRate = error_correction_rate
    parameters.perspectiveRemovePixelPerCell = CELL_SAMPLES
    parameters.perspectiveRemoveIgnoredMarginPerCell = CELL_MARGIN
    parameters.minMarkerPerimeterRate = min_perimeter
    return cv2.aruco.ArucoDetector(dictionary, parameters)


def square_corners_m(size_m: float) -> Array:
    """The tag's corners in its frame, shape (4, 3), in the order of `find_tags`."""
    h = size_m / 2.0
    return np.array([[-h, h, 0.0], [h, h, 0.0], [h, -h, 0.0], [-h, -h, 0.0]])


def pose_candidates(corners_px: Array, size_m: float, K: Array, D: Array) -> list[Array]:
    """Both poses that four corners allow, shape (4, 4) each, the better one first (Collins and Bartoli 2014)."""
    seen = (np.ascontiguousarray(corners_px), K, D if len(D) else None)
    _, rotations, translations, _ = cv2.solvePnPGeneric(square_corners_m(size_m), *seen, flags=cv2.SOLVEPNP_IPPE_SQUARE)
    poses = []
    for rotation, translation in zip(rotations, translations, strict=True):
        T = make_transform(cv2.Rodrigues(rotation)[0], np.asarray(translation).ravel())
        if np.all(np.isfinite(T)) and T[2, 3] > 0.0:
            poses.append(T)
    return poses


def tag_plate(corners_px: Array, shape: tuple[int, ...], settings: TagSettings) -> Image:
    """Mask, of `shape` (h, w), of the plate around a tag with these corners, shape (4, 2)."""
    middle_px = corners_px.mean(0)
    plate_px = middle_px + settings.plate_ratio * (corners_px - middle_px)
    mask = np.zeros(shape, np.uint8)
    cv2.fillConvexPoly(mask, np.round(plate_px).astype(np.int32), 255)
    return mask
