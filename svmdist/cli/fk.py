"""`svmdist fk`: the tool's pose for each joint state of a log."""

from __future__ import annotations

import math
from collections.abc import Generator
from contextlib import closing, nullcontext
from dataclasses import dataclass
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
    from svmdist.workflows.fk import PoseErrors
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
    from svmdist.report.rows import pose_rows
    from svmdist.workflows.fk import fk_blocks

    profile = request.setup.profile.for_instrument(recording.instruments[0])
    sums, count = ErrorSums(), 0
    with progress_bar("reading", "joint states") as advance:
        made = fk_blocks(recording, profile, in_camera=in_camera, window=request.window, on_progress=advance)
        with closing(made):
            for block in made:
                if block.errors is not None:
                    sums.add(block.errors)
                for row in pose_rows(block.stamps_ns, block.poses):
                    yield row | {"recording": recording.name} if named else row
                    count += 1
    sums.log(recording.name if named else "")
    return count


@dataclass
class ErrorSums:
    """Errors against a pose topic, added up block by block."""

    count: int = 0
    unpaired_count: int = 0
    frame_id: str | None = None
    square_mm2: float = 0.0
    max_mm: float = 0.0
    square_deg2: float = 0.0
    max_deg: float = 0.0

    def add(self, errors: PoseErrors) -> None:
        """Take in a block."""
        import numpy as np

        self.frame_id = errors.frame_id
        self.unpaired_count += errors.unpaired_count
        if len(errors.stamps_ns) == 0:
            return
        position_mm, angle_deg = errors.position_m * 1e3, np.degrees(errors.angle_rad)
        self.count += len(position_mm)
        self.square_mm2 += float(np.sum(position_mm**2))
        self.square_deg2 += float(np.sum(angle_deg**2))
        self.max_mm = max(self.max_mm, float(position_mm.max()))
        self.max_deg = max(self.max_deg, float(angle_deg.max()))

    def log(self, name: str) -> None:
        """Log the errors, where there is a pose topic."""
        if self.frame_id is None:
            return
        of = f"{name}: " if name else ""
        if self.count == 0:
            LOG.info("%sno pose of the topic (frame %s) is near a joint state in time", of, self.frame_id)
            return
        LOG.info(
            "%sagainst %d poses in frame %s: position RMSE %.4g mm, max %.4g mm; angle RMSE %.4g°, max %.4g°;"
            " %d joint states without a pose",
            *(of, self.count, self.frame_id),
            *(math.sqrt(self.square_mm2 / self.count), self.max_mm),
            *(math.sqrt(self.square_deg2 / self.count), self.max_deg),
            self.unpaired_count,
        )
