"""ORB features and their matching: detection, brute-force Hamming kNN and the ratio test (paper, sec. III.B)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.samples import Image
from svmdist.transforms import Array

EDGE_MARGIN_PX = 31
"""ORB finds no keypoint closer to the border than its `edgeThreshold`: images are padded by this much."""

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
    if min(image_grey.shape) <= 2 * EDGE_MARGIN_PX:  # all margin; OpenCV fails on the smallest of these
        return _no_features()
    orb = cv2.ORB_create(nfeatures=feature_count, edgeThreshold=EDGE_MARGIN_PX, patchSize=EDGE_MARGIN_PX)  # type: ignore[attr-defined]
    keypoints, descriptors = orb.detectAndCompute(image_grey, mask)
    if descriptors is None or not keypoints:
        return _no_features()
    points_px = np.array([keypoint.pt for keypoint in keypoints], np.float64)
    return Features(points_px, np.asarray(descriptors, np.uint8))


def match_features(template: Features, frame: Features, ratio: float) -> Matches:
    """Match each template feature to the nearest frame feature, if it is clearly nearer than the second.

    Brute-force Hamming distance with k = 2 and the ratio test (Lowe 2004, sec. 7.1); matches are sorted
    by distance. A feature with a single neighbour has nothing to be compared with and is dropped.
    """
    if len(template) == 0 or len(frame) < 2:
        return Matches(np.zeros((0, 2)), np.zeros((0, 2)))
    pairs = cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(template.descriptors, frame.descriptors, k=2)
    kept = [pair[0] for pair in pairs if len(pair) == 2 and pair[0].distance < ratio * pair[1].distance]
    kept.sort(key=lambda match: (match.distance, match.queryIdx))
    in_template = [match.queryIdx for match in kept]
    in_frame = [match.trainIdx for match in kept]
    return Matches(
        template.points_px[in_template],
        frame.points_px[in_frame],
    )


def hamming(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> int:
    """Number of bits in which two descriptors, shape (32,), differ."""
    return int(np.bitwise_count(np.bitwise_xor(a, b)).sum())


def _no_features() -> Features:
    return Features(np.zeros((0, 2)), np.zeros((0, DESCRIPTOR_BYTES), np.uint8))
