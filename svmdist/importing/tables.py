"""Tables of times, poses and joints that other programs write, and the time stamps of images.

A table has cells between commas, semicolons, tabs, bars or blanks, and names of columns in its first row or in a
comment, or none. Rows without a time belong to the images, one each or by name.
"""

from __future__ import annotations

import csv
import json
import logging
import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Context, Decimal
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from svmdist.errors import SourceError, restated
from svmdist.files import read_regular, reading
from svmdist.importing.images import numbers_of
from svmdist.tracks import MAX_GAP_NS, JointTrack, TransformTrack, apart_ns
from svmdist.transforms import Array, Stamps, known_rotations, make_transform, rotation_error

LOG = logging.getLogger("svmdist")
MAX_BYTES = 1 << 28
MAX_STAMP_NS = (1 << 63) - 1
DECIMAL_STAMP = re.compile(r"(?<!\d)(\d{9,11})[._](\d{3,9})(?!\d)")  # seconds since 1970 and their fraction
WHOLE_STAMP = re.compile(r"(?<!\d)(\d{13,19})(?!\d)")
BRACKETS = re.compile(r"\s*\[(.*)\]\s*$")  # a unit behind a name, as in `timestamp [ns]`
UNITS_NS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
LENGTHS_M = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
JOINT_UNITS = {"deg": np.pi / 180.0, "rad": 1.0, "mm": 1e-3, "m": 1.0}
STAMP_NAMES = frozenset({"stamp", "timestamp", "time", "t", "stamps", "secs", "header.stamp"})
STAMP = tuple(re.compile(rf"((header\.)?stamp\.)?{part}") for part in ("secs?", "n(ano)?secs?"))
"""Names of the two columns that a stamp of ROS may have."""
NO_JOINT = re.compile(r"header[._]|(velocity|effort)([._]|\d+$)|name[._]?\d+$", re.IGNORECASE)
"""How the names begin of what joint states have beside positions."""
IMAGE_NAMES = frozenset({"image", "frame", "file", "filename", "name", "image_name", "index"})
# What names of columns have before the axis.
POSITION = r"(p|t|pos_|position[_.]?|p_rs_r_|pose\.position\.|translation_)?"
QUATERNION = r"(q_?|quat_|orientation[_.]|q_rs_|pose\.orientation\.|rotation_|quaternion_)"
POSE = {axis: POSITION + axis for axis in "xyz"} | {f"q{axis}": QUATERNION + axis for axis in "xyzw"}
TUM = ("stamp", *POSE)
ROTATION_TOLERANCE = 1e-2
"""Of a quaternion's length and of R Rᵀ - I: rounded numbers are accepted, other quantities are not."""
FARTHEST_JOINT = 10.0  # rad or m: no joint of a surgical robot goes farther, and degrees read as rad do
FARTHEST_M = 10.0  # from a robot's base: no instrument is farther, and one of millimetres read as metres is


def parse_stamp_ns(text: str, unit: str | None = None) -> int:
    """A stamp in ns, or ValueError; without a unit (s, ms, us, ns) it follows from the size, for times since 1970."""
    value = Decimal(text, Context(traps=[]))  # NaN of what is no number
    if not value.is_finite():
        raise ValueError(f"expected a time as a number, found {text[:40]!r}")
    if unit is None:
        sizes = (("ns", 10**17), ("us", 10**14), ("ms", 10**11))
        unit = next((name for name, least in sizes if value >= least), "s")
    # In whatever unit, a number beyond those of ns is none; and its product might have millions of digits.
    if not 0 <= value <= MAX_STAMP_NS or (stamp_ns := round(value * UNITS_NS[unit])) > MAX_STAMP_NS:
        raise ValueError(f"a time must not be negative or beyond 64 bits of ns, found {text[:40]}")
    return stamp_ns


