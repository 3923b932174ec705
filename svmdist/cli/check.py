"""`svmdist check`: whether a log and a profile agree with each other, before anything is measured."""

from __future__ import annotations

from typing import TYPE_CHECKING

from svmdist.cli import options
from svmdist.cli.logs import LogOptions, Run
from svmdist.cli.output import ExitCode, progress_bar, write_results
from svmdist.report.writers import Holds

if TYPE_CHECKING:
    from svmdist.recording.log import Recording
    from svmdist.report.tables import Row
    from svmdist.workflows.request import Request


class Check(LogOptions, options.ReadOptions, options.OutputOptions):
    """Compare what a log and its profile show more than once.

    Disparities against the baseline, the tissue by both views against the profile's, the tool by kinematics, shaft, tag
    and disparity against each other and against the image, sizes against an endoscope's field of view. There is a line
    for each comparison: the difference, over its standard deviation, and what could be wrong where it contradicts. The
    same is looked at before the first row of every estimate.

    Exit code 4 if something contradicts.

    Examples:
      Whether a log fits the profile:
        svmdist check log.mcap --profile mine.toml
      In a script:
        svmdist check log.mcap -f json -o check.json
    """

    form: str | None = options.format_option(Holds.TABLES)

    def _run(self) -> ExitCode:
        from svmdist.report.info import check_results
        from svmdist.workflows.request import Request, Setup

        writer = self.writer(self.paths, Holds.TABLES)
        request = Request(Setup.reading(self.profile, self.hand_eye), self.topics)
        run = Run(self, compared_rows, request, list, "comparing")
        run.finish()
        rows: list[Row] = [row for _, _, found in run.measured for row in found]
        write_results(check_results(rows), writer, self.output)
        code = run.exit_code()
        return ExitCode.WORSE if any(row["verdict"] == "contradicts" for row in rows) else code


def compared_rows(recording: Recording, request: Request, _threads: int) -> list[Row]:
    """The comparisons of a log as rows."""
    from svmdist.report.info import check_rows
    from svmdist.workflows.check import check_log

    with progress_bar(f"comparing {recording.name}"):
        return list(check_rows(recording.name, check_log(recording, request.setup.profile)))
