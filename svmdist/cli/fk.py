"""`svmdist fk`: the tool's pose for each joint state of a log."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from svmdist.cli.console import report_health, require_output, say, terminal_width, write_lines
from svmdist.cli.options import HandEyeOption, OutputOption, ProfileOption, TopicOption, topics_of
from svmdist.cli.outputs import by_ending
from svmdist.cli.progress import Item, progress_bar, tracked
from svmdist.cli.recordings import window_of

if TYPE_CHECKING:
    from svmdist.workflows.fk import PoseErrors


class PoseFormat(StrEnum):
    """`--format` of poses."""

    CSV = "csv"
    JSON = "json"
    TUM = "tum"


def fk_command(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Recording to read.", show_default=False)],
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
    form: Annotated[
        PoseFormat | None,
        typer.Option(
            "--format",
            "-f",
            help="Format of the data; tum is the format of evo. Default: by the ending of the output file, else csv.",
            show_default=False,
        ),
    ] = None,
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
) -> None:
    """Print the tool's pose for every joint state.

    The pose is the forward kinematics of the profile's chain, in its base frame or the camera's. Where the log has a
    pose topic, the errors against it are printed on stderr.
    """
    from svmdist.profile import load_profile
    from svmdist.recording.reader import open_recording
    from svmdist.report.poses import POSE_KEYS, pose_rows, tum_lines
    from svmdist.report.table import csv_lines, json_array_lines
    from svmdist.workflows.fk import fk

    require_output(output, [file])
    chosen = pose_format(form, output)
    window = window_of(start, end, every)
    loaded = load_profile(profile, hand_eye)
    topics = topics_of(topic) | ({"joints": joints} if joints else {})
    recording = open_recording(file, loaded, topics=topics)
    loaded = loaded.for_instrument(recording.instruments[0])
    with progress_bar("reading", "joint states") as advance:
        result = fk(recording, loaded, in_camera=in_camera, window=window, on_progress=advance)
    count = len(result.stamps_ns)
    match chosen:
        case PoseFormat.CSV:
            write_lines(csv_lines(POSE_KEYS, _written(pose_rows(result), output, count)), output)
        case PoseFormat.JSON:
            lines = json_array_lines(POSE_KEYS, _written(pose_rows(result), output, count))
            write_lines(lines, output, is_json=True)
        case PoseFormat.TUM:
            write_lines(_written(tum_lines(result), output, count), output)
    if result.errors is not None:
        _say_errors(result.errors)
    raise typer.Exit(report_health([recording]))


def pose_format(given: PoseFormat | None, output: Path | None) -> PoseFormat:
    """The format of poses: the given one, else that of the file's ending, else CSV; raises UsageError."""
    endings = {f".{form}": form for form in PoseFormat}
    return by_ending(endings, PoseFormat.CSV, output, "CSV") if given is None else given


def _written(rows: Iterable[Item], output: Path | None, count: int) -> Iterable[Item]:
    """The rows, with progress told, but where they show on a terminal by themselves."""
    return rows if terminal_width(output) is not None else tracked(rows, "writing", "poses", count)


def _say_errors(errors: PoseErrors) -> None:
    import numpy as np

    if len(errors.stamps_ns) == 0:
        say(f"svmdist: no pose of the topic (frame {errors.frame_id}) is near a joint state in time")
        return
    position_mm, angle_deg = errors.position_m * 1e3, np.degrees(errors.angle_rad)
    say(
        f"svmdist: against {len(position_mm)} poses in frame {errors.frame_id}:"
        f" position RMSE {np.sqrt(np.mean(position_mm**2)):.4g} mm, max {position_mm.max():.4g} mm;"
        f" angle RMSE {np.sqrt(np.mean(angle_deg**2)):.4g}°, max {angle_deg.max():.4g}°;"
        f" {errors.unpaired_count} joint states without a pose"
    )
