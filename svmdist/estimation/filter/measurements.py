"""The kinds of measurements that the filter takes, to be imported from one place."""

from __future__ import annotations

from svmdist.estimation.filter.measurement import LinkMeasurement
from svmdist.estimation.filter.point_measurements import (
    DisparityMeasurement,
    PointsMeasurement,
    SizeMeasurement,
)
from svmdist.estimation.filter.shape_measurements import ContourMeasurement, PoseMeasurement

__all__ = [
    "ContourMeasurement",
    "DisparityMeasurement",
    "LinkMeasurement",
    "PointsMeasurement",
    "PoseMeasurement",
    "SizeMeasurement",
]
