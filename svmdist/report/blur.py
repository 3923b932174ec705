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
    "The paper's columns are Table I as published. The paper states no kernels, has no row without blur, and used"
    " another scene. Counts are means per frame. The virtual marker is pasted after the blur, so it stays sharp."
)


def blur_row(row: BlurRow) -> dict[str, Cell]:
    """One row in SI, flat, with the keys of `BLUR_KEYS`."""
    printed = row.printed
    return {
        **{key: getattr(row, key) for key in BLUR_KEYS if not key.startswith("paper_")},
        "blur": str(row.blur),
        "paper_keypoint_count": printed.keypoint_count if printed else None,
        "paper_contour_area_px": printed.contour_area_px if printed else None,
    }
