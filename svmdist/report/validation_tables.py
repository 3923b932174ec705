"""Validation results as tables for a person: planar figures, 3D figures, alarms; and remarks below them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from rich.table import Table as RichTable
from rich.text import Text

from svmdist.alarm_metrics import AlarmStatistics
from svmdist.estimation.methods import PLANAR_METHODS
from svmdist.metrics import ErrorStatistics
from svmdist.report.table import Cell, Column, Row, number, percent, rich_table
from svmdist.report.text import printable
from svmdist.report.validation import PAPER_NOTE, score_row
from svmdist.workflows.scoring.distances import score_pairs
from svmdist.workflows.scoring.score import Score
from svmdist.workflows.validate import Validation

_AGAINST = Column(
    "reference", "against", lambda name: "truth" if name == "ground_truth" else str(name), is_text=True
)

COLUMNS = (
    Column("recording", "recording", is_text=True),
    _AGAINST,
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

DISTANCE_COLUMNS = (
    Column("recording", "recording", is_text=True),
    _AGAINST,
    Column("distance", "distance", is_text=True),
    Column("count", "n"),
    Column("r_squared", "R²", number(4)),
    Column("rmse_m", "RMSE", number(2, 1e3)),
    Column("p95_abs_error_m", "p95", number(2, 1e3)),
    Column("bias_m", "bias", number(2, 1e3)),
    Column("truth_std_m", "σ", number(2, 1e3)),
    Column("interval_coverage", "in 95 %", percent(1)),
)

ALARM_COLUMNS = (
    Column("recording", "recording", is_text=True),
    Column("unsafe", "unsafe"),
    Column("alarm_recall", "recall", percent(1)),
    Column("alarm_precision", "precision", percent(1)),
    Column("false_alarm_fraction", "safe alarmed", percent(1)),
    Column("false_alarms_per_minute", "false/min", number(1)),
    Column("warned", "warned"),
    Column("alarm_lead_median_s", "lead", number(2)),
    Column("alarm_lead_min_s", "least", number(2)),
)


def validation_tables(validation: Validation) -> list[RichTable]:
    """The tables for a person: planar figures, those in 3D where there are any, and alarms where asked for."""
    tables = [validation_table(validation)]
    scores = (*validation.scores, *validation.overall)
    if any(score.spatial or score.clearance for score in scores):
        tables.append(distance_table(validation))
    if validation.alarm_rules is not None:
        tables.append(alarm_table(validation))
    return tables


def validation_table(validation: Validation) -> RichTable:
    """The table for a person: a row a recording and reference, then the overall rows."""
    first = next(iter(validation.scores))
    how = f"{first.equations} equations" if first.method in PLANAR_METHODS else "planar distance"
    return _table(
        f"{first.method}, {how}; errors and σ (of the truth) in mm; 95 %: bootstrap interval",
        COLUMNS,
        [_shown(score) for score in validation.scores],
        [_shown(score) for score in validation.overall],
    )


def distance_table(validation: Validation) -> RichTable:
    """The three distances side by side, a row a recording, reference and distance."""
    return _table(
        "in 3D; errors and σ (of the truth) in mm; in 95 %: truths inside the stated interval",
        DISTANCE_COLUMNS,
        _distance_rows(validation.scores),
        _distance_rows(validation.overall),
    )


def alarm_table(validation: Validation) -> RichTable:
    """How alarms did, a row a recording."""
    rules = validation.alarm_rules
    assert rules is not None
    return _table(
        f"alarms: clearance below {rules.below_m * 1e3:g} mm with P ≥ {rules.confidence:g}; shares in %, leads in s",
        ALARM_COLUMNS,
        [_alarm_row(score, score.alarms) for score in validation.scores if score.alarms],
        [_alarm_row(score, score.alarms) for score in validation.overall if score.alarms],
    )


def _alarm_row(score: Score, alarms: AlarmStatistics) -> Row:
    return score_row(score) | {
        "unsafe": f"{alarms.unsafe_count} of {alarms.frame_count}",
        "warned": f"{alarms.event_count - alarms.missed_event_count} of {alarms.event_count}",
    }


def _distance_rows(scores: Iterable[Score]) -> Iterator[Row]:
    for score in scores:
        parts = {"planar": score_pairs(score.pairs), "spatial": score.spatial, "clearance": score.clearance}
        for name, part in parts.items():
            if part is not None:
                yield {
                    "recording": score.recording,
                    "reference": str(score.reference),
                    "distance": name,
                    "count": part.statistics.count,
                    "r_squared": part.statistics.r_squared,
                    "rmse_m": part.statistics.rmse,
                    "p95_abs_error_m": part.statistics.p95_abs_error,
                    "bias_m": part.statistics.bias,
                    "truth_std_m": part.statistics.truth_std,
                    "interval_coverage": part.interval_coverage,
                }


def _table(title: str, columns: Sequence[Column], rows: Iterable[Row], overall: Iterable[Row]) -> RichTable:
    """A table whose last rows, over all recordings, stand apart."""
    table = rich_table(title, columns, rows)
    table.add_section()
    for row in overall:
        table.add_row(
            *(Text(printable(column.show(row.get(column.key)))) for column in columns), style="bold"
        )
    return table


def remarks(validation: Validation) -> list[str]:
    """What the table has no room for, a line a recording: frames that were lost, lag, and what was fitted on.

    Last, of a planar method, what the paper reports.
    """
    lines: dict[str, list[str]] = {}
    for score in validation.scores:
        found = ["fitted on this log: left out of the overall row"] if score.fitted_on else []
        if score.rejected:
            reasons = ", ".join(f"{count} {reason}" for reason, count in score.rejected.items())
            found.append(f"not measured: {reasons} of {score.frame_count} frames")
        if score.alarms and score.alarms.unjudged_count:
            found.append(f"no clearance to alarm by: {score.alarms.unjudged_count} frames")
        if score.unpaired_count:
            found.append(f"measured where there is no {score.reference}: {score.unpaired_count}")
        if score.lag and score.lag.lag_s != 0.0 and score.uncorrected:
            found.append(f"lag {score.lag.lag_s * 1e3:+.1f} ms (confidence {score.lag.confidence:.2f})")
            found.append(f"without it against {score.reference}: {_figures(score.uncorrected)}")
        known = lines.setdefault(score.recording, [])
        known += [remark for remark in found if remark not in known]
    told = [printable(f"{name}: {'; '.join(found)}") for name, found in lines.items() if found]
    return [*told, PAPER_NOTE] if any(score.method in PLANAR_METHODS for score in validation.scores) else told


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
