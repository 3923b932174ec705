"""The logs that a command is given: which they are, by what names, how they are grouped, and what was lost of them."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Sequence
from functools import cached_property
from glob import glob
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote

from svmdist.cli.options import JOBS, Options, argument, option
from svmdist.cli.output import LOG, ExitCode
from svmdist.errors import RecordingError, UsageError
from svmdist.files import reading
from svmdist.remote import LogPath, RemoteFile, is_url, listed_urls

if TYPE_CHECKING:
    from svmdist.recording.source import Health
    from svmdist.workflows.batch import LogFile

LOG_ENDINGS = (".mcap", ".bag", ".db3")
GLOB = re.compile(r"[*?\[]")


class LogOptions(Options):
    """Logs, and where they are measured."""

    files: list[str] = argument(..., "FILE", "Logs (.mcap, .bag, rosbag2), folders, globs or URLs.")
    jobs: int | None = JOBS
    scheduler: str | None = option("--scheduler URL", "Measure on this Dask cluster: tcp://HOST:PORT.")
    resume: Path | None = option("--resume FOLDER", "Keep results here; reuse those that still hold.")

    @cached_property
    def logs(self) -> list[LogFile]:
        """The logs; raises UsageError where options contradict each other or name no log."""
        if self.scheduler is not None and self.jobs is not None:
            raise UsageError("--jobs and --scheduler: the cluster has its own workers; leave out one of them")
        if not self.files and not any(Path("recordings").glob("*.mcap")):
            raise UsageError(f"no FILE given, and there is no .mcap in {Path('recordings').resolve()}")
        return named_logs(self.files or ["recordings/*.mcap"])

    @property
    def paths(self) -> list[LogPath]:
        """Where they are."""
        return [log.path for log in self.logs]

    @property
    def is_one(self) -> bool:
        """Whether there is one log, measured here: its rows come as they are measured, its errors end the command."""
        return len(self.logs) == 1 and self.scheduler is None and self.resume is None


class OneLogOptions(Options):
    """One log."""

    file: str = argument(..., "FILE", "Log (.mcap, .bag, rosbag2), or its URL.")

    @cached_property
    def log(self) -> LogFile:
        """Where it is, and its name; raises UsageError where a folder or glob has several."""
        logs = named_logs([self.file])
        if len(logs) > 1:
            raise UsageError(f"{self.file}: expected one log, found {', '.join(str(one.path) for one in logs)}")
        return logs[0]


class GroupOption(Options):
    """How logs are grouped."""

    group: str | None = option("--group KEY,...", "Figures of groups, too: metadata as in scenario,world.")

    @property
    def group_keys(self) -> tuple[str, ...]:
        """The keys of `--group`; raises UsageError for none."""
        if self.group is None:
            return ()
        keys = tuple(key.strip() for key in self.group.split(","))
        if not all(keys):
            raise UsageError(f"--group {self.group}: expected names of metadata, as in scenario,world")
        return keys


def group_name(metadata: dict[str, str], keys: Sequence[str]) -> str:
    """What a log is grouped as: `scenario=sweep world=real`; a key that it does not have is `none`."""
    return " ".join(f"{key}={metadata.get(key, 'none')}" for key in keys)


def log_losses(path: LogPath, health: Health) -> ExitCode:
    """Say what of a log contradicts, and what was lost while reading it; the exit code tells whether anything was."""
    for line in health.contradictions:
        LOG.warning("warning: %s: %s", path, line)
    for line in health.describe():
        LOG.error("loss: %s: %s", path, line)
    return ExitCode.CLEAN if health.is_clean else ExitCode.LOSS


def named_logs(files: Sequence[str | Path]) -> list[LogFile]:
    """The logs that files, folders, globs and URLs stand for, each once and under a name of its own.

    Raises UsageError for a glob that nothing matches, and RecordingError where a store cannot be asked.
    """
    from svmdist.workflows.batch import LogFile

    found: dict[object, LogPath] = {}
    for text in files:
        for path in _paths_of(os.fspath(text)):
            found.setdefault(path if isinstance(path, RemoteFile) else os.path.realpath(path), path)
    paths = list(found.values())
    return [LogFile(path, name) for path, name in zip(paths, _unique_names(paths), strict=True)]


def _unique_names(paths: Sequence[LogPath]) -> list[str]:
    """A name for each log: the file's without its ending, with as many folders before it as tell it from others."""
    parts: list[tuple[str, ...]] = []
    for path in paths:
        folders = path.folders if isinstance(path, RemoteFile) else Path(os.path.abspath(path)).parts[1:-1]
        parts.append((*folders, path.stem))
    ends = {part: [part[-depth:] for depth in range(1, len(part) + 1)] for part in parts}
    counts = Counter(end for each in ends.values() for end in each)
    return ["/".join(next((end for end in ends[part] if counts[end] == 1), part)) for part in parts]


def _paths_of(text: str) -> Sequence[LogPath]:
    """The logs of a file, or of a folder, a glob or a URL of one, by name; a file, and what is no log, is itself."""
    if is_url(text):
        url = RemoteFile(text)
        with reading(url, RecordingError):
            urls = listed_urls(text, LOG_ENDINGS, is_glob=GLOB.search(url.parts[2]) is not None)
        if not urls:
            raise UsageError(f"{url}: no log matches")
        return urls
    if text.lower().startswith(("file://", "local://")):
        text = unquote(text.partition("://")[2].removeprefix("localhost"))
    path = Path(text)
    if "\0" in text or os.path.lexists(path) or not GLOB.search(text):
        return _logs_in(path)
    from svmdist.recording.topics import WHAT_IS_EXPECTED

    matches = sorted(Path(match) for match in glob(text, recursive=True))
    logs = [match for match in matches if _is_log(match)]
    logs = logs or [log for match in matches if match.is_dir() for log in _logs_in(match) if log != match]
    chosen = logs or [match for match in matches if match.is_file()]
    if not chosen:
        raise UsageError(f"{text}: no log matches; a log is {WHAT_IS_EXPECTED}")
    return chosen


def _is_log(path: Path) -> bool:
    from svmdist.recording.source import METADATA_FILE

    return path.suffix.lower() in LOG_ENDINGS or (path.is_dir() and (path / METADATA_FILE).is_file())


def _logs_in(path: Path) -> list[Path]:
    """The logs in a folder, by name; a file, and a folder that is a rosbag2, stand for themselves."""
    if "\0" in str(path) or not path.is_dir() or _is_log(path):
        return [path]
    with reading(path, RecordingError):
        found = sorted(file for file in path.iterdir() if _is_log(file) and not file.name.startswith("."))
    return found or [path]  # opening it says what was expected
