"""The recordings that a command is given: files and folders, names that differ, and which images are read."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from glob import glob
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from svmdist.cli.console import ExitCode, Verbosity, report_health, say
from svmdist.errors import RecordingError, SvmdistError, UsageError
from svmdist.input_file import LogPath
from svmdist.remote_file import RemoteFile, is_url

if TYPE_CHECKING:
    from svmdist.profile import Profile
    from svmdist.recording.log import Recording
    from svmdist.recording.observations import Window
    from svmdist.workflows.batch.task import LogFile

LOG_ENDINGS = (".mcap", ".bag")
GLOB = re.compile(r"[*?\[]")

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
    from svmdist.recording.observations import Window

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
    files: Sequence[LogFile], profile: Profile, topics: dict[str, str], window: Window | None = None
) -> Opened:
    """Open logs, each under its name; one of several that cannot be opened is left out.

    Raises RecordingError where there is one only, or none that can be opened.
    """
    from svmdist.recording.topics import Role

    opened = Opened(count=len(files))
    for log in files:
        try:
            recording = open_log(log, profile, topics, window)
        except RecordingError as problem:
            opened.fail(problem)
        else:
            opened.recordings.append(recording)
            found = [f"{role} {topic}" for role in Role if (topic := recording.topic_of(role))]
            say(f"svmdist: {log.name}: {log.path}: {', '.join(found)}", Verbosity.VERBOSE)
    return opened


def open_log(
    log: LogFile, profile: Profile, topics: dict[str, str], window: Window | None = None
) -> Recording:
    """Open a log under its name; raises RecordingError."""
    from svmdist.recording.log import open_recording
    from svmdist.recording.observations import Reading

    return open_recording(log.path, profile, topics=topics).read_as(Reading(log.name, window))


def logs_or_golden(files: Sequence[str | Path] | None) -> list[LogFile]:
    """The logs that are named, else every recording in recordings/; raises UsageError where there is none."""
    if files:
        return named_logs(files)
    if not any(Path("recordings").glob("*.mcap")):
        raise UsageError(f"no FILE given, and there is no .mcap in {Path('recordings').resolve()}")
    return named_logs(["recordings/*.mcap"])


def named_logs(files: Sequence[str | Path]) -> list[LogFile]:
    """The logs that files, folders, globs and URLs stand for, each once and under a name of its own.

    Raises UsageError for a glob that nothing matches, and RecordingError where a store cannot be asked.
    """
    from svmdist.input_file import unique_names
    from svmdist.workflows.batch.task import LogFile

    found: dict[object, LogPath] = {}
    for text in files:
        for path in _paths_of(os.fspath(text)):
            found.setdefault(path if isinstance(path, RemoteFile) else os.path.realpath(path), path)
    paths = list(found.values())
    return [LogFile(path, name) for path, name in zip(paths, unique_names(paths), strict=True)]


def local_logs(logs: Sequence[LogFile]) -> list[Path]:
    """The paths of logs that are on this machine."""
    return [log.path for log in logs if isinstance(log.path, Path)]


def _paths_of(text: str) -> list[LogPath]:
    if is_url(text):
        return [*_urls_of(text)]
    if text.lower().startswith(("file://", "local://")):
        from urllib.parse import unquote

        text = unquote(text.partition("://")[2].removeprefix("localhost"))
    path = Path(text)
    if "\0" in text or os.path.lexists(path) or not GLOB.search(text):
        return [*logs_in(path)]
    matches = sorted(Path(match) for match in glob(text, recursive=True))
    logs = [match for match in matches if _is_log(match)]
    folders = [match for match in matches if match.is_dir() and match not in logs]
    if not logs and len(folders) == len(matches) and matches:
        logs = [log for folder in folders for log in logs_in(folder) if log != folder]
    chosen = logs or [match for match in matches if match.is_file()]
    if not chosen:
        raise UsageError(f"{text}: no log matches")
    return [*chosen]


def _urls_of(url: str) -> list[RemoteFile]:
    """The logs of a URL: of a folder or a glob all those in it, by name; a file stands for itself."""
    from svmdist.remote_file import listed_urls

    try:
        found = listed_urls(
            url, LOG_ENDINGS, is_glob=GLOB.search(url.partition("://")[2].partition("?")[0]) is not None
        )
    except OSError as problem:
        raise RecordingError(f"{RemoteFile(url)}: cannot read: {problem.strerror or problem}") from None
    if not found:
        raise UsageError(f"{RemoteFile(url)}: no log matches")
    return found


def _is_log(path: Path) -> bool:
    from svmdist.recording.source import METADATA_FILE

    return path.suffix.lower() in LOG_ENDINGS or (path.is_dir() and (path / METADATA_FILE).is_file())


def logs_in(path: Path) -> list[Path]:
    """The logs in a folder, by name; a file, and a folder that is a rosbag2, stand for themselves."""
    if "\0" in str(path) or not path.is_dir() or _is_log(path):
        return [path]
    try:
        found = sorted(file for file in path.iterdir() if _is_log(file) and not file.name.startswith("."))
    except OSError as problem:
        raise RecordingError(f"{path}: cannot read: {problem.strerror or problem}") from None
    return found or [path]  # opening it tells what was expected
