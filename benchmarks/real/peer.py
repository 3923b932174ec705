"""What fifteen lines of OpenCV do on the same images: the peer of the page, without intervals and reasons."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np

from benchmarks.real.common import Figures, Mask
from svmdist.samples import Image
from svmdist.transforms import Array


class Rod(NamedTuple):
    """An instrument as a rectangle: its end in the image, (2,) in px, its place, (3,) in m, and its pixels."""

    end_px: Array
    place_m: Array
    mask: Mask


def rods(bgr: Image, K: Array, radius_m: float, most: int = 1) -> list[Rod]:
    """Parts that reach the border, grey or dark, whichever are smaller: rectangles, depth by the known diameter."""
    seen: list[list[tuple[float, Mask, Any]]] = []
    for channel in cv2.split(cv2.cvtColor(bgr, cv2.COLOR_BGR2HSV))[1:]:
        _, low = cv2.threshold(channel, 0, 1, cv2.THRESH_BINARY_INV + cv2.THRESH_OTSU)
        low = cv2.morphologyEx(low, cv2.MORPH_OPEN, np.ones((5, 5), np.uint8))
        parts = [(cv2.contourArea(x), x) for x in cv2.findContours(low, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]]
        masks = [(area, cv2.drawContours(np.zeros_like(low), [x], -1, 1, -1) > 0, x) for area, x in parts if area > 500]
        seen.append([one for one in masks if one[1].sum() > one[1][1:-1, 1:-1].sum()])
    found: list[Rod] = []
    for _, mask, contour in sorted(
        min(seen, key=lambda ones: sum(one[0] for one in ones) or np.inf), key=lambda x: -x[0]
    ):
        corners = cv2.boxPoints(cv2.minAreaRect(contour))
        sides = np.linalg.norm(corners - np.roll(corners, -1, 0), axis=1)
        short = int(np.argmin(sides[:2]))
        ends = np.array([corners[[short, short + 1]].mean(0), corners[[short + 2, (short + 3) % 4]].mean(0)])
        end = ends[np.argmin(np.linalg.norm(ends - np.array(mask.shape[::-1]) / 2, axis=1))]  # the one inside
        z = 2.0 * radius_m * K[0, 0] / max(float(sides[short]), 1.0)
        found.append(Rod(end, z * np.linalg.solve(K, [*end, 1.0]), mask))
    return found[:most]


def found(pictures: Sequence[Image], K: Array, radius_m: float, most: int = 1) -> list[tuple[int, Rod]]:
    """The instruments of all pictures, each with the number of its picture."""
    return [(number, rod) for number, bgr in enumerate(pictures) for rod in rods(bgr, K, radius_m, most)]


def figures(of: Sequence[tuple[int, Rod]], seen: Sequence[Mask], unit: str = "", errors: Any = ()) -> Figures:
    """Their errors, and how much of them is on what is seen in each picture."""
    return Figures(str(len(of)), unit, errors, [float(seen[number][rod.mask].mean()) for number, rod in of])


def surface(views: Sequence[Image], K: Sequence[Array], D: Sequence[Array], T: Array, most: int = 20000) -> Array:
    """Points (n, 3) in the left camera's frame, in the unit of T (4, 4) from left to right, by semi-global matching."""
    size = (views[0].shape[1], views[0].shape[0])
    R1, R2, P1, P2, Q, *_ = cv2.stereoRectify(K[0], D[0], K[1], D[1], size, T[:3, :3], T[:3, 3:])
    grey = []
    for bgr, k, d, R, P in zip(views, K, D, (R1, R2), (P1, P2), strict=True):
        x, y = cv2.initUndistortRectifyMap(k, d, R, P, size, cv2.CV_32FC1)
        grey.append(cv2.cvtColor(cv2.remap(bgr, x, y, cv2.INTER_LINEAR), cv2.COLOR_BGR2GRAY))
    matcher = cv2.StereoSGBM.create(0, 128, 5, 200, 800, 1, 0, 10, 100, 2, cv2.STEREO_SGBM_MODE_SGBM_3WAY)
    disparity = matcher.compute(*grey).astype(np.float32) / 16.0
    points = cv2.reprojectImageTo3D(disparity, Q)[disparity > 0] @ R1
    points = points[np.isfinite(points).all(1) & (points[:, 2] > 0)]
    return np.asarray(points[:: max(1, len(points) // most)], np.float64)
