"""Work in several threads or processes, and how far it is: results do not depend on the number of workers."""

from __future__ import annotations

import atexit
import multiprocessing
import os
import shutil
import signal
import tempfile
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, nullcontext
from functools import partial
from multiprocessing.util import get_temp_dir
from typing import Any, TypeVar

import cv2
import numpy as np

from svmdist.errors import SvmdistError

Item = TypeVar("Item")
Result = TypeVar("Result")
Progress = Callable[[int, int | None], None]  # is called with how much is done, and how much there is where it is known

LOOK_AHEAD = 2  # results per worker that may wait: enough for a slow frame, and few images in memory
LARGEST_KEPT_BYTES = 24 << 20
LOOK_S = 0.2  # seconds between two looks at the progress of other processes
PRELOADED = ["svmdist.workflows.replay"]
"""Imported once, by the server that forks workers: a worker then starts in milliseconds."""
SOCKETS = "SVMDIST_SOCKETS"
"""Names, for the server that forks workers, its folder of sockets: a process that is killed cannot remove it."""
if SOCKETS in os.environ:  # this is the server, which ends after the last process that knows it
    atexit.register(shutil.rmtree, os.environ.pop(SOCKETS), ignore_errors=True)


def unwatched(_done: int, _total: int | None) -> None:
    """The progress of work that nobody watches."""


class WorkerDiedError(SvmdistError):
    """A worker process was killed."""

    def __init__(self) -> None:
        super().__init__("a worker process was killed, perhaps for want of memory: try fewer --jobs")


def usable_cores() -> int:
    """Cores that this process may run on."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # macOS and Windows
        return os.cpu_count() or 1


@contextmanager
def one_opencv_thread() -> Iterator[None]:
    """Frames are worked on in parallel; OpenCV's own threads inside each would only get in their way."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    # From here on glibc keeps what an image of this size or less held for the next one; given back to the system after
    # each frame, every page of it would be asked for again: a tenth of the processor's time with two threads.
    np.empty(LARGEST_KEPT_BYTES, np.uint8)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def in_order(
    function: Callable[[Item], Result], items: Iterable[Item], workers: int, pool: Executor | None = None
) -> Generator[Result]:
    """Yield the function of every item, in the items' order; up to so many workers run ahead of the consumer.

    Workers are threads, or those of `pool`; with one worker and no pool everything runs in the consumer's thread.
    Items are taken in the consumer's thread, a few ahead. What the function raises is raised here, in its place.
    """
    if pool is None and workers <= 1:
        yield from map(function, items)
        return
    waiting: deque[Future[Result]] = deque()
    threads = ThreadPoolExecutor(workers, thread_name_prefix="svmdist") if pool is None else nullcontext(pool)
    with threads as chosen:
        try:
            for item in items:
                waiting.append(chosen.submit(function, item))
                if len(waiting) > LOOK_AHEAD * workers:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            # A pool of processes cancels its own: one that ends fails at what others have cancelled.
            for future in waiting if pool is None else ():
                future.cancel()


def each_in_processes(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    workers: int,
    *,
    attempts: int = 1,
    died: Result | None = None,
    on_step: Callable[[int], None] | None = None,
) -> Generator[tuple[int, Result]]:
    """Yield (place, what the function gives of the item there) as the items end, by so many processes; one is this one.

    An item whose process is killed is tried `attempts` times; then `died` is its result, or WorkerDiedError is raised
    where that is None. What the function raises is raised here, and ends all processes at once. `on_step` is called
    with the number of every `step()` in any of the other processes.
    """
    if workers <= 1:
        yield from enumerate(map(function, items))
        return
    waiting = deque((place, 1) for place in range(len(items)))
    running: dict[Future[Result], tuple[ProcessPoolExecutor, int, int]] = {}
    with process_pools() as make:
        steps: Any = _context().Value("q", 0) if on_step else None
        seen = 0
        idle: list[ProcessPoolExecutor] = []  # of one process each: a killed one takes only its own item
        while waiting or running:
            while waiting and len(running) < workers:
                place, attempt = waiting.popleft()
                pool = idle.pop() if idle else make(1, partial(_count_in, steps))
                running[pool.submit(function, items[place])] = (pool, place, attempt)
            done, _ = wait(running, LOOK_S if on_step else None, return_when="FIRST_COMPLETED")
            while on_step and seen < steps.value:
                seen += 1
                on_step(seen)
            for future in done:
                pool, place, attempt = running.pop(future)
                try:
                    result = future.result()
                except BrokenProcessPool:
                    if attempt < attempts:
                        waiting.appendleft((place, attempt + 1))
                    elif died is None:
                        raise
                    else:
                        yield place, died
                else:
                    idle.append(pool)
                    yield place, result


