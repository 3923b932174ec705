"""Tables as data, and the ways they are written: for a person, CSV, JSON, Parquet, LaTeX and Markdown."""

from __future__ import annotations

import csv
import io
import json
import math
import re
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from rich.table import Table

from svmdist.errors import OutputError
from svmdist.files import atomic_file

if TYPE_CHECKING:
    from rich.table import Table as RichTable

    from svmdist.workflows.scoring.metric_table import Metric


FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")


def printable(text: str) -> str:
    """Replace control, format and surrogate characters, which could drive a terminal, by U+FFFD."""
    return "".join("\N{REPLACEMENT CHARACTER}" if _is_unsafe(character) else character for character in text)


def counted(count: int, noun: str) -> str:
    """A count with its noun: `1 recording`, `2 recordings`."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def csv_text(text: str) -> str:
    """Make a text cell that no spreadsheet takes for a formula."""
    text = printable(text)
    return f"'{text}" if text.startswith(FORMULA_STARTS) else text


def _is_unsafe(character: str) -> bool:
    # Cc: control, such as ESC; Cf: format, such as the bidirectional overrides; Zl, Zp: line breaks.
    return unicodedata.category(character) in {"Cc", "Cf", "Cs", "Co", "Zl", "Zp"}


SURROGATES = re.compile("[\ud800-\udfff]")

Cell = str | int | float | None
Row = Mapping[str, Cell]


@dataclass(frozen=True, slots=True)
class Column:
    """One column for a person: its key in the row, its heading, and how a value is shown."""

    key: str
    heading: str
    show: Callable[[Cell], str] = lambda value: "" if value is None else str(value)
    is_text: bool = False
    min_width: int | None = None
    """Of a plain table whose rows are not known beforehand; None: 16 for text, 7 for numbers."""


def number(digits: int, factor: float = 1.0) -> Callable[[Cell], str]:
    """Show a number with a fixed count of digits, in another unit: `number(2, 1e3)` shows m as mm."""

    def show(value: Cell) -> str:
        value = json_value(value)
        return f"{float(value) * factor:.{digits}f}" if isinstance(value, int | float) else "–"

    return show


def percent(digits: int) -> Callable[[Cell], str]:
    """Show a fraction as a percentage."""
    return number(digits, 100.0)


def metric_column(metric: Metric[Any], heading: str = "") -> Column:
    """The column of a metric for a person, in the unit that a person is shown; a heading replaces its own."""
    unit, heading = metric.unit, heading or metric.title
    if unit.digits is None:
        return Column(metric.key, heading)
    return Column(metric.key, heading, number(unit.digits, unit.factor))


def rich_table(title: str, columns: Sequence[Column], rows: Iterable[Row]) -> RichTable:
    """Build the table for a person; text is printed as it stands, without markup."""
    from rich.text import Text

    table = _empty_table(printable(title))
    for column in columns:
        # As Text: a plain "[mm]" would be taken for markup and vanish.
        justify: Literal["left", "right"] = "left" if column.is_text else "right"
        table.add_column(Text(column.heading), justify=justify, overflow="fold")
    for row in rows:
        table.add_row(*(Text(printable(column.show(row.get(column.key)))) for column in columns))
    return table


def _empty_table(title: str) -> RichTable:
    from rich import box
    from rich.table import Table as RichTable
    from rich.text import Text

    return RichTable(
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        collapse_padding=True,
        title=Text(title) if title else None,
        title_justify="left",
        title_style="bold",
    )


def render(table: RichTable, *, width: int | None = None, colour: bool = False) -> str:
    """Render a table to text; as wide as it needs where no width is given, as for a pipe.

    A table that is wider than `width` comes in parts, one below the other, so that no cell is broken.
    """
    from rich.console import Console

    buffer = io.StringIO()
    console = Console(
        file=buffer,
        width=width or 1000,
        force_terminal=colour,
        no_color=not colour,
        emoji=False,
        highlight=False,
    )
    for part in _parts(table, width) if width else [table]:
        console.print(part)
    return "\n".join(line.rstrip() for line in buffer.getvalue().splitlines()) + "\n"


def _parts(table: RichTable, width: int) -> Iterator[RichTable]:
    """The table, or some of its columns after the others, each part led by the first ones, which tell rows apart.

    Columns under one heading, those whose own begins with an empty line, stay together.
    """
    columns = table.columns
    lead = [0]
    while columns[len(lead)].justify == "left":
        if _natural_width(_part(table, [*lead, len(lead)])) > width // 2:
            break
        lead.append(len(lead))
    groups: list[list[int]] = []
    for index in range(len(lead), len(columns)):
        if groups and str(columns[index].header).startswith("\n"):
            groups[-1].append(index)
        else:
            groups.append([index])
    title, taken = str(table.title or ""), lead
    for group in groups:
        if taken != lead and _natural_width(_part(table, taken + group)) > width:
            yield _part(table, taken, title)
            title, taken = "", lead
        taken = taken + group
    yield _part(table, taken, title)


def _part(table: RichTable, indices: Sequence[int], title: str = "") -> RichTable:
    """Some of a table's columns."""
    part = _empty_table(title)
    for index in indices:
        column = table.columns[index]
        part.add_column(column.header, justify=column.justify, overflow=column.overflow)
    cells = [list(table.columns[index].cells) for index in indices]
    for at, row in enumerate(table.rows):
        part.add_row(*(column[at] for column in cells), style=row.style, end_section=row.end_section)
    return part


