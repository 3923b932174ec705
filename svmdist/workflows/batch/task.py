"""A task: one log through one job, to an outcome: what was measured, what was lost, or why there is nothing."""

from __future__ import annotations

import json
import traceback
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from svmdist.errors import OutputError, ProfileError, SvmdistError, UsageError
from svmdist.files import FALLBACK, atomic_file
from svmdist.input_file import LogPath, why
from svmdist.recording.source import Health, Loss, LossKind

Result = TypeVar("Result")
RowWriter = Callable[[Mapping[str, Any]], None]


@dataclass(frozen=True, slots=True)
class LogFile:
    """A log to measure, and the name that it goes by."""

    path: LogPath
    name: str


@dataclass(frozen=True, slots=True)
class Note:
    """A line for a person, and how much a person must want to know to be told."""

    text: str
    level: int = 1


@dataclass(frozen=True)
class Measurement(Generic[Result]):
    """What a job makes of a log: a result, and what was found out about the log meanwhile."""

    result: Result
    health: Health
    metadata: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[Note, ...] = ()


class LogJob(Protocol[Result]):
    """What is done with each log. It travels between processes, and says by its fields what results depend on."""

    @property
    def result_type(self) -> type[Result]:
        """The type of a result: a dataclass of numbers, texts, arrays and others of its kind."""

    def measure(self, log: LogFile, threads: int, write: RowWriter) -> Measurement[Result]:
        """Measure a log by so many threads; rows are written as they come. Raises SvmdistError where that fails."""


@dataclass(frozen=True)
class Outcome(Generic[Result]):
    """What came of a log. `failure` says why there is no result; `rows` is a file with a JSON object a line."""

    log: LogFile
    result: Result | None
    failure: str | None = None
    losses: tuple[Loss, ...] = ()
    unlisted_count: int = 0
    metadata: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[Note, ...] = ()
    rows: Path | None = None
    row_count: int = 0

    @property
    def path(self) -> LogPath:
        """Where the log is."""
        return self.log.path

    @property
    def health(self) -> Health:
        """What was lost while it was read."""
        health = Health(self.unlisted_count)
        for loss in self.losses:
            health.add(loss)
        return health


@dataclass(frozen=True)
class Stored:
    """An outcome as it is kept: everything but the log's place and the rows."""

    failure: str | None
    result: Any
    losses: tuple[tuple[str, str, int | None, str | None], ...]
    unlisted_count: int
    metadata: dict[str, str]
    notes: tuple[Note, ...]
    row_count: int

    def outcome(self, log: LogFile, rows: Path | None, result: Result | None) -> Outcome[Result]:
        """The outcome again."""
        losses = tuple(
            Loss(LossKind(kind), detail, offset, topic) for kind, detail, offset, topic in self.losses
        )
        return Outcome(
            log,
            result,
            self.failure,
            losses,
            self.unlisted_count,
            self.metadata,
            self.notes,
            rows,
            self.row_count,
        )


def failed(reason: str) -> Stored:
    """The outcome of a log of which there is nothing."""
    return Stored(reason, None, (), 0, {}, (), 0)


def measure_log(job: LogJob[Any], log: LogFile, threads: int, rows: Path) -> Stored:
    """Measure a log, and write its rows to a file, which has its name when all are in it.

    Raises UsageError and ProfileError, which every log would meet, and OutputError where rows cannot be written.
    Whatever else goes wrong is told in the outcome: the other logs are measured all the same.
    """
    from svmdist.workflows.batch.plain import to_plain

    count = 0
    with ExitStack() as stack:
        target = stack.enter_context(atomic_file(rows))
        file = stack.enter_context(target.open("w", encoding="utf-8", errors=FALLBACK, newline=""))

        def write(row: Mapping[str, Any]) -> None:
            nonlocal count
            try:
                file.write(json.dumps(row, ensure_ascii=True, separators=(",", ":")) + "\n")
            except OSError as problem:
                raise OutputError(f"{rows}: cannot write: {why(problem)}") from None
            count += 1

        try:
            measured = job.measure(log, threads, write)
        except (UsageError, ProfileError, OutputError):
            raise
        except SvmdistError as problem:
            file.truncate(0)
            return failed(str(problem))
        except Exception as problem:
            file.truncate(0)
            return failed(_fault(problem))
    health = measured.health
    return Stored(
        None,
        to_plain(measured.result),
        tuple((str(one.kind), one.detail, one.byte_offset, one.topic) for one in health.losses),
        health.unlisted_count,
        dict(measured.metadata),
        measured.notes,
        count,
    )


def _fault(problem: Exception) -> str:
    """A fault of svmdist's own, or of the machine, in a line."""
    if isinstance(problem, MemoryError):
        return "there is not enough memory"
    frames = traceback.extract_tb(problem.__traceback__)
    place = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""
    what = f"{type(problem).__name__}: {' '.join(str(problem).split())}"
    return f"svmdist failed on it, please report this: {what}{place}"
