"""Where an instrument's shaft is on its chain: what the last prismatic joint pushes, along its own axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svmdist.kinematics.dh import DHChain
from svmdist.transforms import Array


@dataclass(frozen=True, slots=True)
class ShaftAxis:
    """The instrument's shaft on the chain: a point in m and the direction to the tip, (3,), in the row's frame."""

    link: str
    p_axis_m: Array
    axis: Array


def shaft_of(chain: DHChain) -> ShaftAxis | None:
    """The shaft of a chain; None for a chain in which nothing slides."""
    prismatic = [row for row in chain.rows if row.joint == "prismatic"]
    if not prismatic:
        return None
    row = prismatic[-1]
    if chain.convention == "modified":
        return ShaftAxis(row.name, np.zeros(3), np.array([0.0, 0.0, 1.0]))
    # The row's frame is Trans_x(a) Rot_x(α) away from the axis.
    axis = np.array([0.0, np.sin(row.alpha_rad), np.cos(row.alpha_rad)])
    return ShaftAxis(row.name, np.array([-row.a_m, 0.0, 0.0]), axis)
