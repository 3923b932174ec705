"""Scores as rows and tables: of validate, compare and blur-bench, and the ranking of logs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any

from svmdist.errors import printable
from svmdist.estimation.methods import PLANAR_METHODS
from svmdist.metrics import COUNT, LENGTH, SHARE, TEXT, Column, Interval, Unit, finite, row_of
from svmdist.report.tables import Row, Table, counted
from svmdist.report.writers import Results
from svmdist.workflows.compare import BlurTally, MethodScore, pooled_tallies
from svmdist.workflows.scoring import metric_table
from svmdist.workflows.scoring.metric_table import Metric, Output, of_part, within
from svmdist.workflows.scoring.references import Reference
from svmdist.workflows.scoring.scores import Score
from svmdist.workflows.validate import PAPER_R_SQUARED, Validation

VALIDATION_SCHEMA = "svmdist.validation/1"
PAPER_NOTE = (
    f"The paper reports R² = {PAPER_R_SQUARED:.0%} for its own scene and trajectory, without RMSE or n; the scenes"
    " differ, so that figure and ours stand side by side and are not compared."
)
FIGURE_NOTE = (
    "Errors in mm against the truth of logs that have one. ∈95 %: share in % of truths inside the stated 95 % interval."
    " ms: processor time of the method per frame, with its detections, without reading, decoding and degrading."
    " –: the method does not estimate it."
)
PAIR_NOTE = (
    "Differences of two methods say nothing about which of them is right. / σ: RMSE of differences over their joint"
    " standard deviations; about 1 where both are honest and independent, – where either states none."
)
SAME_TOOL_M = 1e-4  # no two measurements of a tool agree to this everywhere
BLUR_NOTE = (
    "The paper's columns are Table I as published. The paper states no kernels, has no row without blur, and used"
    " another scene. Counts are means per frame. The virtual marker is pasted after the blur, so it stays sharp."
)


def _in_order(before: Sequence[Column], metrics: Sequence[Metric], after: Sequence[Column]) -> list[Column]:
    """The columns of a row: labels, metrics, labels, and metrics that came later."""
    early = [metric for metric in metrics if not metric.is_late]
    return [*before, *early, *after, *(metric for metric in metrics if metric.is_late)]


def score_columns() -> list[Column]:
    """The columns of a score. Some may be added at the end, none is renamed or removed."""
    labels = [Column(key, TEXT, key) for key in ("recording", "method", "equations")]
    labels.append(Column("reference", TEXT, "against"))
    instrument = Column("instrument", TEXT, "instrument", lambda score: score.instrument or None)
    return _in_order(labels, within(metric_table.score_metrics(), Output.SCORES), [instrument])


def validation_results(validation: Validation) -> Results:
    """The scores of all recordings, then of groups, then overall."""
    columns, document = score_columns(), validation_document(validation)
    rows = [row_of(columns, one) for one in (*validation.scores, *validation.groups, *validation.overall)]
    return Results(columns, rows, None, validation_tables(validation), remarks(validation), document)


def validation_document(validation: Validation) -> dict[str, Any]:
    """The JSON document: `overall` is the score against the strongest reference, `overall_by_reference` has all."""
    primary, columns = validation.primary, score_columns()

    def of(score: Score) -> dict[str, Any]:
        row = {key: finite(value) for key, value in row_of(columns, score).items()}
        return row | {"rejected": dict(score.rejected)}

    overall, of_first = validation.overall, (primary.instrument, primary.reference) if primary else ("", "")
    return {
        "schema": VALIDATION_SCHEMA,
        "recordings": [of(score) for score in validation.scores],
        "overall": of(primary) if primary else None,
        "overall_by_reference": {str(one.reference): of(one) for one in overall if one.instrument == of_first[0]},
        "overall_by_instrument": {one.instrument: of(one) for one in overall if one.reference == of_first[1]},
        **({"groups": [of(score) for score in validation.groups]} if validation.groups else {}),
        "paper": {"r_squared": PAPER_R_SQUARED, "note": PAPER_NOTE},
        "notes": list(validation.notes),
    }


_NAME = Column("recording", TEXT, "recording", "recording")
_AGAINST = Column("against", TEXT, "against", lambda one: str(one.reference).replace("ground_truth", "truth"))


def _bounds(key: str, unit: Unit) -> Column:
    bound = Column(key, unit)

    def read(score: Score) -> str:
        found: Interval | None = getattr(score.intervals, key)
        return "–" if found is None else f"{bound.show(found.low)}–{bound.show(found.high)}"

    return Column(f"{key}_interval", TEXT, "95 %", read)


_INTERVALS = {"r_squared": [_bounds("r_squared", Unit("1", digits=3))], "rmse_m": [_bounds("rmse", LENGTH)]}
"""The bootstrap interval that is shown beside a metric."""


def validation_tables(validation: Validation) -> list[Table]:
    """The readable tables: planar metrics, those in 3D where there are any, and alarms where asked for."""
    parts = (validation.scores, (*validation.groups, *validation.overall))
    first = validation.scores[0]
    how = f"{first.equations} equations" if first.method in PLANAR_METHODS else "planar distance"
    metrics = metric_table.score_metrics()
    # Lengths in mm, as the title says: a unit in every heading would not fit a terminal.
    planar = [one for of in within(metrics, Output.SCORE_TABLE) for one in (of, *_INTERVALS.get(of.key, []))]
    title = f"{first.method}, {how}; errors and σ (of the truth) in mm; 95 %: bootstrap interval"
    # Where a reference has the tool alone, its table says all.
    shown = [[score for score in part if score.planar or not score.tool] for part in parts]
    tables = [_score_table(title, [_NAME, _AGAINST, *planar], shown)] if any(shown) else []
    if any(score.spatial or score.clearance for part in parts for score in part):
        of_distance = within(metric_table.OF_DISTANCE, Output.DISTANCE_TABLE)
        columns = [_NAME, _AGAINST, Column("distance", TEXT, "distance"), *of_distance]
        title = "in 3D; errors and σ (of the truth) in mm; in 95 %: truths inside the stated interval"
        tables.append(Table.of(title, columns, *(_distance_rows(part, of_distance) for part in parts)))
    if any(shown := [[score for score in part if score.tool] for part in parts]):
        columns = [_NAME, _AGAINST, *within(metrics, Output.TOOL_TABLE)]
        tables.append(_score_table(f"{first.method}, the tool's pose; errors of position in mm", columns, shown))
    if (rules := validation.alarm_rules) is not None:
        alarms = within(metrics, Output.ALARM_TABLE)
        alarms.sort(key=lambda metric: ["unsafe", "alarm_recall", metric.key].index(metric.key))
        shown = [[score for score in part if score.alarms] for part in parts]
        tables.append(_score_table(f"alarms: {rules.in_words}; shares in %, leads in s", [_NAME, *alarms], shown))
    return tables


def _score_table(title: str, columns: Sequence[Column], parts: Iterable[Iterable[Score]]) -> Table:
    return Table.of(title, columns, *([row_of(columns, score) for score in part] for part in parts))


def _distance_rows(scores: Iterable[Score], metrics: list[Metric]) -> Iterator[Row]:
    for score in scores:
        for name in ("planar", "spatial", "clearance"):
            if (part := getattr(score, name)) is not None:
                yield row_of((_NAME, _AGAINST), score) | {"distance": name} | row_of(metrics, part)


def remarks(validation: Validation) -> list[str]:
    """What the tables have no room for, one line per recording; of a planar method also what the paper reports."""
    lines: dict[str, list[str]] = {}
    for score in validation.scores:
        found = ["fitted on this log: left out of the overall row"] if score.fitted_on else []
        if score.rejected:
            reasons = ", ".join(f"{count} {reason}" for reason, count in score.rejected.items())
            found.append(f"not measured: {reasons} of {score.frame_count} frames")
        if score.alarms and score.alarms.unjudged_count:
            unsafe = score.alarms.unsafe_unjudged_count
            missed = f", {unsafe} of them unsafe, which count as missed" if unsafe else ""
            found.append(f"no clearance to alarm by: {score.alarms.unjudged_count} frames{missed}")
        if score.unpaired_count and (score.planar or not (score.spatial or score.clearance or score.tool)):
            found.append(f"measured where there is no {score.reference}: {score.unpaired_count}")
        if score.tool and score.reference is not Reference.GROUND_TRUTH and score.tool.estimate_m.max() < SAME_TOOL_M:
            found.append(f"the tool is that of {score.reference}: of the same kinematics, whose errors do not show")
        if score.lag and score.lag.lag_s != 0.0 and (before := score.uncorrected):
            found.append(f"lag {score.lag.lag_s * 1e3:+.1f} ms (confidence {score.lag.confidence:.2f})")
            r2 = "–" if before.r_squared is None else f"{before.r_squared:.4f}"
            found.append(f"without it against {score.reference}: R² {r2}, RMSE {before.rmse * 1e3:.2f} mm")
        known = lines.setdefault(score.recording, [])
        known += [remark for remark in found if remark not in known]
    planar = any(score.method in PLANAR_METHODS for score in validation.scores)
    remarked = [printable(f"{name}: {'; '.join(found)}") for name, found in lines.items() if found]
    return [*remarked, *([PAPER_NOTE] if planar else [])]


def compare_columns() -> list[Column]:
    """The columns of a comparison."""
    labels = [Column("group", TEXT, of=lambda score: str(score.group)), Column("method", TEXT, "method")]
    after = [Column(key, TEXT, of=f"group.{key}") for key in ("scenario", "degradation")]
    after += [Column("instrument", TEXT), Column("against", TEXT, of=lambda score: score.against or None)]
    return _in_order(labels, of_part(within(metric_table.figure_metrics(), Output.FIGURES), "figures"), after)


def compare_results(scores: Sequence[MethodScore]) -> Results:
    """One row per group and method; one table per group, since one of all would be too wide for a terminal."""
    columns, tables, is_paired = compare_columns(), [], any(score.against for score in scores)
    for (group, paired), members in groupby(scores, lambda score: (score.group, bool(score.against))):
        rows = [row_of(columns, score) for score in members]
        frames = counted(int(rows[0]["frame_count"] or 0), "frame")
        title = f"{group}: {counted(len(rows), 'method')} on {frames}"
        if paired:
            rows = [row | {"method": f"{row['method']} − {row['against']}"} for row in rows]
            title = f"{group}: methods against each other, where both measured, of {frames}"
        tables.append(Table.of(title, _figures_shown(rows, is_paired, paired), rows))
    notes = [FIGURE_NOTE, PAIR_NOTE] if is_paired else [FIGURE_NOTE]
    return Results(columns, [row_of(columns, score) for score in scores], tables=tables, notes=notes)


def _figures_shown(rows: Sequence[Row], with_tool: bool, paired: bool) -> list[Column]:
    """The columns of a comparison's table: those of a distance below its name, the time last."""
    shown = [Column("method", TEXT, "difference" if paired else "method")]
    metrics = within(metric_table.figure_metrics(), Output.PAIR_TABLE if paired else Output.FIGURE_TABLE)
    metrics.sort(key=lambda metric: metric.key == "ms_per_frame")
    for name, of in groupby(metrics, lambda metric: metric.group.replace("clearance", "clear.")):
        group = list(of)
        has_any = any(row[metric.key] is not None for row in rows for metric in group)
        if (with_tool and not has_any) or (name == "tool" and not with_tool):
            continue
        for index, metric in enumerate(group):
            title = metric.narrow_heading or metric.heading
            heading = f"{'' if index else name}\n{title}" if name else title.replace(" ", "\n")
            shown.append(replace(metric, heading=heading))
    return shown


