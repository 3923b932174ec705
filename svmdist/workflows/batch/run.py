"""Running a job over many logs: what is there already is taken, the rest is measured, and all come in order."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from svmdist.errors import OutputError, SvmdistError
from svmdist.input_file import why
from svmdist.remote_file import RemoteFile
from svmdist.workflows.batch.cluster import measured_on_cluster
from svmdist.workflows.batch.pool import Task, measure_task, measured_in_processes
from svmdist.workflows.batch.store import ResultStore
from svmdist.workflows.batch.task import LogFile, LogJob, Outcome, Stored, failed, measure_log
from svmdist.workflows.parallel import usable_cores

Result = TypeVar("Result")
Progress = Callable[[int, int | None], None]


def unheard(*_: object) -> None:
    """Nobody wants to know."""


@dataclass(frozen=True)
class How:
    """Where logs are measured: by `jobs` processes, or by the cluster of a scheduler; and where results stay.

    `folder` keeps them for another run; without one they stay while this run lasts.
    """

    jobs: int | None = None
    scheduler: str | None = None
    folder: Path | None = None


@contextmanager
def measured_logs(
    job: LogJob[Result],
    logs: Sequence[LogFile],
    how: How,
    on_progress: Progress = unheard,
    say: Callable[[str], None] = unheard,
) -> Iterator[list[Outcome[Result]]]:
    """Give the outcomes of all logs, in their order; the files with their rows are there inside the block.

    Outcomes are the same for any number of processes or workers. Raises what ends all work: UsageError and
    ProfileError, OutputError where results cannot be kept, SvmdistError where the cluster is lost.
    """
    with ExitStack() as stack:
        folder = how.folder
        if folder is None:
            try:
                made = stack.enter_context(
                    tempfile.TemporaryDirectory(prefix="svmdist-", ignore_cleanup_errors=True)
                )
            except OSError as problem:
                raise OutputError(f"{tempfile.gettempdir()}: cannot write: {why(problem)}") from None
            folder = Path(made)
        yield _outcomes(job, logs, how, ResultStore(folder, job), on_progress, say)


def _outcomes(
    job: LogJob[Any],
    logs: Sequence[LogFile],
    how: How,
    store: ResultStore,
    on_progress: Progress,
    say: Callable[[str], None],
) -> list[Outcome[Any]]:
    found: dict[int, Outcome[Any]] = {}
    tasks: list[Task] = []
    places: dict[int, Path] = {}
    for number, log in enumerate(logs):
        try:
            # Without a folder nothing is looked for again: the place says which log it is, not what is in it.
            place = store.place_of(log) if how.folder else store.place(log, str(number))
        except SvmdistError as problem:
            found[number] = failed(str(problem)).outcome(log, None, None)
            continue
        known = store.load(place, log) if how.folder else None
        if known is not None:
            found[number] = known
            continue
        places[number] = place
        tasks.append(Task(number, log, store.rows_of(place)))
    if how.folder and (found or len(logs) > 1):
        say(
            f"{len(found) - sum(one.failure is not None for one in found.values())} of {len(logs)} logs are done"
        )
    on_progress(len(found), len(logs))
    with closing(_measured(job, tasks, how, say)) as measured:
        for task, stored in measured:
            place = places[task.number]
            if stored.failure is None or how.folder is None:
                if how.folder:
                    store.save(place, stored)
                found[task.number] = store.outcome(place, task.log, stored)
            else:
                found[task.number] = stored.outcome(task.log, None, None)
                store.rows_of(place).unlink(missing_ok=True)
            on_progress(len(found), len(logs))
    return [found[number] for number in range(len(logs))]


def _measured(
    job: LogJob[Any], tasks: Sequence[Task], how: How, say: Callable[[str], None]
) -> Generator[tuple[Task, Stored]]:
    if not tasks:
        return
    if how.scheduler is not None:
        yield from measured_on_cluster(job, tasks, how.scheduler, say)
        return
    jobs = usable_cores() if how.jobs is None else how.jobs
    urls = [task.log.path.url for task in tasks if isinstance(task.log.path, RemoteFile)]
    workers = min(jobs, len(tasks))
    if workers <= 1 or any(url.startswith("memory:") for url in urls):  # a process's memory is its own
        for task in tasks:
            yield task, measure_log(job, task.log, jobs, task.rows)
        return
    work = partial(measure_task, job)
    yield from measured_in_processes(work, tasks, workers, max(1, jobs // workers), forks=not urls)
