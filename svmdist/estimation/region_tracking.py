"""Which coloured region of an image belongs to which instrument, stable through crossings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from svmdist.profile.settings import AssociationSettings
from svmdist.transforms import Array

GATE_D2 = 18.4  # squared Mahalanobis distance in two dimensions that a right region exceeds once in 10,000
CLUTTER_COUNT = 0.05  # regions of nothing that an image of any size has, on average
MARGIN = 2.0  # a newcomer is named when no other naming is more than e^-2 times as likely
CONTEST = 4.6  # two tracks contest a region that is less than a hundred times (e^4.6) as likely one's as the other's
UNCERTAIN_FRACTION = 0.08  # of the width: a prediction less certain than this identifies nothing any more
MERGED_AREA = 1.4  # a region this much larger than its instrument's is two that touch
MAX_REGIONS = 6  # the largest; assignments grow with their number to the power of the tracks
SPREAD_FRACTION = 0.2  # of a region's radius: shading and jaws move its centroid
MIN_STD_PX = 1.0  # standard deviation of a centroid at least, by segmentation
FIRST_SPEED_WIDTHS = 0.6  # standard deviation of the speed of what was detected once, in widths per s
LINEAR_STD = 0.4  # of seen over nominal motion: the nominal depth is off by as much
DRIFT_WIDTHS = 0.01  # how the offset between seen and nominal place drifts, in widths per square root of s
# How the relation of seen and nominal motion drifts, as the depth changes, per square root of s
LINEAR_DRIFT = 0.05


@dataclass(frozen=True, slots=True)
class Gaussian:
    """A place in the image: mean, shape (2,) in px, and covariance, shape (2, 2) in px²."""

    mean: Array
    covariance: Array

    @property
    def std_px(self) -> float:
        """Along the direction in which it is least sure."""
        return float(np.sqrt(max(np.linalg.eigvalsh(self.covariance)[-1], 0.0)))


class SteadyMotion:
    """Constant velocity with random accelerations: a Kalman filter over (x, y, vx, vy) in px and px/s."""

    def __init__(self, width_px: int, settings: AssociationSettings) -> None:
        self._acceleration = settings.acceleration_widths * width_px
        self._first_speed = FIRST_SPEED_WIDTHS * width_px
        self._x: Array | None = None
        self._P = np.zeros((4, 4))
        self._stamp_ns = 0

    def predict(self, stamp_ns: int) -> Gaussian | None:
        """Go on to a stamp; None before the first region."""
        dt = max(0.0, (stamp_ns - self._stamp_ns) / 1e9)
        self._stamp_ns = stamp_ns
        if self._x is None:
            return None
        F = np.eye(4)
        F[0, 2] = F[1, 3] = dt
        G = np.vstack([0.5 * dt * dt * np.eye(2), dt * np.eye(2)])
        self._x, self._P = F @ self._x, F @ self._P @ F.T + self._acceleration**2 * G @ G.T
        return Gaussian(self._x[:2], self._P[:2, :2])

    def update(self, place: Gaussian) -> None:
        """Take up a region, or a place that a better prediction gives."""
        self._x, self._P = _updated(self._x, self._P, place, self._first_speed)


@dataclass(frozen=True, slots=True)
class NominalPlace:
    """Where the tool is by nominal kinematics: in the image, in the camera frame, (3,) in m, and its scale."""

    place: Gaussian
    position_m: Array
    px_per_m: float


class NominalMotion:
    """The nominal place, corrected: seen = nominal + offset + M (motion in space since it was last seen).

    A robot that is wrong about where its camera stands still knows its own motion. What it gets wrong about how
    that looks, by a wrong depth, place and turn, is linear to first order: offset (2,) and M (2, 3), in px of image
    for px of motion, are the eight states of a Kalman filter. The relation outlives occlusions. `origin` is where the
    tool was nominally when it was last seen.
    """

    def __init__(self, width_px: int) -> None:
        self._drift = DRIFT_WIDTHS * width_px
        self._x: Array | None = None
        self._P = np.zeros((8, 8))
        self.origin: NominalPlace | None = None
        self._now: NominalPlace | None = None
        self._stamp_ns = 0

    def predict(self, stamp_ns: int, nominal: NominalPlace | None) -> Gaussian | None:
        """Where the region should be, for a nominal place; before the first region, the nominal place itself."""
        self._now = nominal
        if nominal is None:
            return None
        dt = max(0.0, (stamp_ns - self._stamp_ns) / 1e9)
        self._stamp_ns = stamp_ns
        if self._x is None:
            return nominal.place
        self._P = self._P + dt * np.diag([self._drift**2] * 2 + [LINEAR_DRIFT**2] * 6)
        H = self._H(nominal)
        return Gaussian(nominal.place.mean + H @ self._x, H @ self._P @ H.T)

    def update(self, place: Gaussian) -> None:
        """Take up a region, seen when the nominal place was the one last given."""
        if self._now is None:
            return
        if self._x is not None:
            # From here on motion counts from this place: what is unsure of M shows in what comes, not in what was.
            moved = np.eye(8)
            moved[:2] = self._H(self._now)
            self._x, self._P = moved @ self._x, moved @ self._P @ moved.T
        offset = Gaussian(place.mean - self._now.place.mean, place.covariance)
        self._x, self._P = _updated(self._x, self._P, offset, LINEAR_STD)
        self.origin = self._now

    def _H(self, nominal: NominalPlace) -> Array:
        origin = self.origin or nominal
        motion_px = (nominal.position_m - origin.position_m) * origin.px_per_m
        return np.hstack([np.eye(2), np.kron(np.eye(2), motion_px[None])])


def _updated(x: Array | None, P: Array, seen: Gaussian, first_std: float) -> tuple[Array, Array]:
    """The Kalman update of the first two states, in Joseph's form, which keeps P positive; the first sets the state."""
    size, R = len(P), seen.covariance
    if x is None:
        P = np.diag([0.0] * 2 + [first_std**2] * (size - 2))
        P[:2, :2] = R
        return np.concatenate([seen.mean, np.zeros(size - 2)]), P
    H = np.eye(2, size)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    A = np.eye(size) - K @ H
    return x + K @ (seen.mean - H @ x), A @ P @ A.T + K @ R @ K.T


