"""`svmdist estimate` of several logs: a task a log, and the rows of all."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from svmdist.cli.console import hearing, say
from svmdist.cli.drawn import Tally
from svmdist.cli.many import Outcomes, group_name, heard_notes, measurement
from svmdist.cli.recordings import open_log
from svmdist.report.scores import LogFigures, pooled_log_figures, ranked
from svmdist.workflows.batch.store import stored_rows
from svmdist.workflows.batch.task import LogFile, Measurement, Outcome, RowWriter

if TYPE_CHECKING:
    from svmdist.estimation.alarms import AlarmRules
    from svmdist.recording.observations import Window
    from svmdist.report.tables import Row
    from svmdist.workflows.lag import Lag
    from svmdist.workflows.request import Setup
    from svmdist.workflows.validate import Measured

MAX_REPORTED = 12
"""The most logs whose frames are held at once, and fill a page."""


@dataclass(frozen=True)
class EstimateResult:
    """How the rows of one log ended: (status, detail, count), in the order in which they first came."""

    tally: tuple[tuple[str, str, int], ...]
    instruments: tuple[str, ...]


@dataclass(frozen=True)
class EstimateJob:
    """What `estimate` does with each log."""

    setup: Setup
    topics: dict[str, str]
    window: Window | None
    wanted: tuple[str, ...] | None
    lag: Lag | None
    rules: AlarmRules | None
    grouped: bool

    @property
    def result_type(self) -> type[EstimateResult]:
        """The type of a result."""
        return EstimateResult

    def measure(self, log: LogFile, threads: int, write: RowWriter) -> Measurement[EstimateResult]:
        """Write the rows of a log."""
        from svmdist.cli.estimate import rows_of

        tally: Tally = Counter()
        with heard_notes() as notes:
            recording = open_log(log, self.setup.profile, self.topics, self.window)
            for row in rows_of(
                recording, self.setup, self.wanted, tally, self.rules, self.lag, threads, None
            ):
                write({key: value for key, value in row.items() if value is not None})
        counts = tuple((status, detail, count) for (status, detail), count in tally.items())
        result = EstimateResult(counts, self.wanted or recording.instruments)
        return measurement(recording, result, notes, grouped=self.grouped)


def rows_of_logs(outcomes: Outcomes[EstimateResult]) -> Iterator[Row]:
    """The rows of all logs, in their order."""
    for one, _ in outcomes.measured:
        if one.rows is not None:
            yield from stored_rows(one.rows)


def tally_of_logs(outcomes: Outcomes[EstimateResult]) -> Tally:
    """How the rows of all logs ended."""
    tally: Tally = Counter()
    for _, result in outcomes.measured:
        for status, detail, count in result.tally:
            tally[status, detail] += count
    return tally


def figures_of_logs(
    outcomes: Outcomes[EstimateResult], keys: Sequence[str]
) -> tuple[list[LogFigures], list[LogFigures]]:
    """The figures of each log, what went wrong most first; and those of groups and of all logs together."""
    each = [_figures(one, keys) for one in outcomes.all]
    return ranked(each), pooled_log_figures(each)


def _figures(one: Outcome[EstimateResult], keys: Sequence[str]) -> LogFigures:
    statuses: Counter[str] = Counter()
    for status, _, count in one.result.tally if one.result else ():
        statuses[status] += count
    return LogFigures(
        recording=one.log.name,
        path=str(one.path),
        failure=one.failure,
        statuses=dict(statuses),
        loss_count=len(one.losses),
        group=group_name(one.metadata, keys) if keys and one.failure is None else "",
    )


def reported_logs(logs: Sequence[LogFile], each: Sequence[LogFigures]) -> list[LogFile]:
    """The logs that a report and a plot show frame by frame: all, or of many those with which most went wrong."""
    by_name = {log.name: log for log in logs}
    usable = [one for one in each if one.failure is None and one.frame_count]
    if len(usable) > MAX_REPORTED:
        say(
            f"svmdist: note: the report and the plot show {MAX_REPORTED} of {len(usable)} logs frame by frame"
        )
        return [by_name[one.recording] for one in usable[:MAX_REPORTED]]
    names = {one.recording for one in usable}
    return [log for log in logs if log.name in names]


def measured_again(job: EstimateJob, logs: Sequence[LogFile], jobs: int | None) -> list[Measured]:
    """The frames of some logs, which results that are kept do not have; what is remarked on them was told already."""
    from svmdist.cli.estimate import rows_of

    measured: list[Measured] = []
    with hearing():
        for log in logs:
            recording = open_log(log, job.setup.profile, job.topics, job.window)
            rows = rows_of(recording, job.setup, job.wanted, Counter(), job.rules, job.lag, jobs, measured)
            deque(rows, maxlen=0)
    return measured
