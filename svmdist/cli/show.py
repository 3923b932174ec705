"""`svmdist show`: pictures of what the methods see in a log's images."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from svmdist.cli.estimate import corrected
from svmdist.cli.logs import log_losses
from svmdist.cli.options import (
    JOBS,
    InstrumentOption,
    LagOption,
    MethodOptions,
    ReadOptions,
    argument,
    option,
    output_option,
)
from svmdist.cli.output import LOG, progress_bar, write_lines
from svmdist.errors import OutputError, UsageError

if TYPE_CHECKING:
    from svmdist.recording.log import Recording
    from svmdist.samples import Image
    from svmdist.workflows.request import Request

DEFAULT_COUNT = 6
"""Pictures where none is asked for: enough to see a log from its beginning to its end."""
PICTURE_ENDINGS = frozenset(
    {".png", ".jpg", ".jpeg", ".svg", ".pdf", ".gif", ".bmp", ".tif", ".tiff", ".webp"}
)
"""Names that mean a picture, and not a folder."""


class ShowOptions(MethodOptions, ReadOptions, InstrumentOption, LagOption):
    """What `show` takes."""

    file: Path = argument(..., "FILE", "Recording to look at.")
    masks: bool = option(False, "--masks", "Draw what is segmented as tissue, shaft, distal part and border.")
    frame: int | None = option(None, "--frame N", "Only the image of this number, from 0.", min=0)
    at: float | None = option(None, "--at S", "Only the image nearest to so many seconds.", min=0.0)
    worst: int | None = option(
        None,
        "--worst N",
        "The N worst frames: by error where the log has ground truth, else by the interval's width.",
        min=1,
    )
    output: Path = output_option(
        "DIR",
        "Folder that the pictures go to; it is made. A name in .png is the one picture of --frame or --at.",
        Path(),
    )
    jobs: int | None = JOBS


def show_command(given: ShowOptions) -> None:
    """Show images with what was found in them.

    The pictures are PNG files. Each phase of the method is a panel: segmentation, contours, marker, matches and
    outline of overlay; edges, tip, tag and surface of fused. With --masks, only what was segmented is drawn. Without
    --frame, --at or --worst, six images from the first to the last are drawn. The names of the files are printed.

    Examples:
      Each step of a method in one frame:
        svmdist show log.mcap --frame 40 --method fused
      The three worst frames:
        svmdist show log.mcap --worst 3 --method fused -o pictures
      What is segmented, in six frames:
        svmdist show log.mcap --masks
    """
    from svmdist.report.panels import write_picture
    from svmdist.workflows.frame_drawing import Segmented
    from svmdist.workflows.request import Request, prepare

    if sum(choice is not None for choice in (given.frame, given.at, given.worst)) > 1:
        raise UsageError("--frame, --at and --worst choose images: give one of them")
    if given.masks and given.worst is not None:
        raise UsageError(
            "--worst needs what a method measured, and --masks shows what was segmented before it"
        )
    lag, output = given.given_lag, given.output
    method = Segmented() if given.masks else given.method
    setup = prepare(given.profile, method, "corrected", given.calibration, given.hand_eye)
    request = Request(setup, given.topics, None, given.instruments(setup.profile), lag)
    recording = request.open(given.file, given.file.stem)
    seen = corrected(recording, request, given.jobs)
    numbers = _numbers(given, seen, request)
    is_one = _is_one_picture(output, len(numbers))
    try:
        (output.parent if is_one else output).mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise OutputError(f"{output}: cannot make the folder: {problem.strerror or problem}") from None
    drawn = 0
    for number, picture in _pictures(seen, request, numbers, given.jobs, masks=given.masks):
        path = output if is_one else output / f"{recording.name}-{number:05d}.png"
        write_picture(path, picture)
        write_lines([f"{path}\n"], None)
        drawn += 1
    if drawn < len(numbers):
        left = len(numbers) - drawn
        LOG.info("%d of %d images cannot be read, and are not drawn", left, len(numbers))
    raise typer.Exit(log_losses(recording.path, recording.health))


def _numbers(given: ShowOptions, recording: Recording, request: Request) -> set[int]:
    """The numbers of the images to draw; raises UsageError."""
    from svmdist.workflows.frame_drawing import image_stamps_ns

    stamps_ns = image_stamps_ns(recording)
    count = len(stamps_ns)
    if given.worst is not None:
        return _worst(recording, request, given.worst, given.jobs)
    if given.frame is not None:
        if given.frame >= count:
            raise UsageError(f"--frame {given.frame}: {given.file.name} has {count} images, 0 to {count - 1}")
        return {given.frame}
    if given.at is not None:
        at = given.at
        return {min(range(count), key=lambda n: abs((stamps_ns[n] - stamps_ns[0]) * 1e-9 - at))}
    if count <= DEFAULT_COUNT:
        return set(range(count))
    return {round(at * (count - 1) / (DEFAULT_COUNT - 1)) for at in range(DEFAULT_COUNT)}


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


def _pictures(
    recording: Recording, request: Request, numbers: set[int], jobs: int | None, *, masks: bool
) -> Iterator[tuple[int, Image]]:
    from svmdist.report.panels import masks_picture, phases_picture
    from svmdist.workflows.frame_drawing import drawn_frames
    from svmdist.workflows.parallel import Steps

    method, wanted = request.setup.method, request.instruments
    with progress_bar(f"drawing {recording.name}", "images") as advance:
        steps = Steps(advance, max(numbers) + 1)
        for shown in drawn_frames(
            recording, request.setup, wanted=wanted, jobs=jobs, numbers=numbers, on_image=steps.advance
        ):
            where = f"{recording.name}  frame {shown.number}"
            if masks:
                yield shown.number, masks_picture(shown, f"{where}  {shown.seconds:.2f} s  masks")
            else:
                yield shown.number, phases_picture(shown, f"{where}  method {method}", method)


def _worst(recording: Recording, request: Request, count: int, jobs: int | None) -> set[int]:
    """The numbers of the worst frames of any instrument; says of each how bad it is."""
    from svmdist.workflows.estimate import Measured, estimate
    from svmdist.workflows.parallel import Steps, image_total
    from svmdist.workflows.series import series_of, worst_frames

    instruments = request.instruments or recording.instruments
    with progress_bar(f"measuring {recording.name}", "rows") as advance:
        steps = Steps(advance, image_total([recording], lambda _: len(instruments)))
        rows = list(steps.of(estimate(recording, request.setup, request.instruments, jobs)))
    found = Measured(recording, recording, tuple(rows), None)
    worst = worst_frames(series_of([found], request), count)
    for one in worst:
        LOG.info("%s", one.in_words)
    return {one.number for one in worst}
