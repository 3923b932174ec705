"""Scores of methods as rows and tables: validate, compare, blur-bench, and the ranking of logs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any

from rich.table import Table
from rich.table import Table as RichTable
from rich.text import Text

from svmdist.estimation.methods import PLANAR_METHODS
from svmdist.metrics import ErrorStatistics, coverage
from svmdist.report.tables import (
    Cell,
    Column,
    Row,
    counted,
    json_value,
    metric_column,
    number,
    percent,
    printable,
    rich_table,
)
from svmdist.workflows.blur_bench import BlurRow
from svmdist.workflows.compare import Figures, MethodScore
from svmdist.workflows.degradation_grid import GridCell
from svmdist.workflows.scoring.metric_table import (
    Metric,
    Output,
    cells,
    distance_metrics,
    figure_metrics,
    row_keys,
    score_metrics,
    within,
)
from svmdist.workflows.scoring.score import DistanceScore, Score
from svmdist.workflows.validate import PAPER_R_SQUARED, Validation

GROUP_TITLES = {"": "", "planar": "planar", "spatial": "spatial", "clearance": "clear."}

FIGURE_NOTE = (
    "Errors in mm against the simulator's truth. ∈95 %: share in % of truths inside the stated 95 % interval."
    " ms: processor time of the method per frame, with its detections, without reading, decoding and degrading."
    " –: the method does not estimate it."
)


def figure_keys(before: tuple[str, ...], after: tuple[str, ...] = ()) -> tuple[str, ...]:
    """The columns of a row of figures, with the labels before and after them."""
    return row_keys(before, within(figure_metrics(), Output.FIGURES), after)


def figure_cells(figures: Figures) -> dict[str, Cell]:
    """The figures in SI, flat."""
    return cells(within(figure_metrics(), Output.FIGURES), figures)


def figure_columns() -> list[Column]:
    """The columns for a person: those of a distance stand below its name, and the time is the last one."""
    columns = []
    metrics = sorted(
        within(figure_metrics(), Output.FIGURE_TABLE), key=lambda metric: metric.key == "ms_per_frame"
    )
    for group, members in groupby(metrics, lambda metric: metric.group):
        for index, metric in enumerate(members):
            title = metric.narrow_title or metric.title
            heading = (
                f"{GROUP_TITLES[group] if index == 0 else ''}\n{title}" if group else title.replace(" ", "\n")
            )
            columns.append(metric_column(metric, heading))
    return columns


SCHEMA = "svmdist.validation/1"

PAPER_NOTE = (
    f"The paper reports R² = {PAPER_R_SQUARED:.0%} for its own scene and trajectory, without RMSE or n; the scenes"
    " differ, so that figure and ours stand side by side and are not compared."
)


def score_keys() -> tuple[str, ...]:
    """The columns of a row, in order. Some may be added at the end, none is renamed or removed."""
    labels = ("recording", "method", "equations", "reference")
    return row_keys(labels, within(score_metrics(), Output.SCORES), ("instrument",))


def score_row(score: Score) -> dict[str, Cell]:
    """One score in SI, flat, with the keys of `score_keys()`."""
    values: dict[str, Cell] = {
        "recording": score.recording,
        "method": score.method,
        "equations": score.equations,
        "reference": str(score.reference),
        "instrument": score.instrument or None,
        **cells(within(score_metrics(), Output.SCORES), score),
    }
    return {key: values[key] for key in score_keys()}


def validation_document(validation: Validation) -> dict[str, Any]:
    """The JSON document: `overall` is the score against the strongest reference, `overall_by_reference` has all."""
    primary = validation.primary
    return {
        "schema": SCHEMA,
        "recordings": [_json_score(score) for score in validation.scores],
        "overall": _json_score(primary) if primary else None,
        "overall_by_reference": {
            str(score.reference): _json_score(score)
            for score in validation.overall
            if primary is None or score.instrument == primary.instrument
        },
        "overall_by_instrument": {
            score.instrument: _json_score(score)
            for score in validation.overall
            if primary is None or score.reference is primary.reference
        },
        **({"groups": [_json_score(score) for score in validation.groups]} if validation.groups else {}),
        "paper": {"r_squared": PAPER_R_SQUARED, "note": PAPER_NOTE},
        "notes": list(validation.notes),
    }


def _json_score(score: Score) -> dict[str, Any]:
    """A row whose `rejected` is an object of counts by reason."""
    row = {key: json_value(value) for key, value in score_row(score).items()}
    return row | {"rejected": dict(score.rejected)}


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


def compare_keys() -> tuple[str, ...]:
    """The columns of a row, in order."""
    return figure_keys(("group", "method"), ("scenario", "degradation", "instrument"))


def compare_row(score: MethodScore) -> dict[str, Cell]:
    """One score in SI, flat, with the keys of `compare_keys()`."""
    return {
        "group": str(score.group),
        "method": score.method,
        **figure_cells(score.figures),
        "scenario": score.group.scenario,
        "degradation": score.group.degradation,
        "instrument": score.instrument,
    }


def compare_tables(scores: Sequence[MethodScore]) -> list[RichTable]:
    """One table per group, in the order of the scores: one table of all would be too wide for a terminal."""
    columns = [Column("method", "method", is_text=True), *figure_columns()]
    tables = []
    for group, members in groupby(scores, lambda score: score.group):
        of = list(members)
        frames = counted(of[0].figures.frame_count, "frame")
        title = f"{group}: {counted(len(of), 'method')} on {frames}"
        tables.append(rich_table(title, columns, [compare_row(score) for score in of]))
    return tables


CLEAN_NAME = "none"


def grid_keys() -> tuple[str, ...]:
    """The columns of a row, in order."""
    return figure_keys(("method", "degradation", "severity"))


def grid_row(cell: GridCell) -> dict[str, Cell]:
    """One cell in SI, flat, with the keys of `grid_keys()`; the log as recorded is `none` of severity 0."""
    return {
        "method": cell.method,
        "degradation": str(cell.condition.name or CLEAN_NAME),
        "severity": cell.condition.severity,
        **figure_cells(cell.figures),
    }


def grid_table(title: str, cells: Sequence[GridCell]) -> RichTable:
    """The table for a person."""
    rows = [grid_row(cell) | {"condition": str(cell.condition) or "as recorded"} for cell in cells]
    return rich_table(title, [Column("condition", "images", is_text=True), *figure_columns()], rows)


def recorded_notes(logs: Iterable[tuple[str, Mapping[str, str]]]) -> list[str]:
    """Remarks on logs, by name and metadata, that were degraded when they were recorded."""
    return [
        f"{name} was recorded with {metadata['degrade']}; the grid's degradations come on top."
        for name, metadata in logs
        if "degrade" in metadata
    ]


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


OVERALL = "overall"
LOG_KEYS = (
    "rank",
    "recording",
    "state",
    "frame_count",
    "measured_count",
    "coverage",
    "worst",
    "worst_count",
    "loss_count",
    "reason",
    "group",
    "path",
)
"""The contract: columns may be added at the end, none is renamed or removed."""
LOG_COLUMNS = (
    Column("rank", "rank"),
    Column("recording", "recording", is_text=True),
    Column("state", "state", is_text=True),
    Column("frame_count", "frames"),
    Column("measured_count", "measured"),
    Column("coverage", "coverage [%]", percent(1)),
    Column("worst", "most often", is_text=True),
    Column("worst_count", "frames so"),
    Column("loss_count", "losses"),
    Column("reason", "reason", is_text=True),
    Column("group", "group", is_text=True),
)


@dataclass(frozen=True)
class LogFigures:
    """One log, or several together. `statuses` counts frames by how they ended; `failure` says why there are none."""

    recording: str
    path: str = ""
    failure: str | None = None
    statuses: Mapping[str, int] = field(default_factory=dict)
    loss_count: int = 0
    group: str = ""
    log_count: int = 1
    failed_count: int = 0

    @property
    def frame_count(self) -> int:
        """Number of frames."""
        return sum(self.statuses.values())

    @property
    def measured_count(self) -> int:
        """Number of frames that were measured."""
        return self.statuses.get("ok", 0)

    @property
    def lost_count(self) -> int:
        """Number of frames that were not."""
        return self.frame_count - self.measured_count

    @property
    def worst(self) -> tuple[str | None, int | None]:
        """How most of the frames ended that were not measured, and how many did."""
        found = Counter({status: count for status, count in self.statuses.items() if status != "ok"})
        return found.most_common(1)[0] if found else (None, None)

    @property
    def state(self) -> str:
        """What is to be said first: failed, nothing measured, loss, or ok."""
        if self.failure is not None:
            return "failed"
        if self.measured_count == 0:
            return "nothing measured"
        return "loss" if self.loss_count or self.failed_count else "ok"


def ranked(figures: Sequence[LogFigures]) -> list[LogFigures]:
    """What went wrong most first: what failed, then by the share of frames that were not measured, then by losses.

    Logs with which as much went wrong keep their order.
    """

    def wrong(one: LogFigures) -> tuple[bool, float, int]:
        return one.failure is None, coverage(one.measured_count, one.frame_count), -one.loss_count

    return sorted(figures, key=wrong)


def pooled_log_figures(figures: Sequence[LogFigures]) -> list[LogFigures]:
    """The figures of each group, in the order of their names, and of all logs: every frame counts the same."""
    names = sorted({one.group for one in figures if one.group})
    groups = [_pooled(name, [one for one in figures if one.group == name], name) for name in names]
    return [*groups, _pooled(OVERALL, figures)]


def _pooled(name: str, members: Sequence[LogFigures], group: str = "") -> LogFigures:
    statuses: Counter[str] = Counter()
    for one in members:
        statuses.update(one.statuses)
    return LogFigures(
        name,
        statuses=dict(statuses),
        loss_count=sum(one.loss_count for one in members),
        group=group,
        log_count=len(members),
        failed_count=sum(one.failure is not None for one in members),
    )


def log_rows(each: Sequence[LogFigures], together: Sequence[LogFigures]) -> list[dict[str, Cell]]:
    """A row a log with its rank, then groups and all logs, with the keys of `LOG_KEYS`."""
    rows = [_row(one) | {"rank": rank} for rank, one in enumerate(each, 1)]
    for one in together:
        row = _row(one)
        row["reason"] = f"{one.failed_count} of {one.log_count} logs failed" if one.failed_count else None
        rows.append(row)
    return rows


def _row(one: LogFigures) -> dict[str, Cell]:
    worst, worst_count = one.worst
    return {
        "rank": None,
        "recording": one.recording,
        "state": one.state,
        "frame_count": one.frame_count,
        "measured_count": one.measured_count,
        "coverage": coverage(one.measured_count, one.frame_count) if one.frame_count else None,
        "worst": worst,
        "worst_count": worst_count,
        "loss_count": one.loss_count,
        "reason": one.failure,
        "group": one.group or None,
        "path": one.path or None,
    }


def log_table(each: Sequence[LogFigures], together: Sequence[LogFigures]) -> Table:
    """The same for a person."""
    columns = [column for column in LOG_COLUMNS if column.key != "group" or len(together) > 1]
    return rich_table("Logs, what went wrong most first", columns, log_rows(each, together))
