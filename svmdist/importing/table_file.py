"""A table of text cells as a file has it: CSV or columns of numbers, with or without names of columns."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from svmdist.errors import SourceError
from svmdist.input_file import read_regular, why
from svmdist.transforms import Array

MAX_BYTES = 1 << 28
UNIT = re.compile(r"\s*\[(.*)\]\s*$")
"""A unit in brackets behind a name, as in `timestamp [ns]`."""
LENGTHS_M = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}


@dataclass(frozen=True)
class Table:
    """Rows of text cells; `names` of the columns, None where the file has none; `units` in brackets or suffixes."""

    path: Path
    names: tuple[str, ...] | None
    rows: tuple[tuple[str, ...], ...]
    first_line: int

    def fail(self, row: int, reason: str) -> SourceError:
        """The error for a row."""
        return SourceError(f"{self.path}: line {row + self.first_line}: {reason}")


def read_table(path: Path) -> Table:
    """Read a table whose cells stand between commas, semicolons, tabs or blanks; SourceError in one line."""
    try:
        text = read_regular(path, MAX_BYTES).decode("utf-8-sig")
    except OSError as problem:
        raise SourceError(f"{path}: cannot read: {why(problem)}") from None
    except UnicodeDecodeError as problem:
        raise SourceError(f"{path}: not a table: byte {problem.start} is not UTF-8") from None
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    comments = [line.lstrip("# ") for _, line in lines if line.lstrip().startswith("#")]
    lines = [(number, line) for number, line in lines if not line.lstrip().startswith("#")]
    if not lines:
        raise SourceError(f"{path}: an empty table")
    split = _splitter(lines[0][1])
    rows = [split(line) for _, line in lines]
    names = None
    if _looks_named(rows):
        names, rows, lines = rows[0], rows[1:], lines[1:]
    elif comments and len(split(comments[-1])) == len(rows[0]) and not is_number(split(comments[-1])[0]):
        names = split(comments[-1])
    if not rows:
        raise SourceError(f"{path}: a table without rows")
    width = len(names or rows[0])
    for (number, _), row in zip(lines, rows, strict=True):
        if len(row) != width:
            raise SourceError(f"{path}: line {number}: expected {width} cells, found {len(row)}")
    return Table(path, None if names is None else tuple(names), tuple(map(tuple, rows)), lines[0][0])


def numbers_in(table: Table, columns: Sequence[int]) -> Array:
    """Columns as numbers, shape (n, m)."""
    numbers = np.empty((len(table.rows), len(columns)))
    for row, cells in enumerate(table.rows):
        for place, column in enumerate(columns):
            if not is_number(cells[column]) or not math.isfinite(float(cells[column])):
                raise table.fail(row, f"expected a number, found {cells[column][:40]!r}")
            numbers[row, place] = float(cells[column])
    return numbers


def unit_of(name: str) -> str | None:
    """The unit that a name of a column states, in brackets or behind its last underscore; None for none."""
    found = UNIT.search(name)
    if found:
        return found[1].strip().lower()
    suffix = name.strip().rpartition("_")[2].lower()
    return suffix if suffix in LENGTHS_M and "_" in name else None


def plain_name(name: str) -> str:
    """A column's name without its unit in brackets, in small letters."""
    return UNIT.sub("", name).strip().lower()


def _splitter(line: str) -> Callable[[str], list[str]]:
    """What cuts a line into cells, as the first line shows."""
    mark = next((mark for mark in (",", ";", "\t") if mark in line), None)
    if mark is None:
        return str.split
    return lambda text: [cell.strip() for cell in next(csv.reader([text], delimiter=mark))]


def _looks_named(rows: Sequence[Sequence[str]]) -> bool:
    """Whether the first row names columns: one of its cells is text where the next row has a number."""
    if len(rows) == 1:
        return not any(map(is_number, rows[0]))
    return any(
        not is_number(first) and is_number(second) for first, second in zip(rows[0], rows[1], strict=False)
    )


def is_number(text: str) -> bool:
    """Whether a cell is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True
