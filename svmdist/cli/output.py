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
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from itertools import chain
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, TextIO, TypeVar

from svmdist.cli.options import RowFormat, SummaryFormat, TableFormat
from svmdist.errors import OutputError, UsageError
from svmdist.files import FALLBACK, write_atomically
from svmdist.input_file import LogPath, why

if TYPE_CHECKING:
    from rich.table import Table

    from svmdist.report.tables import Row

Item = TypeVar("Item")
Form = TypeVar("Form", bound=StrEnum)

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
        from svmdist.report.tables import printable

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


@dataclass(frozen=True)
class Summary:
    """Results to be written in any form: tables and notes to read, rows and their keys, or a document, for programs."""

    tables: Sequence[Table]
    keys: Sequence[str]
    rows: Sequence[Row]
    notes: Sequence[str] = ()
    document: object = None
    """What JSON has in place of the rows."""


def write_summary(summary: Summary, form: StrEnum, output: Path | None) -> None:
    """Write tables, in markup too, CSV, Parquet, or JSON."""
    from svmdist.report.tables import csv_lines, json_text, latex, markdown, render, write_parquet

    match str(form):
        case "table":
            width = terminal_width(output)
            colour = width is not None and "NO_COLOR" not in os.environ
            texts = [render(table, width=width, colour=colour) for table in summary.tables]
            notes = [line for note in summary.notes for line in (wrap(note, width) if width else [note])]
            write_lines([*texts, *(f"{line}\n" for line in notes)], output)
        case "csv":
            write_lines(csv_lines(summary.keys, summary.rows), output)
        case "json":
            document = list(summary.rows) if summary.document is None else summary.document
            write_lines([json_text(document, indent=1) + "\n"], output, is_json=True)
        case "latex":
            write_lines(latex(summary.tables, summary.notes), output)
        case "markdown":
            write_lines(markdown(summary.tables, summary.notes), output)
        case "parquet" if output is not None:
            write_parquet(output, summary.keys, summary.rows)


class FileFormat(StrEnum):
    """What is written to a file only, by its ending."""

    MCAP = "mcap"
    MP4 = "mp4"
    HTML = "html"


ROW_ENDINGS = {f".{form}": form for form in RowFormat if form is not RowFormat.TABLE}
SUMMARY_ENDINGS = {
    ".csv": SummaryFormat.CSV,
    ".json": SummaryFormat.JSON,
    ".tex": SummaryFormat.LATEX,
    ".md": SummaryFormat.MARKDOWN,
    ".parquet": SummaryFormat.PARQUET,
}
TABLE_ENDINGS = {f".{form}": form for form in TableFormat if form is not TableFormat.TABLE}
FILE_ENDINGS = {f".{form}": form for form in FileFormat} | {".htm": FileFormat.HTML}
TEXT_ENDINGS = frozenset({"", ".txt", ".log", ".out"})
"""Files to read: a table."""


def row_format(given: RowFormat | None, output: Path | None) -> RowFormat | FileFormat:
    """The format of rows, as `by_ending`, or a file's; raises UsageError for a given format with such a file."""
    ending = "" if output is None else output.suffix.lower()
    if ending in FILE_ENDINGS:
        if given is not None:
            raise UsageError(
                f"--format {given}: {output} is written as {FILE_ENDINGS[ending]}; leave out one of them"
            )
        return FILE_ENDINGS[ending]
    return by_ending(given, ROW_ENDINGS, RowFormat.TABLE, output, others=FILE_ENDINGS)


def summary_format(given: SummaryFormat | None, output: Path | None) -> SummaryFormat:
    """The format of a summary, as `by_ending`."""
    return by_ending(given, SUMMARY_ENDINGS, SummaryFormat.TABLE, output)


def by_ending(
    given: Form | None,
    endings: Mapping[str, Form],
    plain: Form,
    output: Path | None,
    name: str = "a table",
    others: Iterable[str] = (),
) -> Form:
    """The given format, else that of a file's ending, else `plain` for text and stdout.

    Raises UsageError for another ending (a table in a file that is called .avi is not what was meant), and for Parquet
    on stdout; OutputError for Parquet where pyarrow is missing.
    """
    ending = "" if output is None else output.suffix.lower()
    is_text = ending in TEXT_ENDINGS or (output is not None and output.parent == Path("/dev"))
    chosen = given or endings.get(ending) or (plain if is_text else None)
    if chosen is None:
        choices = ", ".join(sorted({*endings, *others}))
        hint = "; svmdist validate --report FILE.html writes a report" if ending in {".html", ".htm"} else ""
        raise UsageError(
            f"-o {output}: no format has the ending {ending}: the choices are {choices}, and .txt for {name};"
            f" or give --format{hint}"
        )
    if chosen == "parquet":
        from svmdist.report.tables import require_pyarrow

        if output is None:
            raise UsageError("--format parquet is no text: give a file with -o FILE.parquet")
        require_pyarrow()
    return chosen


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
    from svmdist.report.html import require_plotly

    require_plotly()


def require_plot(path: Path | None, inputs: Iterable[LogPath] = ()) -> None:
    """Raise OutputError for a plot that cannot be written, or has another ending than png, svg or pdf."""
    if path is not None:
        from svmdist.report.plots import plot_format

        plot_format(path)
        require_output(path, inputs)


def command_line() -> str:
    """The command as it was typed, for a report's provenance."""
    return shlex.join(["svmdist", *sys.argv[1:]])
