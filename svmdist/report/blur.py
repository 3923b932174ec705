"""The blur bench as rows: Table I of the paper beside ours."""

from __future__ import annotations

from svmdist.report.table import Cell, Column, number, percent
from svmdist.workflows.blur_bench import BlurRow

BLUR_KEYS = (
    "blur",
    "kernel_px",
    "keypoint_count",
    "contour_area_px",
    "marker_keypoint_count",
    "match_count",
    "inlier_count",
    "coverage",
    "rmse_m",
    "frame_count",
    "paper_keypoint_count",
    "paper_contour_area_px",
)

BLUR_COLUMNS = (
    Column("blur", "blur", is_text=True),
    Column("kernel_px", "kernel [px]"),
    Column("keypoint_count", "features, alone", number(1)),
    Column("paper_keypoint_count", "paper", number(0)),
    Column("contour_area_px", "area [px²]", number(0)),
    Column("paper_contour_area_px", "paper", number(0)),
    Column("marker_keypoint_count", "features, marker", number(0)),
    Column("match_count", "matches", number(0)),
    Column("inlier_count", "inliers", number(0)),
    Column("coverage", "coverage [%]", percent(1)),
    Column("rmse_m", "RMSE [mm]", number(3, 1e3)),
)

BLUR_NOTE = (
    "The paper's columns are Table I as printed: it states no kernels and has no clean row, and its scene differs."
    " Counts are means per frame; the marker is virtual, so it is pasted after the blur and stays sharp."
)


def blur_row(row: BlurRow) -> dict[str, Cell]:
    """One row in SI, flat, with the keys of `BLUR_KEYS`."""
    return {
        "blur": str(row.blur),
        "kernel_px": row.kernel_px,
        "keypoint_count": row.keypoint_count,
        "contour_area_px": row.contour_area_px,
        "marker_keypoint_count": row.marker_keypoint_count,
        "match_count": row.match_count,
        "inlier_count": row.inlier_count,
        "coverage": row.coverage,
        "rmse_m": row.rmse_m,
        "frame_count": row.frame_count,
        "paper_keypoint_count": row.printed.keypoint_count if row.printed else None,
        "paper_contour_area_px": row.printed.contour_area_px if row.printed else None,
    }
