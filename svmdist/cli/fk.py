"""`svmdist fk`: the tool's pose for each joint state of a log."""

from __future__ import annotations

import math
from collections.abc import Generator
from contextlib import closing
from typing import TYPE_CHECKING

from svmdist.cli import output
from svmdist.cli.logs import LogOptions, Run
from svmdist.cli.options import OutputOptions, ReadOptions, WindowOptions, format_option, option
from svmdist.cli.output import LOG, ExitCode
from svmdist.errors import UsageError
from svmdist.report.writers import Holds, Results

if TYPE_CHECKING:
    from svmdist.recording.log import Recording
    from svmdist.report.tables import Row
    from svmdist.transforms import Array
    from svmdist.workflows.request import Request


class Fk(LogOptions, ReadOptions, WindowOptions, OutputOptions):
    """Print the tool's pose for every joint state.

    The forward kinematics of the profile's chain, in its base frame. Errors against the log's poses are on stderr.
    --start, --end and --every count joint states in place of images.

    Examples:
      The tool's pose for each joint state:
        svmdist fk log.mcap -o poses.csv
      In the camera's frame, for evo:
        svmdist fk log.mcap --in-camera -o poses.tum
    """

    joints: str | None = option("--joints TOPIC", "Topic of the joint states.")
    in_camera: bool = option("--in-camera", "In the camera's frame.", False)
    form: str | None = format_option(Holds.POSES)

    def _run(self) -> ExitCode:
        from svmdist.metrics import TEXT
        from svmdist.report.rows import POSE_COLUMNS
        from svmdist.report.tables import Column
        from svmdist.workflows.request import Request, Setup

        writer = self.writer(self.paths, Holds.POSES)
        several = len(self.logs) > 1
        if writer.name == "tum" and several:
            raise UsageError(f"--format tum writes one trajectory, and {len(self.logs)} logs are given")
        topics = self.topics
        if self.joints and topics.setdefault("joints", self.joints) != self.joints:
            raise UsageError(
                f"--joints {self.joints} and --topic joints={topics['joints']}: give one of them"
            )
        request = Request(Setup.reading(self.profile, self.hand_eye), topics, self.window)
        run = Run(self, pose_rows_of, request, int, "computing", options=(self.in_camera, several))
        columns = (*POSE_COLUMNS, Column("recording", TEXT)) if several else POSE_COLUMNS
        _, rows = run.begun(1, self.output)
        output.write_results(Results(columns, rows), writer, self.output)
        return run.exit_code()


def pose_rows_of(
    recording: Recording, request: Request, _threads: int, in_camera: bool, named: bool
) -> Generator[Row, None, int]:
    """The rows of one recording, which name it where there are several; the errors against its poses are logged."""
    import numpy as np

    from svmdist.report.rows import pose_rows
    from svmdist.workflows.fk import fk_blocks

    profile = request.setup.profile.for_instrument(recording.instruments[0])
    errors, count = [], 0
    with output.progress_bar("reading", "joint states") as advance:
        made = fk_blocks(recording, profile, in_camera=in_camera, on_progress=advance)
        with closing(made):
            for block in made:
                errors.append(block.errors)
                for row in pose_rows(block.stamps_ns, block.poses):
                    yield row | {"recording": recording.name} if named else row
                    count += 1
    if recording.topic_of("pose") is not None:
        of = f"{recording.name}: " if named else ""
        _log_errors(np.concatenate(errors), recording.pose_track().parent, of)
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
