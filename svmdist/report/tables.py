"""Columns and tables, and how their values are written: as text, CSV, JSON, Parquet, LaTeX and Markdown."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice, pairwise
from pathlib import Path
from textwrap import wrap
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from svmdist.errors import printable
from svmdist.files import atomic_file
from svmdist.metrics import Cell, Column, finite

if TYPE_CHECKING:
    from svmdist.report.writers import Results

Row = Mapping[str, Cell]

SURROGATES = re.compile("[\ud800-\udfff]")
FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")  # in a spreadsheet
PARQUET_ROWS = 1 << 14  # that are held at once


def keys_of(columns: Iterable[Column]) -> tuple[str, ...]:
    """The keys for machines, in order."""
    return tuple(column.key for column in columns if column.stored)


@dataclass(frozen=True)
class Table:
    """A readable table: texts below headings, flush left where `is_text`; rows of `overall` stand apart below."""

    title: str
    headings: tuple[str, ...]
    is_text: tuple[bool, ...]
    rows: tuple[tuple[str, ...], ...]
    overall: tuple[tuple[str, ...], ...] = ()

    @classmethod
    def of(cls, title: str, columns: Sequence[Column], *parts: Iterable[Row]) -> Table:
        """The table of some rows, and of those overall."""
        texts = [tuple(tuple(one.show(row.get(one.key)) for one in columns) for row in rows) for rows in parts]
        headings = tuple(column.heading for column in columns)
        return cls(printable(title), headings, tuple(column.is_text for column in columns), *texts)


def table_lines(results: Results, width: int | None, colour: bool) -> Iterator[str]:
    """The readable text: the results' own, or their tables and notes."""
    if results.text is not None:
        yield from results.text(width)
    yield from (render(table, width=width, colour=colour) for table in results.tables)
    for note in results.notes:
        yield from (f"{line}\n" for line in (wrap(note, width) if width else [note]))


def render(table: Table, *, width: int | None = None, colour: bool = False) -> str:
    """Render a table to text, as wide as it needs without a width; a wider one comes in parts with whole cells."""
    from rich import box  # here: rows that are written as they come need no layout, and start sooner without it
    from rich.console import Console
    from rich.table import Table as RichTable
    from rich.text import Text

    console = Console(width=width or 1000, force_terminal=colour, no_color=not colour, emoji=False, highlight=False)
    with console.capture() as captured:
        title = Text(table.title) if table.title else None  # as `Text`, since rich takes a plain "[mm]" for markup
        for indices in _parts(table, width) if width else [range(len(table.headings))]:
            part = RichTable(box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True, title_justify="left")
            part.title, part.title_style, title = title, "bold", None
            for index in indices:
                justify: Any = "left" if table.is_text[index] else "right"
                part.add_column(Text(table.headings[index]), justify=justify, overflow="fold")
            for rows, style in ((table.rows, None), (table.overall, "bold")):
                for row in rows:
                    part.add_row(*(Text(row[index]) for index in indices), style=style)
                part.add_section()
            console.print(part)
    return "\n".join(line.rstrip() for line in captured.get().splitlines()) + "\n"


def _parts(table: Table, width: int) -> Iterator[list[int]]:
    """The columns of each part, led by the first ones, which tell rows apart; those under one heading stay together."""
    from rich.cells import cell_len

    columns = zip(table.headings, *table.rows, *table.overall, strict=True)
    lines = ([line for text in column for line in text.splitlines()] for column in columns)
    widths = [2 + max(map(cell_len, texts), default=0) for texts in lines]  # with the space to the next one
    lead = [0]
    while table.is_text[len(lead)] and sum(widths[: len(lead) + 1]) <= width // 2:
        lead.append(len(lead))
    left = range(len(lead), len(table.headings))
    # A column under the heading of the one before begins with an empty line.
    begins = [at for at in left if at == len(lead) or not table.headings[at].startswith("\n")]
    taken = lead
    for begin, end in pairwise([*begins, len(table.headings)]):
        if taken != lead and sum(widths[at] for at in taken) + sum(widths[begin:end]) > width:
            yield taken
            taken = lead
        taken = [*taken, *range(begin, end)]
    yield taken


def text_lines(columns: Sequence[Column], rows: Iterable[Row]) -> Iterator[str]:
    """Yield a plain table line by line as rows come; a value wider than its column pushes its line to the right."""
    widths = _text_widths(columns)
    forms = [f"{'<' if column.is_text else '>'}{width}" for column, width in zip(columns, widths, strict=True)]

    def line(cells: Iterable[str]) -> str:
        return "  ".join(map(format, cells, forms)).rstrip() + "\n"

    yield line(column.heading for column in columns)
    yield "  ".join("─" * width for width in widths) + "\n"
    for row in rows:
        yield line(column.show(row.get(column.key)) for column in columns)


def text_width(columns: Sequence[Column]) -> int:
    """How wide `text_lines` makes a table of these columns, in characters."""
    return sum(_text_widths(columns)) + 2 * (len(columns) - 1)


def _text_widths(columns: Sequence[Column]) -> list[int]:
    return [max(len(column.heading), column.width or (16 if column.is_text else 7)) for column in columns]


