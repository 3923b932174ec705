"""Regions of a mask: connected parts above an area gate, their size and centroid (eqs. 1, 2, 7, 8, 19, 20)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.profile import AreaGate
from svmdist.profile.settings import OutlineSettings
from svmdist.samples import Image
from svmdist.transforms import Array, polygon_centroid
from svmdist.vision.completion import complete_outline

DEFAULT = OutlineSettings()


@dataclass(frozen=True, slots=True)
class Region:
    """One segmented object, of one or several connected parts.

    `area_px` counts pixels, `polygon_area_px2` is the area inside the outer contours (the audit asks for
    both); `centroid_px` has shape (2,); `hull` is the convex hull, shape (n, 1, 2) of int32, of all `part_count` parts.
    """

    area_px: int
    polygon_area_px2: float
    centroid_px: Array
    hull: NDArray[np.int32]
    hull_area_px2: float
    part_count: int = 1


@dataclass(frozen=True, slots=True)
class _Part:
    """A connected part: its outer contour, shape (n, 1, 2), and its own pixels in the contour's bounding box.

    `pixels`, shape (h, w), is 0 outside the part and in its holes; `corner_px` is its top left pixel (x, y).
    """

    contour: NDArray[np.int32]
    pixels: Image
    corner_px: tuple[int, int]
    area_px: int


def find_region(mask: Image, rule: AreaGate, settings: OutlineSettings = DEFAULT) -> Region | None:
    """Find the region of a mask, shape (h, w), that passes the rule's area gate; None where there is none."""
    parts = _parts(mask, rule)
    if not parts:
        return None
    largest = max(parts, key=lambda part: part.area_px)
    if rule.components == "largest":
        parts = [largest]
    least_px = settings.speck_fraction * largest.area_px
    parts = [part for part in parts if part.area_px > rule.min_area_px and part.area_px >= least_px]
    if not parts:
        return None
    hull = np.asarray(cv2.convexHull(np.concatenate([part.contour for part in parts])), np.int32)
    if rule.occlusion == "outline":
        centroid_px = complete_outline(mask, hull, settings).centroid_px
    elif rule.occlusion == "hull":
        centroid_px = polygon_centroid(hull)
    else:
        centroid_px = _pixel_centroid(parts)
    return Region(
        area_px=sum(part.area_px for part in parts),
        polygon_area_px2=float(sum(cv2.contourArea(part.contour) for part in parts)),
        centroid_px=centroid_px,
        hull=hull,
        hull_area_px2=float(cv2.contourArea(hull)),
        part_count=len(parts),
    )


def _parts(mask: Image, rule: AreaGate) -> list[_Part]:
    """The connected parts, without those whose bounding box already has too few pixels: specks may be thousands."""
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    parts = []
    for contour in contours:
        x, y, width, height = cv2.boundingRect(contour)
        if width * height <= rule.min_area_px:
            continue
        pixels = mask[y : y + height, x : x + width]
        if len(contours) > 1:  # other parts may have pixels in this box
            inside = np.zeros((height, width), np.uint8)
            cv2.drawContours(inside, [contour], -1, 255, cv2.FILLED, offset=(-x, -y))
            pixels = np.asarray(cv2.bitwise_and(inside, pixels), np.uint8)
        parts.append(_Part(np.asarray(contour, np.int32), pixels, (x, y), int(cv2.countNonZero(pixels))))
    return parts


def _pixel_centroid(parts: Sequence[_Part]) -> Array:
    """Mean of the coordinates of the parts' pixels, shape (2,) as x, y: eqs. (1), (2)."""
    total, weighted = 0.0, np.zeros(2)
    for part in parts:
        moments = cv2.moments(part.pixels, binaryImage=True)
        x, y = part.corner_px
        total += moments["m00"]
        weighted += np.array([moments["m10"] + x * moments["m00"], moments["m01"] + y * moments["m00"]])
    return weighted / total
