"""Time stamps of imported images, in ns: from file names, from a table, or from a rate."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from svmdist.errors import SourceError
from svmdist.importing.images import numbers_of
from svmdist.input_file import read_regular, why
from svmdist.transforms import Array, make_transform, rotation_from_quaternion_xyzw

DECIMAL_STAMP = re.compile(r"(?<!\d)(\d{9,11})[._](\d{3,9})(?!\d)")
"""Seconds since 1970 and their fraction."""
WHOLE_STAMP = re.compile(r"(?<!\d)(\d{13,19})(?!\d)")
MAX_STAMP_NS = (1 << 63) - 1
UNITS_NS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}


def parse_stamp_ns(text: str, unit: str | None = None) -> int:
    """A stamp in ns; without a unit (s, ms, us, ns) by its size, which tells them apart for times since 1970.

    Raises ValueError for text that is no number, and for a stamp that is negative or beyond 64 bits.
    """
    try:
        value = Decimal(text)
    except InvalidOperation:
        raise ValueError(f"expected a time, found {text[:40]!r}") from None
    if not value.is_finite():
        raise ValueError(f"expected a time, found {text[:40]!r}")
    if unit is None:
        unit = next(
            (name for name, least in (("ns", 10**17), ("us", 10**14), ("ms", 10**11)) if value >= least), "s"
        )
    stamp_ns = round(value * UNITS_NS[unit])
    if not 0 <= stamp_ns <= MAX_STAMP_NS:
        raise ValueError(f"a time must not be negative or beyond 64 bits of ns, found {text[:40]}")
    return stamp_ns


def stamps_from_names(names: Sequence[str]) -> list[int] | None:
    """The stamps in file names, `1479250744.250.png` in s or `1479250744250000000.png`; None where one has none."""
    stamps = []
    for name in names:
        stem = name.rpartition(".")[0] or name
        decimal = DECIMAL_STAMP.search(stem)
        whole = WHOLE_STAMP.search(stem)
        if decimal:
            stamps.append(int(decimal[1]) * 10**9 + int(decimal[2].ljust(9, "0")))
        elif whole:
            stamps.append(parse_stamp_ns(whole[1]))
        else:
            return None
    return stamps


def stamps_at_rate(count: int, rate_hz: float, start_ns: int) -> list[int]:
    """Stamps at a steady rate."""
    return [start_ns + round(number * 1e9 / rate_hz) for number in range(count)]


def require_rising(stamps_ns: Sequence[int], names: Sequence[str], what: str) -> None:
    """Raise SourceError where a stamp is not after the one before it."""
    for number in range(1, len(stamps_ns)):
        if stamps_ns[number] <= stamps_ns[number - 1]:
            raise SourceError(
                f"{what}: the time of {names[number]} ({stamps_ns[number]} ns) is not after that of"
                f" {names[number - 1]} ({stamps_ns[number - 1]} ns)"
            )


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


STAMP_NAMES = frozenset({"stamp", "timestamp", "time", "t", "stamps", "secs", "header.stamp"})
IMAGE_NAMES = frozenset({"image", "frame", "file", "filename", "name", "image_name", "index"})
AXES = ("x", "y", "z")
POSITION_NAMES = tuple(
    {axis, f"p{axis}", f"t{axis}", f"pos_{axis}", f"position_{axis}", f"position.{axis}", f"p_rs_r_{axis}"}
    | {f"pose.position.{axis}", f"translation_{axis}", f"position{axis}"}
    for axis in AXES
)
QUATERNION_NAMES = tuple(
    {f"q{axis}", f"q_{axis}", f"quat_{axis}", f"orientation_{axis}", f"orientation.{axis}", f"q_rs_{axis}"}
    | {f"pose.orientation.{axis}", f"rotation_{axis}", f"quaternion_{axis}"}
    for axis in (*AXES, "w")
)


@dataclass(frozen=True)
class StampedPoses:
    """Poses over time: stamps (n,) in ns, and transforms (n, 4, 4)."""

    stamps_ns: list[int]
    T: Array


@dataclass(frozen=True)
class StampedJoints:
    """Joint positions over time: stamps (n,) in ns, and positions (n, j) in rad or m by joint."""

    stamps_ns: list[int]
    names: tuple[str, ...]
    positions: Array


@dataclass(frozen=True)
class ImageTimes:
    """Names and stamps of the images, which rows without a time belong to."""

    names: list[str]
    stamps_ns: list[int]


def read_times(path: Path, names: Sequence[str]) -> list[int]:
    """The stamps of images, in ns, from a table of names and times, or of one time per image."""
    table = read_table(path)
    width = len(table.rows[0])
    stamp, image = _special(table)
    if stamp is None:
        stamp = next(
            (column for column in range(width) if column != image and is_number(table.rows[0][column])), None
        )
        if image is None and width > 1:
            image = next((column for column in range(width) if column != stamp), None)
    if stamp is None:
        raise SourceError(f"{path}: no column of times; expected a name such as stamp_ns or timestamp")
    unit = _unit(table, stamp)
    stamps = [_stamp(table, row, stamp, unit) for row in range(len(table.rows))]
    if image is None:
        if len(stamps) != len(names):
            raise SourceError(f"{path}: {len(stamps)} times for {len(names)} images")
        return stamps
    places = _places(table, image, names)
    found = dict(zip(places, stamps, strict=True))
    missing = next((name for place, name in enumerate(names) if place not in found), None)
    if missing is not None:
        raise SourceError(f"{path}: no time for the image {missing}")
    return [found[place] for place in range(len(names))]


def read_poses(path: Path, images: ImageTimes, unit_m: float) -> StampedPoses:
    """Poses of a table: columns by name, or `[time] x y z qx qy qz qw` (TUM), or 12 or 16 numbers of a matrix.

    Rows without time and image belong to the images, one each. `unit_m` is the unit of lengths whose column states
    none. Raises SourceError in one line.
    """
    table = read_table(path)
    stamps, used = _row_stamps(table, images, {7, 12, 16})
    if table.names is None:
        others = [column for column in range(len(table.rows[0])) if column not in used]
        return StampedPoses(stamps, _from_plain(table, numbers_in(table, others), unit_m))
    plain = [plain_name(name) for name in table.names]
    position = [_column(table, plain, choices) for choices in POSITION_NAMES]
    quaternion = [_column(table, plain, choices) for choices in QUATERNION_NAMES]
    scale = [LENGTHS_M.get(unit_of(table.names[column]) or "", unit_m) for column in position]
    T = _transforms(table, numbers_in(table, position) * scale, numbers_in(table, quaternion))
    return StampedPoses(stamps, T)


def read_joints(path: Path, images: ImageTimes, names: Sequence[str] | None = None) -> StampedJoints:
    """Joint positions of a table whose columns are the joints'; `names` are theirs where the file has none.

    Columns are in rad and m; `_deg` or `_mm` behind a name says otherwise, and is no part of it.
    """
    table = read_table(path)
    stamps, used = _row_stamps(table, images, {len(names)} if names else set())
    others = [column for column in range(len(table.rows[0])) if column not in used]
    if names is None and table.names is None:
        raise SourceError(f"{path}: the columns have no names: give --joint-names")
    columns = list(names) if names else [table.names[column] for column in others if table.names]
    if len(columns) != len(others) or not columns:
        raise SourceError(f"{path}: {len(others)} columns of numbers for {len(columns)} joint names")
    numbers = numbers_in(table, others)
    plain, scales = zip(*(_joint(column) for column in columns), strict=True)
    if len(set(plain)) < len(plain):
        raise SourceError(f"{path}: two columns are of the same joint: {', '.join(columns)}")
    return StampedJoints(stamps, plain, numbers * scales)


def _joint(column: str) -> tuple[str, float]:
    unit = unit_of(column)
    name = UNIT.sub("", column).strip()
    for suffix, scale in (("deg", np.pi / 180.0), ("rad", 1.0), ("mm", 1e-3), ("m", 1.0)):
        if unit == suffix or (unit is None and name.endswith(f"_{suffix}")):
            return name.removesuffix(f"_{suffix}"), float(scale)
    return name, 1.0


def _row_stamps(table: Table, images: ImageTimes, plain_widths: set[int]) -> tuple[list[int], set[int]]:
    """The stamp of each row, and the columns that told it."""
    stamp, image = _special(table)
    width = len(table.rows[0])
    if table.names is None and width - 1 in plain_widths:
        stamp = 0
    if stamp is not None:
        unit = _unit(table, stamp)
        stamps = [_stamp(table, row, stamp, unit) for row in range(len(table.rows))]
        for row in range(1, len(stamps)):
            if stamps[row] <= stamps[row - 1]:
                raise table.fail(
                    row, f"its time {stamps[row]} ns is not after the one before, {stamps[row - 1]} ns"
                )
        return stamps, {stamp} | ({image} if image is not None else set())
    if image is not None:
        places = _places(table, image, images.names)
        if sorted(places) != places or len(set(places)) < len(places):
            raise SourceError(f"{table.path}: rows that are not in the order of the images")
        return [images.stamps_ns[place] for place in places], {image}
    if len(table.rows) != len(images.stamps_ns):
        raise SourceError(
            f"{table.path}: no column of times (stamp_ns, timestamp) or images (image), and {len(table.rows)} rows"
            f" for {len(images.stamps_ns)} images"
        )
    return list(images.stamps_ns), set()


def _special(table: Table) -> tuple[int | None, int | None]:
    """The columns of times and of images, by their names."""
    stamp = image = None
    for column, name in enumerate(table.names or ()):
        plain = plain_name(name)
        bare = re.sub(r"_(s|ms|us|ns)$", "", plain)
        if stamp is None and bare in STAMP_NAMES:
            stamp = column
        elif image is None and plain in IMAGE_NAMES:
            image = column
    return stamp, image


def _places(table: Table, image: int, names: Sequence[str]) -> list[int]:
    """The place of each row's image, by its name, its name without suffix, or the last number in it."""
    by_name = {name: place for place, name in enumerate(names)}
    by_name |= {name.rpartition(".")[0]: place for place, name in enumerate(names)}
    by_number = numbers_of(names)
    places = []
    for row, cells in enumerate(table.rows):
        cell = re.split(r"[\\/]", cells[image])[-1]
        place = by_name.get(cell)
        if place is None and cell.isdecimal():
            place = by_number.get(int(cell))
        if place is None:
            raise table.fail(row, f"there is no image {cells[image]!r}; the first one is {names[0]}")
        places.append(place)
    return places


