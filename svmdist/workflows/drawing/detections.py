"""The shapes of what a method detected in an image, in px of the image that its detectors looked at.

Only what the method asked for is drawn: a detection that it never used would explain nothing.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from svmdist.drawing import Form, Part, Shape
from svmdist.estimation.detection.distal_marker import DistalMarker
from svmdist.estimation.detection.shaft import Contour, ShaftDetection
from svmdist.estimation.frame import Frame
from svmdist.results import FrameResult
from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision.regions import Region
from svmdist.vision.shaft_segmentation import ShaftRegion

CIRCLE_POINTS = 36
MIN_CONTOUR_PX = 6
"""Shorter contours are specks."""


def scene_shapes(frame: Frame) -> Iterator[Shape]:
    """What belongs to no instrument: the tissue's contours and its outline, completed behind the instrument."""
    tissue = frame.scene.found.get("tissue")
    if tissue is not None:
        yield from _contours(frame.scene.left.masks.tissue, tissue.region, Part.TISSUE)
        yield Shape(Part.TISSUE, Form.LOOP, np.asarray(tissue.outline.curve_px, np.float64))


def tool_shapes(frame: Frame, name: str) -> Iterator[Shape]:
    """What belongs to one instrument: contours, distal marker, shaft, tag."""
    found = frame.tool.found
    regions: tuple[Region | None, Region | None] = found.get("regions_as_recorded") or (None, None)
    tissue, instrument = regions
    if tissue is not None:
        yield from _contours(frame.left.masks_as_recorded.tissue, tissue, Part.TISSUE)
        yield Shape(Part.TISSUE, Form.POINTS, np.atleast_2d(tissue.centroid_px))
    if instrument is not None:
        yield from _contours(frame.left.masks_as_recorded.instrument, instrument, Part.INSTRUMENT, name)
    region = found.get("region")
    if region is not None:
        yield from _contours(frame.left.masks.instrument, region, Part.INSTRUMENT, name)
    marker = found.get("distal_marker")
    if marker is not None:
        yield _distal_marker(marker, name)
    shaft = found.get("shaft")
    if shaft is not None:
        yield from _shaft(frame, shaft, found.get("shaft_region"), name)
    corners_px = found.get("tag_corners_px")
    if corners_px is not None:
        yield Shape(Part.TAG, Form.LOOP, np.asarray(corners_px, np.float64), name)


def place_shapes(result: FrameResult) -> Iterator[Shape]:
    """Where tool and tissue are, by a result, in px of the recorded image."""
    if result.image.tool_px is not None:
        yield Shape(Part.TIP, Form.POINTS, np.array([result.image.tool_px]), result.instrument)
    if result.image.tissue_px is not None:
        yield Shape(Part.TISSUE, Form.POINTS, np.array([result.image.tissue_px]))


def _contours(mask: Image, region: Region, part: Part, name: str = "") -> Iterator[Shape]:
    """The outer contours of a mask, shape (h, w), inside the hull of a region."""
    x, y, width, height = cv2.boundingRect(region.hull)
    inside = np.zeros((height, width), np.uint8)
    cv2.fillConvexPoly(inside, region.hull - np.array([x, y], np.int32), 255)
    window = cv2.bitwise_and(np.ascontiguousarray(mask[y : y + height, x : x + width]), inside)
    contours, _ = cv2.findContours(window, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE, offset=(x, y))
    for contour in contours:
        if cv2.arcLength(contour, closed=True) >= MIN_CONTOUR_PX:
            yield Shape(part, Form.LOOP, contour.reshape(-1, 2).astype(np.float64), name)


def _distal_marker(marker: DistalMarker, name: str) -> Shape:
    """The circle of the marker; its centre where no circle fits."""
    centre_px, radius_px = marker.centre_px, marker.radius_px
    if marker.disc is not None:
        centre_px, radius_px = marker.disc.centre_px, marker.disc.radius_px
    if radius_px is None:
        return Shape(Part.MARKER, Form.POINTS, np.atleast_2d(centre_px), name)
    angles = np.linspace(0.0, 2.0 * np.pi, CIRCLE_POINTS, endpoint=False)
    around = np.column_stack([np.cos(angles), np.sin(angles)])
    return Shape(Part.MARKER, Form.LOOP, centre_px + radius_px * around, name)


def _shaft(frame: Frame, shaft: ShaftDetection, region: ShaftRegion | None, name: str) -> Iterator[Shape]:
    """The measured edges, as long as the shaft is visible, and its end across its middle line."""
    if region is None:
        return
    half_width_px = 0.5 * float(np.linalg.norm(region.first.end_px - region.second.end_px))
    for contour in shaft.contours:
        ends_px = _edge(contour, region, frame.left.camera.K)
        yield Shape(Part.SHAFT, Form.LINE, ends_px, name)
    if shaft.rim is not None:
        across = np.array([-shaft.rim.towards_tip[1], shaft.rim.towards_tip[0]])
        ends_px = shaft.rim.pixel + np.outer([-half_width_px, half_width_px], across)
        yield Shape(Part.SHAFT, Form.LINE, ends_px, name)


def _edge(contour: Contour, region: ShaftRegion, K: Array) -> Array:
    """The line in which a tangent plane meets the image, between the feet of the rough side's ends, shape (2, 2)."""
    line = np.linalg.inv(K).T @ contour.plane.normal  # l · (u, v, 1) = 0
    line = line / np.linalg.norm(line[:2])

    def off(px: Array) -> float:
        return float(line[:2] @ px + line[2])

    sides = (region.first, region.second)
    side = min(sides, key=lambda one: abs(off(one.start_px)) + abs(off(one.end_px)))
    return np.array([px - off(px) * line[:2] for px in (side.start_px, side.end_px)])
