"""Figures of logs, of groups of them and of all together; and the logs ranked by what went wrong with them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from rich.table import Table

from svmdist.metrics import coverage
from svmdist.report.table import Cell, Column, percent, rich_table

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
