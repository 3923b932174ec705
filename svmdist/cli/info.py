"""`svmdist info`: what is in a recording, and what can be done with it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from svmdist.cli.console import report_health, require_output, terminal_width, write_lines
from svmdist.cli.options import (
    OutputOption,
    ProfileOption,
    TableFormat,
    TableFormatOption,
    TopicOption,
    topics_of,
)
from svmdist.cli.outputs import table_format


def info_command(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Recording to inspect.", show_default=False)],
    profile: ProfileOption = "psm13",
    topic: TopicOption = None,
    form: TableFormatOption = None,
    output: OutputOption = None,
) -> None:
    """Show topics, rates, cameras, frames and health.

    It also lists the commands and methods that the recording can serve, and what is missing for the others.
    """
    import json

    from svmdist.profile import load_profile
    from svmdist.recording.inspect import inspect_recording
    from svmdist.report.info import TOPIC_KEYS, info_document, info_lines, topic_row
    from svmdist.report.table import csv_lines

    require_output(output, [file])
    loaded = load_profile(profile)
    summary = inspect_recording(file, loaded, topics=topics_of(topic))
    match table_format(form, output):
        case TableFormat.TABLE:
            write_lines(info_lines(summary, loaded, terminal_width(output)), output)
        case TableFormat.CSV:
            write_lines(csv_lines(TOPIC_KEYS, (topic_row(entry) for entry in summary.topics)), output)
        case TableFormat.JSON:
            write_lines(
                [json.dumps(info_document(summary, loaded), indent=1, ensure_ascii=False) + "\n"], output
            )
    raise typer.Exit(report_health([summary]))
