"""The comparison of methods as rows: method by planar, spatial and clearance figures."""

from __future__ import annotations

from svmdist.report.table import Cell, Column, number, percent
from svmdist.workflows.compare import DistanceScore, MethodScore

COMPARE_KEYS = (
    "group",
    "method",
    "frame_count",
    "measured_count",
    "coverage",
    "ms_per_frame",
    "r_squared",
    "rmse_m",
    "p95_abs_error_m",
    "interval_coverage",
    "spatial_r_squared",
    "spatial_rmse_m",
    "spatial_p95_abs_error_m",
    "spatial_interval_coverage",
    "clearance_r_squared",
    "clearance_rmse_m",
    "clearance_p95_abs_error_m",
    "clearance_interval_coverage",
)

COMPARE_COLUMNS = (
    Column("group", "frames of", is_text=True),
    Column("method", "method", is_text=True),
    Column("frame_count", "n"),
    Column("coverage", "cov. %", percent(1)),
    Column("r_squared", "R²", number(4)),
    Column("rmse_m", "planar RMSE", number(2, 1e3)),
    Column("spatial_rmse_m", "spatial RMSE", number(2, 1e3)),
    Column("spatial_p95_abs_error_m", "p95", number(2, 1e3)),
    Column("spatial_interval_coverage", "in 95 %", percent(1)),
    Column("clearance_rmse_m", "clearance RMSE", number(2, 1e3)),
    Column("clearance_p95_abs_error_m", "p95", number(2, 1e3)),
    Column("clearance_interval_coverage", "in 95 %", percent(1)),
    Column("ms_per_frame", "ms/frame", number(1)),
)

COMPARE_NOTE = (
    "Errors in mm against the simulator's truth; `in 95 %`: share of truths inside the stated 95 % interval;"
    " ms/frame: the method alone, without reading and decoding. –: the method cannot tell."
)


def compare_row(score: MethodScore) -> dict[str, Cell]:
    """One score in SI, flat, with the keys of `COMPARE_KEYS`."""
    row: dict[str, Cell] = {
        "group": score.group,
        "method": score.method,
        "frame_count": score.frame_count,
        "measured_count": score.measured_count,
        "coverage": score.coverage,
        "ms_per_frame": score.ms_per_frame,
    }
    for prefix, part in (("", score.planar), ("spatial_", score.spatial), ("clearance_", score.clearance)):
        row |= _figures(prefix, part)
    return row


def _figures(prefix: str, score: DistanceScore | None) -> dict[str, Cell]:
    statistics = score.statistics if score else None
    return {
        f"{prefix}r_squared": statistics.r_squared if statistics else None,
        f"{prefix}rmse_m": statistics.rmse if statistics else None,
        f"{prefix}p95_abs_error_m": statistics.p95_abs_error if statistics else None,
        f"{prefix}interval_coverage": score.interval_coverage if score else None,
    }
