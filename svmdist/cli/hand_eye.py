"""`svmdist hand-eye`: fit the camera-to-base transform."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer

from svmdist.cli.estimate import corrected
from svmdist.cli.logs import log_losses
from svmdist.cli.options import (
    FORCE,
    JOBS,
    InstrumentOption,
    LagOption,
    ProfileOptions,
    WindowOptions,
    argument,
    format_option,
    option,
    output_option,
)
from svmdist.cli.output import LOG, progress_bar, require_new, require_output, write_results
from svmdist.errors import RecordingError
from svmdist.report.writers import Holds, choose_writer

if TYPE_CHECKING:
    from svmdist.profile import Profile


SeeingMethod = Literal["fiducial", "stereo", "shaft"]
Against = Literal["kinematics", "pose"]


class HandEyeOptions(ProfileOptions, InstrumentOption, LagOption, WindowOptions):
    """What `hand-eye` takes."""

    file: Path = argument(..., "FILE", "Recording to fit on.")
    method: SeeingMethod | None = option(
        None,
        "--method",
        "What finds the tool: fiducial, stereo or shaft. Default: the first of these that finds it.",
    )
    against: Against | None = option(
        None,
        "--against",
        "What the robot reports: kinematics of its joints, or the poses of measured_cp. Default: the joints"
        " where log and profile have them.",
    )
    form: str | None = format_option(Holds.TABLES)
    output: Path | None = output_option(
        "FILE.toml", 'Store the transforms in this file; a profile names it: hand_eye = "FILE.toml".'
    )
    force: bool = FORCE
    jobs: int | None = JOBS


def hand_eye_command(given: HandEyeOptions) -> None:
    """Fit the camera-to-base transform.

    The tool as the images show it is compared with the joints or poses that the robot reports. The result has a
    covariance, and is used by every command whose profile names the file, or by --hand-eye.

    Examples:
      Fit by the tag on the instrument:
        svmdist hand-eye log.mcap --method fiducial -o hand-eye.toml
      Use the transform:
        svmdist estimate log.mcap --method fused --hand-eye hand-eye.toml
    """
    from svmdist.profile import load_profile
    from svmdist.profile.hand_eye import save_hand_eye
    from svmdist.report.info import hand_eye_file, hand_eye_results
    from svmdist.results import Failure
    from svmdist.workflows.calibrate import HandEyeResult, hand_eye
    from svmdist.workflows.request import Request, prepare

    file, output = given.file, given.output
    require_output(output, [file])
    require_new(output, force=given.force)
    writer = choose_writer(given.form, None, Holds.TABLES)
    lag, window, topics = given.given_lag, given.window, given.topics
    methods = [given.method] if given.method else _served(file, load_profile(given.profile), topics)
    failures: list[str] = []
    for method in methods:
        setup = prepare(given.profile, method)
        request = Request(setup, topics, window, given.instruments(setup.profile), lag)
        recording = request.open(file, file.stem)
        seen = corrected(recording, request, given.jobs)
        found = {}
        for name in request.instruments or recording.instruments:
            with progress_bar(f"{method} finds {name}", "images") as advance:
                found[name] = hand_eye(seen, setup, name, given.against, given.jobs, advance)
        failures += [
            f"{method}, {name}: {one.reason}" for name, one in found.items() if isinstance(one, Failure)
        ]
        results = [one for one in found.values() if isinstance(one, HandEyeResult)]
        if results:
            break
    else:
        raise RecordingError(f"{file}: no transform can be estimated: {'; '.join(failures)}")
    write_results(hand_eye_results(results), writer, None)
    for failure in failures:
        LOG.info("note: %s", failure)
    if output is not None:
        save_hand_eye(output, hand_eye_file(results, recording))
        LOG.info(
            '%s: %d transforms; in a profile beside it: hand_eye = "%s"', output, len(results), output.name
        )
    raise typer.Exit(log_losses(recording.path, recording.health))


def _served(file: Path, profile: Profile, topics: dict[str, str]) -> list[str]:
    """The methods that log and profile serve, the surest first; RecordingError where there is none."""
    from svmdist.recording.summary import inspect_recording
    from svmdist.workflows.calibrate import SEEING_METHODS
    from svmdist.workflows.capabilities import method_capabilities

    summary = inspect_recording(file, profile, topics=topics)
    found = {one.name: one for one in method_capabilities(summary, profile)}
    served = [name for name in SEEING_METHODS if found[name].served]
    if not served:
        lacking = "; ".join(f"{name} lacks {', '.join(found[name].missing)}" for name in SEEING_METHODS)
        raise RecordingError(f"{file}: no method can see the tool: {lacking}")
    return served
