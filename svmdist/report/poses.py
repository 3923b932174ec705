"""Poses as rows: CSV and JSON in SI, and TUM, the trajectory format that evo reads."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from svmdist.report.table import Cell, Row
from svmdist.transforms import Array, quaternion_xyzw_from_rotation
from svmdist.workflows.fk import ForwardKinematics

BLOCK = 1 << 14
POSE_KEYS = ("stamp_ns", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")


def pose_rows(result: ForwardKinematics) -> Iterator[dict[str, Cell]]:
    """One row a joint state, with the keys of `POSE_KEYS`."""
    for at in range(0, len(result.stamps_ns), BLOCK):
        yield from block_rows(result.stamps_ns[at : at + BLOCK], result.poses[at : at + BLOCK])


def block_rows(stamps_ns: NDArray[np.int64], poses: Array) -> Iterator[dict[str, Cell]]:
    """The rows of some poses, shape (n, 4, 4), at their stamps, shape (n,)."""
    quaternions_xyzw = quaternion_xyzw_from_rotation(poses[:, :3, :3])
    for stamp_ns, T, q in zip(stamps_ns, poses, quaternions_xyzw, strict=True):
        values = (int(stamp_ns), *(float(v) for v in T[:3, 3]), *(float(v) for v in q))
        yield dict(zip(POSE_KEYS, values, strict=True))


def tum_lines(rows: Iterable[Row]) -> Iterator[str]:
    """One line a joint state: `timestamp x y z qx qy qz qw`, time in s with all nine decimals."""
    for row in rows:
        seconds, nanoseconds = divmod(int(row["stamp_ns"] or 0), 1_000_000_000)
        numbers = " ".join(f"{row[key]:.17g}" for key in POSE_KEYS[1:])
        yield f"{seconds}.{nanoseconds:09d} {numbers}\n"
