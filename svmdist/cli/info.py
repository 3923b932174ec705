"""`svmdist info`: what is in a recording, and what can be done with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import typer

from svmdist.cli.console import (
    Summary,
    report_health,
    require_output,
    terminal_width,
    write_lines,
    write_summary,
)
from svmdist.cli.many import Many, ResumeOption, SchedulerOption, heard_notes
from svmdist.cli.options import (
    Files,
    HandEyeOption,
    JobsOption,
    OutputOption,
    ProfileOption,
    SummaryFormat,
    TableFormat,
    TableFormatOption,
    TopicOption,
    topics_of,
)
from svmdist.cli.outputs import table_format
from svmdist.cli.recordings import local_logs, named_logs
from svmdist.errors import RecordingError

if TYPE_CHECKING:
    from svmdist.profile import Profile
    from svmdist.recording.summary import RecordingSummary
    from svmdist.workflows.batch.task import LogFile, Measurement, RowWriter
    from svmdist.workflows.capabilities import TagCheck


def info_command(
    files: Files,
    profile: ProfileOption = "psm13",
    hand_eye: HandEyeOption = None,
    topic: TopicOption = None,
    form: TableFormatOption = None,
    output: OutputOption = None,
    jobs: JobsOption = None,
    scheduler: SchedulerOption = None,
    resume: ResumeOption = None,
) -> None:
    """Show topics, rates, cameras, frames and health.

    It also lists the commands and methods that the recording can serve, and what is missing for the others. Of several
    recordings there is a line each; csv has the topics of all, and json an array with everything.
    """
    from svmdist.profile import load_profile
    from svmdist.report.info import TOPIC_KEYS, info_document, info_lines, topic_row
    from svmdist.report.tables import csv_lines, json_text

    logs = named_logs(files)
    require_output(output, local_logs(logs))
    loaded = load_profile(profile, hand_eye)
    chosen = table_format(form, output)
    many = Many(logs, jobs, scheduler, resume)
    if len(logs) > 1 or many.is_asked_for:
        _info_of_logs(many, InfoJob(loaded, topics_of(topic), chosen is not TableFormat.CSV), chosen, output)
    summary, tags = _inspect(logs[0], loaded, topics_of(topic), looks_for_tag=chosen is not TableFormat.CSV)
    match chosen:
        case TableFormat.TABLE:
            write_lines(info_lines(summary, loaded, terminal_width(output), tags), output)
        case TableFormat.CSV:
            write_lines(csv_lines(TOPIC_KEYS, (topic_row(entry) for entry in summary.topics)), output)
        case TableFormat.JSON:
            document = info_document(summary, loaded, tags)
            write_lines([json_text(document, indent=1) + "\n"], output, is_json=True)
    raise typer.Exit(report_health([summary]))


def _inspect(
    log: LogFile, profile: Profile, topics: dict[str, str], *, looks_for_tag: bool
) -> tuple[RecordingSummary, TagCheck | None]:
    """Read a whole log, and look for the profile's tag in some of its images."""
    from svmdist.recording.log import open_recording
    from svmdist.recording.summary import inspect_recording
    from svmdist.workflows.capabilities import look_for_tag

    summary = inspect_recording(log.path, profile, topics=topics)
    if not looks_for_tag or not {"image", "camera_info"} <= set(summary.roles):
        return summary, None
    try:
        return summary, look_for_tag(open_recording(log.path, profile, topics=topics), profile)
    except RecordingError:  # a calibration that is not usable: the summary tells of it
        return summary, None


def _info_of_logs(many: Many, job: InfoJob, form: TableFormat, output: Any) -> None:
    from svmdist.report.info import LOG_COLUMNS, LOG_KEYS, TOPIC_KEYS, log_row
    from svmdist.report.tables import rich_table

    with many.measured(job, "inspecting") as outcomes:
        found = [(one.log.name, result.document) for one, result in outcomes.measured]
        if form is TableFormat.CSV:
            keys = (*TOPIC_KEYS, "recording")
            rows = [topic | {"recording": name} for name, document in found for topic in document["topics"]]
            write_summary(Summary([], keys, rows), SummaryFormat.CSV, output)
        elif form is TableFormat.JSON:
            write_summary(Summary([], (), [document for _, document in found]), SummaryFormat.JSON, output)
        else:
            rows = [log_row(name, document) for name, document in found]
            table = rich_table("", LOG_COLUMNS, rows)
            write_summary(Summary([table], LOG_KEYS, rows), SummaryFormat.TABLE, output)
        raise typer.Exit(outcomes.code())


@dataclass(frozen=True)
class InfoResult:
    """The document of a log."""

    document: dict[str, Any]


@dataclass(frozen=True)
class InfoJob:
    """Inspects a log."""

    profile: Profile
    topics: dict[str, str]
    looks_for_tag: bool

    @property
    def result_type(self) -> type[InfoResult]:
        """The type of a result."""
        return InfoResult

    def measure(self, log: LogFile, _: int, __: RowWriter) -> Measurement[InfoResult]:
        """Inspect a log."""
        from svmdist.report.info import info_document
        from svmdist.workflows.batch.task import Measurement

        with heard_notes() as notes:
            summary, tags = _inspect(log, self.profile, self.topics, looks_for_tag=self.looks_for_tag)
        document = info_document(summary, self.profile, tags)
        return Measurement(InfoResult(document), summary.health, {}, tuple(notes))
