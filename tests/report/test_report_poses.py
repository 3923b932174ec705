"""Poses as rows and as TUM lines: the same numbers, and nanoseconds that survive."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.report.rows import POSE_KEYS, pose_rows, tum_lines
from svmdist.transforms import rotation_z
from svmdist.workflows.fk import ForwardKinematics

STAMPS_NS = np.array([1_700_000_000_000_000_001, 1_700_000_000_999_999_999], np.int64)


def poses() -> ForwardKinematics:
    """A quarter turn about z, 1, 2 and 3 m away, twice."""
    T = np.eye(4)
    T[:3, :3] = rotation_z(np.pi / 2)
    T[:3, 3] = 1.0, 2.0, 3.0
    return ForwardKinematics(STAMPS_NS, np.stack([T, T]), None)


def test_rows_hold_position_and_quaternion() -> None:
    """x y z as in the matrix; half of a quarter turn is 45°, about z, to rounding."""
    first, _ = pose_rows(poses())
    assert tuple(first) == POSE_KEYS
    assert [first[key] for key in ("x_m", "y_m", "z_m")] == [1.0, 2.0, 3.0]
    half = np.sqrt(0.5)
    assert [first[key] for key in ("qx", "qy", "qz", "qw")] == pytest.approx(
        [0.0, 0.0, half, half], abs=1e-15
    )


def test_tum_lines_keep_every_nanosecond() -> None:
    """Seconds with nine decimals, exact where a float of seconds would be rounded to 100 ns; then seven numbers."""
    lines = [line.split() for line in tum_lines(pose_rows(poses()))]
    assert [line[0] for line in lines] == ["1700000000.000000001", "1700000000.999999999"]
    for line, row in zip(lines, pose_rows(poses()), strict=True):
        assert [float(number) for number in line[1:]] == [row[key] for key in POSE_KEYS[1:]]
