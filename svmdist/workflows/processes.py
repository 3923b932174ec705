"""Independent parts of a replay in processes of their own: what they give in order, and how far they are meanwhile."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from typing import Any, TypeVar

from svmdist.errors import SvmdistError
from svmdist.workflows.ahead import one_opencv_thread

Part = TypeVar("Part")
Result = TypeVar("Result")
Advance = Callable[[], None]
"""Is called once for each step that is done."""

LOOK_S = 0.2
"""Progress is looked at so often."""

_steps: Any = None
"""In a worker: the steps done of each part, in memory that all processes share."""


def in_processes(
    function: Callable[[Part, Advance], Result], parts: Sequence[Part], workers: int, advance: Advance
) -> list[Result]:
    """Give what the function makes of each part, in their order; `advance` hears of the steps of all while they last.

    Function, parts and results travel between processes. What the function raises is raised here, and the processes
    end at once; so they do on an interrupt. Raises SvmdistError where a process is killed.
    """
    # A fork costs 10 ms, a new interpreter with all imports 0.5 s. OpenCV's threads do not survive one, and end before.
    forks = "fork" in multiprocessing.get_all_start_methods()
    context = multiprocessing.get_context("fork" if forks else "spawn")
    steps = context.RawArray("q", len(parts))
    others = set(multiprocessing.active_children())
    told = 0
    with (
        one_opencv_thread(),
        ProcessPoolExecutor(min(workers, len(parts)), context, _begin, (steps,)) as pool,
    ):
        try:
            futures = [pool.submit(partial(_work, function), at, part) for at, part in enumerate(parts)]
            pending: Iterable[Any] = futures
            while pending:
                done, pending = wait(pending, LOOK_S, "FIRST_COMPLETED")
                for future in done:
                    future.result()
                for _ in range(sum(steps) - told):
                    advance()
                    told += 1
            return [future.result() for future in futures]
        except BaseException as problem:
            for process in set(multiprocessing.active_children()) - others:
                process.terminate()
            if isinstance(problem, BrokenProcessPool):
                raise SvmdistError(
                    "a process that measures was killed, perhaps for want of memory: try fewer --jobs"
                ) from None
            raise


def _begin(steps: Any) -> None:
    """Prepare a worker: an interrupt ends it without a word, for the process that began it tells of it."""
    global _steps  # noqa: PLW0603  (a worker has nothing else that outlives a part)
    _steps = steps
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _work(function: Callable[[Part, Advance], Result], at: int, part: Part) -> Result:
    def advance() -> None:
        _steps[at] += 1

    return function(part, advance)