BLUR_COLUMNS = (
    Column("blur", TEXT, "blur"),
    Column("kernel_px", COUNT, "kernel [px]"),
    Column("keypoint_count", Unit(digits=1), "features, alone", "means.0"),
    Column("contour_area_px", Unit("px²", digits=0), "area [px²]", "means.1"),
    Column("marker_keypoint_count", Unit(digits=0), "features, marker", "means.2"),
    Column("match_count", Unit(digits=0), "matches", "means.3"),
    Column("inlier_count", Unit(digits=0), "inliers", "means.4"),
    Column("coverage", SHARE, "coverage [%]", "figures.coverage"),
    Column("rmse_m", Unit("m", 1e3, 3), "RMSE [mm]", "figures.planar.statistics.rmse"),
    Column("frame_count", of="figures.frame_count"),
    Column("paper_keypoint_count", COUNT, "paper", "published.0"),
    Column("paper_contour_area_px", COUNT, "paper", "published.1"),
)


def blur_results(parts: Sequence[Sequence[BlurTally]]) -> Results:
    """The blur bench over several recordings: Table I of the paper beside ours."""
    rows = [row_of(BLUR_COLUMNS, tally) for tally in pooled_tallies(parts)]
    (*ours, _, paper_keypoints, paper_area) = BLUR_COLUMNS
    shown = [*ours[:3], paper_keypoints, ours[3], paper_area, *ours[4:]]
    title = f"{rows[0]['frame_count']} frames of {counted(len(parts), 'recording')}"
    return Results(BLUR_COLUMNS, rows, tables=[Table.of(title, shown, rows)], notes=[BLUR_NOTE])


