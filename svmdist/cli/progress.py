"""A progress bar on a terminal's stderr; nothing in a pipe."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from svmdist.cli.console import error_console


@contextmanager
def progress_bar(title: str, unit: str) -> Iterator[Callable[[int, int | None], None]]:
    """Give a function that is told (done, total), and shows units per second and the time left.

    A total of None is not known.
    """
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
        with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
            task = progress.add_task(title, total=None, rate="")

            def advance(done: int, total: int | None) -> None:
                elapsed_s = progress.tasks[0].elapsed or 0.0
                rate = f"{done / elapsed_s:.1f} {unit}/s" if elapsed_s > 0 else ""
                progress.update(task, completed=done, total=total, rate=rate)

            yield advance
    finally:
        # An interrupt while the bar is being set up would leave the terminal without a cursor.
        if console.is_terminal:
            console.show_cursor(True)