def _from_plain(table: Table, numbers: Array, unit_m: float) -> Array:
    """Transforms of 7 columns (position and quaternion x, y, z, w), or 12 or 16 (rows of a matrix)."""
    if numbers.shape[1] == 7:
        return _transforms(table, numbers[:, :3] * unit_m, numbers[:, 3:])
    if numbers.shape[1] not in (12, 16):
        raise SourceError(
            f"{table.path}: expected 7 numbers of a pose (x y z qx qy qz qw), or 12 or 16 of a matrix, and a time"
            f" before them or none; found {numbers.shape[1]}"
        )
    matrices = numbers.reshape(len(numbers), -1, 4)
    R = matrices[:, :3, :3]
    off = np.abs(R @ R.swapaxes(1, 2) - np.eye(3)).max((1, 2)) + (np.linalg.det(R) < 0)
    if (off > 1e-2).any():
        raise table.fail(int(np.argmax(off > 1e-2)), "its matrix is no rotation")
    u, _, vt = np.linalg.svd(R)
    return make_transform(u @ vt, matrices[:, :3, 3] * unit_m)


def _transforms(table: Table, positions_m: Array, quaternions: Array) -> Array:
    off = np.abs(np.linalg.norm(quaternions, axis=1) - 1.0)
    if (off > 1e-2).any():
        row = int(np.argmax(off > 1e-2))
        raise table.fail(
            row, f"its quaternion has length {np.linalg.norm(quaternions[row]):.4g}, 1 is expected"
        )
    return make_transform(rotation_from_quaternion_xyzw(quaternions), positions_m)


def _column(table: Table, lower: Sequence[str], choices: set[str]) -> int:
    for column, name in enumerate(lower):
        if name in choices or re.sub(r"_(mm|cm|m)$", "", name) in choices:
            return column
    wanted = min(choices, key=lambda choice: (len(choice), choice))
    raise SourceError(f"{table.path}: no column {wanted}; the columns are {', '.join(table.names or ())}")


def _stamp(table: Table, row: int, column: int, unit: str | None) -> int:
    try:
        return parse_stamp_ns(table.rows[row][column], unit)
    except ValueError as problem:
        raise table.fail(row, str(problem)) from None


def _unit(table: Table, column: int) -> str | None:
    """The unit of a column of times, None where its name states none."""
    if table.names is None:
        return None
    name = table.names[column]
    unit = unit_of(name)
    if unit is None:
        found = re.search(r"_(s|ms|us|ns)$", plain_name(name))
        unit = found[1] if found else None
    return unit if unit in ("s", "ms", "us", "ns") else None
