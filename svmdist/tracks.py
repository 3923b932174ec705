"""Values over time: joints, transforms and distances, and their interpolation between stamps.

A track never extrapolates, and does not interpolate across a gap that is longer than a limit: invalid values are NaN.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svmdist import transforms
from svmdist.transforms import Array, Stamps

Mask = NDArray[np.bool_]

MAX_GAP_NS = 100_000_000  # longest gap to interpolate across: ten samples of the slowest useful joint states
RATE_WINDOW_NS = 40_000_000  # a rate is over the samples within: eight at 100 Hz average encoder noise out


@dataclass(frozen=True, slots=True)
class LagEstimate:
    """A lag in s, positive when the image stamps are late, with its standard deviation.

    `confidence` in [0, 1] is how much better the best lag explains the images than the best lag elsewhere:
    1 - J_best / J_rival. Where the lag is not observable, it is 0 and `reason` says why.
    """

    lag_s: float
    std_s: float | None
    confidence: float
    reason: str = ""

    @property
    def is_observable(self) -> bool:
        """Whether the motion was enough to estimate it."""
        return not self.reason

    @property
    def lag_ns(self) -> int:
        """The lag in ns."""
        return round(self.lag_s * 1e9)


@dataclass(frozen=True)
class Bracket:
    """For each of m stamps the samples on its two sides, shape (m,), and whether they may be used."""

    left: NDArray[np.intp]
    right: NDArray[np.intp]
    fraction: Array
    valid: Mask


def bracket(stamps_ns: Stamps, at_ns: Stamps, max_gap_ns: int = MAX_GAP_NS) -> Bracket:
    """Find the samples around the stamps `at_ns`, shape (m,), in sorted, distinct stamps, shape (n,).

    A stamp is valid at a sample, or between two samples that are at most `max_gap_ns` apart.
    """
    at_ns = np.asarray(at_ns, np.int64)
    if len(stamps_ns) == 0:
        none = np.zeros(len(at_ns), np.intp)
        return Bracket(none, none, none.astype(np.float64), none.astype(np.bool_))
    right = np.searchsorted(stamps_ns, at_ns, side="left")
    inside = right < len(stamps_ns)
    right = np.minimum(right, len(stamps_ns) - 1)
    exact = stamps_ns[right] == at_ns
    inside &= exact | (right > 0)
    left = np.where(exact | (right == 0), right, right - 1)
    gap_ns = stamps_ns[right] - stamps_ns[left]
    valid = inside & (gap_ns <= max_gap_ns)
    fraction = np.where(valid & (gap_ns > 0), (at_ns - stamps_ns[left]) / np.maximum(gap_ns, 1), 0.0)
    return Bracket(left, right, fraction, valid)


def nearest_in_words(apart_s: float) -> str:
    """How far the nearest sample is where none is near enough."""
    if apart_s == np.inf:
        return "there is none"
    return f"nearest {apart_s:.1f} s" if apart_s >= 1.0 else f"nearest {apart_s * 1e3:.3g} ms"


def sort_stamps(stamps_ns: Stamps) -> NDArray[np.intp]:
    """Indices that sort stamps and keep of equal ones the first."""
    order = np.argsort(stamps_ns, kind="stable")
    return np.asarray(order[np.append(True, np.diff(stamps_ns[order]) != 0)[: len(order)]])


def apart_ns(stamps_ns: Stamps, at_ns: Stamps) -> Stamps:
    """How far the nearest of sorted, distinct stamps, (n,), is from each of `at_ns`, (m,); 0 if there is a value."""
    where = bracket(stamps_ns, at_ns)
    left_ns, right_ns = (np.abs(stamps_ns[side] - at_ns) for side in (where.left, where.right))
    return np.where(where.valid, 0, np.minimum(left_ns, right_ns))


@dataclass(frozen=True)
class Sampled:
    """Interpolated values, one row per asked stamp, and which of them are valid; the others are NaN."""

    values: Array
    valid: Mask


def _interpolate_rows(rows: Array, where: Bracket) -> Sampled:
    values = np.full((len(where.valid), *rows.shape[1:]), np.nan)
    left, right = (rows[side[where.valid]] for side in (where.left, where.right))
    # Written so that a fraction of 0 gives the left row to the last bit.
    values[where.valid] = left + where.fraction[where.valid, None] * (right - left)
    return Sampled(values, where.valid)


@dataclass(frozen=True)
class JointTrack:
    """Joint positions over time, shape (n, j) in rad or m by joint, in the order of `names`."""

    stamps_ns: Stamps
    names: tuple[str, ...]
    positions: Array

    def at(self, at_ns: Stamps, max_gap_ns: int = MAX_GAP_NS) -> Sampled:
        """Interpolate linearly; the values have shape (m, j)."""
        return _interpolate_rows(self.positions, bracket(self.stamps_ns, at_ns, max_gap_ns))

    def near(self, at_ns: int) -> Array:
        """The positions at a stamp, shape (j,); beyond the ends they go on at the rate that they have there."""
        inside_ns = int(np.clip(at_ns, self.stamps_ns[0], self.stamps_ns[-1]))
        inside = np.asarray(self.at(np.array([inside_ns]), np.iinfo(np.int64).max).values[0])
        beyond_ns = at_ns - inside_ns
        return inside + self.rate_near(inside_ns) * beyond_ns / 1e9 if beyond_ns else inside

    def rate_near(self, at_ns: int) -> Array:
        """Derivatives by time about a stamp, shape (j,), by a least-squares line; zero for a single sample."""
        about = np.abs(self.stamps_ns - at_ns) <= RATE_WINDOW_NS
        if np.count_nonzero(about) < 2:
            about = np.ones(len(self.stamps_ns), np.bool_)
        t_s = (self.stamps_ns[about] - at_ns) / 1e9
        t_s = t_s - t_s.mean()
        if (square := float(t_s @ t_s)) == 0.0:
            return np.zeros(self.positions.shape[1])
        return np.asarray(t_s @ (self.positions[about] - self.positions[about].mean(0)) / square)


@dataclass(frozen=True)
class TransformTrack:
    """`T_parent_child` over time, shape (n, 4, 4); a static one is always valid, and that of a pose has no `child`."""

    parent: str
    child: str
    stamps_ns: Stamps
    T_parent_child: Array
    is_static: bool = False

    def at(self, at_ns: Stamps, max_gap_ns: int = MAX_GAP_NS) -> Sampled:
        """Interpolate translations linearly and rotations by slerp; the values have shape (m, 4, 4)."""
        if self.is_static:
            return Sampled(np.repeat(self.T_parent_child[:1], len(at_ns), axis=0), np.ones(len(at_ns), np.bool_))
        where = bracket(self.stamps_ns, at_ns, max_gap_ns)
        values = np.full((len(at_ns), 4, 4), np.nan)
        left, right = (self.T_parent_child[side[where.valid]] for side in (where.left, where.right))
        fraction = where.fraction[where.valid]  # of 0: the left one is returned to the last bit
        t_m = left[:, :3, 3] + fraction[:, None] * (right[:, :3, 3] - left[:, :3, 3])
        turn_rad = transforms.rotation_vector(np.swapaxes(left[:, :3, :3], 1, 2) @ right[:, :3, :3])
        R = left[:, :3, :3] @ transforms.rotation_of(fraction[:, None] * turn_rad)
        values[where.valid] = transforms.make_transform(R, t_m)
        return Sampled(values, where.valid)


@dataclass(frozen=True)
class DistanceTrack:
    """The true planar distance, spatial distance and clearance over time, shape (n, 3), in m."""

    stamps_ns: Stamps
    distances_m: Array

    def at(self, at_ns: Stamps, max_gap_ns: int = MAX_GAP_NS) -> Sampled:
        """Interpolate linearly; the values have shape (m, 3)."""
        return _interpolate_rows(self.distances_m, bracket(self.stamps_ns, at_ns, max_gap_ns))
