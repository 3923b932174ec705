"""`svmdist compare`: all methods on the same logs."""

from __future__ import annotations

from typing import Annotated

import typer

from svmdist.cli.console import Summary, files_or_golden, report_health, require_output_folder, write_summary
from svmdist.cli.options import (
    CalibrationOption,
    Method,
    OptionalFiles,
    OutputOption,
    ProfileOption,
    TableFormat,
    TableFormatOption,
    TopicOption,
    topics_of,
)


def compare_command(
    files: OptionalFiles = None,
    method: Annotated[
        list[Method] | None,
        typer.Option(
            "--method", help="A method to compare; may be repeated. Default: all.", show_default=False
        ),
    ] = None,
    calibration: CalibrationOption = None,
    profile: ProfileOption = "psm13",
    topic: TopicOption = None,
    form: TableFormatOption = TableFormat.TABLE,
    output: OutputOption = None,
) -> None:
    """Measure with all methods side by side.

    One pass over the images of each recording; per scenario and over all. Without FILE, on every log in
    recordings/.
    """
    from svmdist.recording.reader import open_recording
    from svmdist.report.comparison import COMPARE_COLUMNS, COMPARE_KEYS, COMPARE_NOTE, compare_row
    from svmdist.workflows.compare import compare
    from svmdist.workflows.setup import prepare

    require_output_folder(output)
    methods = list(dict.fromkeys(method)) if method else list(Method)
    planar = (Method.OVERLAY, Method.CENTROID)
    setups = [
        prepare(profile, chosen.value, "corrected", calibration if chosen in planar else None)
        for chosen in methods
    ]
    recordings = [
        open_recording(path, setups[0].profile, topics=topics_of(topic)) for path in files_or_golden(files)
    ]
    rows = [compare_row(score) for score in compare(recordings, setups)]
    title = f"{len(methods)} methods on {len(recordings)} recordings"
    write_summary(Summary(title, COMPARE_COLUMNS, COMPARE_KEYS, rows, [COMPARE_NOTE]), form, output)
    raise typer.Exit(report_health(recordings))
