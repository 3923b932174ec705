"""Regions of a mask: connected parts above an area gate, their size and centroid (eqs. 1, 2, 7, 8, 19, 20)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.profile import AreaGate
from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision.completion import completed_centroid, polygon_centroid

SPECK_FRACTION = 0.02
"""A part below this fraction of the largest one is a speck of colour elsewhere, not a part of the region:
it would pull the convex hull across the image."""


@dataclass(frozen=True, slots=True)
class Region:
    """One segmented object, of one or several connected parts.

    `area_px` counts pixels, `polygon_area_px2` is the area inside the outer contours (the audit asks for
    both); `centroid_px` has shape (2,); `hull` is the convex hull, shape (n, 1, 2) of int32.
    """

    area_px: int
    polygon_area_px2: float
    centroid_px: Array
    hull: NDArray[np.int32]
    hull_area_px2: float


def find_region(mask: Image, rule: AreaGate) -> Region | None:
    """Find the region of a mask, shape (h, w), that passes the rule's area gate; None where there is none."""
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    parts = [(_pixel_count(mask, contour), contour) for contour in _worth_counting(contours, rule)]
    if not parts:
        return None
    largest = max(count for count, _ in parts)
    if rule.components == "largest":
        parts = [max(parts, key=lambda part: part[0])]
    parts = [
        (count, contour)
        for count, contour in parts
        if count > rule.min_area_px and count >= SPECK_FRACTION * largest
    ]
    if not parts:
        return None
    hull = np.asarray(cv2.convexHull(np.concatenate([contour for _, contour in parts])), np.int32)
    if rule.occlusion == "outline":
        centroid_px = completed_centroid(mask, hull)
    elif rule.occlusion == "hull":
        centroid_px = polygon_centroid(hull)
    else:
        centroid_px = _pixel_centroid(mask, [contour for _, contour in parts])
    return Region(
        area_px=sum(count for count, _ in parts),
        polygon_area_px2=float(sum(cv2.contourArea(contour) for _, contour in parts)),
        centroid_px=centroid_px,
        hull=hull,
        hull_area_px2=float(cv2.contourArea(hull)),
    )


def _worth_counting(contours: object, rule: AreaGate) -> list[NDArray[np.int32]]:
    """Drop contours whose bounding box already holds too few pixels: speckled masks have thousands."""
    kept = []
    for contour in contours:  # type: ignore[attr-defined]
        _, _, width, height = cv2.boundingRect(contour)
        if width * height > rule.min_area_px:
            kept.append(np.asarray(contour, np.int32))
    return kept


def _pixel_count(mask: Image, contour: NDArray[np.int32]) -> int:
    """Number of set pixels inside one outer contour; holes do not count."""
    inside, window = _filled(mask, contour)
    return int(cv2.countNonZero(cv2.bitwise_and(inside, window)))


def _pixel_centroid(mask: Image, contours: list[NDArray[np.int32]]) -> Array:
    """Mean of the coordinates of the set pixels inside the contours, shape (2,) as x, y: eqs. (1), (2)."""
    total, weighted = 0.0, np.zeros(2)
    for contour in contours:
        x, y, _, _ = cv2.boundingRect(contour)
        inside, window = _filled(mask, contour)
        moments = cv2.moments(cv2.bitwise_and(inside, window), binaryImage=True)
        total += moments["m00"]
        weighted += np.array([moments["m10"] + x * moments["m00"], moments["m01"] + y * moments["m00"]])
    return weighted / total


def _filled(mask: Image, contour: NDArray[np.int32]) -> tuple[Image, Image]:
    """The contour filled, and the mask, both cut to the contour's bounding box."""
    x, y, width, height = cv2.boundingRect(contour)
    inside = np.zeros((height, width), np.uint8)
    cv2.drawContours(inside, [contour], -1, 255, cv2.FILLED, offset=(-x, -y))
    return inside, mask[y : y + height, x : x + width]