@dataclass(frozen=True)
class LogFigures:
    """One log, or several together: how its frames ended. `problem` says why there are none, or of how many logs."""

    recording: str
    path: str | None
    group: str | None
    statuses: Counter[str]
    loss_count: int
    problem: str | None = None
    has_failed: bool = False

    @property
    def coverage(self) -> float | None:
        """Measured frames per frame; None without any."""
        return self.statuses["ok"] / self.statuses.total() if self.statuses else None

    @property
    def state(self) -> str:
        """The gravest of failed, nothing measured, loss and ok."""
        if self.has_failed:
            return "failed"
        if not self.statuses["ok"]:
            return "nothing measured"
        return "loss" if self.loss_count or self.problem else "ok"

    @property
    def worst(self) -> tuple[str | None, int | None]:
        """How most of the frames ended that were not measured, and how many did."""
        return next((one for one in self.statuses.most_common() if one[0] != "ok"), (None, None))


LOG_COLUMNS = (
    Column("rank", COUNT, "rank", lambda _: None),
    Column("recording", TEXT, "recording"),
    Column("state", TEXT, "state"),
    Column("frame_count", COUNT, "frames", lambda log: log.statuses.total()),
    Column("measured_count", COUNT, "measured", lambda log: log.statuses["ok"]),
    Column("coverage", SHARE, "coverage [%]"),
    Column("worst", TEXT, "most often", "worst.0"),
    Column("worst_count", COUNT, "frames so", "worst.1"),
    Column("loss_count", COUNT, "losses"),
    Column("reason", TEXT, "reason", "problem"),
    Column("group", TEXT, "group"),
    Column("path", TEXT),
)
"""The contract: columns may be added at the end, none is renamed or removed."""


