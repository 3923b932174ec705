"""Where `svmdist estimate` writes to: rows, a recording or a video with drawings, a report, a plot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from svmdist.cli.console import require_output
from svmdist.cli.outputs import command_line, require_report
from svmdist.cli.plots import require_plot
from svmdist.cli.progress import progress_bar
from svmdist.errors import UsageError
from svmdist.report.writers import Holds, Results, Writer, choose_writer

if TYPE_CHECKING:
    from svmdist.estimation.alarms import AlarmRules
    from svmdist.workflows.request import Setup
    from svmdist.workflows.validate import Measured


@dataclass(frozen=True)
class EstimateTargets:
    """What was asked for. `form` is that of the rows, None where none are written; `drawn` is a file with drawings."""

    output: Path | None
    form: Writer | None
    drawn: tuple[Path, Writer] | None
    report: Path | None
    plot: Path | None

    @staticmethod
    def of(form: str | None, output: Path | None, report: Path | None, plot: Path | None) -> EstimateTargets:
        """Sort the options; raises UsageError where two of them contradict each other."""
        chosen = choose_writer(form, output, Holds.ROWS | Holds.FRAMES | Holds.REPORT)
        if chosen.holds & Holds.ROWS or output is None:
            return EstimateTargets(output, chosen, None, report, plot)
        if chosen.holds & Holds.REPORT:
            if report is not None:
                raise UsageError(
                    f"--report {report} and -o {output}: both are the report; leave out one of them"
                )
            return EstimateTargets(None, None, None, output, plot)
        if report or plot:
            raise UsageError(f"--report and --save-plot go with rows: write {output} by itself")
        return EstimateTargets(output, None, (output, chosen), None, None)

    def check(self, files: Sequence[Path], count: int) -> None:
        """Fail before the work rather than after it; raises OutputError or UsageError."""
        for target in (self.output, self.report):
            require_output(target, files)
        require_report(self.report)
        require_plot("estimate", None, self.plot, files)
        if self.drawn and count > 1:
            raise UsageError(f"{self.drawn[0]}: holds one recording, and {count} are given")

    @property
    def is_trajectory(self) -> bool:
        """Whether the rows are written as one trajectory."""
        return self.form is not None and self.form.name == "tum"

    @property
    def needs_rows_kept(self) -> bool:
        """Whether something is made of all rows together."""
        return self.report is not None or self.plot is not None

    def write_pictures(
        self,
        measured: Sequence[Measured],
        setup: Setup,
        rules: AlarmRules | None,
        jobs: int | None,
        logs: Results | None = None,
    ) -> None:
        """Write the plot and the report, where they are asked for; `logs` is a table of all logs for the report."""
        if self.plot:
            from svmdist.report.plots import SeriesPlot, save_series_plot
            from svmdist.workflows.series import make_series

            series = [
                made for one in measured for made in make_series(one.rows, one.recording, setup, lag=one.lag)
            ]
            save_series_plot(series, SeriesPlot.TIME, self.plot, rules.below_m if rules else None)
        if self.report:
            from svmdist.report.html import estimate_report, write_report

            with progress_bar("drawing the worst frames", "images") as advance:
                page = estimate_report(measured, setup, command_line(), rules, jobs, logs, advance)
            write_report(page, self.report)
