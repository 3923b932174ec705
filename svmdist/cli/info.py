"""`svmdist info`: what is in a recording, and what can be done with it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from svmdist.cli.console import (
    report_health,
    require_output,
    write_results,
)
from svmdist.cli.many import Many, ResumeOption, SchedulerOption, heard_notes
from svmdist.cli.options import (
    Files,
    HandEyeOption,
    JobsOption,
    OutputOption,
    ProfileOption,
    TableFormatOption,
    TopicOption,
    topics_of,
)
from svmdist.cli.recordings import local_logs, named_logs
from svmdist.errors import RecordingError
from svmdist.report.writers import Holds, Writer, choose_writer

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
    from svmdist.report.info import info_results

    logs = named_logs(files)
    require_output(output, local_logs(logs))
    loaded = load_profile(profile, hand_eye)
    writer = choose_writer(form, output, Holds.TABLES)
    looks_for_tag = writer.name != "csv"
    many = Many(logs, jobs, scheduler, resume)
    if len(logs) > 1 or many.is_asked_for:
        _info_of_logs(many, InfoJob(loaded, topics_of(topic), looks_for_tag), writer, output)
    summary, tags = _inspect(logs[0], loaded, topics_of(topic), looks_for_tag=looks_for_tag)
    write_results(info_results(summary, loaded, tags), writer, output)
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


def _info_of_logs(many: Many, job: InfoJob, writer: Writer, output: Path | None) -> None:
    from svmdist.report.info import logs_results

    with many.measured(job, "inspecting") as outcomes:
        found = [(one.log.name, result.document) for one, result in outcomes.measured]
        write_results(logs_results(found), writer, output)
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
