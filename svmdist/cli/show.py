"""`svmdist show`: pictures of what the methods see in a log's images."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from svmdist.cli.console import report_health, say, write_lines
from svmdist.cli.options import (
    CalibrationOption,
    JobsOption,
    Method,
    MethodOption,
    ProfileOption,
    TopicOption,
    topics_of,
)
from svmdist.cli.progress import progress_bar
from svmdist.errors import OutputError, UsageError

if TYPE_CHECKING:
    from svmdist.recording.log import Recording
    from svmdist.samples import Image
    from svmdist.workflows.request import Setup

DEFAULT_COUNT = 6
"""Pictures where none is asked for: enough to see a log from its beginning to its end."""
PICTURE_ENDINGS = frozenset(
    {".png", ".jpg", ".jpeg", ".svg", ".pdf", ".gif", ".bmp", ".tif", ".tiff", ".webp"}
)
"""Names that mean a picture, and not a folder."""
Picture = tuple[int, "Image"]


def show_command(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Recording to look at.", show_default=False)],
    masks: Annotated[
        bool,
        typer.Option("--masks", help="Draw what is segmented as tissue, shaft, distal part and border."),
    ] = False,
    frame: Annotated[
        int | None,
        typer.Option(
            "--frame", metavar="N", min=0, help="Only the image of this number, from 0.", show_default=False
        ),
    ] = None,
    at: Annotated[
        float | None,
        typer.Option(
            "--at",
            metavar="S",
            min=0.0,
            help="Only the image nearest to so many seconds.",
            show_default=False,
        ),
    ] = None,
    worst: Annotated[
        int | None,
        typer.Option(
            "--worst",
            metavar="N",
            min=1,
            help="The N worst frames: by error where the log has ground truth, else by the interval's width.",
            show_default=False,
        ),
    ] = None,
    method: MethodOption = Method.OVERLAY,
    calibration: CalibrationOption = None,
    profile: ProfileOption = "psm13",
    topic: TopicOption = None,
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            metavar="DIR",
            help="Folder that the pictures go to; it is made. A name in .png is the one picture of --frame or --at.",
            show_default=".",
        ),
    ] = Path("."),
    jobs: JobsOption = None,
) -> None:
    """Show images with what was found in them.

    The pictures are PNG files. Each phase of the method is a panel: segmentation, contours, marker, matches and
    outline of overlay; edges, tip, tag and surface of fused. With --masks, only what was segmented is drawn. Without
    --frame, --at or --worst, six images from the first to the last are drawn. The names of the files are printed.
    """
    if sum(choice is not None for choice in (frame, at, worst)) > 1:
        raise UsageError("--frame, --at and --worst choose images: give one of them")
    if masks and worst is not None:
        raise UsageError(
            "--worst needs what a method measured, and --masks shows what was segmented before it"
        )
    from svmdist.recording.log import open_recording
    from svmdist.report.panels import write_picture
    from svmdist.workflows.frame_drawing import Segmented, image_stamps_ns, spread
    from svmdist.workflows.request import prepare

    setup = prepare(profile, Segmented() if masks else method.value, "corrected", calibration)
    loaded = setup.profile
    recording = open_recording(file, loaded, topics=topics_of(topic))
    stamps_ns = image_stamps_ns(recording)
    if frame is not None:
        if frame >= len(stamps_ns):
            raise UsageError(
                f"--frame {frame}: {file.name} has {len(stamps_ns)} images, 0 to {len(stamps_ns) - 1}"
            )
        numbers = {frame}
    elif at is not None:
        numbers = {min(range(len(stamps_ns)), key=lambda n: abs((stamps_ns[n] - stamps_ns[0]) * 1e-9 - at))}
    elif worst is not None:
        numbers = _worst(recording, setup, worst, len(stamps_ns), jobs)
    else:
        numbers = set(spread(len(stamps_ns), DEFAULT_COUNT))
    is_one = _is_one_picture(output, len(numbers))
    try:
        (output.parent if is_one else output).mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise OutputError(f"{output}: cannot make the folder: {problem.strerror or problem}") from None
    drawn = 0
    for number, picture in _drawn(recording, setup, numbers, jobs, masks=masks):
        path = output if is_one else output / f"{recording.name}-{number:05d}.png"
        write_picture(path, picture)
        write_lines([f"{path}\n"], None)
        drawn += 1
    if drawn < len(numbers):
        say(f"svmdist: {len(numbers) - drawn} of {len(numbers)} images cannot be read, and are not drawn")
    raise typer.Exit(report_health([recording]))


def _is_one_picture(output: Path, count: int) -> bool:
    """Whether the output names a picture, not a folder; raises UsageError where it cannot hold what is asked for."""
    if output.suffix.lower() not in PICTURE_ENDINGS or output.is_dir():
        return False
    if output.suffix.lower() != ".png":
        raise UsageError(f"{output}: pictures are PNG files: give a name in .png, or a folder")
    if count > 1:
        raise UsageError(
            f"{output}: is one picture, and {count} are asked for: give --frame, --at, or a folder"
        )
    return True


def _drawn(
    recording: Recording, setup: Setup, numbers: set[int], jobs: int | None, *, masks: bool
) -> Iterator[Picture]:
    from svmdist.report.panels import masks_picture, phases_picture
    from svmdist.workflows.frame_drawing import drawn_frames
    from svmdist.workflows.parallel import Steps

    with progress_bar(f"drawing {recording.name}", "images") as advance:
        steps = Steps(advance, max(numbers) + 1)
        for shown in drawn_frames(recording, setup, jobs=jobs, numbers=numbers, on_image=steps.advance):
            where = f"{recording.name}  frame {shown.number}"
            if masks:
                yield shown.number, masks_picture(shown, f"{where}  {shown.seconds:.2f} s  masks")
            else:
                yield shown.number, phases_picture(shown, f"{where}  method {setup.method}", setup.method)


def _worst(recording: Recording, setup: Setup, count: int, total: int, jobs: int | None) -> set[int]:
    """The numbers of the worst frames of any instrument; says of each how bad it is."""
    from svmdist.workflows.estimate import estimate
    from svmdist.workflows.series import make_series, worst_frames

    rows = []
    with progress_bar(f"measuring {recording.name}", "rows") as advance:
        for row in estimate(recording, setup, jobs=jobs):
            rows.append(row)
            advance(len(rows), total * len(recording.instruments))
    worst = worst_frames(make_series(rows, recording, setup), count)
    for one in worst:
        say(f"svmdist: {one.in_words}")
    return {one.number for one in worst}