@dataclass(frozen=True, slots=True)
class Blob:
    """One connected coloured region: its centroid, shape (2,), and its area."""

    centre_px: Array
    area_px: float

    @property
    def radius_px(self) -> float:
        """Radius of the disc of the same area."""
        return float(np.sqrt(self.area_px / np.pi))


@dataclass
class _Track:
    """One instrument over time; `alone` is its region when last seen, with its area by itself, None before."""

    steady: SteadyMotion
    nominal: NominalMotion
    alone: Blob | None = None

    def predict(self, stamp_ns: int, place: NominalPlace | None) -> Gaussian | None:
        """Where the region should be; None where nothing tells."""
        steady, nominal = self.steady.predict(stamp_ns), self.nominal.predict(stamp_ns, place)
        return steady if nominal is None else nominal

    def update(self, blob: Blob | None, expected: Gaussian | None) -> None:
        """Take up a region; without one, nominal motion that was ever corrected moves the other prediction along."""
        if blob is None:
            if expected is not None and self.nominal.origin is not None:
                self.steady.update(expected)
            return
        std_px = max(MIN_STD_PX, SPREAD_FRACTION * blob.radius_px)
        if self.alone is None:
            self.alone = blob
        elif blob.area_px < 0.7 * self.alone.area_px:
            std_px += 0.5 * self.alone.radius_px  # half is hidden: its middle is elsewhere
        else:
            self.alone = Blob(blob.centre_px, 0.8 * self.alone.area_px + 0.2 * blob.area_px)
        place = Gaussian(blob.centre_px, std_px**2 * np.eye(2))
        self.steady.update(place)
        self.nominal.update(place)


@dataclass(frozen=True, slots=True)
class Identity:
    """One instrument in one image: its region's index, None where it coasts, its expected place, last radius."""

    blob: int | None
    expected: Gaussian | None
    radius_px: float | None = None


