"""AprilTags in an image: their corners, the poses that four corners allow, and the plate around them."""

from __future__ import annotations

import cv2
import numpy as np

from svmdist.samples import Image
from svmdist.transforms import Array, make_transform

DICTIONARIES = {
    "16h5": cv2.aruco.DICT_APRILTAG_16h5,
    "25h9": cv2.aruco.DICT_APRILTAG_25h9,
    "36h10": cv2.aruco.DICT_APRILTAG_36h10,
    "36h11": cv2.aruco.DICT_APRILTAG_36h11,
}
PLATE = 1.45
"""A tag's plate over its black square: the white margin of a cell or more, and the blur around it."""


class TagFinder:
    """Finds the one tag of a family and number."""

    def __init__(self, family: str, tag_id: int) -> None:
        dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARIES[family])
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        parameters.relativeCornerRefinmentWinSize = 0.3  # of a cell: a window that sees no other corner
        self._detector = cv2.aruco.ArucoDetector(dictionary, parameters)
        self._id = tag_id

    def corners_px(self, image_grey: Image) -> Array | None:
        """Corners, shape (4, 2) in px: upper left, upper right, lower right, lower left as one reads the tag."""
        corners, ids, _ = self._detector.detectMarkers(image_grey)
        if ids is None:
            return None
        found = [
            np.asarray(c, np.float64).reshape(4, 2)
            for c, i in zip(corners, ids.ravel(), strict=True)
            if i == self._id
        ]
        if not found:
            return None
        return max(found, key=lambda c: float(cv2.contourArea(c.astype(np.float32))))


def square_corners_m(size_m: float) -> Array:
    """The tag's corners in its frame, shape (4, 3), in the order of `TagFinder.corners_px`."""
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


def tag_plate(corners_px: Array, shape: tuple[int, ...]) -> Image:
    """Mask, of `shape` (h, w), of the plate around a tag with these corners, shape (4, 2)."""
    middle_px = corners_px.mean(0)
    plate_px = middle_px + PLATE * (corners_px - middle_px)
    mask = np.zeros(shape, np.uint8)
    cv2.fillConvexPoly(mask, np.round(plate_px).astype(np.int32), 255)
    return mask