def _natural_width(table: RichTable) -> int:
    from rich.console import Console

    return Console(width=1000).measure(table).maximum


def text_lines(columns: Sequence[Column], rows: Iterable[Row]) -> Iterator[str]:
    """Yield a plain table line by line, so that a log of any length can be shown as it is measured.

    Column widths come from the headings and a minimum for text, for the rows are not known beforehand; a
    longer value pushes its line to the right.
    """
    widths = _text_widths(columns)
    yield _text_line(columns, [column.heading for column in columns], widths)
    yield "  ".join("─" * width for width in widths) + "\n"
    for row in rows:
        yield _text_line(columns, [printable(column.show(row.get(column.key))) for column in columns], widths)


def text_width(columns: Sequence[Column]) -> int:
    """How wide `text_lines` makes a table of these columns, in characters."""
    return sum(_text_widths(columns)) + 2 * (len(columns) - 1)


def _text_widths(columns: Sequence[Column]) -> list[int]:
    return [max(len(column.heading), column.min_width or (16 if column.is_text else 7)) for column in columns]


def _text_line(columns: Sequence[Column], cells: Sequence[str], widths: Sequence[int]) -> str:
    aligned = [
        cell.ljust(width) if column.is_text else cell.rjust(width)
        for column, cell, width in zip(columns, cells, widths, strict=True)
    ]
    return "  ".join(aligned).rstrip() + "\n"


def csv_lines(keys: Sequence[str], rows: Iterable[Row]) -> Iterator[str]:
    """Yield CSV, RFC 4180, header first; a value that does not exist is an empty cell."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(keys)
    yield _take(buffer)
    for row in rows:
        writer.writerow([_csv_cell(row.get(key)) for key in keys])
        yield _take(buffer)


def json_lines(keys: Sequence[str], rows: Iterable[Row]) -> Iterator[str]:
    """Yield one JSON object a line; a value that does not exist is null."""
    for row in rows:
        yield json_text({key: json_value(row.get(key)) for key in keys}) + "\n"


def json_array_lines(keys: Sequence[str], rows: Iterable[Row]) -> Iterator[str]:
    """Yield one JSON array of objects, a line an object, without holding the rows."""
    separator = "[\n"
    for line in json_lines(keys, rows):
        yield separator + line.rstrip("\n")
        separator = ",\n"
    yield "[]\n" if separator == "[\n" else "\n]\n"


def json_text(document: object, indent: int | None = None) -> str:
    """JSON of a document. A byte of a file's name that is not UTF-8 becomes U+FFFD, which every reader takes."""
    text = json.dumps(document, indent=indent, ensure_ascii=False)
    return text if text.isascii() else SURROGATES.sub("\N{REPLACEMENT CHARACTER}", text)


