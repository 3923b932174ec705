"""ORB features and their matching: detection, brute-force Hamming kNN and the ratio test (paper, sec. III.B)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.samples import Image
from svmdist.transforms import Array

EDGE_MARGIN_PX = 31
"""ORB finds no keypoint closer to the border of a pyramid level than its `edgeThreshold`."""

SCALE_FACTOR = 1.2
MAX_LEVELS = 8
"""ORB's pyramid as in Rublee 2011, sec. 6.1: eight levels, each 1.2 times as coarse as the one before."""

DESCRIPTOR_BYTES = 32
"""eqs. (13)–(16): n = 256 binary tests make 32 bytes, not "32 dimensions"."""


@dataclass(frozen=True, slots=True)
class Features:
    """Keypoints, shape (n, 2) in px, with their ORB descriptors, shape (n, 32) of uint8."""

    points_px: Array
    descriptors: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.points_px)


@dataclass(frozen=True, slots=True)
class Matches:
    """Matched points, both of shape (n, 2) in px, best match first."""

    template_px: Array
    frame_px: Array

    def __len__(self) -> int:
        return len(self.template_px)


def detect_orb(image_grey: Image, feature_count: int, mask: Image | None = None) -> Features:
    """Detect ORB features (Rublee 2011) of a grey image, shape (h, w), inside a mask of the same shape.

    A featureless image gives no features rather than an error.
    """
    side_px = min(image_grey.shape)
    if side_px <= 2 * EDGE_MARGIN_PX:  # all margin; OpenCV fails on the smallest of these
        return _no_features()
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
        return _no_features()
    points_px = np.asarray(cv2.KeyPoint.convert(keypoints), np.float64)
    return Features(points_px, np.asarray(descriptors, np.uint8))


def match_features(template: Features, frame: Features, ratio: float) -> Matches:
    """Match each template feature to the nearest frame feature, if it is clearly nearer than the second.

    Brute-force Hamming distance with k = 2 and the ratio test (Lowe 2004, sec. 7.1); matches are sorted
    by distance. A feature with a single neighbour has nothing to be compared with and is dropped.
    """
    if len(template) == 0 or len(frame) < 2:
        return Matches(np.zeros((0, 2)), np.zeros((0, 2)))
    # What cv2.BFMatcher.knnMatch does, without an object for every match.
    distance, nearest = cv2.batchDistance(
        template.descriptors, frame.descriptors, cv2.CV_32S, normType=cv2.NORM_HAMMING, K=2
    )
    kept = np.flatnonzero(distance[:, 0] < ratio * distance[:, 1])
    kept = kept[np.argsort(distance[kept, 0], kind="stable")]
    return Matches(template.points_px[kept], frame.points_px[nearest[kept, 0]])


def _no_features() -> Features:
    return Features(np.zeros((0, 2)), np.zeros((0, DESCRIPTOR_BYTES), np.uint8))
