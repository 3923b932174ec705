"""Estimates as rows: the columns of `svmdist estimate`, for machines in SI and for a person in mm."""

from __future__ import annotations

from svmdist.report.table import Cell, Column, Row, number
from svmdist.samples import Estimate

ESTIMATE_KEYS = (
    "recording",
    "stamp_ns",
    "status",
    "distance_m",
    "tool_x_px",
    "tool_y_px",
    "tissue_x_px",
    "tissue_y_px",
    "tool_area_px",
    "tissue_area_px",
    "keypoint_count",
    "match_count",
    "inlier_count",
    "method",
    "equations",
)
"""The contract: columns may be added at the end, none is renamed or removed."""

ESTIMATE_COLUMNS = (
    Column("recording", "recording", is_text=True),
    Column("time_s", "t [s]", number(3)),
    Column("status", "status", is_text=True),
    Column("distance_m", "distance [mm]", number(2, 1e3)),
    Column("tool_x_px", "tool x [px]", number(1)),
    Column("tool_y_px", "tool y [px]", number(1)),
    Column("tissue_x_px", "tissue x [px]", number(1)),
    Column("tissue_y_px", "tissue y [px]", number(1)),
    Column("tool_area_px", "tool [px²]", number(0)),
    Column("tissue_area_px", "tissue [px²]", number(0)),
    Column("keypoint_count", "keypoints", number(0)),
    Column("match_count", "matches", number(0)),
    Column("inlier_count", "inliers", number(0)),
)


def estimate_row(recording: str, estimate: Estimate, method: str, equations: str, start_ns: int) -> Row:
    """One row; `time_s` counts from the recording's first image and is for a person only."""
    row: dict[str, Cell] = {
        key: getattr(estimate, key) for key in ESTIMATE_KEYS if hasattr(estimate, key) and key != "status"
    }
    row |= {
        "recording": recording,
        "status": str(estimate.status),
        "method": method,
        "equations": equations,
        "time_s": (estimate.stamp_ns - start_ns) / 1e9,
    }
    return row