_steps: Any = None  # in a worker: the counter of steps that all processes share


def _count_in(steps: Any) -> None:
    global _steps  # noqa: PLW0603  (a worker has nothing else that outlives a task)
    _steps = steps


def step(*_: object) -> None:
    """Count one step of the work of this worker process, as a recording's `on_progress`."""
    if _steps is not None:
        with _steps.get_lock():
            _steps.value += 1


def is_worker() -> bool:
    """Whether this process is a worker: it starts no others."""
    return multiprocessing.parent_process() is not None


def _context() -> Any:
    # Not fork: threads of this process, as that of a progress bar, do not survive one. A fork server listens at a
    # socket in the temporary folder, whose path has at most 107 bytes, 32 of them behind the folder's.
    has_server = "forkserver" in multiprocessing.get_all_start_methods()
    is_short = len(os.fsencode(tempfile.gettempdir())) <= 107 - 32
    return multiprocessing.get_context("forkserver" if has_server and is_short else "spawn")


@contextmanager
def process_pools() -> Iterator[Callable[..., ProcessPoolExecutor]]:
    """Give a function that makes a pool of so many processes, each of which calls `begin()` first.

    They end with the block: after their tasks, or at once where it is left by an error. Interrupts are this process's
    to handle; workers also end where this process is killed. Raises WorkerDiedError where a worker is killed.
    """
    context = _context()
    if context.get_start_method() == "forkserver":
        from multiprocessing import forkserver, resource_tracker

        context.set_forkserver_preload(PRELOADED)
        with _quiet_start():
            resource_tracker.ensure_running()  # first: until the server runs, nobody removes the folder of sockets
            os.environ[SOCKETS] = get_temp_dir()
            forkserver.ensure_running()
            del os.environ[SOCKETS]
    pools: list[Any] = []
    others = set(multiprocessing.active_children())

    def make(workers: int, begin: Callable[[], object] = object) -> Any:
        pools.append(ProcessPoolExecutor(workers, context, _begin, (dict(os.environ), begin)))
        return pools[-1]

    try:
        yield make
    except BaseException as problem:
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()
            process.join()
        for pool in pools:
            # A worker that ended in the midst of a result leaves a pool that waits for the rest of it, since this
            # process could still write it, until it no longer can.
            pool._result_queue._writer.close()
        if isinstance(problem, BrokenProcessPool):
            raise WorkerDiedError from None
        raise
    finally:
        for pool in pools:
            pool.shutdown(cancel_futures=True)


def _begin(environment: dict[str, str], begin: Callable[[], object]) -> None:
    """Prepare a worker: the process that began it handles interrupts, and takes it along where it is killed."""
    os.environ.update(environment)  # it may have changed since the server began that forks workers
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    cv2.setNumThreads(1)
    begin()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def _quiet_start() -> Iterator[None]:
    """A process that begins meanwhile gets no interrupts and has no stderr, nor have its children."""
    # Where the process that began them is gone, Python would print tracebacks of them all; errors travel as results.
    mask, stderr = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}), os.dup(2)
    try:
        with open(os.devnull, "w") as null:
            os.dup2(null.fileno(), 2)
        yield
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
