"""`svmdist estimate`: one row per frame."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Generator, Iterator
from contextlib import nullcontext
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from svmdist.cli.logs import Logs, Run, log_losses
from svmdist.cli.options import (
    PLOT,
    REPORT,
    GroupOption,
    LogOptions,
    MeasureOptions,
    format_option,
    option,
    output_option,
)
from svmdist.cli.output import (
    LOG,
    ExitCode,
    command_line,
    no_progress,
    progress_bar,
    require_output,
    require_plot,
    require_report,
    terminal_width,
    tracked,
    write_results,
)
from svmdist.errors import UsageError
from svmdist.report.writers import Holds, Results, Writer, choose_writer

if TYPE_CHECKING:
    from svmdist.recording.log import Recording
    from svmdist.report.tables import Row
    from svmdist.workflows.estimate import Keep, Measured
    from svmdist.workflows.frame_drawing import DrawnFrame
    from svmdist.workflows.request import Request


class EstimateOptions(LogOptions, MeasureOptions, GroupOption):
    """What `estimate` takes."""

    form: str | None = format_option(Holds.ROWS)
    output: Path | None = output_option()
    force: bool = option(
        False, "--force", "Replace a recording that exists. Other files are replaced anyway."
    )
    report: Path | None = REPORT
    save_plot: Path | None = PLOT
    summary: Path | None = option(
        None,
        "--summary FILE",
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
    output, report = given.output, given.report
    writer = choose_writer(given.form, output, Holds.ROWS | Holds.FRAMES | Holds.REPORT)
    if writer.holds is Holds.REPORT:
        if report is not None:
            raise UsageError(f"--report {report} and -o {output}: both are the report; leave out one of them")
        output, report = None, output
    elif writer.holds is Holds.FRAMES:
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
    summary_writer = choose_writer(None, given.summary, Holds.FIGURES)
    request = given.request()
    if writer.name == "tum" and request.setup.is_planar:
        raise UsageError(
            f"--format tum writes the tool's pose, and {given.method} knows none: choose a method in 3D"
        )
    if writer.holds is Holds.FRAMES and output is not None:
        raise typer.Exit(_write_drawn(logs, request, output, writer, force=given.force))
    run = Run(logs, Job(measure_rows, request, EstimateResult), "measuring")
    measured: list[Measured] = []
    keeps = report is not None or given.save_plot is not None
    _write_rows(run, run.rows(measured.append if keeps else None), request, writer, output)
    figures = None
    if given.summary is not None or not logs.is_one:
        from svmdist.report.scores import log_results

        figures = log_results(run.figures(keys))
    if figures is not None and given.summary is not None:
        write_results(figures, summary_writer, given.summary)
    tally = sum((Counter(result.tally) for result in run.results), Counter[tuple[str, str]]())
    _log_tally(tally)
    if keeps:
        run.measure_again(measured.append)
        pooled = None if logs.is_one else figures
        _write_pictures(measured, request, logs.jobs, pooled, report, given.save_plot)
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
    from svmdist.workflows.estimate import with_lag
    from svmdist.workflows.parallel import Steps

    for warning in request.setup.degeneracies(recording.camera):
        LOG.info("warning: %s", warning)
    if request.lag != "auto":
        return with_lag(recording, request)[0]
    with progress_bar(f"lag of {recording.name}", "images") as advance:
        steps = Steps(advance, recording.image_count())
        seen, found = with_lag(recording, request, jobs, steps.advance)
    if found.told:
        said = f"lag {found.lag_s * 1e3:+.1f} ms (confidence {found.confidence:.2f})"
    else:
        said = f"the lag cannot be estimated and none is applied: {found.reason}"
    LOG.info("note: %s: %s", recording.name, said)
    return seen


def _write_rows(
    run: Run[EstimateResult], rows: Iterator[Row], request: Request, writer: Writer, output: Path | None
) -> None:
    from svmdist.report.rows import ESTIMATE_COLUMNS, shown_columns
    from svmdist.report.tables import text_lines

    if writer.holds is Holds.REPORT:
        deque(rows, maxlen=0)
        return
    # Rows on a terminal show by themselves how far the command is.
    with no_progress() if terminal_width(output) is not None else nullcontext():
        head = list(islice(rows, 2))  # so that a log that cannot be read leaves no header behind
        several = len({row.get("instrument") for row in head}) > 1 or any(
            len(result.instruments) > 1 for result in run.results
        )
        if writer.name == "tum" and several:
            raise UsageError("--format tum writes one trajectory: choose an instrument with --instrument")
        every = chain(head, rows)

        def text(width: int | None) -> Iterator[str]:
            planar, alarms = request.setup.is_planar, request.alarms is not None
            return text_lines(shown_columns(width, planar=planar, several=several, alarms=alarms), every)

        write_results(Results(ESTIMATE_COLUMNS, every, text), writer, output)


def _write_pictures(
    measured: list[Measured],
    request: Request,
    jobs: int | None,
    logs: Results | None,
    report: Path | None,
    plot: Path | None,
) -> None:
    if plot:
        from svmdist.report.plots import draw_series, save_figure
        from svmdist.workflows.series import series_of

        below_m = request.alarms.below_m if request.alarms else None
        save_figure(plot, draw_series, series_of(measured, request), "time", below_m)
    if report:
        from svmdist.report.html import make_report, write_report

        with progress_bar("drawing the worst frames", "images") as advance:
            page = make_report(measured, request, command_line(), jobs=jobs, logs=logs, on_progress=advance)
        write_report(page, report)


def _write_drawn(logs: Logs, request: Request, output: Path, writer: Writer, *, force: bool) -> ExitCode:
    """Measure a recording and write it with its drawings, as a recording or a video."""
    from svmdist.workflows.frame_drawing import drawn_frames

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

        writer.write(counted(), output, seen, request.setup, force)
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
