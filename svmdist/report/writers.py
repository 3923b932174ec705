"""The output formats, one table: their names, the endings of their files, what they hold and how they are written.

Light to import: `svmdist --help` reads the names.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Flag, auto
from importlib import import_module
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

from svmdist.errors import OutputError, UsageError, did_you_mean, optional_package

if TYPE_CHECKING:
    from svmdist.recording.log import Recording
    from svmdist.report.tables import Column, Row, Table
    from svmdist.workflows.frame_drawing import DrawnFrame
    from svmdist.workflows.request import Setup


class Holds(Flag):
    """What a file can hold; a command gives one or several of these."""

    ROWS = auto()
    """Rows of any number, written as they come."""
    POSES = auto()
    """Rows with poses."""
    TABLES = auto()
    """Tables for a person, with the rows behind them."""
    FIGURES = auto()
    """The same of metrics, which papers and pages want too."""
    FRAMES = auto()
    """Images with what was found and measured drawn on them."""
    REPORT = auto()
    PLOT = auto()


ANY_ROWS = Holds.ROWS | Holds.POSES | Holds.TABLES | Holds.FIGURES


@dataclass(frozen=True)
class Results:
    """What a command gives: rows with their columns; of a summary also tables, notes, and the JSON document.

    `text` gives what a person reads at a width in characters, None for a file or a pipe, in place of tables or rows.
    """

    columns: Sequence[Column]
    rows: Iterable[Row]
    text: Callable[[int | None], Iterable[str]] | None = None
    tables: Sequence[Table] = ()
    notes: Sequence[str] = ()
    document: object = None

    @property
    def keys(self) -> tuple[str, ...]:
        """The columns for machines."""
        return tuple(_tables().keys_of(self.columns))

    def table_lines(self, width: int | None, colour: bool) -> Iterator[str]:
        """The text for a person."""
        if self.text is not None:
            yield from self.text(width)
            return
        tables = _tables()
        if not self.tables:
            yield from tables.text_lines([column for column in self.columns if column.heading], self.rows)
        yield from (tables.render(table, width=width, colour=colour) for table in self.tables)
        for note in self.notes:
            yield from (f"{line}\n" for line in (wrap(note, width) if width else [note]))

    def json_lines(self) -> Iterator[str]:
        """The document, or the rows as an array."""
        if self.document is None:
            yield from _tables().json_array_lines(self.keys, self.rows)
        else:
            yield _tables().json_text(self.document, indent=1) + "\n"


Lines = Callable[[Results, int | None, bool], Iterator[str]]
"""Texts of results, for a terminal of a width in characters, None for a file or a pipe, and with or without colour."""


@dataclass(frozen=True)
class Writer:
    """One format. A text format has `lines`; a binary one has `save`, which a command calls with what it holds.

    `needs` raises OutputError where a package is missing.
    """

    name: str
    endings: tuple[str, ...]
    holds: Holds
    lines: Lines | None = None
    save: Callable[..., Any] | None = None
    needs: Callable[[], object] = tuple
    is_json: bool = False


def _tables() -> Any:
    return import_module("svmdist.report.tables")


def _tum_lines(results: Results, *_: object) -> Iterator[str]:
    from svmdist.report.rows import tum_lines

    return tum_lines(results.keys, results.rows)


def _save_annotated(
    frames: Iterable[DrawnFrame], seen: Recording, setup: Setup, output: Path, force: bool
) -> None:
    from svmdist.report.annotated import write_annotated

    write_annotated(frames, seen, setup, output, force=force)


def _save_video(frames: Iterable[DrawnFrame], seen: Recording, _: Setup, output: Path, __: bool) -> None:
    from svmdist.report.annotated import write_video

    write_video(frames, output, (seen.logged_camera.width_px, seen.logged_camera.height_px))


def _package(name: str, extra: str, what: str) -> Callable[[], object]:
    return lambda: optional_package(name, extra, what, OutputError)


def require_report() -> None:
    """Raise OutputError where a package is missing that makes a report: plotly carries the code that draws plots."""
    for name in ("plotly", "jinja2"):
        optional_package(name, "report", "a report", OutputError)


# fmt: off
WRITERS = (
    Writer("table", ("", ".txt", ".log", ".out"), Holds.ROWS | Holds.TABLES | Holds.FIGURES, Results.table_lines),
    Writer("csv", (".csv",), ANY_ROWS, lambda results, *_: _tables().csv_lines(results.keys, results.rows)),
    Writer("json", (".json",), ANY_ROWS, lambda results, *_: results.json_lines(), is_json=True),
    Writer("jsonl", (".jsonl",), Holds.ROWS,
           lambda results, *_: _tables().json_lines(results.keys, results.rows), is_json=True),
    Writer("tum", (".tum",), Holds.ROWS | Holds.POSES, _tum_lines),
    Writer("latex", (".tex",), Holds.FIGURES, lambda results, *_: _tables().latex(results.tables, results.notes)),
    Writer("markdown", (".md",), Holds.FIGURES, lambda results, *_: _tables().markdown(results.tables, results.notes)),
    Writer("parquet", (".parquet",), Holds.ROWS | Holds.POSES | Holds.FIGURES,
           save=lambda results, output: _tables().write_parquet(output, results.columns, results.rows),
           needs=_package("pyarrow", "parquet", "Parquet")),
    Writer("mcap", (".mcap",), Holds.FRAMES, save=_save_annotated),
    Writer("mp4", (".mp4",), Holds.FRAMES, save=_save_video, needs=_package("av", "video", "a video")),
    Writer("html", (".html", ".htm"), Holds.REPORT, needs=require_report),
    Writer("png", (".png",), Holds.PLOT),
    Writer("svg", (".svg",), Holds.PLOT),
    Writer("pdf", (".pdf",), Holds.PLOT),
)
"""Every format that a command writes. A new one is an entry here."""
# fmt: on


def names_of(holds: Holds) -> tuple[str, ...]:
    """The names of the formats that can hold what a command gives, for its `--format`."""
    return tuple(writer.name for writer in WRITERS if writer.holds & holds)


def choose_writer(given: str | None, output: Path | None, holds: Holds) -> Writer:
    """The writer of what a command gives: the named one, else that of the file's ending, else that of plain text.

    Raises UsageError for a name that contradicts the ending, and for an ending that no format has; raises OutputError
    where a package is missing.
    """
    able = [writer for writer in WRITERS if writer.holds & holds]
    ending = "" if output is None else output.suffix.lower()
    by_ending = next((writer for writer in able if ending in writer.endings), None)
    if given is not None:
        if by_ending is not None and not by_ending.holds & ANY_ROWS:
            raise UsageError(
                f"--format {given}: {output} is written as {by_ending.name}; leave out one of them"
            )
        named = {writer.name: writer for writer in able if writer.holds & ANY_ROWS}
        if given not in named:
            raise UsageError(f"--format {given}: {did_you_mean(given, named)}")
        chosen = named[given]
    elif by_ending is not None:
        chosen = by_ending
    elif ending in WRITERS[0].endings or (output is not None and output.parent == Path("/dev")):
        chosen = able[0]
    else:
        plain, *others = able if able[0].name == "table" else (able[0], *able)
        choices = ", ".join(sorted(end for writer in others for end in writer.endings))
        hint = "; svmdist validate --report FILE.html writes a report" if ending in {".html", ".htm"} else ""
        raise UsageError(
            f"-o {output}: no format has the ending {ending}: the choices are {choices}, and .txt for"
            f" {'a table' if plain.name == 'table' else plain.name.upper()}; or give --format{hint}"
        )
    if chosen.lines is None and chosen.holds & ANY_ROWS and output is None:
        raise UsageError(f"--format {chosen.name} is no text: give a file with -o FILE{chosen.endings[0]}")
    chosen.needs()
    return chosen


def plot_format(path: Path) -> str:
    """The format of a plot by its path's ending; raises OutputError, which lists the choices, for another one."""
    ending, choices = path.suffix.lower(), names_of(Holds.PLOT)
    if ending.lstrip(".") not in choices:
        found = f"a {ending}" if ending else "a file without an ending"
        raise OutputError(f"{path}: cannot draw {found}: the choices are {', '.join(choices)}")
    return ending.lstrip(".")