def stamps_from_names(names: Sequence[str]) -> list[int] | None:
    """The stamps in file names, `1479250744.250.png` in s or `1479250744250000000.png`; None where one has none."""
    stamps = []
    for name in names:
        stem = name.rpartition(".")[0] or name
        decimal, whole = DECIMAL_STAMP.search(stem), WHOLE_STAMP.search(stem)
        text = ".".join(decimal.groups()) if decimal else whole[1] if whole else ""
        try:
            stamps.append(parse_stamp_ns(text, "s" if decimal else None))
        except ValueError:  # no number, or one of a date
            return None
    return stamps


def require_rising(stamps_ns: Sequence[int], names: Sequence[str], what: str) -> None:
    """Raise SourceError where a stamp is not after the one before it."""
    for (last_ns, last), (stamp_ns, name) in pairwise(zip(stamps_ns, names, strict=True)):
        if stamp_ns <= last_ns:
            raise SourceError(f"{what}: the time of {name} ({stamp_ns} ns) is not after that of {last} ({last_ns} ns)")


def read_times(path: Path, names: Sequence[str]) -> list[int]:
    """The stamps of images, in ns: a table of names and times, or of times, or what dVRK writes beside a video."""
    table = _read_sidecar(path) if path.suffix.lower() == ".json" else read_table(path)
    columns = range(len(table.rows[0]))
    stamp, image, _ = table.special
    if stamp is None:
        stamp = next((at for at in columns if at != image and is_number(table.rows[0][at])), None)
        image = next((at for at in columns if at != stamp), None) if image is None else image
        if stamp is None:
            last = ", ".join(table.rows[-1])[:60]
            raise table.fail(len(table.rows) - 1, f"expected a time as a number of s, ms, us or ns, found {last!r}")
        if table.names:
            said = "warning: %s: column %s is taken for the times; their names are: %s"
            LOG.warning(said, path, table.names[stamp], ", ".join(sorted(STAMP_NAMES)))
    stamps = table.stamps_ns(stamp)
    if image is None:
        if len(stamps) != len(names):
            raise SourceError(f"{path}: {len(stamps)} times for {len(names)} images")
        return stamps
    found = dict(zip(table.places(image, names), stamps, strict=True))
    for place, name in enumerate(names):
        if place not in found:
            raise SourceError(f"{path}: no time for the image {name}")
    return [found[place] for place in range(len(names))]


def _read_sidecar(path: Path) -> Table:
    """The times in the file of dVRK's data_collection, less how late frames came, as a table of one column."""
    try:
        with reading(path, SourceError):
            sidecar = json.loads(read_regular(path, MAX_BYTES))
        late_ns = round(1e9 * float(sidecar.get("estimated_latency", 0.0)))
        rows = tuple((str(int(frame["cpu_ts"]) - late_ns),) for frame in sidecar["frames"])
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError):
        rows = ()
    if not rows:
        raise SourceError(f"{path}: expected frames with cpu_ts in ns, as data_collection of the dVRK writes")
    return Table(path, ("stamp_ns",), rows, 1)


def read_poses(path: Path, images_ns: Mapping[str, int], unit_m: float, frame_id: str) -> TransformTrack:
    """Poses of a table: columns by name, or `[time] x y z qx qy qz qw` (TUM), or 12 or 16 numbers of a matrix.

    `images_ns` are the stamps of images by their names, in order; `unit_m` is the unit of lengths that have none.
    """
    table = read_table(path)
    stamps_ns, others = _row_stamps(table, images_ns, {7, 12, 16})
    if not table.names and len(others) in (12, 16):  # a matrix by rows
        matrices = table.numbers(others).reshape(len(stamps_ns), -1, 4)
        R = matrices[:, :3, :3]
        for row in np.flatnonzero(rotation_error(R) > ROTATION_TOLERANCE):
            raise table.fail(int(row), "its matrix is no rotation")
        u, _, vt = np.linalg.svd(R)  # the nearest rotations of rounded ones
        T = make_transform(u @ vt, matrices[:, :3, 3] * unit_m)
        return TransformTrack(frame_id, "", stamps_ns, table.near(T))
    if not table.names and len(others) != len(POSE):
        expected = "7 numbers of a pose (x y z qx qy qz qw), or 12 or 16 of a matrix, and a time before them or none"
        raise SourceError(f"{path}: expected {expected}; found {len(others)}")
    found = (table if table.names else replace(table, names=TUM[-len(table.rows[0]) :])).columns(POSE)
    for kind in POSE:
        if kind not in found:
            raise SourceError(f"{path}: no column {kind}; the columns are {', '.join(table.names)}")
    columns = [found[kind][0] for kind in POSE]
    R = table.rotations(table.numbers(columns[3:]))
    scale = [LENGTHS_M.get(found[axis][1], unit_m) for axis in "xyz"]
    T = table.near(make_transform(R, table.numbers(columns[:3]) * scale))
    return TransformTrack(frame_id, "", stamps_ns, T)