class RegionTracker:
    """Assigns the regions of one camera's images to instruments, frame by frame, in the order of their stamps."""

    def __init__(self, count: int, width_px: int, height_px: int, settings: AssociationSettings) -> None:
        self._width_px = width_px
        self._settings = settings
        self._extra_region_cost = float(np.log(width_px * height_px / CLUTTER_COUNT))
        self._tracks = [
            _Track(SteadyMotion(width_px, settings), NominalMotion(width_px)) for _ in range(count)
        ]

    def update(
        self,
        stamp_ns: int,
        places: Sequence[NominalPlace | None],
        blobs: Sequence[Blob],
        evidence: Array | None = None,
    ) -> tuple[Identity, ...]:
        """Name the regions of the next image.

        `places` are those of the tools by nominal kinematics. `evidence`, shape (n_instruments, n_blobs), is the
        log-likelihood of what else is seen around each region, were it that instrument's.
        """
        order = sorted(range(len(blobs)), key=lambda at: -blobs[at].area_px)[:MAX_REGIONS]
        seen = [blobs[at] for at in order]
        expected = [t.predict(stamp_ns, b) for t, b in zip(self._tracks, places, strict=True)]
        cost = self._costs(expected, seen)
        if evidence is not None:
            cost -= evidence[:, order]
        identities = []
        for track, at, where in zip(self._tracks, self._assign(expected, seen, cost), expected, strict=True):
            track.update(None if at is None else seen[at], where)
            radius_px = track.alone.radius_px if track.alone else None
            identities.append(Identity(None if at is None else order[at], where, radius_px))
        return tuple(identities)

    def _costs(self, expected: Sequence[Gaussian | None], blobs: Sequence[Blob]) -> Array:
        """-log likelihood of each region under each track, shape (n_tracks, n_blobs); inf outside of the gate."""
        cost = np.full((len(expected), len(blobs)), np.inf)
        for i, where in enumerate(expected):
            if where is None:
                continue
            for a, blob in enumerate(blobs):
                spread_px2 = (SPREAD_FRACTION * blob.radius_px) ** 2
                S = where.covariance + spread_px2 * np.eye(2) + MIN_STD_PX**2 * np.eye(2)
                offset = blob.centre_px - where.mean
                d2 = float(offset @ np.linalg.solve(S, offset))
                if self._is_uncertain(where):
                    d2 = min(d2, GATE_D2)  # a newcomer may be anywhere; only the comparison counts
                if d2 <= GATE_D2:
                    cost[i, a] = 0.5 * d2 + 0.5 * float(np.log(np.linalg.det(2.0 * np.pi * S)))
        return cost

    def _assign(
        self, expected: Sequence[Gaussian | None], blobs: Sequence[Blob], cost: Array
    ) -> list[int | None]:
        hypotheses = ranked_assignments(cost, self._extra_region_cost, self._settings.miss_cost)
        best_cost, best = hypotheses[0]
        found = list(best)
        uncertain = [self._is_uncertain(where) for where in expected]
        missed = [j for j, a in enumerate(best) if a is None and not uncertain[j]]
        for i, a in enumerate(best):
            if a is None:
                continue
            is_new, is_known = uncertain[i], self._tracks[i].alone is not None
            # What may be anywhere does not keep a first detection at a sure place from being named.
            rivals = [j for j in range(len(best)) if is_new or is_known or not uncertain[j]]
            # This region for one of those; for one that may be anywhere itself, another region, too.
            others = [
                c
                for c, h in hypotheses
                if h[i] != a and (any(h[j] == a for j in rivals) or (is_new and h[i] is not None))
            ]
            is_contested = min(others, default=np.inf) - best_cost < (MARGIN if is_new else CONTEST)
            if is_contested or any(self._may_hold(blobs[a], self._tracks[i], expected[j]) for j in missed):
                found[i] = None
        return found

    def _may_hold(self, blob: Blob, track: _Track, missed: Gaussian | None) -> bool:
        """Whether a track's region may hold that of an instrument which has none, too."""
        if missed is None or track.alone is None:
            return False
        reach_px = 2.0 * blob.radius_px + 3.0 * missed.std_px
        near = float(np.linalg.norm(missed.mean - blob.centre_px)) < reach_px
        return near and blob.area_px > MERGED_AREA * track.alone.area_px

    def _is_uncertain(self, where: Gaussian | None) -> bool:
        return where is None or where.std_px > UNCERTAIN_FRACTION * self._width_px


def ranked_assignments(
    cost: Array, unnamed_cost: float, miss_cost: float
) -> list[tuple[float, tuple[int | None, ...]]]:
    """Every way to give each track one region or none, no region twice, by -log likelihood, the likeliest first.

    `cost`, shape (n_tracks, n_regions), is that of each pair; a region without a track costs, as does a track without.
    """
    track_count, region_count = cost.shape
    found = []
    for assignment in product([None, *range(region_count)], repeat=track_count):
        taken = [a for a in assignment if a is not None]
        if len(taken) == len(set(taken)):
            total = unnamed_cost * (region_count - len(taken))
            for i, a in enumerate(assignment):
                total += miss_cost if a is None else float(cost[i, a])
            found.append((total, assignment))
    return sorted(found, key=lambda item: item[0])
