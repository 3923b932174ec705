"""The output formats, one table: their names, the endings of their files, what they hold and who writes them.

Light to import: `svmdist --help` reads the names.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import Flag, auto
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

from svmdist.errors import OutputError, UsageError, did_you_mean, optional_package

if TYPE_CHECKING:
    from svmdist.metrics import Column
    from svmdist.report.tables import Row, Table


class Holds(Flag):
    """What a file can hold; a command gives one or several of these."""

    ROWS = auto()  # of any number, written as they come
    POSES = auto()  # rows with poses
    TABLES = auto()  # readable ones, with the rows behind them
    FIGURES = auto()  # tables of metrics, which papers and pages want too
    FRAMES = auto()  # images with what was found and measured drawn on them
    REPORT = auto()
    PLOT = auto()
    CLOUD = auto()  # points of a surface


ANY_ROWS = Holds.ROWS | Holds.POSES | Holds.TABLES | Holds.FIGURES


@dataclass(frozen=True)
class Results:
    """What a command gives: rows with their columns; of a summary also tables, notes, and the JSON document."""

    columns: Sequence[Column]
    rows: Iterable[Row]
    # What a person reads at a width in characters, None for a file or a pipe, in place of tables or rows.
    text: Callable[[int | None], Iterable[str]] | None = None
    tables: Sequence[Table] = ()
    notes: Sequence[str] = ()
    document: object = None


@dataclass(frozen=True)
class Writer:
    """One format. `by` names the function that writes it, in a module of `svmdist.report`.

    Of a text format it yields the text of `Results`, given also the terminal's width in characters, None for a file or
    a pipe, and whether there are colours; of another it writes the file. `needs`: what needs which extra's packages.
    """

    name: str
    endings: tuple[str, ...]
    holds: Holds
    by: str = ""
    is_text: bool = True
    needs: tuple[str, ...] = ("", "")

    def write(self, *given: object) -> Any:
        """Call the function, whose module is imported now."""
        return resolve_name(f"svmdist.report.{self.by}")(*given)


# fmt: off
WRITERS = (
    Writer("table", ("", ".txt", ".log", ".out"), Holds.ROWS | Holds.TABLES | Holds.FIGURES, "tables:table_lines"),
    Writer("csv", (".csv",), ANY_ROWS | Holds.CLOUD, "tables:csv_lines"),
    Writer("json", (".json",), ANY_ROWS | Holds.CLOUD, "tables:json_document"),
    Writer("jsonl", (".jsonl",), Holds.ROWS, "tables:json_lines"),
    Writer("tum", (".tum",), Holds.ROWS | Holds.POSES, "rows:tum_lines"),
    Writer("latex", (".tex",), Holds.FIGURES, "tables:latex"),
    Writer("markdown", (".md",), Holds.FIGURES, "tables:markdown"),
    Writer("parquet", (".parquet",), Holds.ROWS | Holds.POSES | Holds.FIGURES, "tables:write_parquet", is_text=False,
           needs=("Parquet", "parquet", "pyarrow")),
    Writer("mcap", (".mcap",), Holds.FRAMES, "annotated:write_annotated", is_text=False),
    Writer("mp4", (".mp4",), Holds.FRAMES, "annotated:write_video", is_text=False, needs=("a video", "video", "av")),
    Writer("rrd", (".rrd",), Holds.FRAMES, "annotated:write_rrd", is_text=False, needs=(".rrd", "rerun", "rerun")),
    Writer("html", (".html", ".htm"), Holds.REPORT, is_text=False, needs=("a report", "report", "plotly", "jinja2")),
    *(Writer(name, (f".{name}",), Holds.CLOUD, f"rows:write_{name}", is_text=False) for name in ("ply", "npz")),
    *(Writer(name, (f".{name}",), Holds.PLOT, is_text=False) for name in ("png", "svg", "pdf")),
)
"""Every format that a command writes. A new one is an entry here."""
# fmt: on


def names_of(holds: Holds) -> tuple[str, ...]:
    """The names of the formats that can hold what a command gives, for its `--format`."""
    return tuple(writer.name for writer in WRITERS if writer.holds & holds)


def choose_writer(given: str | None, output: Path | None, holds: Holds, option: str = "-o") -> Writer:
    """The writer by name, else by the file's ending, else of plain text; UsageError, OutputError."""
    able = [writer for writer in WRITERS if writer.holds & holds]
    ending = "" if output is None else output.suffix.lower()
    by_ending = next((writer for writer in able if ending in writer.endings), None)
    if given is not None:
        named = {one.name: one for one in able if one is by_ending or one.holds & (ANY_ROWS | Holds.CLOUD)}
        if given not in named:
            raise UsageError(f"--format {given}: {did_you_mean(given, named)}")
        chosen = named[given]
        if by_ending not in (None, chosen) and not by_ending.holds & chosen.holds & ANY_ROWS:
            raise UsageError(f"--format {given}: {output} is written as {by_ending.name}; leave out one of them")
    elif by_ending is not None:
        chosen = by_ending
    elif ending in WRITERS[0].endings or (output is not None and output.parent == Path("/dev")):
        chosen = able[0]
    else:
        plain = "a table" if able[0].name == "table" else able[0].name.upper()
        choices = ", ".join(sorted(end for writer in able if writer.name != "table" for end in writer.endings))
        hint = "; or give --format" if option == "-o" else ""
        if ending in {".html", ".htm"}:
            hint += "; svmdist validate --report FILE.html writes a report"
        said = f"no format has the ending {ending}: the choices are {choices}, and .txt for {plain}{hint}"
        raise UsageError(f"{option} {output}: {said}")
    if not chosen.is_text and output is None:
        raise UsageError(f"--format {chosen.name} is no text: give a file with -o FILE{chosen.endings[0]}")
    what, extra, *packages = chosen.needs
    for package in packages:
        optional_package(package, extra, what, OutputError)
    return chosen


def plot_format(path: Path) -> str:
    """The format of a plot by its path's ending; raises UsageError, which lists the choices, for another one."""
    ending, choices = path.suffix.lower(), names_of(Holds.PLOT)
    if ending.lstrip(".") not in choices:
        found = f"a {ending}" if ending else "a file without an ending"
        raise UsageError(f"--save-plot {path}: cannot draw {found}: the choices are {', '.join(choices)}")
    return ending.lstrip(".")
