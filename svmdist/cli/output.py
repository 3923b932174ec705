"""Where output goes: data to stdout or a file in the format of its ending, remarks and progress to stderr."""

from __future__ import annotations

import codecs
import json
import logging
import os
import shlex
import stat
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from enum import IntEnum
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from svmdist.errors import OutputError, UsageError, concealed, printable
from svmdist.files import why, write_atomically
from svmdist.remote import LogPath
from svmdist.report.writers import WRITERS, plot_format

if TYPE_CHECKING:
    from svmdist.recording.log import Recording
    from svmdist.report.writers import Results, Writer
    from svmdist.workflows.parallel import Progress as Advance

LOG = logging.getLogger("svmdist")
"""Messages beside the data: errors, then remarks (INFO), then choices and times (DEBUG)."""


class ExitCode(IntEnum):
    """What the shell gets."""

    CLEAN = 0
    UNUSABLE = 1
    USAGE = 2
    LOSS = 3
    WORSE = 4
    INTERRUPTED = 130


class _Stderr(logging.Handler):
    """Prints one line for each record, without markup, control characters, or secrets of URLs."""

    shows_progress = False  # of the command itself, not of workers, and not within what is shown already

    def emit(self, record: logging.LogRecord) -> None:
        with suppress(OSError):  # where stderr is full, nobody can be informed
            print(printable(concealed(f"svmdist: {record.getMessage()}")), file=sys.stderr)


@contextmanager
def print_log() -> Iterator[None]:
    """Print what is logged, from INFO on until -q or -v say otherwise."""
    handler = _Stderr()
    LOG.addHandler(handler)
    LOG.setLevel(logging.INFO)
    _Stderr.shows_progress = True
    try:
        yield
    finally:
        LOG.removeHandler(handler)
        LOG.setLevel(logging.NOTSET)
        _Stderr.shows_progress = False


def next_command(*words: object) -> str:
    """A command that helps on, as it is typed."""
    return shlex.join(["svmdist", *map(str, words)])


def with_notes(message: str, error: BaseException) -> str:
    """A message, with what was noted on the error on its way: what is left of the work."""
    return "; ".join([message, *getattr(error, "__notes__", [])])


def with_name(reason: str, *names: object) -> str:
    """Why something failed, with its first name where the reason has none of them."""
    return reason if any(str(name) in reason for name in names) else f"{names[0]}: {reason}"


@contextmanager
def progress_bar(title: str, unit: str = "") -> Iterator[Advance]:
    """Give a function of (done, total or None), which shows a bar where stderr is a terminal.

    Until it is called, the bar shows that something is done, and for how long.
    """
    if not _Stderr.shows_progress or not LOG.isEnabledFor(logging.INFO) or not sys.stderr.isatty():
        yield lambda _done, _total: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True, markup=False, emoji=False, highlight=False)
    name, said = (TextColumn(f"{{task.{field}}}", markup=False) for field in ("description", "fields[said]"))
    _Stderr.shows_progress = False
    try:
        with Progress(name, BarColumn(), said, TimeElapsedColumn(), console=console, transient=True) as progress:
            task = progress.add_task(title, total=None, said="")

            def advance(done: int, total: int | None) -> None:
                said = _how_far(done, total, unit, progress.tasks[0].elapsed or 1e-3)
                progress.update(task, completed=done, total=total, said=said)

            yield advance
    finally:
        _Stderr.shows_progress = True
        console.show_cursor(True)  # a bar that was interrupted while it was set up has hidden it


@contextmanager
def watched(recording: Recording, title: str) -> Iterator[Recording]:
    """Give the recording, each replay of which shows its progress."""
    with progress_bar(title, "images") as advance:
        yield replace(recording, on_progress=advance)


def _how_far(done: int, total: int | None, unit: str, seconds: float) -> str:
    rate = done / seconds
    left = f", {(total - done) / rate:.0f} s left" if total and rate else ""
    return f"{done}{'' if total is None else f' of {total}'} {unit}, {rate:.1f} {unit}/s{left}"


