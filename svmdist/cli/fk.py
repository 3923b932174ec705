"""`svmdist fk`: the tool's pose for each joint state of a log."""

from __future__ import annotations

import math
from collections.abc import Generator
from contextlib import closing, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from svmdist.cli.logs import Logs, Run
from svmdist.cli.options import LogOptions, ReadOptions, WindowOptions, format_option, option, output_option
from svmdist.cli.output import (
    LOG,
    no_progress,
    progress_bar,
    require_output,
    started,
    terminal_width,
    write_results,
)
from svmdist.errors import UsageError
from svmdist.report.writers import Holds, Results, choose_writer

if TYPE_CHECKING:
    from svmdist.recording.log import Recording
    from svmdist.report.tables import Row
    from svmdist.transforms import Array
    from svmdist.workflows.request import Request


class FkOptions(LogOptions, ReadOptions, WindowOptions):
    """What `fk` takes."""

    joints: str | None = option(None, "--joints TOPIC", "Topic of the joint states.")
    in_camera: bool = option(
        False, "--in-camera", "In the camera's frame, by the transform of hand-eye or of the log."
    )
    form: str | None = format_option(Holds.POSES, "; tum is the format of evo")
    output: Path | None = output_option()
    start: float = option(0.0, "--start SECONDS", "Seconds after the first joint state to begin at.", min=0.0)
    end: float | None = option(
        None, "--end SECONDS", "Seconds after the first joint state to end at.", min=0.0
    )
    every: int = option(1, "--every N", "Take every N-th joint state only.", min=1)


def fk_command(given: FkOptions) -> None:
    """Print the tool's pose for every joint state.

    The pose is the forward kinematics of the profile's chain, in its base frame or the camera's. Where the log has a
    pose topic, the errors against it are printed on stderr. Of several logs each row names its own.

    Examples:
      The tool's pose for each joint state:
        svmdist fk log.mcap -o poses.csv
      In the camera's frame, for evo:
        svmdist fk log.mcap --in-camera -o poses.tum
    """
    from svmdist.metrics import TEXT
    from svmdist.report.rows import POSE_COLUMNS
    from svmdist.report.tables import Column
    from svmdist.workflows.batch import Job
    from svmdist.workflows.request import Request, Setup

    logs = Logs(given)
    require_output(given.output, logs.paths)
    writer = choose_writer(given.form, given.output, Holds.POSES)
    several = len(logs.files) > 1
    if writer.name == "tum" and several:
        raise UsageError(f"--format tum writes one trajectory, and {len(logs.files)} logs are given")
    topics = given.topics | ({"joints": given.joints} if given.joints else {})
    request = Request(Setup.reading(given.profile, given.hand_eye), topics, given.window)
    run: Run[int] = Run(logs, Job(pose_rows_of, request, int, (given.in_camera, several)), "computing")
    columns = (*POSE_COLUMNS, Column("recording", TEXT)) if several else POSE_COLUMNS
    with no_progress() if terminal_width(given.output) is not None else nullcontext():
        write_results(Results(columns, started(run.rows())), writer, given.output)
    raise typer.Exit(run.exit_code())


def pose_rows_of(
    recording: Recording, request: Request, _threads: int, in_camera: bool, named: bool
) -> Generator[Row, None, int]:
    """The rows of one recording, which name it where there are several; the errors against its poses are logged."""
    import numpy as np

    from svmdist.report.rows import pose_rows
    from svmdist.workflows.fk import fk_blocks

    profile = request.setup.profile.for_instrument(recording.instruments[0])
    errors, count = [], 0
    with progress_bar("reading", "joint states") as advance:
        made = fk_blocks(recording, profile, in_camera=in_camera, window=request.window, on_progress=advance)
        with closing(made):
            for block in made:
                errors.append(block.errors)
                for row in pose_rows(block.stamps_ns, block.poses):
                    yield row | {"recording": recording.name} if named else row
                    count += 1
    if recording.topic_of("pose") is not None:
        _log_errors(
            np.concatenate(errors), recording.pose_track().parent, f"{recording.name}: " if named else ""
        )
    return count


def _log_errors(errors: Array, frame_id: str | None, of: str) -> None:
    """Log errors against the poses of a topic, shape (n, 2): position in m and angle in rad, NaN without a pose."""
    import numpy as np

    known = errors[np.isfinite(errors[:, 0])] * [1e3, math.degrees(1.0)]
    if len(known) == 0:
        LOG.info("%sno pose of the topic (frame %s) is near a joint state in time", of, frame_id)
        return
    (rmse_mm, rmse_deg), (max_mm, max_deg) = np.sqrt(np.mean(known**2, axis=0)), known.max(axis=0)
    LOG.info(
        "%sagainst %d poses in frame %s: position RMSE %.4g mm, max %.4g mm; angle RMSE %.4g°, max %.4g°;"
        " %d joint states without a pose",
        *(of, len(known), frame_id, rmse_mm, max_mm, rmse_deg, max_deg, len(errors) - len(known)),
    )
