"""`svmdist info`: what is in a recording, and what can be done with it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from svmdist.cli.logs import Logs
from svmdist.cli.options import LogOptions, ReadOptions, format_option, output_option
from svmdist.cli.output import require_output, write_results
from svmdist.errors import RecordingError
from svmdist.report.writers import Holds, choose_writer

if TYPE_CHECKING:
    from svmdist.recording.log import Recording
    from svmdist.recording.summary import RecordingSummary
    from svmdist.workflows.capabilities import TagCheck
    from svmdist.workflows.request import Request


class InfoOptions(LogOptions, ReadOptions):
    """What `info` takes."""

    form: str | None = format_option(Holds.TABLES)
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
    from svmdist.report.info import info_results, logs_results
    from svmdist.workflows.batch import Job
    from svmdist.workflows.request import Request, Setup

    logs = Logs(given)
    require_output(given.output, logs.paths)
    setup = Setup.reading(given.profile, given.hand_eye)
    writer = choose_writer(given.form, given.output, Holds.TABLES)
    job = Job(inspect_log, Request(setup, given.topics), dict[str, Any], (writer.name != "csv",))
    run = logs.run(job, "inspecting")
    found = [(log.name, document) for log, _, document in run.measured]
    write_results(info_results(found[0][1]) if logs.is_one else logs_results(found), writer, given.output)
    raise typer.Exit(run.exit_code())


def inspect_log(recording: Recording, request: Request, _threads: int, looks_for_tag: bool) -> dict[str, Any]:
    """A whole log as a document, with the profile's tag looked for in some images."""
    from svmdist.recording.summary import inspect_recording
    from svmdist.report.info import info_document

    profile = request.setup.profile
    summary = inspect_recording(recording.path, profile, topics=dict(request.topics))
    tags = _look_for_tag(recording, request, summary) if looks_for_tag else None
    recording.health.join(summary.health)
    return info_document(summary, profile, tags)


def _look_for_tag(recording: Recording, request: Request, summary: RecordingSummary) -> TagCheck | None:
    from svmdist.workflows.capabilities import look_for_tag

    if not {"image", "camera_info"} <= set(summary.roles):
        return None
    try:
        return look_for_tag(recording, request.setup.profile)
    except RecordingError:  # a calibration that is not usable: the summary says so
        return None