def write_lines(lines: Iterable[str], output: Path | None, *, is_json: bool = False) -> None:
    """Write lines to stdout as they come, with JSON in ASCII unless that is UTF-8, or to a file; raises OutputError."""
    if output is not None:
        write_atomically(output, lines)
        return
    require_output(None)
    escapes = is_json and codecs.lookup(getattr(sys.stdout, "encoding", None) or "ascii").name != "utf-8"
    for line in chain(lines, [None]):  # what fails in making the lines is not an error of stdout
        try:
            if line is None:
                sys.stdout.flush()
            elif escapes:  # what there is beside ASCII stands in texts
                sys.stdout.write("".join(one if one.isascii() else json.dumps(one)[1:-1] for one in line))
            else:
                sys.stdout.write(line)
        except BrokenPipeError:  # the reader of the pipe has enough, as `head` does
            abandon(sys.stdout)
            raise SystemExit(ExitCode.CLEAN) from None
        except OSError as problem:
            abandon(sys.stdout)
            raise OutputError(f"stdout: cannot write: {why(problem)}") from None


def abandon(stream: TextIO | None) -> None:
    """Let a stream that accepts no more lose what it still holds: Python would complain again when it flushes."""
    with suppress(OSError, ValueError, AttributeError):
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, stream.fileno())  # type: ignore[union-attr]
        os.close(null)


def terminal_width(output: Path | None) -> int | None:
    """Columns of the terminal that stdout is; None where the data goes to a pipe or a file."""
    return os.get_terminal_size().columns if output is None and sys.stdout.isatty() else None


def write_results(results: Results, writer: Writer, output: Path | None) -> None:
    """Write what a command gives in a format that holds rows or tables, to stdout or atomically to a file."""
    if not writer.is_text:
        writer.write(results, output)
        return
    width = terminal_width(output)
    forced, refused = (os.environ.get(name) for name in ("FORCE_COLOR", "NO_COLOR"))
    colour = output is None and not refused and bool(forced or width is not None)
    write_lines(writer.write(results, width, colour), output, is_json=writer.name in ("json", "jsonl"))


def require_output(output: Path | None, inputs: Iterable[LogPath] = ()) -> None:
    """Before the work, raise OutputError for a file that cannot be written, and UsageError for one of the inputs."""
    if output is None:
        if sys.stdout is None:  # as `svmdist … >&-` has it
            raise OutputError("stdout: cannot write: it is closed; give --output FILE")
        return
    found = None
    try:
        with suppress(FileNotFoundError):
            found = os.stat(output)
    except (OSError, ValueError) as problem:
        raise OutputError(f"{output}: cannot write: {why(problem)}") from None
    if found is None and not output.parent.is_dir():
        raise OutputError(f"{output}: cannot write: there is no folder {output.parent}")
    if found is not None:
        if any(os.path.samefile(output, path) for path in inputs if isinstance(path, Path) and os.path.exists(path)):
            raise UsageError(f"{output}: is the recording to read; give the output another name")
        if stat.S_ISDIR(found.st_mode):
            raise OutputError(f"{output}: cannot write: it is a folder")
        if stat.S_ISREG(found.st_mode) and found.st_size > 0:
            LOG.debug("replaces %s", output)
    if not os.access(output.parent if found is None else output, os.W_OK):
        raise OutputError(f"{output}: cannot write: permission denied")


def require_toml(output: Path | None, inputs: Iterable[LogPath], *, force: bool) -> None:
    """The same of a file of settings; raises UsageError also for another format's ending, and where it exists."""
    require_output(output, inputs)
    if output is not None:
        require_ending(output, ".toml")
    if output is not None and output.exists() and not force:
        raise UsageError(f"{output}: exists already; give another name, or --force to replace it")


def require_ending(output: Path, ending: str) -> None:
    """Raise UsageError for the ending of another format than the one that is written."""
    others = [writer for writer in WRITERS[1:] if ending not in writer.endings]
    if any(output.suffix.lower() in writer.endings for writer in others):
        name = ending.removeprefix(".").upper()
        raise UsageError(f"-o {output}: is written as {name}: give it the ending {ending}")


def require_plot(path: Path | None, inputs: Iterable[LogPath], kind: str | None = None) -> None:
    """Raise OutputError for a plot that cannot be written, UsageError for another ending or a kind without a file."""
    if path is not None:
        plot_format(path)
        require_output(path, inputs)
    elif kind is not None:
        raise UsageError(f"--plot {kind}: says what --save-plot FILE draws, which is not given")