def read_joints(path: Path, images_ns: Mapping[str, int], names: Sequence[str] | None = None) -> JointTrack:
    """Joint positions of a table with one column per joint; `names` are theirs where the file has none.

    Columns are in rad and m; `_deg` or `_mm` behind a name says otherwise, and is no part of it, nor is `position.`
    before it. Velocities and efforts are left out. In flat arrays of a message, `name.0` says whose `position.0` is.
    """
    table = read_table(path)
    stamps_ns, others = _row_stamps(table, images_ns, {len(names)} if names else set())
    if table.names:
        others = [column for column in others if not NO_JOINT.match(table.names[column])]
    elif names is None:
        raise SourceError(f"{path}: the columns have no names: give --joint-names")
    if table.columns(POSE).keys() == POSE.keys():
        raise SourceError(f"{path}: expected joints, found a pose in the columns: give it as --poses")
    columns = list(names) if names else [table.joint(table.names[column]) for column in others]
    if len(columns) != len(others) or not columns:
        raise SourceError(f"{path}: {len(others)} columns of numbers for {len(columns)} joint names")
    joints, units = zip(*(split_unit(re.sub(r"^position[._]", "", one), JOINT_UNITS) for one in columns), strict=True)
    if len(set(joints)) < len(joints):
        raise SourceError(f"{path}: two columns are of the same joint: {', '.join(columns)}")
    numbers = table.numbers(others) * [JOINT_UNITS.get(unit, 1.0) for unit in units]
    for row, column in np.argwhere(np.abs(numbers) > FARTHEST_JOINT):
        reason = f"expected {joints[column]} in rad or m, at most {FARTHEST_JOINT:g}; found {numbers[row, column]:.4g}"
        raise table.fail(int(row), f"{reason}: of other units, name the column as q_deg or q_mm")
    return JointTrack(stamps_ns, joints, numbers)


