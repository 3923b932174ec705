"""`svmdist hand-eye`: fit where the robot's base stands for the camera."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from svmdist.cli.console import report_health, require_output, say, write_results
from svmdist.cli.options import (
    InstrumentOption,
    JobsOption,
    LagOption,
    ProfileOption,
    TableFormatOption,
    TopicOption,
    instruments_of,
    parse_lag,
    topics_of,
)
from svmdist.cli.progress import progress_bar
from svmdist.cli.recordings import EndOption, EveryOption, StartOption, window_of
from svmdist.errors import RecordingError, UsageError
from svmdist.report.writers import Holds, choose_writer

if TYPE_CHECKING:
    from svmdist.profile import Profile


class SeeingMethod(StrEnum):
    """`--method` of hand-eye: what sees the tool in the images alone."""

    FIDUCIAL = "fiducial"
    STEREO = "stereo"
    SHAFT = "shaft"


class Against(StrEnum):
    """`--against`: what the robot reports."""

    KINEMATICS = "kinematics"
    POSE = "pose"


def hand_eye_command(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Recording to fit on.", show_default=False)],
    method: Annotated[
        SeeingMethod | None,
        typer.Option(
            "--method",
            help="What sees the tool: fiducial, stereo or shaft. Default: the first of these that sees it.",
            show_default=False,
        ),
    ] = None,
    against: Annotated[
        Against | None,
        typer.Option(
            "--against",
            help="What the robot reports: kinematics of its joints, or the poses of measured_cp. Default: the joints"
            " where log and profile have them.",
            show_default=False,
        ),
    ] = None,
    profile: ProfileOption = "psm13",
    topic: TopicOption = None,
    instrument: InstrumentOption = None,
    lag: LagOption = None,
    form: TableFormatOption = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE.toml",
            help='Store the transforms in this file; a profile names it: hand_eye = "FILE.toml".',
            show_default=False,
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the file if it exists.")] = False,
    jobs: JobsOption = None,
    start: StartOption = 0.0,
    end: EndOption = None,
    every: EveryOption = 1,
) -> None:
    """Fit where robots' bases stand for the camera.

    The tool as the images show it is compared with the joints or poses that the robot reports. The result has a
    covariance, and is used by every command whose profile names the file, or by --hand-eye.
    """
    from svmdist.cli.lag import told_lag
    from svmdist.profile import load_profile
    from svmdist.profile.hand_eye import save_hand_eye
    from svmdist.recording.log import open_recording
    from svmdist.recording.observations import Reading
    from svmdist.report.info import hand_eye_file, hand_eye_results
    from svmdist.results import Failure
    from svmdist.workflows.hand_eye import HandEyeResult, hand_eye
    from svmdist.workflows.request import prepare

    require_output(output, [file])
    if output is not None and output.exists() and not force:
        raise UsageError(f"{output}: exists already; give another name, or --force to replace it")
    given = parse_lag(lag)
    window = window_of(start, end, every)
    topics = topics_of(topic)
    methods = [method.value] if method else _served(file, load_profile(profile), topics)
    failures: list[str] = []
    for chosen in methods:
        setup = prepare(profile, chosen)
        recording = open_recording(file, setup.profile, topics=topics).read_as(Reading(window=window))
        wanted = instruments_of(instrument, setup.profile) or recording.instruments
        seen = told_lag(recording, setup, given, wanted, jobs)
        found = {}
        for name in wanted:
            with progress_bar(f"{chosen} sees {name}", "images") as advance:
                found[name] = hand_eye(
                    seen, setup, name, None if against is None else against.value, jobs, advance
                )
        failures += [
            f"{chosen}, {name}: {one.reason}" for name, one in found.items() if isinstance(one, Failure)
        ]
        results = [one for one in found.values() if isinstance(one, HandEyeResult)]
        if results:
            break
    else:
        raise RecordingError(f"{file}: no transform can be told: {'; '.join(failures)}")
    write_results(hand_eye_results(results), choose_writer(form, None, Holds.TABLES), None)
    for failure in failures:
        say(f"svmdist: note: {failure}")
    if output is not None:
        save_hand_eye(output, hand_eye_file(results, recording))
        say(
            f'svmdist: {output}: {len(results)} transforms; in a profile beside it: hand_eye = "{output.name}"'
        )
    raise typer.Exit(report_health([recording]))


def _served(file: Path, profile: Profile, topics: dict[str, str]) -> list[str]:
    """The methods that log and profile serve, the surest first; RecordingError where there is none."""
    from svmdist.recording.summary import inspect_recording
    from svmdist.workflows.capabilities import method_capabilities
    from svmdist.workflows.hand_eye import SEEING_METHODS

    summary = inspect_recording(file, profile, topics=topics)
    found = {one.name: one for one in method_capabilities(summary, profile)}
    served = [name for name in SEEING_METHODS if found[name].served]
    if not served:
        lacking = "; ".join(f"{name} lacks {', '.join(found[name].missing)}" for name in SEEING_METHODS)
        raise RecordingError(f"{file}: no method can see the tool: {lacking}")
    return served
