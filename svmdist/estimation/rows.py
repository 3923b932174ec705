"""Estimates under construction: what is known after segmentation, and the finished row."""

from __future__ import annotations

import math
from dataclasses import replace

from svmdist.samples import Estimate, Status
from svmdist.transforms import Array
from svmdist.vision.regions import Region


def first_rows(stamp_ns: int, tissue: Region | None, instrument: Region | None) -> Estimate:
    """The row after segmentation: rejected if a region is missing, and as far as it goes if not."""
    if tissue is None:
        status = Status.NO_TISSUE
    elif instrument is None:
        status = Status.NO_INSTRUMENT
    else:
        status = Status.OK
    return Estimate(
        stamp_ns=stamp_ns,
        status=status,
        tool_x_px=float(instrument.centroid_px[0]) if instrument else None,
        tool_y_px=float(instrument.centroid_px[1]) if instrument else None,
        tissue_x_px=float(tissue.centroid_px[0]) if tissue else None,
        tissue_y_px=float(tissue.centroid_px[1]) if tissue else None,
        tool_area_px=instrument.area_px if instrument else None,
        tissue_area_px=tissue.area_px if tissue else None,
    )


def finish(row: Estimate, tool_px: Array, distance_m: float) -> Estimate:
    """The finished row; a distance that is no number rejects the frame, for it would poison an average."""
    if not math.isfinite(distance_m):
        return replace(row, status=Status.NOT_FINITE)
    return replace(
        row,
        status=Status.OK,
        distance_m=distance_m,
        tool_x_px=float(tool_px[0]),
        tool_y_px=float(tool_px[1]),
    )
