"""`svmdist show`: pictures of what the methods see in a log's images."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from svmdist.cli.console import report_health, say, write_lines
from svmdist.cli.options import ProfileOption, TopicOption, topics_of
from svmdist.errors import OutputError, UsageError

DEFAULT_COUNT = 6
"""Pictures where none is asked for: enough to see a log from its beginning to its end."""


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
    profile: ProfileOption = "psm13",
    topic: TopicOption = None,
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            metavar="DIR",
            help="Folder that the pictures go to; it is made.",
            show_default=".",
        ),
    ] = Path("."),
) -> None:
    """Show images of a recording with what was found in them, as PNG files.

    Without --frame or --at, six images from the first to the last are drawn. The names of the files are printed.
    """
    panels = [name for name, wanted in (("masks", masks),) if wanted]
    if not panels:
        raise UsageError("nothing to show: give --masks")
    if frame is not None and at is not None:
        raise UsageError("--frame and --at both choose an image: give one of them")
    from svmdist.profile import load_profile
    from svmdist.recording.reader import open_recording
    from svmdist.report.pictures import picture_of, write_picture
    from svmdist.workflows.setup import Setup
    from svmdist.workflows.show import image_stamps_ns, shown_frames, spread

    loaded = load_profile(profile)
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
    else:
        numbers = set(spread(len(stamps_ns), DEFAULT_COUNT))
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise OutputError(f"{output}: cannot make the folder: {problem.strerror or problem}") from None
    setup = Setup(loaded, "shaft", "corrected", None)
    drawn = 0
    for shown in shown_frames(recording, setup, lambda number, _: number in numbers, max(numbers)):
        path = output / f"{recording.name}-{shown.number:05d}.png"
        write_picture(path, picture_of(shown, panels, recording.name))
        write_lines([f"{path}\n"], None)
        drawn += 1
    if drawn < len(numbers):
        say(f"svmdist: {len(numbers) - drawn} of {len(numbers)} images cannot be read, and are not drawn")
    raise typer.Exit(report_health([recording]))
