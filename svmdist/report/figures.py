"""The figures of a replay as cells and columns, shared by the comparison and the degradation grid."""

from __future__ import annotations

from svmdist.report.table import Cell, Column, number, percent
from svmdist.workflows.replay import Figures
from svmdist.workflows.scoring.distances import DistanceScore

FIGURE_KEYS = (
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

FIGURE_COLUMNS = (
    Column("coverage", "cov.\n%", percent(1)),
    Column("r_squared", "planar\nR²", number(4)),
    Column("rmse_m", "\nRMSE", number(2, 1e3)),
    Column("p95_abs_error_m", "\np95", number(2, 1e3)),
    Column("interval_coverage", "\n∈95 %", percent(1)),
    Column("spatial_rmse_m", "spatial\nRMSE", number(2, 1e3)),
    Column("spatial_p95_abs_error_m", "\np95", number(2, 1e3)),
    Column("spatial_interval_coverage", "\n∈95 %", percent(1)),
    Column("clearance_rmse_m", "clear.\nRMSE", number(2, 1e3)),
    Column("clearance_p95_abs_error_m", "\np95", number(2, 1e3)),
    Column("clearance_interval_coverage", "\n∈95 %", percent(1)),
    Column("ms_per_frame", "ms", number(0)),
)

FIGURE_NOTE = (
    "Errors in mm against the simulator's truth; ∈95 %: share in % of truths inside the stated 95 % interval;"
    " ms: a frame's time, the method alone, without reading, decoding and degrading. –: the method cannot tell."
)


def figure_cells(figures: Figures) -> dict[str, Cell]:
    """The figures in SI, flat, with the keys of `FIGURE_KEYS`."""
    cells: dict[str, Cell] = {
        "frame_count": figures.frame_count,
        "measured_count": figures.measured_count,
        "coverage": figures.coverage,
        "ms_per_frame": figures.ms_per_frame,
    }
    for prefix, part in (
        ("", figures.planar),
        ("spatial_", figures.spatial),
        ("clearance_", figures.clearance),
    ):
        cells |= _distance_cells(prefix, part)
    return cells


def _distance_cells(prefix: str, score: DistanceScore | None) -> dict[str, Cell]:
    statistics = score.statistics if score else None
    return {
        f"{prefix}r_squared": statistics.r_squared if statistics else None,
        f"{prefix}rmse_m": statistics.rmse if statistics else None,
        f"{prefix}p95_abs_error_m": statistics.p95_abs_error if statistics else None,
        f"{prefix}interval_coverage": score.interval_coverage if score else None,
    }
