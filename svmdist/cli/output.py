"""Where output goes: data to stdout or a file in the format of its ending, remarks and progress to stderr."""

from __future__ import annotations

import codecs
import io
import logging
import os
import shlex
import stat
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from enum import IntEnum
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, TextIO, TypeVar

from svmdist.errors import OutputError, UsageError, printable
from svmdist.files import FALLBACK, LogPath, why, write_atomically
from svmdist.report.writers import Holds, choose_writer, plot_format

if TYPE_CHECKING:
    from svmdist.report.writers import Results, Writer

Item = TypeVar("Item")

LOG = logging.getLogger("svmdist")
"""What users are told beside the data: errors, then remarks (INFO), then choices and times (DEBUG)."""
LINE_EVERY_S = 10.0
"""Between two lines of progress where stderr is no terminal: a job's log shows that it goes on."""


class ExitCode(IntEnum):
    """What the shell gets."""

    CLEAN = 0
    UNUSABLE = 1
    USAGE = 2
    LOSS = 3
    WORSE = 4
    INTERRUPTED = 130


class _Stderr(logging.Handler):
    """Prints one line for each record, without markup or control characters."""

    def emit(self, record: logging.LogRecord) -> None:
        with suppress(OSError):  # where stderr is full, there is nobody left to tell
            print(printable(f"svmdist: {record.getMessage()}"), file=sys.stderr)


@contextmanager
def print_log() -> Iterator[None]:
    """Print what is logged, from INFO on until -q or -v say otherwise."""
    handler = _Stderr()
    LOG.addHandler(handler)
    LOG.setLevel(logging.INFO)
    _Progress.is_wanted = True
    try:
        yield
    finally:
        LOG.removeHandler(handler)
        LOG.setLevel(logging.NOTSET)
        _Progress.is_wanted = False


def with_notes(message: str, error: BaseException) -> str:
    """A message, with what was noted on the error on its way: what is left of the work."""
    return "; ".join([message, *getattr(error, "__notes__", [])])


class _Progress:
    """Whether progress is shown: by the command itself, not by workers, and not within what is shown already."""

    is_wanted = False


@contextmanager
def no_progress() -> Iterator[None]:
    """Show none: what happens inside shows by itself how far it is."""
    before, _Progress.is_wanted = _Progress.is_wanted, False
    try:
        yield
    finally:
        _Progress.is_wanted = before


@contextmanager
def progress_bar(title: str, unit: str) -> Iterator[Callable[[int, int | None], None]]:
    """Give a function of (done, total or None), which shows a bar on a terminal, else a line every ten seconds."""
    if not _Progress.is_wanted or not LOG.isEnabledFor(logging.INFO):
        yield lambda _done, _total: None
        return
    with no_progress():
        if sys.stderr.isatty():
            with _bar(title, unit) as advance:
                yield advance
        else:
            yield _lines(title, unit)


@contextmanager
def _bar(title: str, unit: str) -> Iterator[Callable[[int, int | None], None]]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True, markup=False, emoji=False, highlight=False)
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


def _lines(
    title: str, unit: str, clock: Callable[[], float] = time.monotonic
) -> Callable[[int, int | None], None]:
    start_s = clock()
    next_s = start_s + LINE_EVERY_S

    def advance(done: int, total: int | None) -> None:
        nonlocal next_s
        at_s = clock()
        if at_s >= next_s:
            next_s = at_s + LINE_EVERY_S
            of = "" if total is None else f" of {total}"
            LOG.info("%s: %d%s %s, %.1f %s/s", title, done, of, unit, done / (at_s - start_s), unit)

    return advance


def tracked(items: Iterable[Item], title: str, unit: str, total: int | None) -> Iterator[Item]:
    """The items as they come, with progress."""
    with progress_bar(title, unit) as advance:
        for count, item in enumerate(items, 1):
            yield item
            advance(count, total)


def started(rows: Iterator[Item]) -> Iterator[Item]:
    """Make the first row at once, so that a log that cannot be read leaves no header behind."""
    first = next(rows, None)
    return iter(()) if first is None else chain([first], rows)


def write_lines(lines: Iterable[str], output: Path | None, *, is_json: bool = False) -> None:
    """Write lines to stdout as they come, or atomically to a file, in UTF-8; raises OutputError.

    Where stdout has another encoding, JSON is written in ASCII: whoever reads it need not know which.
    """
    if output is not None:
        write_atomically(output, lines)
        return
    require_output(None)
    escapes = is_json and codecs.lookup(getattr(sys.stdout, "encoding", None) or "ascii").name != "utf-8"
    for line in lines:
        _write(sys.stdout, _escaped(line) if escapes and not line.isascii() else line)
    _write(sys.stdout, "", flush=True)