def ranked(figures: Sequence[LogFigures]) -> list[LogFigures]:
    """Sorted by severity: failed logs, then by the share of frames that were not measured, then by losses."""
    return sorted(figures, key=lambda one: (not one.has_failed, one.coverage or 0.0, -one.loss_count))


def log_results(figures: Sequence[LogFigures]) -> Results:
    """A row per log, worst first, then groups by their names and all logs: every frame counts the same."""
    rows = [row_of(LOG_COLUMNS, one) | {"rank": rank} for rank, one in enumerate(ranked(figures), 1)]
    groups = sorted({one.group for one in figures if one.group})
    for group in (*groups, None):
        members = [one for one in figures if group in (None, one.group)]
        statuses = sum((one.statuses for one in members), Counter[str]())
        losses, failed = (sum(getattr(one, name) for one in members) for name in ("loss_count", "has_failed"))
        problem = f"{failed} of {len(members)} logs failed" if failed else None
        rows.append(row_of(LOG_COLUMNS, LogFigures(group or "overall", None, group, statuses, losses, problem)))
    columns = [column for column in LOG_COLUMNS if column.heading and (groups or column.key != "group")]
    return Results(LOG_COLUMNS, rows, tables=[Table.of("Logs, sorted by severity, worst first", columns, rows)])
