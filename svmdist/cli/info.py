"""`svmdist info`: what is in a recording, and what can be done with it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from svmdist.cli.logs import Logs
from svmdist.cli.options import LogOptions, ReadOptions, TableFormat, format_option, output_option
from svmdist.cli.output import (
    TABLE_ENDINGS,
    Summary,
    by_ending,
    require_output,
    terminal_width,
    write_lines,
    write_summary,
)
from svmdist.errors import RecordingError

if TYPE_CHECKING:
    from svmdist.recording.log import Recording
    from svmdist.recording.summary import RecordingSummary
    from svmdist.workflows.capabilities import TagCheck
    from svmdist.workflows.request import Request


class InfoOptions(LogOptions, ReadOptions):
    """What `info` takes."""

    form: TableFormat | None = format_option()
    output: Path | None = output_option()


def info_command(given: InfoOptions) -> None:
    """Show topics, rates, cameras, frames and health.

    It also lists the commands and methods that the recording can serve, and what is missing for the others. Of several
    recordings there is a line each; csv has the topics of all, and json an array with everything.

    Examples:
      Topics, cameras, and the methods that the log can serve:
        svmdist info log.mcap
      The same of a log with a profile of one's own:
        svmdist info log.mcap --profile mine.toml
      For a program:
        svmdist info log.mcap -f json
    """
    from svmdist.profile import load_profile
    from svmdist.report.info import LOG_COLUMNS, LOG_KEYS, TOPIC_KEYS, log_row
    from svmdist.report.tables import rich_table
    from svmdist.workflows.batch import Job
    from svmdist.workflows.request import Request, Setup

    logs = Logs(given)
    require_output(given.output, logs.paths)
    setup = Setup(load_profile(given.profile, given.hand_eye), "kinematic", "corrected", None)
    form = by_ending(given.form, TABLE_ENDINGS, TableFormat.TABLE, given.output)
    looks_for_tag = form is not TableFormat.CSV
    width = terminal_width(given.output)
    job = Job(inspect_log, Request(setup, given.topics), InspectedLog, (looks_for_tag, width))
    run = logs.run(job, "inspecting")
    found = [(log.name, result.document) for log, _, result in run.measured]
    if form is TableFormat.TABLE and logs.is_one:
        write_lines(run.results[0].lines, given.output)
    elif form is TableFormat.CSV:
        several = () if logs.is_one else ("recording",)
        topics = [topic | {"recording": name} for name, document in found for topic in document["topics"]]
        write_summary(Summary([], (*TOPIC_KEYS, *several), topics), form, given.output)
    else:
        rows = [log_row(name, document) for name, document in found]
        documents: Any = [document for _, document in found]
        document = documents[0] if logs.is_one else documents
        write_summary(
            Summary([rich_table("", LOG_COLUMNS, rows)], LOG_KEYS, rows, (), document), form, given.output
        )
    raise typer.Exit(run.exit_code())


@dataclass(frozen=True)
class InspectedLog:
    """The document of a log, and the lines for a terminal of some width."""

    document: dict[str, Any]
    lines: list[str]


def inspect_log(
    recording: Recording, request: Request, _threads: int, looks_for_tag: bool, width: int | None
) -> InspectedLog:
    """Read a whole log, and look for the profile's tag in some of its images."""
    from svmdist.recording.summary import inspect_recording
    from svmdist.report.info import info_document, info_lines

    profile = request.setup.profile
    summary = inspect_recording(recording.path, profile, topics=dict(request.topics))
    tags = _look_for_tag(recording, request, summary) if looks_for_tag else None
    recording.health.join(summary.health)
    return InspectedLog(
        info_document(summary, profile, tags), list(info_lines(summary, profile, width, tags))
    )


def _look_for_tag(recording: Recording, request: Request, summary: RecordingSummary) -> TagCheck | None:
    from svmdist.workflows.capabilities import look_for_tag

    if not {"image", "camera_info"} <= set(summary.roles):
        return None
    try:
        return look_for_tag(recording, request.setup.profile)
    except RecordingError:  # a calibration that is not usable: the summary says so
        return None
