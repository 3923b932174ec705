"""`svmdist estimate`: one row a frame."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator
from itertools import chain
from typing import TYPE_CHECKING

import typer

from svmdist.cli.alarms import AlarmBelowOption, AlarmConfidenceOption, alarm_rules
from svmdist.cli.console import ExitCode, Verbosity, say, terminal_width, write_results
from svmdist.cli.drawn import DrawnJob, Tally, write_drawn
from svmdist.cli.estimate_targets import EstimateTargets
from svmdist.cli.log_summary import LogSummary, SummaryOption
from svmdist.cli.many import GroupOption, Many, ResumeOption, SchedulerOption
from svmdist.cli.options import (
    CalibrationOption,
    EquationsChoice,
    EquationsOption,
    Files,
    HandEyeOption,
    InstrumentOption,
    JobsOption,
    LagOption,
    Method,
    MethodOption,
    OutputOption,
    PlotOption,
    ProfileOption,
    ReportOption,
    RowFormatOption,
    TopicOption,
    instruments_of,
    parse_lag,
    topics_of,
)
from svmdist.cli.outputs import ForceOption
from svmdist.cli.progress import tracked
from svmdist.cli.recordings import (
    EndOption,
    EveryOption,
    Opened,
    StartOption,
    local_logs,
    named_logs,
    open_recordings,
    window_of,
)
from svmdist.errors import UsageError
from svmdist.report.writers import Results

if TYPE_CHECKING:
    from svmdist.cli.estimate_logs import EstimateJob
    from svmdist.estimation.alarms import AlarmRules
    from svmdist.recording.log import Recording
    from svmdist.report.tables import Row
    from svmdist.results import FrameResult
    from svmdist.workflows.lag import Lag
    from svmdist.workflows.request import Setup
    from svmdist.workflows.validate import Measured


def estimate_command(
    files: Files,
    method: MethodOption = Method.OVERLAY,
    equations: EquationsOption = EquationsChoice.CORRECTED,
    calibration: CalibrationOption = None,
    profile: ProfileOption = "psm13",
    hand_eye: HandEyeOption = None,
    topic: TopicOption = None,
    form: RowFormatOption = None,
    output: OutputOption = None,
    alarm_below: AlarmBelowOption = None,
    alarm_confidence: AlarmConfidenceOption = None,
    instrument: InstrumentOption = None,
    lag: LagOption = None,
    jobs: JobsOption = None,
    force: ForceOption = False,
    report: ReportOption = None,
    save_plot: PlotOption = None,
    start: StartOption = 0.0,
    end: EndOption = None,
    every: EveryOption = 1,
    scheduler: SchedulerOption = None,
    resume: ResumeOption = None,
    summary: SummaryOption = None,
    group: GroupOption = None,
) -> None:
    """Estimate the distance in every frame.

    There is one row per frame, and per instrument where the log has several that the profile names. To a file that
    ends in .mcap goes a copy of the recording with what was found and measured drawn on its images, for Foxglove,
    Lichtblick and Rerun; to one in .mp4, a video of the same; to one in .html, a report; to one in .parquet, a table
    for pandas and Arrow.

    Several logs are measured by --jobs processes. One that cannot be measured is reported at the end, and the others
    are measured all the same.
    """
    from svmdist.estimation.methods import PLANAR_METHODS
    from svmdist.workflows.request import prepare
    from svmdist.workflows.scoring.score import require_clearance

    logs = named_logs(files)
    targets = EstimateTargets.of(form, output, report, save_plot)
    targets.check(local_logs(logs), len(logs))
    summaries = LogSummary.of(summary, group, local_logs(logs))
    given = parse_lag(lag)
    rules = alarm_rules(alarm_below, alarm_confidence, method.value)
    setup = prepare(profile, method.value, equations.value, calibration, hand_eye)
    if rules:
        require_clearance(setup.method, setup.profile)
    window = window_of(start, end, every)
    wanted = instruments_of(instrument, setup.profile)
    if targets.is_trajectory and setup.method in PLANAR_METHODS:
        raise UsageError(
            f"--format tum writes the tool's pose, and {method} knows none: choose a method in 3D"
        )
    many = Many(logs, jobs, scheduler, resume)
    if targets.drawn and (many.is_asked_for or summaries.is_asked_for):
        raise UsageError(
            f"--scheduler, --resume and --summary go with rows: write {targets.drawn[0]} by itself"
        )
    if targets.drawn is None and (len(logs) > 1 or many.is_asked_for or summaries.is_asked_for):
        from svmdist.cli.estimate_logs import EstimateJob

        job = EstimateJob(setup, topics_of(topic), window, wanted, given, rules, bool(summaries.keys))
        raise typer.Exit(_estimate_many(many, job, targets, summaries))
    opened = open_recordings(logs, setup.profile, topics_of(topic), window)
    recordings = opened.recordings
    several = any(len(wanted or recording.instruments) > 1 for recording in recordings)
    _require_one_trajectory(targets, several)
    tally: Tally = Counter()
    measured: list[Measured] = []
    if targets.drawn is not None:
        drawn = DrawnJob(recordings[0], setup, rules, wanted, given, jobs)
        write_drawn(drawn, *targets.drawn, tally, force=force)
    else:
        kept = measured if targets.needs_rows_kept else None
        rows = _started(_rows(opened, setup, wanted, tally, rules, given, jobs, kept))
        if targets.form is None or terminal_width(targets.output) is None:
            # Rows on a terminal show by themselves how far the command is.
            counts = [one.image_count() for one in recordings]
            total = None if None in counts else sum(count or 0 for count in counts)
            rows = tracked(rows, "measuring", "rows", total if not several else None)
        planar = setup.method in PLANAR_METHODS
        if targets.form is None:
            deque(rows, maxlen=0)
        else:
            _write_rows(targets, rows, rules is not None, several, planar)
    _summarise(tally)
    targets.write_pictures(measured, setup, rules, jobs)
    raise typer.Exit(_code(opened.health_code(), tally))


def _estimate_many(many: Many, job: EstimateJob, targets: EstimateTargets, summaries: LogSummary) -> ExitCode:
    from svmdist.cli.estimate_logs import (
        figures_of_logs,
        measured_again,
        reported_logs,
        rows_of_logs,
        tally_of_logs,
    )
    from svmdist.estimation.methods import PLANAR_METHODS
    from svmdist.report.scores import log_results

    with many.measured(job, "measuring") as outcomes:
        tally = tally_of_logs(outcomes)
        if targets.form is not None:
            several = any(len(result.instruments) > 1 for _, result in outcomes.measured)
            _require_one_trajectory(targets, several)
            planar = job.setup.method in PLANAR_METHODS
            _write_rows(targets, rows_of_logs(outcomes), job.rules is not None, several, planar)
        each, together = figures_of_logs(outcomes, summaries.keys)
        summaries.write(each, together)
        _summarise(tally)
        if targets.needs_rows_kept:
            measured = measured_again(job, reported_logs(many.logs, each), many.jobs)
            targets.write_pictures(measured, job.setup, job.rules, many.jobs, log_results(each, together))
        return _code(outcomes.code(), tally)


def _code(code: ExitCode, tally: Tally) -> ExitCode:
    """The exit code, where nothing may have been measured: the summary says why."""
    if code is ExitCode.CLEAN and not any(status == "ok" for status, _ in tally):
        return ExitCode.UNUSABLE
    return code


def _require_one_trajectory(targets: EstimateTargets, several: bool) -> None:
    if targets.is_trajectory and several:
        raise UsageError("--format tum writes one trajectory: choose an instrument with --instrument")


def _write_rows(
    targets: EstimateTargets, rows: Iterator[Row], with_alarms: bool, several: bool, planar: bool
) -> None:
    from svmdist.report.rows import ESTIMATE_COLUMNS, shown_columns
    from svmdist.report.tables import text_lines

    def text(width: int | None) -> Iterator[str]:
        columns = shown_columns(width, planar=planar, several=several, alarms=with_alarms)
        return text_lines(columns, rows)

    assert targets.form is not None
    write_results(Results(ESTIMATE_COLUMNS, rows, text), targets.form, targets.output)


def _rows(
    opened: Opened,
    setup: Setup,
    wanted: tuple[str, ...] | None,
    tally: Tally,
    rules: AlarmRules | None,
    lag: Lag | None,
    jobs: int | None,
    measured: list[Measured] | None = None,
) -> Iterator[Row]:
    """The rows of all recordings; one of several that cannot be measured is told, and left out."""
    from svmdist.errors import RecordingError

    for recording in opened.recordings:
        try:
            yield from rows_of(recording, setup, wanted, tally, rules, lag, jobs, measured)
        except RecordingError as problem:
            opened.fail(problem)


def rows_of(
    recording: Recording,
    setup: Setup,
    wanted: tuple[str, ...] | None,
    tally: Tally,
    rules: AlarmRules | None,
    lag: Lag | None,
    jobs: int | None,
    measured: list[Measured] | None,
) -> Iterator[Row]:
    """The rows of one recording; `tally` counts how they ended, `measured` gets all of them where it is given."""
    from svmdist.cli.lag import told_lag
    from svmdist.estimation.alarms import AlarmWatch
    from svmdist.estimation.lag import LagEstimate
    from svmdist.report.rows import estimate_row
    from svmdist.workflows.estimate import estimate
    from svmdist.workflows.validate import Measured

    for warning in setup.degeneracies(recording.camera):
        say(f"svmdist: warning: {warning}")
    seen = told_lag(recording, setup, lag, wanted, jobs)
    start_ns: int | None = None
    kept: list[FrameResult] = []
    watches = {name: AlarmWatch(rules) for name in recording.instruments} if rules else {}
    for row in estimate(seen, setup, wanted, jobs):
        start_ns = row.stamp_ns if start_ns is None else start_ns
        tally[str(row.status), row.detail] += 1
        if measured is not None:
            kept.append(row)
        alarm = watches[row.instrument].watch(row) if watches else None
        yield estimate_row(recording.name, row, setup.method, setup.equations, start_ns, alarm)
    if measured is not None:
        found = LagEstimate(seen.lag.lag_s, seen.lag.std_s, 1.0) if seen.lag else None
        measured.append(Measured(recording, seen, tuple(kept), found))


def _started(rows: Iterator[Row]) -> Iterator[Row]:
    """Measure the first row at once, so that a log that cannot be read leaves no header behind."""
    first = next(rows, None)
    return iter(()) if first is None else chain([first], rows)


def _summarise(tally: Tally) -> None:
    total = sum(tally.values())
    if total == 0:
        say(
            "svmdist: no frame to measure: the log has no image, or none between --start and --end",
            Verbosity.QUIET,
        )
        return
    measured = sum(count for (status, _), count in tally.items() if status == "ok")
    reasons = sorted({status for status, _ in tally} - {"ok"})
    lost = ", ".join(_lost_by(reason, tally) for reason in reasons)
    say(
        f"svmdist: {measured} of {total} frames measured ({measured / total:.1%})"
        + (f"; {lost}" if lost else "")
    )


def _lost_by(reason: str, tally: Tally) -> str:
    """How many frames ended so, and the detail that most of them have, where they have one."""
    details = Counter({detail: count for (status, detail), count in tally.items() if status == reason})
    ((commonest, _),) = details.most_common(1)
    return f"{details.total()} {reason}" + (f" ({commonest})" if commonest else "")
