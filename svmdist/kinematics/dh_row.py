"""One row of a Denavit–Hartenberg table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

JointType = Literal["revolute", "prismatic", "fixed"]
Convention = Literal["standard", "modified"]


@dataclass(frozen=True, slots=True)
class DHRow:
    """One row of a DH table: lengths in m, angles in rad, limits in the joint's own unit.

    The joint variable adds to `theta_rad` (revolute) or to `d_m` (prismatic), so that the value in a published
    table is the offset at joint value zero.
    """

    name: str
    joint: JointType
    a_m: float = 0.0
    alpha_rad: float = 0.0
    d_m: float = 0.0
    theta_rad: float = 0.0
    lower: float = -np.pi
    upper: float = np.pi
    aliases: tuple[str, ...] = ()


def twist(row: DHRow) -> tuple[float, float]:
    """Cosine and sine of the row's α; that of a quarter turn is exact, where floating point gives 6e-17."""
    cosine, sine = float(np.cos(row.alpha_rad)), float(np.sin(row.alpha_rad))
    return _snap(cosine), _snap(sine)


def _snap(value: float) -> float:
    nearest = float(np.round(value))
    return nearest if abs(value - nearest) < 1e-15 else value
