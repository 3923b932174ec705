"""Validation results as tables for a person: planar figures, 3D figures, alarms; and remarks below them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from rich.table import Table as RichTable
from rich.text import Text

from svmdist.estimation.methods import PLANAR_METHODS
from svmdist.metrics import ErrorStatistics
from svmdist.report.table import Column, Row, metric_column, number, rich_table
from svmdist.report.text import printable
from svmdist.report.validation import PAPER_NOTE, score_row
from svmdist.workflows.scoring.distances import DistanceScore
from svmdist.workflows.scoring.metric_table import (
    Metric,
    Output,
    cells,
    distance_metrics,
    score_metrics,
    within,
)
from svmdist.workflows.scoring.score import Score
from svmdist.workflows.validate import Validation

_AGAINST = Column(
    "reference", "against", lambda name: "truth" if name == "ground_truth" else str(name), is_text=True
)

_NAME = Column("recording", "recording", is_text=True)
_BOUNDS = {
    "r_squared": ("r_squared_low", "r_squared_high", 1.0, 3),
    "rmse_m": ("rmse_low_m", "rmse_high_m", 1e3, 2),
}
"""Metrics beside which their bootstrap interval is shown: its bounds in a row, and how they are shown."""


def validation_tables(validation: Validation) -> list[RichTable]:
    """The tables for a person: planar figures, those in 3D where there are any, and alarms where asked for."""
    tables = [validation_table(validation)]
    scores = (*validation.scores, *validation.groups, *validation.overall)
    if any(score.spatial or score.clearance for score in scores):
        tables.append(distance_table(validation))
    if validation.alarm_rules is not None:
        tables.append(alarm_table(validation))
    return tables


def validation_table(validation: Validation) -> RichTable:
    """The table for a person: one row per recording and reference, then the overall rows."""
    first = next(iter(validation.scores))
    how = f"{first.equations} equations" if first.method in PLANAR_METHODS else "planar distance"
    columns = [_NAME, _AGAINST]
    for metric in within(score_metrics(), Output.SCORE_TABLE):
        # Lengths in mm, as the title says: a unit in every heading would not fit a terminal.
        columns.append(metric_column(metric))
        if metric.key in _BOUNDS:
            columns.append(Column(f"{metric.key} interval", "95 %", is_text=True))
    return _table(
        f"{first.method}, {how}; errors and σ (of the truth) in mm; 95 %: bootstrap interval",
        columns,
        [_shown(score) for score in validation.scores],
        [_shown(score) for score in (*validation.groups, *validation.overall)],
    )


def distance_table(validation: Validation) -> RichTable:
    """The three distances side by side: one row per recording, reference and distance."""
    metrics = within(distance_metrics(), Output.DISTANCE_TABLE)
    columns = [_NAME, _AGAINST, Column("distance", "distance", is_text=True), *map(metric_column, metrics)]
    return _table(
        "in 3D; errors and σ (of the truth) in mm; in 95 %: truths inside the stated interval",
        columns,
        _distance_rows(validation.scores, metrics),
        _distance_rows((*validation.groups, *validation.overall), metrics),
    )


def alarm_table(validation: Validation) -> RichTable:
    """How alarms did: one row per recording; the recall stands before the precision."""
    rules = validation.alarm_rules
    assert rules is not None
    metrics = within(score_metrics(), Output.ALARM_TABLE)
    metrics.sort(key=lambda metric: ["unsafe", "alarm_recall", metric.key].index(metric.key))
    rows, overall = (
        [{"recording": score.recording, **cells(metrics, score)} for score in scores if score.alarms]
        for scores in (validation.scores, (*validation.groups, *validation.overall))
    )
    title = f"alarms: clearance below {rules.below_m * 1e3:g} mm with P ≥ {rules.confidence:g}; shares in %, leads in s"
    return _table(title, [_NAME, *map(metric_column, metrics)], rows, overall)


def _distance_rows(scores: Iterable[Score], metrics: list[Metric[DistanceScore]]) -> Iterator[Row]:
    for score in scores:
        for distance in ("planar", "spatial", "clearance"):
            part: DistanceScore | None = getattr(score, distance)
            if part is not None:
                yield {
                    "recording": score.recording,
                    "reference": str(score.reference),
                    "distance": distance,
                    **cells(metrics, part),
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
    """What the table has no room for, one line per recording: frames that were not measured, lag, fitted logs.

    For a planar method, the last line says what the paper reports.
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


def _shown(score: Score) -> Row:
    """A row with its bootstrap intervals as texts."""
    row = score_row(score) | cells(within(score_metrics(), Output.SCORE_TABLE), score)
    for key, (low, high, factor, digits) in _BOUNDS.items():
        bounds = [number(digits, factor)(row[bound]) for bound in (low, high)]
        row[f"{key} interval"] = "–" if row[low] is None else "–".join(bounds)
    return row


def _figures(statistics: ErrorStatistics) -> str:
    r2 = number(4)(statistics.r_squared)
    return f"R² {r2}, RMSE {statistics.rmse * 1e3:.2f} mm"
