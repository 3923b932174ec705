"""Progress of what takes time: a bar on a terminal's stderr, and a line every ten seconds where that is none."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext
from typing import TypeVar

from svmdist.cli.console import error_console, is_quiet, say

Item = TypeVar("Item")
LINE_EVERY_S = 10.0
"""Where stderr is no terminal, a log of a job wants to know that it goes on, and not much more."""


def stderr_is_terminal() -> bool:
    """Whether a person watches."""
    return sys.stderr.isatty()


@contextmanager
def progress_bar(title: str, unit: str) -> Iterator[Callable[[int, int | None], None]]:
    """Give a function that is told (done, total), and shows units per second and the time left.

    A total of None is not known.
    """
    if is_quiet() or _Shown.is_one:
        yield lambda _done, _total: None
        return
    _Shown.is_one = True
    try:
        with nullcontext(_lines(title, unit)) if not stderr_is_terminal() else _bar(title, unit) as advance:
            yield advance
    finally:
        _Shown.is_one = False


class _Shown:
    """Whether a bar is shown: of what is done within what is watched already, there is no other one."""

    is_one = False


@contextmanager
def _bar(title: str, unit: str) -> Iterator[Callable[[int, int | None], None]]:
    """The bar; its layout is loaded for a terminal only."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = error_console()
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    try:
        with Progress(*columns, console=console, transient=True) as progress:
            task = progress.add_task(title, total=None, rate="")

            def advance(done: int, total: int | None) -> None:
                elapsed_s = progress.tasks[0].elapsed or 0.0
                rate = f"{done / elapsed_s:.1f} {unit}/s" if elapsed_s > 0 else ""
                progress.update(task, completed=done, total=total, rate=rate)

            yield advance
    finally:
        # An interrupt while the bar is being set up would leave the terminal without a cursor.
        console.show_cursor(True)


def tracked(items: Iterable[Item], title: str, unit: str, total: int | None) -> Iterator[Item]:
    """The items as they come, with progress told."""
    with progress_bar(title, unit) as advance:
        for count, item in enumerate(items, 1):
            yield item
            advance(count, total)


def now_s() -> float:
    """The clock by which lines come."""
    return time.monotonic()


def _lines(
    title: str, unit: str, clock: Callable[[], float] | None = None
) -> Callable[[int, int | None], None]:
    """A function that is told (done, total), and says so in a line every ten seconds."""
    clock = clock or now_s
    start_s = clock()
    next_s = start_s + LINE_EVERY_S

    def advance(done: int, total: int | None) -> None:
        nonlocal next_s
        at_s = clock()
        if at_s < next_s:
            return
        next_s = at_s + LINE_EVERY_S
        of = "" if total is None else f" of {total}"
        say(f"svmdist: {title}: {done}{of} {unit}, {done / (at_s - start_s):.1f} {unit}/s")

    return advance
