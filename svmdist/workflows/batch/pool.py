"""Processes that do tasks, one at a time each. One that is killed costs nothing but its time."""

from __future__ import annotations

import multiprocessing
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from svmdist.workflows.batch.task import LogFile, LogJob, Stored, failed, measure_log
from svmdist.workflows.parallel import one_opencv_thread
from svmdist.workflows.workers import (
    Worker,
    begin_worker,
    close_inherited,
    end_workers,
    how_ended,
    put_away,
)

ATTEMPTS = 2
"""A log whose process is killed is measured once more: it may have been another that took the memory."""


@dataclass(frozen=True)
class Task:
    """A log, its number among all, and where its rows go."""

    number: int
    log: LogFile
    rows: Path


Work = Callable[[Task, int], Stored]
"""What a process does with a task, by so many threads; it travels between processes."""


def measure_task(job: LogJob[Any], task: Task, threads: int) -> Stored:
    """Measure a log, and write its rows."""
    return measure_log(job, task.log, threads, task.rows)


@dataclass(frozen=True)
class _Raised:
    """What ends all work."""

    error: BaseException


def measured_in_processes(
    work: Work, tasks: Sequence[Task], workers: int, threads: int, *, forks: bool
) -> Generator[tuple[Task, Stored]]:
    """Yield tasks with their outcomes as they end; the processes end with the iterator.

    Raises what ends all work: UsageError, ProfileError, OutputError, and what a worker did not expect.
    """
    with one_opencv_thread(), closing(_Pool(work, threads, min(workers, len(tasks)), forks=forks)) as pool:
        yield from pool.outcomes(tasks)


class _Pool:
    def __init__(self, work: Work, threads: int, count: int, *, forks: bool) -> None:
        self._function = work
        self._threads = threads
        self._count = count
        # A fork costs 10 ms, a new interpreter with all imports 1 s. Connections to stores do not survive one.
        self._method = "fork" if forks and "fork" in multiprocessing.get_all_start_methods() else "spawn"
        self._workers: list[Worker[Task]] = []

    def outcomes(self, tasks: Sequence[Task]) -> Iterator[tuple[Task, Stored]]:
        waiting = deque(tasks)
        kills: Counter[int] = Counter()
        while waiting or any(worker.task for worker in self._workers):
            while len(self._workers) < min(self._count, len(waiting) + self._busy()):
                self._workers.append(self._begin())
            for worker in self._workers:
                if worker.task is None and waiting:
                    worker.task = waiting.popleft()
                    with suppress(OSError):  # it is dead: told below
                        worker.connection.send(worker.task)
            by_connection = {worker.connection: worker for worker in self._workers}
            for connection in wait(list(by_connection)):
                worker = by_connection[connection]  # type: ignore[index]
                task = worker.task
                try:
                    said = worker.connection.recv()
                except (EOFError, OSError):
                    self._workers.remove(worker)
                    code = put_away(worker)
                    if task is not None:
                        kills[task.number] += 1
                        if kills[task.number] < ATTEMPTS:
                            waiting.appendleft(task)
                        else:
                            why = ", perhaps for want of memory" if code < 0 else ""
                            yield task, failed(f"its process {how_ended(code)}{why}, {ATTEMPTS} times")
                    continue
                if isinstance(said, _Raised):
                    raise said.error
                worker.task = None
                assert task is not None
                yield task, said

    def _busy(self) -> int:
        return sum(worker.task is not None for worker in self._workers)

    def _begin(self) -> Worker[Task]:
        context = multiprocessing.get_context(self._method)
        return begin_worker(context, _work, (self._function, self._threads), self._workers)

    def close(self) -> None:
        """End all workers, whatever they are doing."""
        end_workers(self._workers)
        self._workers.clear()


def _work(connection: Connection, inherited: list[Connection], function: Work, threads: int) -> None:
    """Do tasks until there is nobody to give them."""
    close_inherited(inherited)
    with suppress(EOFError, OSError), one_opencv_thread():  # nobody is there any more
        while True:
            task: Task = connection.recv()
            try:
                said: Stored | _Raised = function(task, threads)
            except Exception as problem:
                said = _Raised(problem)
            connection.send(said)
