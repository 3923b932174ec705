"""The logs that a command is given, and one path for all of them: one log is a batch of one."""

from __future__ import annotations

import os
import re
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import cached_property
from glob import glob
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar
from urllib.parse import unquote

from svmdist.cli.options import JOBS, Options, argument, option
from svmdist.cli.output import LOG, ExitCode, progress_bar, terminal_width, with_name
from svmdist.errors import RecordingError, UsageError, did_you_mean
from svmdist.files import reading
from svmdist.remote import LogPath, RemoteFile, is_url, listed_urls

if TYPE_CHECKING:
    from svmdist.recording.source import Health
    from svmdist.report.scores import LogFigures
    from svmdist.report.tables import Row
    from svmdist.report.writers import Results
    from svmdist.workflows.batch import Job, LogFile, Outcome
    from svmdist.workflows.request import Request

Result = TypeVar("Result")

LOG_ENDINGS = (".mcap", ".bag", ".db3")
GLOB = re.compile(r"[*?\[]")
MAX_REPORTED = 12  # the most logs whose frames are held at once, and fill a page


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


@dataclass
class Run(Generic[Result]):
    """What a job makes of the logs of a command: `outcomes` are known when the rows are at their end.

    The arguments are those of `Job`. With a `unit`, the progress of `measure` is shown. With `keeps`, it gives its
    argument `keep` what pictures and pages are made of. By `keys` of their metadata logs are grouped.
    """

    given: LogOptions
    measure: Callable[..., Any]
    request: Request
    result_type: type[Result]
    title: str
    unit: str = ""
    options: tuple[Any, ...] = ()
    keeps: bool = False
    keys: Sequence[str] = ()
    outcomes: list[tuple[LogFile, Outcome[Result]]] = field(default_factory=list, init=False)
    _kept: list[Any] = field(default_factory=list, init=False)

    @cached_property
    def _job(self) -> Job[Result]:
        from svmdist.workflows.batch import Job

        return Job(self.measure, self.request, self.result_type, self.options)

    def rows(self) -> Iterator[Row]:
        """Measure the logs and yield their rows, in the order of the logs; what was remarked is said once.

        Of one log the rows come as they are measured. Raises RecordingError where no log could be measured.
        """
        from svmdist.workflows.batch import log_notes, measure_logs

        given = self.given
        if given.is_one:
            outcome = yield from self._measured(given.logs[0])
            self.outcomes = [(given.logs[0], outcome)]
            return
        with progress_bar(self.title, "logs") as advance:
            found = measure_logs(self._job, given.logs, given.jobs, given.scheduler, given.resume, advance)
        self.outcomes = list(zip(given.logs, found, strict=True))
        log_notes(found)
        if not self.measured:
            *others, last = [with_name(one.failure or "", log.path, log.name) for log, one in self.outcomes]
            if not others:
                raise RecordingError(last)
            for reason in (*others, last):
                LOG.error("left out: %s", reason)
            raise RecordingError("no recording could be used")
        for _, one, _ in self.measured:
            yield from one.rows()

    def begun(self, count: int, output: Path | None) -> tuple[list[Row], Iterator[Row]]:
        """The first rows, so that a log that cannot be read leaves no header behind; and all.

        Where rows go to a terminal, progress is shown until they come.
        """
        rows = self.rows()
        shows = self.given.is_one and terminal_width(output) is not None
        with progress_bar(f"looking at {self.given.logs[0].name}") if shows else nullcontext():
            head = list(islice(rows, count))
        return head, chain(head, rows)

    def _measured(self, log: LogFile) -> Generator[Row, None, Outcome[Result]]:
        from svmdist.workflows.batch import measured
        from svmdist.workflows.parallel import usable_cores

        threads = self.given.jobs or usable_cores()
        more: dict[str, Any] = {"keep": self._kept.append} if self.keeps else {}
        if not self.unit:  # it shows progress by itself
            return (yield from measured(self._job, log, threads, **more))
        with progress_bar(self.title, self.unit) as advance:
            return (yield from measured(self._job, log, threads, **more, on_progress=advance))

    def finish(self) -> list[Result]:
        """Measure the logs with a job that has no rows: its results."""
        deque(self.rows(), maxlen=0)
        return self.results

    @property
    def measured(self) -> list[tuple[LogFile, Outcome[Result], Result]]:
        """Logs with a result."""
        return [(log, one, one.result) for log, one in self.outcomes if one.result is not None]

    @property
    def results(self) -> list[Result]:
        """The results of the logs that have one."""
        return [result for _, _, result in self.measured]

    @property
    def groups(self) -> list[str]:
        """The group of each log with a result, where logs are grouped."""
        return [group_name(one.metadata, self.keys) for _, one, _ in self.measured] if self.keys else []

    @property
    def _figures(self) -> list[LogFigures]:
        """How the frames of each log ended, by the `statuses` of its result."""
        from svmdist.report.scores import LogFigures

        figures = []
        for log, one in self.outcomes:
            statuses = getattr(one.result, "statuses", {})
            group = group_name(one.metadata, self.keys) if one.failure is None else ""
            figures.append(LogFigures(log.name, str(log.path), one.failure, statuses, len(one.losses), group))
        return figures

    def ranking(self) -> Results:
        """The figures of each log, worst first, of groups and of all logs."""
        from svmdist.report.scores import log_results

        return log_results(self._figures)

    def kept(self) -> list[Any]:
        """What the job kept of one log; of many, those with which most went wrong are measured again for it."""
        from svmdist.report.scores import ranked
        from svmdist.workflows.batch import collected_notes

        if self.given.is_one or not self.keeps:
            return self._kept
        usable = [one for one in ranked(self._figures) if one.failure is None and one.frame_count]
        names = {one.recording for one in usable[:MAX_REPORTED]}
        if len(usable) > MAX_REPORTED:
            LOG.info("note: the report and the plot show %d of %d logs frame by frame", MAX_REPORTED, len(usable))
        with collected_notes():
            for log in self.given.logs:
                if log.name in names:
                    deque(self._measured(log), maxlen=0)
        return self._kept

    def exit_code(self, measured: bool = True) -> ExitCode:
        """Say what was lost, which logs were left out and why, and which keys no log has.

        A loss or a contradiction gives its code; else nothing that was `measured` is unusable.
        """
        known = {key for _, one in self.outcomes if one.failure is None for key in one.metadata}
        for key in self.keys:
            if key not in known:
                LOG.warning("warning: --group %s: no log has it: %s", key, did_you_mean(key, known))
        codes = [log_losses(log.path, one.health) for log, one in self.outcomes if one.failure is None]
        for log, one in self.outcomes:
            if one.failure is not None:
                codes.append(ExitCode.LOSS)
                LOG.error("left out: %s", with_name(one.failure, log.path, log.name))
        return max(codes, default=ExitCode.CLEAN) or (ExitCode.CLEAN if measured else ExitCode.UNUSABLE)


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
    if is_url(text):
        return _urls_of(text)
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


def _urls_of(url: str) -> list[RemoteFile]:
    """The logs of a URL: of a folder or a glob all those in it, by name; a file stands for itself."""
    asked = RemoteFile(url)
    with reading(asked, RecordingError):
        found = listed_urls(url, LOG_ENDINGS, is_glob=GLOB.search(asked.parts[2]) is not None)
    if not found:
        raise UsageError(f"{asked}: no log matches")
    return found


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
