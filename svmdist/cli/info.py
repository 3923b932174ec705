"""`svmdist info`: what is in a recording, and what can be done with it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from svmdist.cli.console import report_health, require_output, terminal_width, write_lines
from svmdist.cli.options import (
    HandEyeOption,
    OutputOption,
    ProfileOption,
    TableFormat,
    TableFormatOption,
    TopicOption,
    topics_of,
)
from svmdist.cli.outputs import table_format
from svmdist.errors import RecordingError


def info_command(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Recording to inspect.", show_default=False)],
    profile: ProfileOption = "psm13",
    hand_eye: HandEyeOption = None,
    topic: TopicOption = None,
    form: TableFormatOption = None,
    output: OutputOption = None,
) -> None:
    """Show topics, rates, cameras, frames and health.

    It also lists the commands and methods that the recording can serve, and what is missing for the others.
    """
    from svmdist.profile import load_profile
    from svmdist.recording.inspect import inspect_recording
    from svmdist.recording.reader import open_recording
    from svmdist.report.info import TOPIC_KEYS, info_document, info_lines, topic_row
    from svmdist.report.table import csv_lines, json_text
    from svmdist.workflows.capabilities import look_for_tag

    require_output(output, [file])
    chosen = table_format(form, output)
    loaded = load_profile(profile, hand_eye)
    summary = inspect_recording(file, loaded, topics=topics_of(topic))
    tags = None
    if chosen is not TableFormat.CSV and {"image", "camera_info"} <= set(summary.roles):
        try:
            tags = look_for_tag(open_recording(file, loaded, topics=topics_of(topic)), loaded)
        except RecordingError:  # a calibration that is not usable: the summary tells of it
            tags = None
    match chosen:
        case TableFormat.TABLE:
            write_lines(info_lines(summary, loaded, terminal_width(output), tags), output)
        case TableFormat.CSV:
            write_lines(csv_lines(TOPIC_KEYS, (topic_row(entry) for entry in summary.topics)), output)
        case TableFormat.JSON:
            document = info_document(summary, loaded, tags)
            write_lines([json_text(document, indent=1) + "\n"], output, is_json=True)
    raise typer.Exit(report_health([summary]))
