"""`svmdist estimate`: one row per frame; and the plots and reports that it shares with `validate`."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from svmdist.cli import output
from svmdist.cli.logs import GroupOption, LogOptions
from svmdist.cli.options import PLOT, MeasureOptions, OutputOptions, format_option, option
from svmdist.cli.output import LOG, ExitCode, next_command
from svmdist.errors import UsageError, concealed
from svmdist.files import write_atomically
from svmdist.report.writers import Holds, Results, Writer, choose_writer

if TYPE_CHECKING:
    from svmdist.cli.jobs import Run
    from svmdist.remote import LogPath
    from svmdist.workflows.estimate import Ending
    from svmdist.workflows.request import Request
    from svmdist.workflows.validate import Validation


class PictureOptions(OutputOptions):
    """What is drawn of all rows together."""

    report: Path | None = option("--report FILE.html", "Page with interactive plots and the worst frames.")
    save_plot: Path | None = PLOT

    def require_pictures(self, inputs: list[LogPath], kind: str | None = None) -> None:
        """Check names and packages before the work; raises UsageError or OutputError."""
        output.require_plot(self.save_plot, inputs, kind)
        if self.report is not None:
            output.require_output(self.report, inputs)
            if self.report.suffix.lower() not in (".html", ".htm"):
                raise UsageError(f"--report {self.report}: a report is a page: give it the ending .html")
            choose_writer(None, self.report, Holds.REPORT)

    def draw(self, run: Run[Any], request: Request, result: Validation | None = None, kind: str = "") -> None:
        """Draw the plot and the report of what was measured, and validated."""
        from svmdist.workflows.estimate import series_of

        measured = run.kept()
        series = series_of(measured, request, result.reference if result else None)
        if self.save_plot:
            from svmdist.report import plots

            if result and kind == "fig6":
                plots.save_figure(self.save_plot, plots.draw, result)
            else:
                plots.save_figure(self.save_plot, plots.draw_series, series, kind or "time")
        if self.report:
            from svmdist.report.html import make_report, page

            command = next_command(*map(concealed, sys.argv[1:]))
            jobs, logs = run.given.jobs, None if run.given.is_one else run.ranking()
            with output.progress_bar("drawing the worst frames", "images") as advance:
                watched = [replace(one, read=replace(one.read, on_progress=advance)) for one in measured]
                report = make_report(series, watched, request, command, result, jobs, logs)
            write_atomically(self.report, [page(report)])


class Estimate(LogOptions, MeasureOptions, GroupOption, PictureOptions):
    """Estimate the distance in every frame.

    A row per frame and instrument. -o FILE.mcap writes a copy of the log with what was found drawn on its images, for
    Foxglove and Lichtblick; .rrd the same for Rerun, .mp4 a video, .html a report.

    Examples:
      A row per frame, as CSV:
        svmdist estimate log.mcap --method fused -o rows.csv
      Alarms where the clearance may be below 5 mm:
        svmdist estimate log.mcap --method fused --alarm-below 5mm
      For Foxglove and Lichtblick:
        svmdist estimate log.mcap --method fused -o seen.mcap
      Seconds 2 to 5, every fourth image, as a video:
        svmdist estimate log.mcap --start 2 --end 5 --every 4 -o seen.mp4
    """

    form: str | None = format_option(Holds.ROWS)
    force: bool = option("--force", "Replace a log that exists; other files are anyway.", False)
    summary: Path | None = option("--summary FILE", "Figures of each log, worst first; as .csv, .md, ….")

    def _run(self) -> ExitCode:
        from svmdist.cli.jobs import Run, draw_log, log_ending, log_tally, measure_rows
        from svmdist.workflows.estimate import Ending

        writer = self.writer(self.paths, Holds.ROWS | Holds.FRAMES | Holds.REPORT)
        self._require_one_kind(writer)
        if writer.holds is Holds.REPORT:
            self.report = self.output
        keys = self.group_keys
        self.require_pictures(self.paths)
        if keys and self.summary is None:
            raise UsageError(f"--group {self.group}: groups the figures of logs: give --summary FILE for them")
        output.require_output(self.summary, self.paths)
        summary_writer = choose_writer(None, self.summary, Holds.FIGURES, "--summary")
        request = self.request(self.paths)
        if writer.name == "tum" and request.setup.is_planar:
            raise UsageError(f"--format tum writes the tool's pose: choose a method in 3D, not {request.setup.method}")
        draws = self.report is not None or self.save_plot is not None
        if writer.holds is Holds.FRAMES:
            run = Run(self, draw_log, request, Ending, "drawing", options=(writer, self.output, self.force))
        else:
            run = Run(self, measure_rows, request, Ending, "measuring", keeps=draws, keys=keys)
        if writer.holds & (Holds.FRAMES | Holds.REPORT):
            run.finish()
        else:
            self._write_rows(run, request, writer)
        if self.summary is not None:
            output.write_results(run.ranking(), summary_writer, self.summary)
        self.say_choice()
        measured = log_tally(run.results)
        log_ending({log.name: ending for log, _, ending in run.measured}, request)
        self._say_next({str(log.path): ending for log, _, ending in run.measured}, request)
        if draws:
            self.draw(run, request)
        return run.exit_code(measured)

    def _say_next(self, endings: Mapping[str, Ending], request: Request) -> None:
        """Log the smallest clearance, and the command that shows it; without any, the one that says why."""
        from svmdist.profile import DEFAULT_PROFILE

        reading = ["--profile", self.profile] if self.profile != DEFAULT_PROFILE else []
        reading += ["--hand-eye", str(self.hand_eye)] if self.hand_eye else []
        reading += [word for topic in self.topic or [] for word in ("--topic", topic)]
        found = [(path, ending, ending.least) for path, ending in endings.items() if ending.least is not None]
        if (guesses := request.setup.profile.guesses) and not request.setup.is_planar:
            LOG.info("guessed in %s, so that distances are as unsure: %s", self.profile, guesses)
        if found:
            path, ending, least = min(found, key=lambda one: one[2].distances.clearance.value_m)  # type: ignore[union-attr]
            frame = ["--frame", str(least.number), "--method", request.setup.method]
            where = f"{path}: " if len(endings) > 1 else ""
            LOG.info("%s%s: %s", where, ending.least_in_words, next_command("show", path, *frame, *reading))
            return
        statuses = set().union(*(ending.statuses for ending in endings.values()))
        for path in list(endings)[:1]:
            command = ["info", path]  # says what each method lacks
            if statuses & {"no_tissue", "no_instrument"}:
                command = ["show", path, "--masks"]
            elif statuses & {"inconsistent", "uncertain"}:
                command = ["check", path]
            LOG.info("next: %s", next_command(*command, *reading))

    def _require_one_kind(self, writer: Writer) -> None:
        """Raise UsageError where a file of images or a report is asked for, and something else, too."""
        name = self.output
        if writer.holds is Holds.FRAMES:
            if self.report or self.save_plot:
                raise UsageError(f"--report and --save-plot go with rows: write {name} by itself")
            if len(self.logs) > 1:
                raise UsageError(f"{name}: holds one recording, and {len(self.logs)} are given")
            if not self.is_one or self.summary is not None:
                raise UsageError(f"--scheduler, --resume and --summary go with rows: write {name} by itself")
        elif writer.holds is Holds.REPORT and self.report is not None:
            raise UsageError(f"--report {self.report} and -o {name}: both are the report; leave out one")

    def _write_rows(self, run: Run[Ending], request: Request, writer: Writer) -> None:
        from svmdist.report.rows import ESTIMATE_COLUMNS, shown_columns
        from svmdist.report.tables import text_lines

        head, every = run.begun(2, self.output)
        several = len({row.get("instrument") for row in head}) > 1 or any(
            len(ending.events) > 1 for ending in run.results
        )
        if writer.name == "tum" and several:
            raise UsageError("--format tum writes one trajectory: choose an instrument with --instrument")

        def text(width: int | None) -> Iterator[str]:
            planar, alarms = request.setup.is_planar, request.alarms is not None
            return text_lines(shown_columns(width, planar=planar, several=several, alarms=alarms), every)

        output.write_results(Results(ESTIMATE_COLUMNS, every, text), writer, self.output)
