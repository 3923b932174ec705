"""AprilTags in an image: their corners, the poses that four corners allow, and the plate around them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from threading import get_ident

import cv2
import numpy as np

from svmdist.profile.settings import TagSettings
from svmdist.samples import Image
from svmdist.transforms import Array, make_transform
from svmdist.vision.tag.corners import refine_corners

DICTIONARIES = {
    "16h5": cv2.aruco.DICT_APRILTAG_16h5,
    "25h9": cv2.aruco.DICT_APRILTAG_25h9,
    "36h10": cv2.aruco.DICT_APRILTAG_36h10,
    "36h11": cv2.aruco.DICT_APRILTAG_36h11,
}
LONG_CODE_CELLS, SHORT_CODE_RATE = 5, 0.6
"""A code of 4 x 4 cells is too short to correct as many bits: every sixth image without one showed some tag of 16h5."""
DEFAULT = TagSettings()


@dataclass(frozen=True, slots=True)
class FoundTag:
    """A tag's number and its corners, shape (4, 2) in px: upper left, upper right, lower right, lower left as read."""

    number: int
    corners_px: Array


def find_tags(image_grey: Image, family: str, settings: TagSettings = DEFAULT) -> dict[int, Array]:
    """Corners, shape (4, 2) in px, of the tags of a family by number, the largest where one is found twice.

    Upper left, upper right, lower right, lower left as one reads the tag.
    """
    found: dict[int, Array] = {}
    for tag in find_every_tag(image_grey, family, settings):
        known = found.get(tag.number)
        if known is None or _area_px2(tag.corners_px) > _area_px2(known):
            found[tag.number] = tag.corners_px
    return found


def find_every_tag(image_grey: Image, family: str, settings: TagSettings = DEFAULT) -> list[FoundTag]:
    """Every tag of a family in an image, shape (h, w), also where several have one number."""
    # OpenCV takes the smallest perimeter relative to the image's longer side.
    min_perimeter = 4.0 * settings.min_side_px / max(image_grey.shape)
    detector = _detector(
        family,
        settings.error_correction_rate,
        settings.cell_samples,
        settings.cell_margin,
        min_perimeter,
        get_ident(),
    )
    corners, ids, _ = detector.detectMarkers(image_grey)
    cell_count = detector.getDictionary().markerSize + 2
    return [
        FoundTag(
            int(number),
            refine_corners(image_grey, np.asarray(seen, np.float64).reshape(4, 2), cell_count, settings),
        )
        for seen, number in zip(corners, [] if ids is None else ids.ravel(), strict=True)
    ]


@lru_cache(maxsize=32)
def _detector(
    family: str,
    error_correction_rate: float,
    cell_samples: int,
    cell_margin: float,
    min_perimeter: float,
    _thread: int,
) -> cv2.aruco.ArucoDetector:
    """The detector of a family; each thread has its own, since it keeps state while it works."""
    dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARIES[family])
    if dictionary.markerSize < LONG_CODE_CELLS:
        error_correction_rate = min(error_correction_rate, SHORT_CODE_RATE)
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    parameters.errorCorrectionRate = error_correction_rate
    parameters.perspectiveRemovePixelPerCell = cell_samples
    parameters.perspectiveRemoveIgnoredMarginPerCell = cell_margin
    parameters.minMarkerPerimeterRate = min_perimeter
    return cv2.aruco.ArucoDetector(dictionary, parameters)


def _area_px2(corners_px: Array) -> float:
    return float(cv2.contourArea(corners_px.astype(np.float32)))


def square_corners_m(size_m: float) -> Array:
    """The tag's corners in its frame, shape (4, 3), in the order of `find_tags`."""
    h = size_m / 2.0
    return np.array([[-h, h, 0.0], [h, h, 0.0], [h, -h, 0.0], [-h, -h, 0.0]])


def pose_candidates(corners_px: Array, size_m: float, K: Array, D: Array) -> list[Array]:
    """Both poses that four corners allow, shape (4, 4) each, the better one first (Collins and Bartoli 2014)."""
    _, rotations, translations, _ = cv2.solvePnPGeneric(
        square_corners_m(size_m),
        np.ascontiguousarray(corners_px),
        K,
        D if len(D) else None,
        flags=cv2.SOLVEPNP_IPPE_SQUARE,
    )
    poses = []
    for rotation, translation in zip(rotations, translations, strict=True):
        T = make_transform(cv2.Rodrigues(rotation)[0], np.asarray(translation).ravel())
        if np.all(np.isfinite(T)) and T[2, 3] > 0.0:
            poses.append(T)
    return poses


def tag_plate(corners_px: Array, shape: tuple[int, ...], settings: TagSettings = DEFAULT) -> Image:
    """Mask, of `shape` (h, w), of the plate around a tag with these corners, shape (4, 2)."""
    middle_px = corners_px.mean(0)
    plate_px = middle_px + settings.plate_ratio * (corners_px - middle_px)
    mask = np.zeros(shape, np.uint8)
    cv2.fillConvexPoly(mask, np.round(plate_px).astype(np.int32), 255)
    return mask