@dataclass(frozen=True)
class Table:
    """Rows of text cells, and the names of the columns, none where the file has none."""

    path: Path
    names: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    first_line: int

    @property
    def special(self) -> tuple[int | None, int | None, list[int]]:
        """The columns of times and of images, by their names, and all that are of neither."""
        plain = [split_unit(name, UNITS_NS)[0].lower() for name in self.names]
        image = next((at for at, name in enumerate(plain) if name in IMAGE_NAMES), None)
        # Recorders write when a message came beside its own stamp, which nobody may have set.
        times = [at for at, name in enumerate(plain) if name in STAMP_NAMES]
        own = [at for at in times if plain[at] == "header.stamp" and len({row[at] for row in self.rows}) > 1]
        others = [at for at in range(len(self.rows[0])) if at not in (image, *times)]
        return next(iter(own or times), None), image, others

    def joint(self, name: str) -> str:
        """The joint that a column of positions is of, the same in every row."""
        other = re.sub(r"^position(?=[._]?\d+$)", "name", name)
        if other == name or other not in self.names:
            return name
        first, *others = [cells[self.names.index(other)] for cells in self.rows]
        for row, one in enumerate(others, 1):
            if one != first:
                raise self.fail(row, f"expected the joint {first} in {other}, as before, found {one[:40]!r}")
        return first

    def fail(self, row: int, reason: str) -> SourceError:
        """The error for a row."""
        return SourceError(f"{self.path}: line {row + self.first_line}: {reason}")

    def near(self, T_base_tool: Array) -> Array:
        """The poses of the rows, shape (n, 4, 4), none of them beyond what a robot reaches."""
        far_m = np.linalg.norm(T_base_tool[:, :3, 3], axis=1)
        for row in np.flatnonzero(far_m > FARTHEST_M):
            expected = f"expected a tool within {FARTHEST_M:g} m of its base, found {far_m[row]:.4g} m"
            raise self.fail(int(row), f"{expected}: if lengths are in mm, say --unit mm, or name columns x_mm")
        return T_base_tool

    def columns(self, forms: Mapping[str, str]) -> dict[str, tuple[int, str]]:
        """The first column of each form, a pattern of names without their units, and its unit of length."""
        found: dict[str, tuple[int, str]] = {}
        for column, name in enumerate(self.names):
            plain, unit = split_unit(name, LENGTHS_M)
            for kind, form in forms.items():
                if re.fullmatch(form, plain.lower()):
                    found.setdefault(kind, (column, unit))
        return found

    def numbers(self, columns: Sequence[int], *, gaps: bool = False) -> Array:
        """Columns as finite numbers, shape (n, m); with `gaps`, empty cells and those that are not finite are NaN."""
        for row, cells in enumerate(self.rows):
            for cell in (cells[column] for column in columns):
                if (cell or not gaps) and not (is_number(cell) and (gaps or math.isfinite(float(cell)))):
                    raise self.fail(row, f"expected a number, found {cell[:40]!r}")
        numbers = np.array([[float(cells[column] or "nan") for column in columns] for cells in self.rows])
        return np.where(np.isfinite(numbers), numbers, np.nan)

    def rotations(self, quaternions: Array) -> Array:
        """Rotations, shape (n, 3, 3), by quaternions of the rows, (n, 4); NaN for those that are not known."""
        lengths = np.linalg.norm(quaternions, axis=1)
        for row in np.flatnonzero(np.abs(lengths - 1.0) > ROTATION_TOLERANCE):
            raise self.fail(int(row), f"its quaternion has length {lengths[row]:.4g}, 1 is expected")
        return known_rotations(quaternions)

    def stamps_ns(self, column: int) -> list[int]:
        """A column of times."""
        unit = split_unit(self.names[column], UNITS_NS)[1] if self.names else ""
        stamps = []
        for row, cells in enumerate(self.rows):
            with restated(ValueError, partial(self.fail, row)):
                stamps.append(parse_stamp_ns(cells[column], unit if unit in UNITS_NS else None))
        return stamps

    def places(self, column: int, names: Sequence[str]) -> list[int]:
        """The place of each row's image, by its name, its name without suffix, or the last number in it."""
        by_number = numbers_of(names)
        by_name = {key: place for place, name in enumerate(names) for key in (name, name.rpartition(".")[0])}
        places = []
        for row, cells in enumerate(self.rows):
            cell = re.split(r"[\\/]", cells[column])[-1]
            place = by_name.get(cell, by_number.get(int(cell)) if cell.isdecimal() else None)
            if place is None:
                raise self.fail(row, f"there is no image {cells[column]!r}; the first one is {names[0]}")
            places.append(place)
        return places


def read_table(path: Path) -> Table:
    """The table in a file; SourceError where it has none."""
    try:
        with reading(path, SourceError):
            text = read_regular(path, MAX_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        raise SourceError(f"{path}: not a table: byte {problem.start} is not UTF-8") from None
    written = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    comments = [line.lstrip("# ") for _, line in written if line.lstrip().startswith("#")]
    lines = [(number, line) for number, line in written if not line.lstrip().startswith("#")]
    if not lines:
        raise SourceError(f"{path}: an empty table")
    mark = next((mark for mark in (",", ";", "\t", "|") if mark in lines[0][1]), None)

    def split(line: str) -> list[str]:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=mark))] if mark else line.split()

    with restated(csv.Error, SourceError, f"{path}: not a table: "):
        rows, last = [split(line) for _, line in lines], split(comments[-1]) if comments else []
    names: list[str] = []
    if _looks_named(rows):
        names, rows, lines = rows[0], rows[1:], lines[1:]
    elif len(last) == len(rows[0]) and not is_number(last[0]):
        names = last
    if not rows:
        raise SourceError(f"{path}: a table without rows")
    width = len(names or rows[0])
    for (number, _), row in zip(lines, rows, strict=True):
        if len(row) != width:
            raise SourceError(f"{path}: line {number}: expected {width} cells, found {len(row)}")
    # `rostopic echo -p` writes %time and field.header.stamp.
    names = [name.removeprefix("%").strip().removeprefix("field.") for name in names]
    s, ns = (next((at for at, name in enumerate(names) if form.fullmatch(name)), None) for form in STAMP)
    if s is not None and ns is not None:
        names[s], names[ns] = "header.stamp_s", "header.nsecs"
        for row in rows:  # what is no number is named as it is, where stamps are read
            is_part = row[ns].isdecimal() and len(row[ns]) <= 9
            row[s] += f".{row[ns]:0>9}" if is_part else f" {row[ns]}"
    return Table(path, tuple(names), tuple(map(tuple, rows)), lines[0][0])


