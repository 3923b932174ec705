"""Frames of a chain for very many joint vectors at once, column by column.

Products of many small matrices cost more than the same sums over long arrays of one number each, where the zeros and
ones of a Denavit–Hartenberg row are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svmdist.kinematics.dh_row import Convention, DHRow, twist
from svmdist.transforms import Array

CHUNK = 2048
"""Joint vectors that are worked on together, so that their columns stay in the processor's second-level cache."""
X, Y, Z, ORIGIN = np.vstack([np.eye(3), np.zeros(3)])[:, :, None]
"""Of the base frame, shape (3, 1) each."""


@dataclass(frozen=True, slots=True)
class FrameColumns:
    """Many frames in the base frame, by columns: axes x, y, z and origin p, shape (3, n), or (3, 1) where all agree."""

    x: Array
    y: Array
    z: Array
    p: Array

    def write(self, T: Array) -> None:
        """Into transforms, shape (n, 4, 4), whose last rows are filled already."""
        for column, values in enumerate((self.x, self.y, self.z, self.p)):
            T[:, :3, column] = values.T

    def twisted(self, row: DHRow) -> FrameColumns:
        """Behind Trans_x(a) Rot_x(α) of a row."""
        p = self.p if row.a_m == 0.0 else self.p + row.a_m * self.x
        cosine, sine = twist(row)
        if sine == 0.0 and cosine == 1.0:
            return FrameColumns(self.x, self.y, self.z, p)
        if cosine == 0.0:
            return FrameColumns(self.x, sine * self.z, -sine * self.y, p)
        return FrameColumns(self.x, cosine * self.y + sine * self.z, cosine * self.z - sine * self.y, p)

    def turned(self, row: DHRow, value: Array | float) -> FrameColumns:
        """Behind Rot_z(θ) Trans_z(d) of a row at joint values, shape (n,)."""
        x, y, p = self.x, self.y, self.p
        theta = row.theta_rad + value if row.joint == "revolute" else row.theta_rad
        d = row.d_m + value if row.joint == "prismatic" else row.d_m
        if row.joint == "prismatic" or row.d_m != 0.0:
            p = p + d * self.z
        if row.joint == "revolute" or row.theta_rad != 0.0:
            c, s = np.cos(theta), np.sin(theta)
            x, y = c * x + s * y, c * y - s * x
        return FrameColumns(x, y, self.z, p)


def last_frame(rows: tuple[DHRow, ...], convention: Convention, q: Array) -> FrameColumns:
    """The frame of the last row for joints of shape (n, n_joints)."""
    frame = FrameColumns(X, Y, Z, ORIGIN)
    joints = iter(np.ascontiguousarray(q.T))
    for row in rows:
        value = 0.0 if row.joint == "fixed" else next(joints)
        if convention == "standard":
            frame = frame.turned(row, value).twisted(row)
        else:
            frame = frame.twisted(row).turned(row, value)
    return frame
