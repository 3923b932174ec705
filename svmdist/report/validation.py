"""Validation results as tables and as the JSON document `svmdist.validation/1`."""

from __future__ import annotations

from typing import Any

from rich.table import Table as RichTable
from rich.text import Text

from svmdist.metrics import ErrorStatistics
from svmdist.report.table import Cell, Column, json_value, number, percent, rich_table
from svmdist.report.text import printable
from svmdist.workflows.validate import PAPER_R_SQUARED, Score, Validation

SCHEMA = "svmdist.validation/1"

VALIDATION_KEYS = (
    "recording",
    "method",
    "equations",
    "reference",
    "sample_count",
    "rejected_count",
    "coverage",
    "r_squared",
    "rmse_m",
    "mae_m",
    "median_abs_error_m",
    "p95_abs_error_m",
    "max_abs_error_m",
    "bias_m",
    "truth_std_m",
    "pearson_r",
    "frame_count",
    "unpaired_count",
    "rmse_low_m",
    "rmse_high_m",
    "r_squared_low",
    "r_squared_high",
    "fitted_on",
    "rejected",
    "lag_s",
    "lag_confidence",
    "r_squared_uncorrected",
    "rmse_uncorrected_m",
)
"""Columns of the CSV. In JSON `rejected` is an object of counts by reason."""

COLUMNS = (
    Column("recording", "recording", is_text=True),
    Column(
        "reference", "against", lambda name: "truth" if name == "ground_truth" else str(name), is_text=True
    ),
    Column("sample_count", "n"),
    Column("coverage", "cov. %", percent(1)),
    Column("r_squared", "R²", number(4)),
    Column("r_squared_interval", "95 %", is_text=True),
    Column("rmse_m", "RMSE", number(2, 1e3)),
    Column("rmse_interval", "95 %", is_text=True),
    Column("mae_m", "MAE", number(2, 1e3)),
    Column("median_abs_error_m", "med.", number(2, 1e3)),
    Column("p95_abs_error_m", "p95", number(2, 1e3)),
    Column("max_abs_error_m", "max", number(2, 1e3)),
    Column("bias_m", "bias", number(2, 1e3)),
    Column("truth_std_m", "σ", number(2, 1e3)),
    Column("pearson_r", "r", number(4)),
)
"""Lengths in mm, as the title says: a unit in every heading would not fit a terminal."""

FULL_WIDTH = 124
"""Columns of a terminal that the whole table needs."""

PAPER_NOTE = (
    f"The paper reports R² = {PAPER_R_SQUARED:.0%} for its own scene and trajectory, without RMSE or n; the scenes"
    " differ, so that figure and ours stand side by side and are not compared."
)


def score_row(score: Score) -> dict[str, Cell]:
    """One score in SI, flat, with the keys of `VALIDATION_KEYS`."""
    statistics, rmse, r2 = score.statistics, score.rmse_interval_m, score.r_squared_interval
    lag, uncorrected = score.lag, score.uncorrected
    return {
        "recording": score.recording,
        "method": score.method,
        "equations": score.equations,
        "reference": str(score.reference),
        "sample_count": score.sample_count,
        "rejected_count": score.rejected_count,
        "coverage": score.coverage,
        "r_squared": statistics.r_squared if statistics else None,
        "rmse_m": statistics.rmse if statistics else None,
        "mae_m": statistics.mae if statistics else None,
        "median_abs_error_m": statistics.median_abs_error if statistics else None,
        "p95_abs_error_m": statistics.p95_abs_error if statistics else None,
        "max_abs_error_m": statistics.max_abs_error if statistics else None,
        "bias_m": statistics.bias if statistics else None,
        "truth_std_m": statistics.truth_std if statistics else None,
        "pearson_r": statistics.pearson_r if statistics else None,
        "frame_count": score.frame_count,
        "unpaired_count": score.unpaired_count,
        "rmse_low_m": rmse.low if rmse else None,
        "rmse_high_m": rmse.high if rmse else None,
        "r_squared_low": r2.low if r2 else None,
        "r_squared_high": r2.high if r2 else None,
        "fitted_on": score.fitted_on,
        "rejected": " ".join(f"{reason}={count}" for reason, count in score.rejected.items()),
        "lag_s": lag.lag_s if lag else None,
        "lag_confidence": lag.confidence if lag else None,
        "r_squared_uncorrected": uncorrected.r_squared if uncorrected else None,
        "rmse_uncorrected_m": uncorrected.rmse if uncorrected else None,
    }


