"""The paper's static virtual marker: its pattern, ORB features and matching, and the homography (sec. III.B, C)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.profile.settings import MarkerSettings
from svmdist.samples import Image
from svmdist.transforms import Array

REFIT_THRESHOLDS_PX = (1.5, 1.0, 0.7, 0.5, 0.3)  # the fine pyramid levels agree best and should decide
REFIT_MIN_COUNT = 20  # fewer matches are not fitted again: five times those that determine a homography

CELL_COUNT = 12  # cells along a side: margin, frame, eight of data, frame, margin
# Eight rows of eight cells, 1 is white. Found by random search: half the cells are white, no run along a row or column
# is longer than three cells, each quarter turn changes 32 cells, and windows of 4 x 4 cells, about an ORB patch, differ
# from one another under every quarter turn.
DATA_ROWS = (0b00100011, 0b11010100, 0b10110111, 0b00111001, 0b11100100, 0b00011011, 0b01011000, 0b11100100)
# Standard deviation of a blur of the cells' edges. Perfectly sharp corners give neighbouring pixels the same FAST
# score, and its non-maximum suppression then drops them all at full resolution.
EDGE_SOFTNESS_PX = 1.0


@lru_cache(maxsize=8)
def marker_pattern(size_px: int) -> Image:
    """The marker as a grey image, shape (size_px, size_px), read-only: every frame has the same."""
    cells = np.full((CELL_COUNT, CELL_COUNT), 255, np.uint8)
    cells[1:-1, 1:-1] = 0
    cells[2:-2, 2:-2] = 255 * np.unpackbits(np.array(DATA_ROWS, np.uint8)[:, None], axis=1)
    index = np.arange(size_px) * CELL_COUNT // size_px
    pattern = np.asarray(cv2.GaussianBlur(cells[np.ix_(index, index)], (0, 0), EDGE_SOFTNESS_PX), np.uint8)
    pattern.setflags(write=False)
    return pattern


def paste_marker(image_bgr: Image, centre_px: Array, size_px: int, margin_px: int) -> tuple[Image, tuple[int, int]]:
    """A window with the marker in its middle, about `centre_px` (x, y, rounded), and the window's top left pixel.

    Its margin keeps a marker at the image's border far enough from the edge for ORB: the image's edge is repeated.
    """
    height, width = image_bgr.shape[:2]
    # The marker's middle is brought back to the image.
    first_px = np.rint(centre_px - (size_px - 1) / 2.0).astype(int)
    x0, y0 = (first_px.clip(-(size_px // 2), np.array([width, height]) - size_px // 2) - margin_px).tolist()
    x, y = (first + np.arange(size_px + 2 * margin_px) for first in (x0, y0))
    window = image_bgr[y.clip(0, height - 1)[:, None], x.clip(0, width - 1)]
    window[margin_px:-margin_px, margin_px:-margin_px] = marker_pattern(size_px)[..., None]
    return window, (x0, y0)


def padded_template(size_px: int, margin_px: int) -> Image:
    """The marker on a grey ground, shape (size_px + 2 margin_px,) squared: ORB skips corners near borders."""
    return np.pad(marker_pattern(size_px), margin_px, constant_values=127)


EDGE_MARGIN_PX = 31  # ORB finds no keypoint closer to the border of a pyramid level than its `edgeThreshold`
SCALE_FACTOR, MAX_LEVELS = 1.2, 8  # of ORB's pyramid, as in Rublee 2011, sec. 6.1


@dataclass(frozen=True, slots=True)
class Features:
    """Keypoints, (n, 2) in px, and ORB descriptors, (n, 32) bytes: the 256 binary tests of eqs. (13)–(16)."""

    points_px: Array
    descriptors: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.points_px)


NO_FEATURES = Features(np.zeros((0, 2)), np.zeros((0, 32), np.uint8))


@dataclass(frozen=True, slots=True)
class Matches:
    """Matched points, both of shape (n, 2) in px, best match first."""

    template_px: Array
    frame_px: Array

    def __len__(self) -> int:
        return len(self.template_px)


def detect_orb(image_grey: Image, feature_count: int, mask: Image | None = None) -> Features:
    """ORB features (Rublee 2011) of a grey image, shape (h, w), inside a mask; none of a featureless image."""
    side_px = min(image_grey.shape)
    if side_px <= 2 * EDGE_MARGIN_PX:  # all margin; OpenCV fails on the smallest of these
        return NO_FEATURES
    # Coarser levels are all margin.
    levels = 1 + int(math.log(side_px / (2 * EDGE_MARGIN_PX + 1), SCALE_FACTOR))
    orb = cv2.ORB_create(  # type: ignore[attr-defined]
        nfeatures=feature_count,
        scaleFactor=SCALE_FACTOR,
        nlevels=min(levels, MAX_LEVELS),
        edgeThreshold=EDGE_MARGIN_PX,
        patchSize=EDGE_MARGIN_PX,
    )
    keypoints, descriptors = orb.detectAndCompute(image_grey, mask)
    if descriptors is None or not keypoints:
        return NO_FEATURES
    return Features(np.asarray(cv2.KeyPoint.convert(keypoints), np.float64), np.asarray(descriptors, np.uint8))


def match_features(template: Features, frame: Features, ratio: float) -> Matches:
    """Nearest neighbours by Hamming distance that pass the ratio test (Lowe 2004, sec. 7.1), best first."""
    if len(template) == 0 or len(frame) < 2:
        return Matches(np.zeros((0, 2)), np.zeros((0, 2)))
    # What cv2.BFMatcher.knnMatch does, without an object for every match.
    distance, nearest = cv2.batchDistance(
        template.descriptors, frame.descriptors, cv2.CV_32S, normType=cv2.NORM_HAMMING, K=2
    )
    kept = np.flatnonzero(distance[:, 0] < ratio * distance[:, 1])
    kept = kept[np.argsort(distance[kept, 0], kind="stable")]
    return Matches(template.points_px[kept], frame.points_px[nearest[kept, 0]])


def fit_homography(matches: Matches, reprojection_px: float) -> tuple[Array, NDArray[np.bool_]] | None:
    """H, (3, 3) with H[2, 2] = 1, by MAGSAC (Barath 2019), and its inliers, (n,), by eq. (18); None below four."""
    parameters = cv2.UsacParams()
    parameters.threshold = reprojection_px
    parameters.confidence = 0.999
    parameters.maxIterations = 2000
    parameters.score = cv2.SCORE_METHOD_MAGSAC
    parameters.loMethod = cv2.LOCAL_OPTIM_SIGMA
    parameters.loIterations = 10
    parameters.loSampleSize = 50
    parameters.isParallel = False
    parameters.randomGeneratorState = 20  # with a fixed seed, and without threads, USAC gives the same bits everywhere
    try:
        fitted, _ = cv2.findHomography(matches.template_px, matches.frame_px, parameters)
    except cv2.error:  # too few, or degenerate points: all alike, or on one line
        return None
    if fitted is None or not np.all(np.isfinite(fitted)) or abs(fitted[2, 2]) < 1e-12:
        return None
    H = np.asarray(fitted / fitted[2, 2], np.float64)
    error_px = _transfer_error(H, matches)
    # Refit by least squares on the matches within shrinking thresholds, while they are many and agree (Hartley and
    # Zisserman 2004, sec. 4.2.2).
    fitted_on = np.zeros(0, np.bool_)
    for threshold_px in REFIT_THRESHOLDS_PX:
        close = error_px <= threshold_px
        if np.count_nonzero(close) < REFIT_MIN_COUNT:
            break
        if np.array_equal(close, fitted_on):
            continue  # the same matches give the same homography
        found, _ = cv2.findHomography(matches.template_px[close], matches.frame_px[close])
        if found is None:
            break
        H, fitted_on = np.asarray(found, np.float64), close
        error_px = _transfer_error(H, matches)
    inliers = error_px <= reprojection_px
    return (H, inliers) if np.count_nonzero(inliers) >= 4 else None


def transfer(H: Array, points_px: Array) -> Array:
    """Map points, shape (n, 2) in px, by eq. (17) with its missing scale: λ [u' v' 1] = H [u v 1]."""
    mapped = points_px @ H[:, :2].T + H[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(mapped[:, :2] / mapped[:, 2:])


def _transfer_error(H: Array, matches: Matches) -> Array:
    """Δd of eq. (18), shape (n,) in px: distance of each match from where the homography puts it."""
    off_px = matches.frame_px - transfer(H, matches.template_px)
    error_px = np.hypot(off_px[:, 0], off_px[:, 1])
    return np.where(np.isfinite(error_px), error_px, np.inf)


def marker_corners(H: Array, size_px: int, settings: MarkerSettings) -> Array | None:
    """Where H puts the template's corners, clockwise from the top left, (4, 2) in px; None of another shape or size."""
    last = size_px - 1.0
    corners = transfer(H, np.array([[0.0, 0.0], [last, 0.0], [last, last], [0.0, last]]))
    if not np.all(np.isfinite(corners)):
        return None
    outline = corners.astype(np.float32)
    area_ratio = cv2.contourArea(outline, oriented=True) / (size_px - 1) ** 2  # negative where it is mirrored
    # It was pasted without scaling.
    is_alike = 1.0 / settings.max_area_ratio < area_ratio < settings.max_area_ratio
    return corners if is_alike and cv2.isContourConvex(outline) else None
