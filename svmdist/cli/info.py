"""`svmdist info`, `check` and `profile new`: what is in a log, whether a profile fits it, and a profile from it."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from svmdist.cli import options, output
from svmdist.cli.logs import LogOptions, OneLogOptions, Run
from svmdist.cli.options import FORCE, option
from svmdist.cli.output import LOG, ExitCode
from svmdist.errors import SvmdistError
from svmdist.report.writers import Holds

if TYPE_CHECKING:
    from svmdist.estimation.comparison import Checks
    from svmdist.recording.log import Recording
    from svmdist.report.tables import Row
    from svmdist.workflows.request import Request


class Info(LogOptions, options.ReadOptions, options.OutputOptions):
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

    def _run(self) -> ExitCode:
        from svmdist.report.info import info_results, logs_results
        from svmdist.workflows.request import Request, Setup

        writer = self.writer(self.paths, Holds.TABLES)
        request = Request(Setup.reading(self.profile, self.hand_eye), self.topics)
        run = Run(self, inspect_log, request, dict[str, Any], "inspecting", options=(writer.name != "csv",))
        run.finish()
        found = [(log.name, document) for log, _, document in run.measured]
        output.write_results(info_results(found[0][1]) if self.is_one else logs_results(found), writer, self.output)
        return run.exit_code()


def inspect_log(recording: Recording, _request: Request, _threads: int, looks_for_tag: bool) -> dict[str, Any]:
    """A whole log as a document: what it holds, whether images show the profile's tag, and what contradicts."""
    from svmdist.recording.source import LossKind
    from svmdist.recording.summary import inspect_recording
    from svmdist.report.info import info_document
    from svmdist.workflows.capabilities import IMAGES, look_for_tag
    from svmdist.workflows.check import check_log

    no_tag = ""
    checks: Mapping[str, Checks] = {}
    with output.progress_bar(f"looking at {recording.name}"):
        summary = inspect_recording(recording.origin.open())
        if looks_for_tag and set(IMAGES) <= set(summary.roles):
            no_tag = look_for_tag(recording)
        again = recording.origin.open()
        with suppress(SvmdistError):  # what it lacks, or what the profile lacks, stands in the methods' lines
            checks = check_log(again)
        health = summary.recording.health
        for loss in again.health.losses:
            if loss.kind is LossKind.IMAGE:  # what else is lost on the way is in the summary already
                health.add(loss)
        recording.health.join(health)
        return info_document(summary, checks, no_tag)


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

    def _run(self) -> ExitCode:
        from svmdist.report.info import check_results
        from svmdist.workflows.request import Request, Setup

        writer = self.writer(self.paths, Holds.TABLES)
        request = Request(Setup.reading(self.profile, self.hand_eye), self.topics)
        run = Run(self, compared_rows, request, list[dict[str, Any]], "comparing")
        rows = [row for found in run.finish() for row in found]
        output.write_results(check_results(rows), writer, self.output)
        code = run.exit_code()
        return ExitCode.WORSE if any(row["verdict"] == "contradicts" for row in rows) else code


def compared_rows(recording: Recording, _request: Request, _threads: int) -> list[Row]:
    """The comparisons of a log as rows."""
    from svmdist.report.info import check_rows
    from svmdist.workflows.check import check_log

    with output.progress_bar(f"comparing {recording.name}"):
        return list(check_rows(recording.name, check_log(recording)))


class New(OneLogOptions, options.TopicOption):
    """Write a commented profile from a log.

    It has the log's topics, frames and instruments, a chain that fits its joints, an instrument's sizes, colours where
    they are distinct, and the tissue's surface where two views show it. Guesses are marked MEASURE, with deviations as
    wide.

    Examples:
      A commented profile, to be completed by hand:
        svmdist profile new log.mcap -o mine.toml
      With the sizes of a known instrument:
        svmdist profile new log.mcap --instrument large-needle-driver
      With a camera's topic that is none of the usual ones:
        svmdist profile new log.mcap --topic image=/left/image_raw
    """

    name: str | None = option("--name NAME", "Name of the profile. Default: that of the log.")
    instrument: str | None = option(
        "--instrument NAME",
        "Sizes of large-needle-driver, da-vinci-8mm, laparoscopic-5mm, raven, …: a wrong name lists all. Default: by"
        " the joints, else 5 to 10 mm.",
    )
    output: Path | None = options.OutputOptions.output
    force: bool = FORCE

    def _run(self) -> None:
        import tomllib

        from svmdist.profile import Profile
        from svmdist.recording.log import open_recording
        from svmdist.report.profile_template import instrument_sizes, profile_text
        from svmdist.report.tables import counted
        from svmdist.workflows.check import check_log, warning
        from svmdist.workflows.new_profile import draft_profile

        output.require_toml(self.output, [self.log.path], force=self.force)
        if self.instrument is not None:
            instrument_sizes(self.instrument)
        with output.progress_bar(f"looking at {self.log.name}"):
            draft = draft_profile(self.log.path, self.name or self.log.name, self.topics, self.instrument)
            text = profile_text(draft)
            profile = Profile.model_validate(tomllib.loads(text))
            found = check_log(open_recording(self.log.path, profile))
        output.write_lines([text], self.output)
        instruments = ", ".join(one.name for one in draft.instruments)
        plane = "the plane from both views" if draft.plane else "measure the plane of the tissue"
        mark = "a distal marker by its colour" if draft.mark else "no colour of its own"
        LOG.info("%s: instruments %s; %s; %s", draft.name, instruments, mark, plane)
        if profile.guesses:
            sizes = "; --instrument NAME has sizes" if self.instrument is None else ""
            LOG.info("%s: guessed: %s%s", draft.name, profile.guesses, sizes)
        if said := warning(found):
            LOG.warning("%s", said)
        else:
            count = sum(len(one.comparisons) for one in found.values())
            LOG.info("%s of the log with it: nothing contradicts", counted(count, "comparison"))
        if self.output is not None:
            with_it = output.next_command("estimate", self.log.path, "--profile", self.output)
            LOG.info("next: complete what is marked MEASURE, and %s", with_it)