def _write(stream: TextIO, text: str, *, flush: bool = False) -> None:
    """Write to stdout; of the errors only its own are meant, not those of what makes the lines."""
    try:
        stream.write(text)
        if flush:
            stream.flush()
    except BrokenPipeError:
        # The reader of the pipe has enough, as `head` does.
        abandon(stream)
        raise SystemExit(ExitCode.CLEAN) from None
    except OSError as problem:
        abandon(stream)
        raise OutputError(f"stdout: cannot write: {why(problem)}") from None


def _escaped(line: str) -> str:
    """JSON in ASCII: what else there is stands in its texts."""
    import json

    return "".join(character if character.isascii() else json.dumps(character)[1:-1] for character in line)


def abandon(stream: TextIO | None) -> None:
    """Let a stream that accepts no more lose what it still holds: Python would complain again when it flushes."""
    with suppress(OSError, ValueError, AttributeError):
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, stream.fileno())  # type: ignore[union-attr]
        os.close(null)


def adapt_streams() -> None:
    """Let no text fail for want of a character in the terminal's encoding, in a file's name, or in the C locale."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=FALLBACK)


def terminal_width(output: Path | None) -> int | None:
    """Columns of the terminal that stdout is; None where the data goes to a pipe or a file."""
    return os.get_terminal_size().columns if output is None and sys.stdout.isatty() else None


def write_results(results: Results, writer: Writer, output: Path | None) -> None:
    """Write what a command gives in a format that holds rows or tables, to stdout or atomically to a file."""
    if not writer.is_text:
        writer.write(results, output)
        return
    width = terminal_width(output)
    colour = width is not None and "NO_COLOR" not in os.environ
    write_lines(writer.write(results, width, colour), output, is_json=writer.is_json)


def require_output(output: Path | None, inputs: Iterable[LogPath] = ()) -> None:
    """Fail before the work rather than after it; raises OutputError, and UsageError where it is one of the inputs."""
    if output is None:
        if sys.stdout is None:  # as `svmdist … >&-` has it
            raise OutputError("stdout: cannot write: it is closed; give --output FILE")
        return
    try:
        found = os.stat(output)
    except FileNotFoundError:
        found = None
    except (OSError, ValueError) as problem:
        raise OutputError(f"{output}: cannot write: {why(problem)}") from None
    if found is None and not output.parent.is_dir():
        raise OutputError(f"{output}: cannot write: there is no folder {output.parent}")
    if found is not None:
        local = [path for path in inputs if isinstance(path, Path) and os.path.exists(path)]
        if any(os.path.samestat(os.stat(path), found) for path in local):
            raise UsageError(f"{output}: is the recording to read; give the output another name")
        if stat.S_ISDIR(found.st_mode):
            raise OutputError(f"{output}: cannot write: it is a folder")
        if stat.S_ISREG(found.st_mode) and found.st_size > 0:
            LOG.debug("replaces %s", output)
    if not os.access(output.parent if found is None else output, os.W_OK):
        raise OutputError(f"{output}: cannot write: permission denied")


def require_new(output: Path | None, *, force: bool) -> None:
    """Raise UsageError where a file exists that is not to be replaced."""
    if output is not None and os.path.exists(output) and not force:
        raise UsageError(f"{output}: exists already; give another name, or --force to replace it")


def require_report(report: Path | None, inputs: Iterable[LogPath] = ()) -> None:
    """Check a report's name and what it needs before the work; raises UsageError or OutputError."""
    if report is None:
        return
    require_output(report, inputs)
    if report.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"--report {report}: a report is a page: give it the ending .html")
    choose_writer(None, report, Holds.REPORT)


def require_plot(path: Path | None, inputs: Iterable[LogPath], kind: str | None = None) -> None:
    """Raise OutputError for a plot that cannot be written, UsageError for another ending or a kind without a file."""
    if path is not None:
        plot_format(path)
        require_output(path, inputs)
    elif kind is not None:
        raise UsageError(f"--plot {kind}: says what --save-plot FILE draws, which is not given")


def command_line() -> str:
    """The command as it was typed, for a report's provenance."""
    return shlex.join(["svmdist", *sys.argv[1:]])
