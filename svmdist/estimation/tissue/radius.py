"""How far a point is from an apex to the outline about it: the normalised radius, and its derivative by the apex.

Between the outline's corners, ordered by their angles about the apex, the reciprocal of their distance from it runs
linearly with the angle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svmdist.transforms import Array

FULL_TURN = 2.0 * np.pi


@dataclass(frozen=True, slots=True)
class PolarOutline:
    """An outline's corners about an apex, shape (2,): vectors from it, shape (n, 2), their angles, and 1 / lengths.

    The angles ascend from -π to π; reciprocals have shape (n,), in 1/m.
    """

    apex_m: Array
    from_apex_m: Array
    angle_rad: Array
    reciprocal: Array

    @staticmethod
    def about(apex_m: Array, outline_m: Array) -> PolarOutline:
        """The outline, shape (n, 2), as seen from the apex."""
        from_apex = outline_m - apex_m
        angle = np.arctan2(from_apex[:, 1], from_apex[:, 0])
        order = np.argsort(angle)
        from_apex = from_apex[order]
        return PolarOutline(apex_m, from_apex, angle[order], 1.0 / np.hypot(from_apex[:, 0], from_apex[:, 1]))

    def normalised_radius(self, points_m: Array) -> Array:
        """0 at the apex, 1 on the outline, for points, shape (n, 2): shape (n,)."""
        from_apex = points_m - self.apex_m
        before, after, span, share = self._between(from_apex)
        del span
        reciprocal = self.reciprocal[before] + share * (self.reciprocal[after] - self.reciprocal[before])
        return np.asarray(np.hypot(from_apex[:, 0], from_apex[:, 1]) * reciprocal)

    def with_derivative(self, points_m: Array) -> tuple[Array, Array]:
        """The same, and its derivative by the apex: shapes (n,) and (n, 2); the latter is zero at the apex itself."""
        from_apex = points_m - self.apex_m
        length = np.hypot(from_apex[:, 0], from_apex[:, 1])
        safe = np.where(length > 0.0, length, np.inf)
        before, after, span, share = self._between(from_apex)
        rise = self.reciprocal[after] - self.reciprocal[before]
        reciprocal = self.reciprocal[before] + share * rise
        # Of a vector r from the apex: d(1/|r|) = r / |r|³, d angle = (r_y, -r_x) / |r|², d|r| = -r / |r|.
        d_reciprocal = self.from_apex_m * self.reciprocal[:, None] ** 3
        d_angle = _across(self.from_apex_m) * self.reciprocal[:, None] ** 2
        d_toward = _across(from_apex) / safe[:, None] ** 2
        d_span = d_angle[after] - d_angle[before]
        d_share = (d_toward - d_angle[before] - share[:, None] * d_span) / np.where(span > 0.0, span, np.inf)[
            :, None
        ]
        d_here = d_reciprocal[before] + share[:, None] * (d_reciprocal[after] - d_reciprocal[before])
        d_here += d_share * rise[:, None]
        derivative = length[:, None] * d_here - reciprocal[:, None] * from_apex / safe[:, None]
        return length * reciprocal, np.where(length[:, None] > 0.0, derivative, 0.0)

    def _between(self, from_apex: Array) -> tuple[NDArray[np.intp], NDArray[np.intp], Array, Array]:
        """The corners before and after vectors from the apex, the angle between them, and the vector's share of it."""
        toward = np.arctan2(from_apex[:, 1], from_apex[:, 0])
        count = len(self.angle_rad)
        at = np.searchsorted(self.angle_rad, toward, side="right") - 1
        before, after = at % count, (at + 1) % count
        span = (self.angle_rad[after] - self.angle_rad[before]) % FULL_TURN
        ahead = (toward - self.angle_rad[before]) % FULL_TURN
        share = np.where(span > 0.0, ahead / np.where(span > 0.0, span, 1.0), 0.0)
        return before, after, span, share


def _across(vectors: Array) -> Array:
    return np.stack([vectors[:, 1], -vectors[:, 0]], -1)
