"""Estimates that any program wrote: a table of stamps with distances or poses, and deviations where it has them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from svmdist.errors import SourceError, optional_package
from svmdist.importing.tables import LENGTHS_M, LOG, POSE, TUM, Table, read_table, split_unit
from svmdist.transforms import make_transform

Rows = Mapping[str, NDArray[Any]]
"""Columns of n rows: `stamp_ns`, distances and deviations in m, `T`, (n, 4, 4), and texts; NaN for what a row lacks."""
TEXTS = ("status", "instrument", "recording", "frame_id")
DISTANCES = ("planar", "distance", "spatial", "clearance")
FORMS = {
    **{name: name for name in (*DISTANCES, *(f"{distance}_std" for distance in DISTANCES), *TEXTS)},
    "tool_std": "(tool|position)_std",
    **{kind: f"(tool_)?{form}" for kind, form in POSE.items()},
}
"""The columns that are read, and patterns of their names without units."""
FARTHEST_M = 2.0  # no endoscope sees farther: most numbers beyond it are of another unit


def read_estimates(path: Path) -> Rows:
    """Read CSV, Parquet or a TUM trajectory: columns by name, as `svmdist estimate` writes them, in any order.

    Lengths are in m, or in the unit behind a name (`clearance_mm`). Raises SourceError.
    """
    table = _parquet(path) if path.suffix.lower() == ".parquet" else read_table(path)
    if not table.names and len(table.rows[0]) == len(TUM):
        table = replace(table, names=TUM)
    names, found, (stamp, *_) = table.names, table.columns(FORMS), table.special
    missing = [name for name in FORMS if name not in found]
    for name in names:
        near = get_close_matches(split_unit(name, LENGTHS_M)[0].lower(), missing, n=1, cutoff=0.8)
        if near and names.index(name) not in {column for column, _ in found.values()}:
            LOG.warning("warning: %s: column %s is not read: did you mean %s?", path, name, near[0])
    if "distance" in found and not found.keys() & (set(DISTANCES) - {"distance"}):
        said = "warning: %s: %s is taken for the planar distance; a clearance is named clearance_m, one in 3D spatial_m"
        LOG.warning(said, path, names[found["distance"][0]])
    for kind in ("distance", "distance_std"):  # the planar one, but where a table has both
        if kind in found:
            found.setdefault(kind.replace("distance", "planar"), found.pop(kind))
    if stamp is None or not (found.keys() & set(DISTANCES) or {"x", "y", "z"} <= found.keys()):
        expected = "expected stamp_ns and a distance (as clearance_m) or a pose (x y z qx qy qz qw)"
        columns = f"are {', '.join(names)}" if names else "have no names"
        raise SourceError(f"{path}: {expected}; the columns {columns}")
    rows: dict[str, NDArray[Any]] = {"stamp_ns": np.array(table.stamps_ns(stamp), np.int64)}
    for kind, (column, unit) in found.items():
        if kind in TEXTS:
            rows[kind] = np.array([cells[column] for cells in table.rows])
            continue
        rows[kind] = values = table.numbers([column], gaps=True)[:, 0] * LENGTHS_M.get(unit, 1.0)
        if kind.endswith("_std") and (values < 0.0).any():
            raise table.fail(int(np.argmax(values < 0.0)), f"a negative deviation {names[column]}")
        if np.nanmax(np.abs(values), initial=0.0) > FARTHEST_M < np.nanpercentile(np.abs(values), 90):
            said = "warning: %s: %s reaches %.4g m: where it is in mm, name it %s_mm"
            LOG.warning(said, path, names[column], np.nanmax(values), kind)
    nothing = np.full(len(table.rows), np.nan)
    position, quaternion = (np.stack([rows.pop(kind, nothing) for kind in of], -1) for of in ("xyz", TUM[4:]))
    return rows | {"T": make_transform(table.rotations(quaternion), position)}


def _parquet(path: Path) -> Table:
    parquet = optional_package("pyarrow.parquet", "parquet", "Parquet", SourceError)
    try:
        read = parquet.read_table(path)
    except (OSError, ValueError) as problem:  # pyarrow's errors are ValueErrors
        raise SourceError(f"{path}: not a Parquet file: {str(problem).splitlines()[0]}") from None
    if not read.num_rows:
        raise SourceError(f"{path}: a table without rows")
    columns = [["" if cell is None else str(cell) for cell in column.to_pylist()] for column in read.columns]
    return Table(path, tuple(read.column_names), tuple(zip(*columns, strict=True)), 1)
