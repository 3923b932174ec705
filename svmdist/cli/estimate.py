"""`svmdist estimate`: one row per frame."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Generator, Iterator
from contextlib import nullcontext
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from svmdist.cli.logs import Logs, Run, log_losses
from svmdist.cli.options import (
    PLOT,
    REPORT,
    GroupOption,
    LogOptions,
    MeasureOptions,
    RowFormat,
    format_option,
    option,
    output_option,
)
from svmdist.cli.output import (
    LOG,
    ExitCode,
    FileFormat,
    Summary,
    command_line,
    no_progress,
    progress_bar,
    require_output,
    require_plot,
    require_report,
    row_format,
    started,
    summary_format,
    terminal_width,
    tracked,
    write_lines,
    write_summary,
)
from svmdist.errors import UsageError

if TYPE_CHECKING:
    from rich.table import Table

    from svmdist.recording.log import Recording
    from svmdist.report.tables import Row
    from svmdist.workflows.annotate import DrawnFrame
    from svmdist.workflows.estimate import Keep, Measured
    from svmdist.workflows.request import Request


class EstimateOptions(LogOptions, MeasureOptions, GroupOption):
    """What `estimate` takes."""

    form: RowFormat | None = format_option()
    output: Path | None = output_option()
    force: bool = option(
        False, "--force", None, "Replace a recording that exists. Other files are replaced anyway."
    )
    report: Path | None = REPORT
    save_plot: Path | None = PLOT
    summary: Path | None = option(
        None,
        "--summary",
        "FILE",
        "Write the figures of each log, sorted by severity, worst first, of groups and of all logs to this file"
        " (csv, json, parquet, md, tex, or text).",
    )


def estimate_command(given: EstimateOptions) -> None:
    """Estimate the distance in every frame.

    There is one row per frame, and per instrument where the log has several that the profile names. To a file that
    ends in .mcap goes a copy of the recording with what was found and measured drawn on its images, for Foxglove,
    Lichtblick and Rerun; to one in .mp4, a video of the same; to one in .html, a report; to one in .parquet, a table
    for pandas and Arrow.

    Several logs are measured by --jobs processes. Failed logs are listed at the end; processing continues.

    Examples:
      A row per frame, as CSV:
        svmdist estimate log.mcap --method fused -o rows.csv
      Alarms where the clearance may be below 5 mm:
        svmdist estimate log.mcap --method fused --alarm-below 5mm
      For Foxglove, Lichtblick and Rerun, or as a video:
        svmdist estimate log.mcap --method fused -o seen.mcap
      Seconds 2 to 5, every fourth image, as a video:
        svmdist estimate log.mcap --start 2 --end 5 --every 4 -o seen.mp4
    """
    from svmdist.workflows.batch import Job

    logs = Logs(given)
    form = row_format(given.form, given.output)
    output, report = given.output, given.report
    if form is FileFormat.HTML:
        if report is not None:
            raise UsageError(f"--report {report} and -o {output}: both are the report; leave out one of them")
        output, report = None, output
    elif isinstance(form, FileFormat):
        if report or given.save_plot:
            raise UsageError(f"--report and --save-plot go with rows: write {output} by itself")
        if len(logs.files) > 1:
            raise UsageError(f"{output}: holds one recording, and {len(logs.files)} are given")
        if not logs.is_one or given.summary is not None:
            raise UsageError(f"--scheduler, --resume and --summary go with rows: write {output} by itself")
    require_output(output, logs.paths)
    require_report(report, logs.paths)
    require_plot(given.save_plot, logs.paths)
    keys = given.group_keys
    if keys and given.summary is None:
        raise UsageError(
            f"--group {given.group}: groups the figures of logs: say where they go with --summary FILE"
        )
    require_output(given.summary, logs.paths)
    summary_form = summary_format(None, given.summary)
    request = given.request()
    if form is RowFormat.TUM and request.setup.is_planar:
        raise UsageError(
            f"--format tum writes the tool's pose, and {given.method} knows none: choose a method in 3D"
        )
    if isinstance(form, FileFormat) and form is not FileFormat.HTML and output is not None:
        raise typer.Exit(_write_drawn(logs, request, output, form, force=given.force))
    run = Run(logs, Job(measure_rows, request, EstimateResult), "measuring")
    measured: list[Measured] = []
    keeps = report is not None or given.save_plot is not None
    _write_rows(run, run.rows(measured.append if keeps else None), request, form, output)
    each = run.figures(keys)
    table = _write_summary(each, given.summary, summary_form) if given.summary or not logs.is_one else None
    tally = sum((Counter(result.tally) for result in run.results), Counter[tuple[str, str]]())
    _log_tally(tally)
    if keeps:
        run.measure_again(measured.append)
        _write_pictures(measured, request, logs.jobs, table, report, given.save_plot)
    raise typer.Exit(_code(run.exit_code(), tally))


@dataclass(frozen=True)
class EstimateResult:
    """How the rows of one log ended: counts of (status, detail), in the order in which they first came."""

    counts: tuple[tuple[str, str, int], ...]
    instruments: tuple[str, ...]

    @property
    def tally(self) -> dict[tuple[str, str], int]:
        """The counts by status and detail."""
        return {(status, detail): count for status, detail, count in self.counts}

    @property
    def statuses(self) -> Counter[str]:
        """The counts by status."""
        statuses: Counter[str] = Counter()
        for status, _, count in self.counts:
            statuses[status] += count
        return statuses


def measure_rows(
    recording: Recording, request: Request, threads: int, keep: Keep | None = None
) -> Generator[Row, None, EstimateResult]:
    """Yield the rows of one recording; `keep` is given all results where something is made of them."""
    from svmdist.estimation.alarms import AlarmWatch
    from svmdist.estimation.lag import LagEstimate
    from svmdist.report.rows import estimate_row
    from svmdist.workflows.estimate import Measured, estimate

    setup = request.setup
    seen = corrected(recording, request, threads)
    wanted = request.instruments or recording.instruments
    watches = {name: AlarmWatch(request.alarms) for name in wanted} if request.alarms else {}
    tally: Counter[tuple[str, str]] = Counter()
    kept = []
    results = estimate(seen, setup, request.instruments, threads)
    total = recording.image_count()
    for row in tracked(results, "measuring", "rows", total and total * len(wanted)):
        tally[str(row.status), row.detail] += 1
        if keep is not None:
            kept.append(row)
        alarm = watches[row.instrument].watch(row) if watches else None
        yield estimate_row(recording.name, row, setup.method, setup.equations, alarm)
    if keep is not None:
        lag = LagEstimate(seen.lag.lag_s, seen.lag.std_s, 1.0) if seen.lag else None
        keep(Measured(recording, seen, tuple(kept), lag))
    counts = tuple((status, detail, count) for (status, detail), count in tally.items())
    return EstimateResult(counts, wanted)


def corrected(recording: Recording, request: Request, jobs: int | None) -> Recording:
    """Say where the equations cannot be right, and apply the requested lag, with progress."""
    from svmdist.workflows.estimate import with_requested_lag
    from svmdist.workflows.parallel import Steps

    for warning in request.setup.degeneracies(recording.camera):
        LOG.info("warning: %s", warning)
    if request.lag != "auto":
        return with_requested_lag(recording, request, jobs)
    with progress_bar(f"lag of {recording.name}", "images") as advance:
        steps = Steps(advance, recording.image_count())
        return with_requested_lag(recording, request, jobs, steps.advance)


def _write_rows(
    run: Run[EstimateResult],
    rows: Iterator[Row],
    request: Request,
    form: RowFormat | FileFormat,
    output: Path | None,
) -> None:
    from svmdist.report.rows import ESTIMATE_KEYS, ESTIMATE_TYPES
    from svmdist.report.tables import write_parquet

    width = terminal_width(output)
    # Rows on a terminal show by themselves how far the command is.
    with no_progress() if width is not None and form is not FileFormat.HTML else nullcontext():
        if form is FileFormat.HTML:
            deque(rows, maxlen=0)
            return
        head = list(islice(started(rows), 2))
        several = len({row.get("instrument") for row in head}) > 1 or any(
            len(result.instruments) > 1 for result in run.results
        )
        if form is RowFormat.TUM and several:
            raise UsageError("--format tum writes one trajectory: choose an instrument with --instrument")
        rows = chain(head, rows)
        if form is RowFormat.PARQUET and output is not None:
            write_parquet(output, ESTIMATE_KEYS, rows, ESTIMATE_TYPES)
            return
        lines = _lines(form, rows, request, several, width)
        write_lines(lines, output, is_json=form in {RowFormat.JSON, RowFormat.JSONL})


def _lines(
    form: RowFormat | FileFormat, rows: Iterator[Row], request: Request, several: bool, width: int | None
) -> Iterator[str]:
    from svmdist.report import rows as table
    from svmdist.report.tables import csv_lines, json_array_lines, json_lines, text_lines

    match form:
        case RowFormat.CSV:
            return csv_lines(table.ESTIMATE_KEYS, rows)
        case RowFormat.JSON:
            return json_array_lines(table.ESTIMATE_KEYS, rows)
        case RowFormat.JSONL:
            return json_lines(table.ESTIMATE_KEYS, rows)
        case RowFormat.TUM:
            return table.tool_pose_lines(rows)
    columns = table.ESTIMATE_COLUMNS + (table.INSTRUMENT_COLUMNS if several else ())
    columns += table.ALARM_COLUMNS if request.alarms else ()
    return text_lines(table.columns_within(columns, width, request.setup.is_planar), rows)


def _write_summary(each: Any, output: Path | None, form: Any) -> Table:
    """Write the figures of logs where they are asked for; gives their table."""
    from svmdist.report.scores import LOG_KEYS, log_rows, log_table, pooled_log_figures, ranked

    ordered, together = ranked(each), pooled_log_figures(each)
    table = log_table(ordered, together)
    if output is not None:
        write_summary(Summary([table], LOG_KEYS, log_rows(ordered, together)), form, output)
    return table


def _write_pictures(
    measured: list[Measured],
    request: Request,
    jobs: int | None,
    logs: Table | None,
    report: Path | None,
    plot: Path | None,
) -> None:
    if plot:
        from svmdist.report.plots import SeriesPlot, save_series_plot
        from svmdist.workflows.series import make_series

        series = [
            made
            for one in measured
            for made in make_series(one.rows, one.recording, request.setup, lag=one.lag)
        ]
        below_m = request.alarms.below_m if request.alarms else None
        save_series_plot(series, SeriesPlot.TIME, plot, below_m)
    if report:
        from svmdist.report.html import estimate_report, write_report

        with progress_bar("drawing the worst frames", "images") as advance:
            page = estimate_report(
                measured, request.setup, command_line(), request.alarms, jobs, logs, advance
            )
        write_report(page, report)


def _write_drawn(logs: Logs, request: Request, output: Path, form: FileFormat, *, force: bool) -> ExitCode:
    """Measure a recording and write it with its drawings, as a recording or a video."""
    from svmdist.report.video import require_av, write_video
    from svmdist.workflows.annotate import drawn_frames, write_annotated

    if form is FileFormat.MP4:
        require_av()  # before the work rather than after it
    (log,) = logs.files
    recording = request.open(log.path, log.name)
    seen = corrected(recording, request, logs.jobs)
    tally: Counter[tuple[str, str]] = Counter()
    with progress_bar(f"drawing {recording.name}", "images") as advance:

        def counted() -> Iterator[DrawnFrame]:
            total = recording.image_count()
            frames = drawn_frames(seen, request.setup, request.alarms, request.instruments, logs.jobs)
            for count, frame in enumerate(frames, 1):
                for result in frame.replayed.results:
                    tally[str(result.status), result.detail] += 1
                yield frame
                advance(count, total)

        if form is FileFormat.MCAP:
            write_annotated(seen, counted(), request.setup, output, force=force)
        else:
            camera = seen.logged_camera
            write_video(counted(), output, (camera.width_px, camera.height_px))
    _log_tally(tally)
    return _code(log_losses(recording.path, recording.health), tally)


def _code(code: ExitCode, tally: Counter[tuple[str, str]]) -> ExitCode:
    """The exit code, where nothing may have been measured: the summary says why."""
    if code is ExitCode.CLEAN and not any(status == "ok" for status, _ in tally):
        return ExitCode.UNUSABLE
    return code


def _log_tally(tally: Counter[tuple[str, str]]) -> None:
    total = tally.total()
    if total == 0:
        LOG.error("no frame to measure: the log has no image, or none between --start and --end")
        return
    measured = sum(count for (status, _), count in tally.items() if status == "ok")
    reasons = sorted({status for status, _ in tally} - {"ok"})
    lost = ", ".join(_lost_by(reason, tally) for reason in reasons)
    LOG.info(
        "%d of %d frames measured (%.1f%%)%s",
        measured,
        total,
        100 * measured / total,
        f"; {lost}" if lost else "",
    )


def _lost_by(reason: str, tally: Counter[tuple[str, str]]) -> str:
    """How many frames ended so, and the detail that most of them have, where they have one."""
    details = Counter({detail: count for (status, detail), count in tally.items() if status == reason})
    ((commonest, _),) = details.most_common(1)
    return f"{details.total()} {reason}" + (f" ({commonest})" if commonest else "")
