"""Processes that are given tasks through a pipe: how one begins, and how it is put away whatever it is doing."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.context import BaseContext
from multiprocessing.process import BaseProcess
from typing import Any, Generic, TypeVar

Task = TypeVar("Task")

END_S = 5.0
"""A worker that has not ended so long after it was told to is killed."""


@dataclass
class Worker(Generic[Task]):
    """A process, our end of its pipe, and the task that it is at."""

    process: BaseProcess
    connection: Connection
    task: Task | None = None


def begin_worker(
    context: BaseContext,
    work: Callable[..., None],
    arguments: Sequence[object],
    others: Sequence[Worker[Any]],
    *,
    daemon: bool = False,
) -> Worker[Any]:
    """Begin a process of `work(connection, inherited, *arguments)`, which closes what it has inherited of others."""
    ours, theirs = context.Pipe()
    forks = context.get_start_method() == "fork"
    inherited = [worker.connection for worker in others] + [ours] if forks else []
    process = context.Process(  # type: ignore[attr-defined]
        target=work, args=(theirs, inherited, *arguments), daemon=daemon
    )
    with _no_interrupts():
        process.start()
    theirs.close()
    return Worker(process, ours)


def close_inherited(inherited: Sequence[Connection]) -> None:
    """Close the pipes of others, which this process would keep open when their owner is gone."""
    for other in inherited:
        other.close()


def end_workers(workers: Sequence[Worker[Any]]) -> None:
    """End processes, whatever they are doing."""
    for worker in workers:
        worker.process.terminate()
    for worker in workers:
        put_away(worker)


def put_away(worker: Worker[Any]) -> int:
    """Wait for a process that ends, and kill one that does not; its exit code."""
    worker.connection.close()
    worker.process.join(END_S)
    if worker.process.is_alive():
        worker.process.kill()
        worker.process.join()
    code = worker.process.exitcode or 0
    worker.process.close()
    return code


def how_ended(code: int | None) -> str:
    """What an exit code says, to be put behind the name of a process."""
    return f"was killed by signal {-code}" if code is not None and code < 0 else f"ended with code {code}"


@contextmanager
def _no_interrupts() -> Iterator[None]:
    """Hold interrupts back: a process that begins meanwhile never gets any; the one that begins it ends it."""
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
