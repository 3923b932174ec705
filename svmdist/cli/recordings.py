"""The recordings that a command is given: files and folders, names that differ, and which images are read."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from svmdist.cli.console import ExitCode, Verbosity, report_health, say
from svmdist.errors import RecordingError, SvmdistError, UsageError

if TYPE_CHECKING:
    from svmdist.profile import Profile
    from svmdist.recording.reader import Recording
    from svmdist.recording.reading import Window

LOG_ENDINGS = (".mcap", ".bag")

StartOption = Annotated[
    float,
    typer.Option("--start", metavar="SECONDS", min=0.0, help="Begin so long after the first image."),
]
EndOption = Annotated[
    float | None,
    typer.Option(
        "--end", metavar="SECONDS", min=0.0, help="End so long after the first image.", show_default=False
    ),
]
EveryOption = Annotated[int, typer.Option("--every", metavar="N", min=1, help="Take every N-th image only.")]


def window_of(start_s: float, end_s: float | None, every: int) -> Window | None:
    """The window that the options name, None for all images; raises UsageError for one without any."""
    if (start_s, end_s, every) == (0.0, None, 1):
        return None
    if end_s is not None and end_s < start_s:
        raise UsageError(f"--end {end_s:g}: is before --start {start_s:g}")
    from svmdist.recording.reading import Window

    return Window(start_s, math.inf if end_s is None else end_s, every)


@dataclass
class Opened:
    """The recordings that could be opened. `failures` counts those that could not be opened or measured."""

    recordings: list[Recording] = field(default_factory=list)
    count: int = 0
    failures: int = 0

    def fail(self, problem: SvmdistError) -> None:
        """Say why one of several recordings is left out; raises the problem where it is the only one."""
        if self.count == 1:
            raise problem
        self.failures += 1
        say(f"svmdist: left out: {problem}", Verbosity.QUIET)
        if self.failures == self.count:
            raise RecordingError("no recording could be used")

    def health_code(self) -> ExitCode:
        """Say what was lost while reading; a recording that was left out is a loss too."""
        code = report_health(self.recordings)
        return ExitCode.LOSS if self.failures else code


def open_recordings(
    paths: Sequence[Path], profile: Profile, topics: dict[str, str], window: Window | None = None
) -> Opened:
    """Open files and all logs in folders, each under a name of its own; one of several that cannot be is left out.

    Raises RecordingError where there is one only, or none that can be opened.
    """
    from svmdist.recording.reader import open_recording
    from svmdist.recording.reading import Reading, unique_names
    from svmdist.recording.topics import Role

    files = [file for path in paths for file in logs_in(path)]
    opened = Opened(count=len(files))
    for path, name in zip(files, unique_names(files), strict=True):
        try:
            recording = open_recording(path, profile, topics=topics)
        except RecordingError as problem:
            opened.fail(problem)
        else:
            recording = recording.read_as(Reading(name, window))
            opened.recordings.append(recording)
            found = [f"{role} {topic}" for role in Role if (topic := recording.topic_of(role))]
            say(f"svmdist: {name}: {path}: {', '.join(found)}", Verbosity.VERBOSE)
    return opened


def logs_in(path: Path) -> list[Path]:
    """The logs in a folder, by name; a file, and a folder that is a rosbag2, stand for themselves."""
    from svmdist.recording.rosbag import METADATA_FILE

    if not path.is_dir() or (path / METADATA_FILE).is_file():
        return [path]
    found = sorted(
        file
        for file in path.iterdir()
        if file.suffix.lower() in LOG_ENDINGS or (file.is_dir() and (file / METADATA_FILE).is_file())
    )
    return found or [path]  # opening it tells what was expected
