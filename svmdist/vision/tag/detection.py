"""AprilTags in an image: their corners, the poses that four corners allow, and the plate around them."""

from __future__ import annotations

import cv2
import numpy as np

from svmdist.samples import Image
from svmdist.settings.tag import TagSettings
from svmdist.transforms import Array, make_transform

DICTIONARIES = {
    "16h5": cv2.aruco.DICT_APRILTAG_16h5,
    "25h9": cv2.aruco.DICT_APRILTAG_25h9,
    "36h10": cv2.aruco.DICT_APRILTAG_36h10,
    "36h11": cv2.aruco.DICT_APRILTAG_36h11,
}
Box = tuple[float, float, float, float]
"""x0, y0, x1, y1 in px: the pixels x0 <= x <= x1 and y0 <= y <= y1."""
LONG_CODE_CELLS, SHORT_CODE_RATE = 5, 0.6
"""A code of 4 x 4 cells is too short to correct as many bits: every sixth image without one showed some tag of 16h5."""
THRESHOLD_REACH_PX = 12.0
"""How far OpenCV looks about a pixel for its threshold: half of its largest window."""
DEFAULT = TagSettings()


class TagFinder:
    """Finds the one tag of a family and number. Threads that run at once need a finder each."""

    def __init__(self, family: str, tag_id: int, settings: TagSettings = DEFAULT) -> None:
        self._parameters = cv2.aruco.DetectorParameters()
        self._parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        self._parameters.relativeCornerRefinmentWinSize = settings.corner_window_cells
        dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARIES[family])
        rate = settings.error_correction_rate
        if dictionary.markerSize < LONG_CODE_CELLS:
            rate = min(rate, SHORT_CODE_RATE)
        self._parameters.errorCorrectionRate = rate
        self._detector = cv2.aruco.ArucoDetector(dictionary, self._parameters)
        self._id = tag_id
        self._settings = settings

    def corners_px(self, image_grey: Image, near: Box | None = None) -> Array | None:
        """Corners, shape (4, 2) in px: upper left, upper right, lower right, lower left as one reads the tag.

        `near` is where the tag is predicted: it is looked for there first, and elsewhere only if it is not found.
        The corners are those of a search of the whole image within 1e-4 px.
        """
        if near is not None:
            x0, y0, x1, y1 = self._window(image_grey, near)
            corners_px = self._search(image_grey[y0:y1, x0:x1]) if min(x1 - x0, y1 - y0) > 0 else None
            if corners_px is not None:
                return np.asarray(corners_px + np.array([x0, y0], np.float64), np.float64)
        return self._search(image_grey)

    def _window(self, image_grey: Image, near: Box) -> tuple[int, int, int, int]:
        """Columns and rows x0, y0, x1, y1 of the window about a box, with a margin; the end is not in it."""
        height, width = image_grey.shape
        x0, y0, x1, y1 = near
        margin_px = self._settings.search_margin * max(x1 - x0, y1 - y0) + THRESHOLD_REACH_PX
        start = np.clip(np.floor([x0 - margin_px, y0 - margin_px]), 0, [width, height]).astype(int)
        end = np.clip(np.ceil([x1 + margin_px, y1 + margin_px]) + 1, 0, [width, height]).astype(int)
        return int(start[0]), int(start[1]), int(end[0]), int(end[1])

    def _search(self, image_grey: Image) -> Array | None:
        # OpenCV takes the smallest perimeter relative to the image's longer side.
        rate = 4.0 * self._settings.min_side_px / max(image_grey.shape)
        if rate != self._parameters.minMarkerPerimeterRate:
            self._parameters.minMarkerPerimeterRate = rate
            self._detector.setDetectorParameters(self._parameters)
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


def tag_plate(corners_px: Array, shape: tuple[int, ...], settings: TagSettings = DEFAULT) -> Image:
    """Mask, of `shape` (h, w), of the plate around a tag with these corners, shape (4, 2)."""
    middle_px = corners_px.mean(0)
    plate_px = middle_px + settings.plate_ratio * (corners_px - middle_px)
    mask = np.zeros(shape, np.uint8)
    cv2.fillConvexPoly(mask, np.round(plate_px).astype(np.int32), 255)
    return mask