def csv_lines(results: Results, *_: object) -> Iterator[str]:
    """Yield CSV, RFC 4180, header first; a value that does not exist is an empty cell."""
    echo: Any = SimpleNamespace(write=str)  # `writerow` returns what `write` does: the line itself
    writer, keys = csv.writer(echo, lineterminator="\n"), keys_of(results.columns)
    yield writer.writerow(keys)
    for row in results.rows:
        yield writer.writerow([_csv_cell(row.get(key)) for key in keys])


def json_lines(results: Results, *_: object) -> Iterator[str]:
    """Yield one JSON object a line; a value that does not exist is null."""
    keys = keys_of(results.columns)
    for row in results.rows:
        yield json_text({key: finite(row.get(key)) for key in keys}) + "\n"


def json_document(results: Results, *_: object) -> Iterator[str]:
    """Yield the document of a summary, else one array of objects, a line an object, without holding the rows."""
    if results.document is not None:
        yield json_text(results.document, indent=1) + "\n"
        return
    separator = "[\n"
    for line in json_lines(results):
        yield separator + line.rstrip("\n")
        separator = ",\n"
    yield "[]\n" if separator == "[\n" else "\n]\n"


def json_text(document: object, indent: int | None = None) -> str:
    """JSON of a document. A byte of a file's name that is not UTF-8 becomes U+FFFD, which every reader takes."""
    text = json.dumps(document, indent=indent, ensure_ascii=False)
    return text if text.isascii() else SURROGATES.sub("\N{REPLACEMENT CHARACTER}", text)


def _csv_cell(value: Cell) -> Cell:
    if not isinstance(value, str):
        return finite(value)
    text = printable(value)
    return f"'{text}" if text.startswith(FORMULA_STARTS) else text


def write_parquet(results: Results, path: Path) -> None:
    """Write rows atomically, in pieces; a value that does not exist is null."""
    import pyarrow
    from pyarrow.parquet import ParquetWriter

    stored = [column for column in results.columns if column.stored]
    types = ["string" if one.is_text else "int64" if one.unit.digits is None else "float64" for one in stored]
    schema = pyarrow.schema([(one.key, kind) for one, kind in zip(stored, types, strict=True)])
    left = iter(results.rows)
    with atomic_file(path) as file, ParquetWriter(file, schema, compression="zstd") as writer:
        while piece := list(islice(left, PARQUET_ROWS)):
            cells = [{column.key: _parquet_cell(row.get(column.key)) for column in stored} for row in piece]
            writer.write_table(pyarrow.Table.from_pylist(cells, schema))


def _parquet_cell(value: Cell) -> Cell:
    if isinstance(value, str):
        return value.encode("utf-8", "replace").decode("utf-8")
    return int(value) if isinstance(value, bool) else finite(value)


LATEX_SPECIAL = str.maketrans(
    {
        **{letter: f"\\{letter}" for letter in "&%$#_{}"},
        **{"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"},
        **{"²": r"\textsuperscript{2}", "σ": r"$\sigma$", "≥": r"$\geq$", "±": r"$\pm$"},
        **{"–": "--", "−": "$-$", "×": r"$\times$"},
    }
)
MARKDOWN_SPECIAL = str.maketrans({letter: f"\\{letter}" for letter in "\\|*_`<"})


def latex(results: Results, *_: object) -> Iterator[str]:
    """Each table as a `table` of the package booktabs, its title as the caption; notes as comments."""

    def line(cells: Iterable[str]) -> str:
        return " & ".join(_escaped(cell, LATEX_SPECIAL) for cell in cells) + " \\\\\n"

    for table in results.tables:
        yield "\\begin{table}\n\\centering\n"
        if table.title:
            yield f"\\caption{{{_escaped(table.title, LATEX_SPECIAL)}}}\n"
        sides = "".join("l" if is_text else "r" for is_text in table.is_text)
        yield f"\\begin{{tabular}}{{{sides}}}\n\\toprule\n{line(table.headings)}\\midrule\n"
        yield from map(line, table.rows)
        yield "\\midrule\n" if table.overall else ""
        yield from map(line, table.overall)
        yield "\\bottomrule\n\\end{tabular}\n\\end{table}\n"
    yield from (f"% {printable(note)}\n" for note in results.notes)


def markdown(results: Results, *_: object) -> Iterator[str]:
    """Each table with pipes, its title above it; notes below."""

    def line(cells: Iterable[str]) -> str:
        return "| " + " | ".join(_escaped(cell, MARKDOWN_SPECIAL) for cell in cells) + " |\n"

    for table in results.tables:
        if table.title:
            yield f"**{_escaped(table.title, MARKDOWN_SPECIAL)}**\n\n"
        yield line(table.headings)
        yield "|" + "|".join("---" if is_text else "---:" for is_text in table.is_text) + "|\n"
        yield from map(line, (*table.rows, *table.overall))
        yield "\n"
    yield from (f"{_escaped(note, MARKDOWN_SPECIAL)}\n\n" for note in results.notes)


def _escaped(text: str, special: dict[int, str]) -> str:
    return printable(" ".join(text.split())).translate(special)


def counted(count: int, noun: str) -> str:
    """A count with its noun: `1 recording`, `2 recordings`."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
