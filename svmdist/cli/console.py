"""Where output goes: data to stdout or a file, everything else to stderr; and the exit codes."""

from __future__ import annotations

import codecs
import io
import os
import stat
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TextIO

from svmdist.errors import OutputError, UsageError, printable
from svmdist.files import FALLBACK, write_atomically
from svmdist.input_file import LogPath, why

if TYPE_CHECKING:
    from rich.console import Console

    from svmdist.recording.source import Health
    from svmdist.report.writers import Results, Writer


class ExitCode(IntEnum):
    """What the shell is told."""

    CLEAN = 0
    UNUSABLE = 1
    USAGE = 2
    LOSS = 3
    WORSE = 4
    INTERRUPTED = 130


class Verbosity(IntEnum):
    """How much goes to stderr: errors only, what a person wants to know, or what was chosen and took time as well."""

    QUIET = 0
    NORMAL = 1
    VERBOSE = 2


@dataclass(frozen=True, slots=True)
class Heard:
    """A line that was to be said, and how much a person must want to know to be told."""

    text: str
    at: Verbosity


_heard: ContextVar[list[Heard] | None] = ContextVar("heard", default=None)


@contextmanager
def hearing() -> Iterator[list[Heard]]:
    """Collect what this thread says instead of printing it: a log's remarks travel with its result."""
    lines: list[Heard] = []
    token = _heard.set(lines)
    try:
        yield lines
    finally:
        _heard.reset(token)


class _Voice:
    """The verbosity of the command that runs."""

    verbosity = Verbosity.NORMAL


def set_verbosity(verbosity: Verbosity) -> None:
    """Choose how much `say` prints from now on."""
    _Voice.verbosity = verbosity


def is_quiet() -> bool:
    """Whether errors only are wanted."""
    return _Voice.verbosity is Verbosity.QUIET


def say(message: str, at: Verbosity = Verbosity.NORMAL) -> None:
    """Print one line for a person to stderr, without markup or control characters, if so much is wanted."""
    lines = _heard.get()
    if lines is not None:
        lines.append(Heard(message, at))
        return
    if _Voice.verbosity < at:
        return
    with suppress(OSError):  # where stderr is full, there is nobody left to tell
        print(printable(message), file=sys.stderr)


def with_notes(message: str, error: BaseException) -> str:
    """A message, with what was noted on the error on its way: what is left of the work."""
    return "; ".join([message, *getattr(error, "__notes__", [])])


def error_console() -> Console:
    """The console for progress and remarks, on stderr."""
    from rich.console import Console

    return Console(stderr=True, markup=False, emoji=False, highlight=False)


def write_lines(lines: Iterable[str], output: Path | None, *, is_json: bool = False) -> None:
    """Write lines to stdout as they come, or atomically to a file, in UTF-8; raises OutputError.

    Where stdout has another encoding, JSON is written in ASCII: whoever reads it need not know which.
    """
    if output is not None:
        write_atomically(output, lines)
        return
    require_output(None)
    escapes = is_json and not _is_utf8(sys.stdout)
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


def _is_utf8(stream: TextIO) -> bool:
    return codecs.lookup(getattr(stream, "encoding", None) or "ascii").name == "utf-8"


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


def write_results(results: Results, writer: Writer, output: Path | None) -> None:
    """Write what a command gives in a format that holds rows or tables, to stdout or atomically to a file."""
    if writer.lines is None:
        assert writer.save is not None
        writer.save(results, output)
        return
    width = terminal_width(output)
    colour = width is not None and "NO_COLOR" not in os.environ
    write_lines(writer.lines(results, width, colour), output, is_json=writer.is_json)


def terminal_width(output: Path | None) -> int | None:
    """Columns of the terminal that stdout is; None where the data goes to a pipe or a file."""
    return os.get_terminal_size().columns if output is None and sys.stdout.isatty() else None


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
            say(f"svmdist: replaces {output}", Verbosity.VERBOSE)
    if not os.access(output.parent if found is None else output, os.W_OK):
        raise OutputError(f"{output}: cannot write: permission denied")


class HasHealth(Protocol):
    """A recording, or a summary of one."""

    @property
    def path(self) -> LogPath:
        """The file or folder, or the URL."""

    @property
    def health(self) -> Health:
        """What was lost while reading it."""


def report_health(recordings: Iterable[HasHealth]) -> ExitCode:
    """Say what was lost while reading, once for each recording; the exit code tells whether anything was."""
    code = ExitCode.CLEAN
    for recording in recordings:
        if not recording.health.is_clean:
            code = ExitCode.LOSS
            for line in recording.health.describe():
                say(f"svmdist: loss: {recording.path}: {line}", Verbosity.QUIET)
    return code