def require_common_time(path: Path, stamps_ns: Stamps, images_ns: Sequence[int]) -> str:
    """Raise SourceError where no row is within `MAX_GAP_NS` of an image; say so in words for few of them, else ""."""
    images = np.array(images_ns, np.int64)
    near_count = int(np.count_nonzero(apart_ns(stamps_ns, images) <= MAX_GAP_NS))
    table, pictures = (f"{one[0] / 1e9:.3f} s to {one[-1] / 1e9:.3f} s" for one in (stamps_ns, images))
    within, times = f"within {MAX_GAP_NS / 1e9:g} s of", f"its times are {table}, those of the images {pictures}"
    remedy = "give both by one clock, and behind a column's name its unit, if not s: time_ms, time_ns"
    if not near_count:
        raise SourceError(f"{path}: no row is {within} an image: {times}; {remedy}")
    few = f"{path}: rows are {within} only {near_count} of {len(images)} images: {times}; {remedy}"
    return few if 2 * near_count < len(images) else ""


def _looks_named(rows: Sequence[Sequence[str]]) -> bool:
    """Whether the first row names columns: one of its cells is text where the next row has a number."""
    if len(rows) == 1:
        return not any(map(is_number, rows[0]))
    # That of decimal commas is one, too: the row is at fault then, not the names.
    pairs = zip(*rows[:2], strict=False)
    return any(not is_number(first) and is_number(second.replace(",", ".")) for first, second in pairs)


def is_number(text: str) -> bool:
    """Whether a text is a number, NaN and infinity too."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def split_unit(name: str, units: Collection[str]) -> tuple[str, str]:
    """A column's name without its unit, and the unit, in brackets or behind the last underscore; "" for none."""
    if found := BRACKETS.search(name):
        unit = found[1].strip().lower()
        return name[: found.start()].strip().removesuffix(f"_{unit}"), unit
    stem, _, suffix = name.strip().rpartition("_")
    return (stem, suffix.lower()) if stem and suffix.lower() in units else (name.strip(), "")


def _row_stamps(table: Table, images_ns: Mapping[str, int], plain_widths: set[int]) -> tuple[Stamps, list[int]]:
    stamp, image, others = table.special
    of_images = list(images_ns.values())
    if not table.names and len(others) - 1 in plain_widths:
        stamp, *others = others
    if stamp is not None:
        stamps = table.stamps_ns(stamp)
        for row, (before_ns, stamp_ns) in enumerate(pairwise(stamps), 1):
            if stamp_ns <= before_ns:
                raise table.fail(row, f"its time {stamp_ns} ns is not after the one before, {before_ns} ns")
    elif image is not None:
        places = table.places(image, [*images_ns])
        if sorted(set(places)) != places:
            raise SourceError(f"{table.path}: rows that are not in the order of the images")
        stamps = [of_images[place] for place in places]
    elif len(table.rows) == len(of_images):
        stamps = of_images
    else:
        missing = "no column of times (stamp_ns, timestamp) or images (image)"
        raise SourceError(f"{table.path}: {missing}, and {len(table.rows)} rows for {len(of_images)} images")
    return np.array(stamps, np.int64), others
