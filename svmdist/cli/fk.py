"""`svmdist fk`: the tool's pose for each joint state of a log."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from svmdist.cli.console import require_output, say, terminal_width, write_results
from svmdist.cli.many import Many, Outcomes, ResumeOption, SchedulerOption, heard_notes, measurement
from svmdist.cli.options import (
    Files,
    HandEyeOption,
    JobsOption,
    OutputOption,
    PoseFormatOption,
    ProfileOption,
    TopicOption,
    topics_of,
)
from svmdist.cli.progress import progress_bar, tracked
from svmdist.cli.recordings import local_logs, named_logs, open_log, open_recordings, window_of
from svmdist.errors import UsageError
from svmdist.report.writers import Holds, Results, Writer, choose_writer

if TYPE_CHECKING:
    from svmdist.profile import Profile
    from svmdist.recording.log import Recording
    from svmdist.recording.observations import Window
    from svmdist.report.tables import Row
    from svmdist.workflows.batch.task import LogFile, Measurement, RowWriter
    from svmdist.workflows.fk import PoseErrors
    from svmdist.workflows.parallel import Progress


def fk_command(
    files: Files,
    joints: Annotated[
        str | None,
        typer.Option("--joints", metavar="TOPIC", help="Topic of the joint states.", show_default=False),
    ] = None,
    profile: ProfileOption = "psm13",
    hand_eye: HandEyeOption = None,
    topic: TopicOption = None,
    in_camera: Annotated[
        bool,
        typer.Option(
            "--in-camera", help="In the camera's frame, by the transform of hand-eye or of the log."
        ),
    ] = False,
    form: PoseFormatOption = None,
    output: OutputOption = None,
    start: Annotated[
        float,
        typer.Option(
            "--start", metavar="SECONDS", min=0.0, help="Begin so long after the first joint state."
        ),
    ] = 0.0,
    end: Annotated[
        float | None,
        typer.Option(
            "--end",
            metavar="SECONDS",
            min=0.0,
            help="End so long after the first joint state.",
            show_default=False,
        ),
    ] = None,
    every: Annotated[
        int, typer.Option("--every", metavar="N", min=1, help="Take every N-th joint state only.")
    ] = 1,
    jobs: JobsOption = None,
    scheduler: SchedulerOption = None,
    resume: ResumeOption = None,
) -> None:
    """Print the tool's pose for every joint state.

    The pose is the forward kinematics of the profile's chain, in its base frame or the camera's. Where the log has a
    pose topic, the errors against it are printed on stderr. Of several logs each row names its own.
    """
    from svmdist.profile import load_profile

    logs = named_logs(files)
    require_output(output, local_logs(logs))
    writer = choose_writer(form, output, Holds.POSES)
    if writer.name == "tum" and len(logs) > 1:
        raise UsageError(f"--format tum writes one trajectory, and {len(logs)} logs are given")
    window = window_of(start, end, every)
    loaded = load_profile(profile, hand_eye)
    topics = topics_of(topic) | ({"joints": joints} if joints else {})
    many = Many(logs, jobs, scheduler, resume)
    job = FkJob(loaded, topics, in_camera, window)
    if len(logs) > 1 or many.is_asked_for:
        with many.measured(job, "computing") as outcomes:
            _write(writer, _rows_of_logs(outcomes), output, several=len(logs) > 1)
            raise typer.Exit(outcomes.code())
    opened = open_recordings(logs, loaded, topics)
    sums = ErrorSums()
    with progress_bar("reading", "joint states") as advance:
        rows = _started(pose_rows_of(opened.recordings[0], job, sums, advance))
    _write(writer, _written(rows, output, sums.joint_count), output, several=False)
    sums.tell()
    raise typer.Exit(opened.health_code())


def _write(writer: Writer, rows: Iterator[Row], output: Path | None, *, several: bool) -> None:
    from svmdist.metrics import TEXT
    from svmdist.report.rows import POSE_COLUMNS
    from svmdist.report.tables import Column

    columns = (*POSE_COLUMNS, Column("recording", TEXT)) if several else POSE_COLUMNS
    write_results(Results(columns, rows), writer, output)


def _written(rows: Iterator[Row], output: Path | None, count: int | None) -> Iterator[Row]:
    """The rows, with progress told, but where they show on a terminal by themselves."""
    return rows if terminal_width(output) is not None else tracked(rows, "writing", "poses", count)


def _rows_of_logs(outcomes: Outcomes[FkResult]) -> Iterator[Row]:
    from svmdist.workflows.batch.store import stored_rows

    for one, _ in outcomes.measured:
        if one.rows is not None:
            for row in stored_rows(one.rows):
                yield row | {"recording": one.log.name}


def _started(rows: Iterator[Row]) -> Iterator[Row]:
    """Compute the first row at once, so that a log that cannot be read leaves no header behind."""
    first = next(rows, None)
    return iter(()) if first is None else chain([first], rows)


@dataclass
class ErrorSums:
    """Errors against a pose topic, added up block by block; `joint_count` is known from the first one on."""

    joint_count: int | None = None
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

    def tell(self, name: str = "") -> None:
        """Say the errors, where there is a pose topic."""
        import math

        if self.frame_id is None:
            return
        of = f"{name}: " if name else ""
        if self.count == 0:
            say(f"svmdist: {of}no pose of the topic (frame {self.frame_id}) is near a joint state in time")
            return
        say(
            f"svmdist: {of}against {self.count} poses in frame {self.frame_id}:"
            f" position RMSE {math.sqrt(self.square_mm2 / self.count):.4g} mm, max {self.max_mm:.4g} mm;"
            f" angle RMSE {math.sqrt(self.square_deg2 / self.count):.4g}°, max {self.max_deg:.4g}°;"
            f" {self.unpaired_count} joint states without a pose"
        )


@dataclass(frozen=True)
class FkResult:
    """How many poses a log gave."""

    pose_count: int


@dataclass(frozen=True)
class FkJob:
    """Computes the poses of a log."""

    profile: Profile
    topics: dict[str, str]
    in_camera: bool
    window: Window | None = None

    @property
    def result_type(self) -> type[FkResult]:
        """The type of a result."""
        return FkResult

    def measure(self, log: LogFile, _: int, write: RowWriter) -> Measurement[FkResult]:
        """Write the poses of a log."""
        count = 0
        with heard_notes() as notes:
            recording = open_log(log, self.profile, self.topics)
            sums = ErrorSums()
            for row in pose_rows_of(recording, self, sums):
                write(row)
                count += 1
            sums.tell(log.name)
        return measurement(recording, FkResult(count), notes, grouped=False)


def pose_rows_of(
    recording: Recording, job: FkJob, sums: ErrorSums, on_progress: Progress | None = None
) -> Iterator[Row]:
    """The rows of one recording; `sums` gets their errors, and `on_progress` hears of joint states as they are read."""
    from svmdist.report.rows import pose_rows
    from svmdist.workflows.fk import fk_blocks

    profile = job.profile.for_instrument(recording.instruments[0])
    made = fk_blocks(recording, profile, in_camera=job.in_camera, window=job.window, on_progress=on_progress)
    with closing(made):
        for block in made:
            sums.joint_count = block.joint_count
            if block.errors is not None:
                sums.add(block.errors)
            yield from pose_rows(block.stamps_ns, block.poses)
