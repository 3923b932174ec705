"""Many logs from the command line: where they are measured, what is kept, and what is told of those that failed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Generic, TypeVar

import typer

from svmdist.cli.console import ExitCode, Heard, Verbosity, hearing, report_health, say
from svmdist.cli.progress import progress_bar
from svmdist.errors import RecordingError, UsageError

if TYPE_CHECKING:
    from svmdist.recording.log import Recording
    from svmdist.workflows.batch.task import LogFile, LogJob, Measurement, Note, Outcome

Result = TypeVar("Result")

SchedulerOption = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        metavar="tcp://HOST:PORT",
        help="Measure on this Dask cluster, a log a task; its workers read the same paths or URLs.",
        show_default=False,
    ),
]
ResumeOption = Annotated[
    Path | None,
    typer.Option(
        "--resume",
        metavar="FOLDER",
        help="Keep each log's result in this folder, and take those that are there: of the same content, request and"
        " version.",
        show_default=False,
    ),
]
GroupOption = Annotated[
    str | None,
    typer.Option(
        "--group",
        metavar="KEY,...",
        help="Also give figures for each group of logs, by their metadata, as in scenario,world.",
        show_default=False,
    ),
]
MAX_SAME = 3
"""A remark that so many logs share is told once."""


def group_keys(text: str | None) -> tuple[str, ...]:
    """The keys of `--group`; raises UsageError for none."""
    if text is None:
        return ()
    keys = tuple(key.strip() for key in text.split(","))
    if not all(keys):
        raise UsageError(f"--group {text}: expected names of metadata, as in scenario,world")
    return keys


def group_name(metadata: Mapping[str, str], keys: Sequence[str]) -> str:
    """What a log is grouped as: `scenario=sweep world=real`; a key that it does not have is `none`."""
    return " ".join(f"{key}={metadata.get(key, 'none')}" for key in keys)


@dataclass(frozen=True)
class Many:
    """How many logs are measured."""

    logs: Sequence[LogFile]
    jobs: int | None
    scheduler: str | None
    resume: Path | None

    def __post_init__(self) -> None:
        """Raise UsageError where two options contradict each other."""
        if self.scheduler is not None and self.jobs is not None:
            raise UsageError("--jobs and --scheduler: the cluster has its own workers; leave out one of them")

    @property
    def is_asked_for(self) -> bool:
        """Whether the logs are to be measured one by one, even if there is one only."""
        return self.scheduler is not None or self.resume is not None

    @property
    def fills_cores(self) -> bool:
        """Whether there are as many logs as cores, so that sharing one between processes gains nothing."""
        from svmdist.workflows.parallel import usable_cores

        return len(self.logs) > 1 and len(self.logs) >= (self.jobs or usable_cores())

    @contextmanager
    def measured(self, job: LogJob[Result], title: str) -> Iterator[Outcomes[Result]]:
        """Measure all logs, and say what was remarked on them; the files of rows are there inside the block.

        Raises RecordingError where no log could be measured.
        """
        from svmdist.workflows.batch.run import How, measured_logs

        how = How(self.jobs, self.scheduler, self.resume)
        with (
            progress_bar(title, "logs") as advance,
            measured_logs(job, self.logs, how, advance, lambda text: say(f"svmdist: {text}")) as outcomes,
        ):
            found = Outcomes(outcomes)
            found.say_notes()
            found.require_any()
            yield found


@dataclass(frozen=True)
class Outcomes(Generic[Result]):
    """What came of all logs, in their order."""

    all: Sequence[Outcome[Result]]

    @property
    def measured(self) -> list[tuple[Outcome[Result], Result]]:
        """Those with a result."""
        return [(one, one.result) for one in self.all if one.failure is None and one.result is not None]

    @property
    def failures(self) -> list[Outcome[Result]]:
        """Those without."""
        return [one for one in self.all if one.failure is not None]

    def say_notes(self) -> None:
        """Say what was remarked on the logs; what is true of many is said once."""
        counts = Counter(note.text for one in self.all for note in set(one.notes))
        said = set()
        for one in self.all:
            for note in one.notes:
                if counts[note.text] <= MAX_SAME or note.text not in said:
                    of = f" (so in {counts[note.text]} logs)" if counts[note.text] > MAX_SAME else ""
                    say(f"{note.text}{of}", Verbosity(note.level))
                said.add(note.text)

    def require_any(self) -> None:
        """Raise RecordingError where no log could be measured, with the reason of each."""
        if self.measured:
            return
        reasons = [_reason(one) for one in self.failures]
        if len(reasons) == 1:
            raise RecordingError(reasons[0])
        for reason in reasons:
            say(f"svmdist: left out: {reason}", Verbosity.QUIET)
        raise RecordingError("no recording could be used")

    def code(self) -> ExitCode:
        """Say what was lost in reading, and which logs were left out and why; the exit code tells of either."""
        code = report_health(one for one in self.all if one.failure is None)
        for one in self.failures:
            code = ExitCode.LOSS
            say(f"svmdist: left out: {_reason(one)}", Verbosity.QUIET)
        return code


def _reason(one: Outcome[Any]) -> str:
    """Why a log was left out, with its name."""
    reason, path = one.failure or "", str(one.path)
    is_named = any(name in reason for name in (path, one.log.name))
    return reason if is_named else f"{path}: {reason}"


@contextmanager
def heard_notes() -> Iterator[list[Note]]:
    """Collect what is said about a log, to be told with its result."""
    notes: list[Note] = []
    with hearing() as lines:
        try:
            yield notes
        finally:
            notes += [_note(line) for line in lines]


def _note(line: Heard) -> Note:
    from svmdist.workflows.batch.task import Note

    return Note(line.text, int(line.at))


def measurement(
    recording: Recording, result: Result, notes: Sequence[Note], *, grouped: bool
) -> Measurement[Result]:
    """What a job gives back of a recording that was measured; its metadata only where logs are grouped by it."""
    from svmdist.workflows.batch.task import Measurement

    metadata = dict(recording.metadata) if grouped else {}
    return Measurement(result, recording.health, metadata, tuple(notes))
