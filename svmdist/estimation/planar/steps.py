"""The steps that the paper's estimators share: where tissue and instrument are, and the distance in the plane."""

from __future__ import annotations

import math
from dataclasses import replace

from svmdist.estimation.frame import Frame
from svmdist.estimation.planar.equations import PlaneMapping, planar_distance_m
from svmdist.results import Distance, Distances, FrameResult, ImageFindings, as_pixel
from svmdist.samples import Status
from svmdist.transforms import Array
from svmdist.vision.regions import Region


def locate(frame: Frame) -> tuple[FrameResult, Region | None, Region | None]:
    """Tissue and instrument by their colours as recorded, and the result so far; rejected if one is missing."""
    tissue, instrument = frame.tool.regions_as_recorded
    status = Status.OK
    if tissue is None or instrument is None:
        status = Status.NO_TISSUE if tissue is None else Status.NO_INSTRUMENT
    found = ImageFindings(
        tool_px=as_pixel(instrument.centroid_px) if instrument else None,
        tissue_px=as_pixel(tissue.centroid_px) if tissue else None,
        tool_area_px=instrument.area_px if instrument else None,
        tissue_area_px=tissue.area_px if tissue else None,
    )
    return FrameResult(frame.stamp_ns, status, found), tissue, instrument


def in_plane(result: FrameResult, tool_px: Array, tissue_px: Array, mapping: PlaneMapping) -> FrameResult:
    """Both places to the plane, and the distance between them; one that is not finite rejects the frame."""
    distance_m = planar_distance_m(mapping.to_plane_m(tool_px), mapping.to_plane_m(tissue_px))
    if not math.isfinite(distance_m):
        return result.rejected(Status.NOT_FINITE)
    distances = Distances(planar=Distance(distance_m))
    return replace(result.with_image(tool_px=as_pixel(tool_px)), distances=distances)