def validation_document(validation: Validation) -> dict[str, Any]:
    """The JSON document: `overall` is the score against the strongest reference, `overall_by_reference` all."""
    primary = validation.primary
    return {
        "schema": SCHEMA,
        "recordings": [_json_score(score) for score in validation.scores],
        "overall": _json_score(primary) if primary else None,
        "overall_by_reference": {str(score.reference): _json_score(score) for score in validation.overall},
        "paper": {"r_squared": PAPER_R_SQUARED, "note": PAPER_NOTE},
        "notes": list(validation.notes),
    }


def validation_table(validation: Validation, width: int | None = None) -> RichTable:
    """The table for a person: a row a recording and reference, then the overall rows.

    In a terminal narrower than `FULL_WIDTH` the intervals are left out, rather than every cell broken.
    """
    first = next(iter(validation.scores))
    narrow = width is not None and width < FULL_WIDTH
    columns = [column for column in COLUMNS if not (narrow and column.key.endswith("_interval"))]
    table = rich_table(
        f"{first.method}, {first.equations} equations; errors and σ (of the truth) in mm; 95 %: bootstrap interval",
        columns,
        [_shown(score) for score in validation.scores],
    )
    table.add_section()
    for row in [_shown(score) for score in validation.overall]:
        table.add_row(
            *(Text(printable(column.show(row.get(column.key)))) for column in columns), style="bold"
        )
    return table


def remarks(validation: Validation) -> list[str]:
    """What the table has no room for, a line a recording: frames that were lost, lag, and what was fitted on."""
    lines: dict[str, list[str]] = {}
    for score in validation.scores:
        found = ["fitted on this log: left out of the overall row"] if score.fitted_on else []
        if score.rejected:
            reasons = ", ".join(f"{count} {reason}" for reason, count in score.rejected.items())
            found.append(f"not measured: {reasons} of {score.frame_count} frames")
        if score.unpaired_count:
            found.append(f"measured where there is no {score.reference}: {score.unpaired_count}")
        if score.lag and score.lag.lag_s != 0.0 and score.uncorrected:
            found.append(f"lag {score.lag.lag_s * 1e3:+.1f} ms (confidence {score.lag.confidence:.2f})")
            found.append(f"without it against {score.reference}: {_figures(score.uncorrected)}")
        known = lines.setdefault(score.recording, [])
        known += [remark for remark in found if remark not in known]
    return [printable(f"{name}: {'; '.join(found)}") for name, found in lines.items() if found]


def _shown(score: Score) -> dict[str, Cell]:
    row = score_row(score)
    rmse, r2 = score.rmse_interval_m, score.r_squared_interval
    return row | {
        "rmse_interval": f"{rmse.low * 1e3:.2f}–{rmse.high * 1e3:.2f}" if rmse else "–",
        "r_squared_interval": f"{r2.low:.3f}–{r2.high:.3f}" if r2 else "–",
    }


def _figures(statistics: ErrorStatistics) -> str:
    r2 = "–" if statistics.r_squared is None else f"{statistics.r_squared:.4f}"
    return f"R² {r2}, RMSE {statistics.rmse * 1e3:.2f} mm"


def _json_score(score: Score) -> dict[str, Any]:
    return {key: json_value(value) for key, value in score_row(score).items()} | {
        "rejected": dict(score.rejected)
    }