def json_value(value: Cell) -> Cell:
    """Turn a value into what JSON can hold: a number that is not finite does not exist."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _csv_cell(value: Cell) -> str:
    value = json_value(value)
    if value is None:
        return ""
    if isinstance(value, float):
        return repr(float(value))  # a NumPy float is one, and writes its type into its repr
    return csv_text(value) if isinstance(value, str) else repr(value)


def _take(buffer: io.StringIO) -> str:
    text = buffer.getvalue()
    buffer.seek(0)
    buffer.truncate()
    return text


LATEX_SPECIAL = {
    "\\": r"\textbackslash{}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "²": r"\textsuperscript{2}",
    "σ": r"$\sigma$",
    "≥": r"$\geq$",
    "±": r"$\pm$",
    "–": "--",
    "−": "$-$",
    "×": r"$\times$",
}


def latex(tables: Sequence[Table], notes: Sequence[str]) -> Iterator[str]:
    """Each table as a `table` of the package booktabs, its title as the caption; notes as comments."""
    for table in tables:
        yield "\\begin{table}\n\\centering\n"
        if table.title:
            yield f"\\caption{{{latex_text(str(table.title))}}}\n"
        sides = "".join("r" if column.justify == "right" else "l" for column in table.columns)
        yield f"\\begin{{tabular}}{{{sides}}}\n\\toprule\n"
        yield _row(_headings(table), latex_text, " & ", " \\\\\n")
        yield "\\midrule\n"
        for row, cells in zip(table.rows, _cells(table), strict=True):
            yield _row(cells, latex_text, " & ", " \\\\\n")
            if row.end_section:
                yield "\\midrule\n"
        yield "\\bottomrule\n\\end{tabular}\n\\end{table}\n"
    for note in notes:
        yield f"% {printable(note)}\n"


def markdown(tables: Sequence[Table], notes: Sequence[str]) -> Iterator[str]:
    """Each table with pipes, its title above it; notes below."""
    for table in tables:
        if table.title:
            yield f"**{markdown_text(str(table.title))}**\n\n"
        yield "| " + _row(_headings(table), markdown_text, " | ", " |\n")
        sides = ("---:" if column.justify == "right" else "---" for column in table.columns)
        yield "|" + "|".join(sides) + "|\n"
        for cells in _cells(table):
            yield "| " + _row(cells, markdown_text, " | ", " |\n")
        yield "\n"
    for note in notes:
        yield f"{markdown_text(note)}\n\n"


def latex_text(text: str) -> str:
    """Text with LaTeX's special characters escaped."""
    return "".join(LATEX_SPECIAL.get(letter, letter) for letter in printable(text))


def markdown_text(text: str) -> str:
    """Text that is no markup and ends no cell."""
    plain = printable(text)
    for letter in ("\\", "|", "*", "_", "`", "<"):
        plain = plain.replace(letter, f"\\{letter}")
    return plain


def _headings(table: Table) -> list[str]:
    return [" ".join(str(column.header).split()) for column in table.columns]


def _cells(table: Table) -> Iterator[tuple[str, ...]]:
    columns = [[str(cell) for cell in column.cells] for column in table.columns]
    return zip(*columns, strict=True)


def _row(cells: Sequence[str], escape: Callable[[str], str], between: str, end: str) -> str:
    return between.join(escape(cell) for cell in cells) + end


PIECE = 1 << 14
"""Rows that are held at once."""


def require_pyarrow() -> Any:
    """pyarrow; raises OutputError where it is not installed."""
    try:
        import pyarrow
    except ImportError:
        raise OutputError(
            "Parquet needs the package pyarrow, which is not installed: pip install 'svmdist[parquet]'"
        ) from None
    return pyarrow


def write_parquet(
    path: Path, keys: Sequence[str], rows: Iterable[Row], types: Mapping[str, str] | None = None
) -> None:
    """Write rows atomically; a value that does not exist is null.

    `types` are those of the columns: string, int64 or float64. Without them all rows are held, and tell the types.
    """
    pyarrow = require_pyarrow()
    from pyarrow.parquet import ParquetWriter

    if types is None:
        rows = list(rows)
        types = {key: _type_of([row.get(key) for row in rows]) for key in keys}
    schema = pyarrow.schema([(key, types[key]) for key in keys])
    left = iter(rows)
    with atomic_file(path) as target, ParquetWriter(target, schema, compression="zstd") as writer:
        while piece := list(islice(left, PIECE)):
            columns = [
                pyarrow.array([_cell(row.get(key), types[key]) for row in piece], types[key]) for key in keys
            ]
            writer.write_table(pyarrow.Table.from_arrays(columns, schema=schema))


def _cell(value: Any, kind: str) -> Any:
    value = json_value(value)
    if value is None:
        return None
    match kind:
        case "string":
            return str(value).encode("utf-8", "replace").decode("utf-8")
        case "float64":
            return float(value)
    return int(value)


def _type_of(values: Sequence[Any]) -> str:
    known = [value for value in values if value is not None]
    if any(isinstance(value, str) for value in known):
        return "string"
    return "int64" if known and all(isinstance(value, int) for value in known) else "float64"
