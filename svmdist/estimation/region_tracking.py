"""Which coloured region of an image belongs to which instrument, stable through crossings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
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

DEFAULT = AssociationSettings()


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

    def __init__(self, width_px: int, settings: AssociationSettings = DEFAULT) -> None:
        self._acceleration = settings.acceleration_widths * width_px
        self._first_speed = FIRST_SPEED_WIDTHS * width_px
        self._x: Array | None = None
        self._P = np.zeros((4, 4))
        self._stamp_ns = 0
        self._now_ns = 0

    def predict(self, stamp_ns: int) -> Gaussian | None:
        """Go on to a stamp; None before the first region."""
        self._now_ns = stamp_ns
        if self._x is None:
            return None
        dt = max(0.0, (stamp_ns - self._stamp_ns) / 1e9)
        F = np.eye(4)
        F[0, 2] = F[1, 3] = dt
        G = np.vstack([0.5 * dt * dt * np.eye(2), dt * np.eye(2)])
        self._x = F @ self._x
        self._P = F @ self._P @ F.T + self._acceleration**2 * G @ G.T
        self._stamp_ns = stamp_ns
        return Gaussian(self._x[:2], self._P[:2, :2])

    def update(self, pixel: Array, std_px: float) -> None:
        """Take up a region, shape (2,)."""
        self._update(np.asarray(pixel, np.float64), std_px**2 * np.eye(2))

    def follow(self, place: Gaussian) -> None:
        """Take up a place that another prediction gives, for it knows better."""
        self._update(place.mean, place.covariance)

    def _update(self, pixel: Array, R: Array) -> None:
        if self._x is None:
            self._x = np.array([*pixel, 0.0, 0.0])
            self._P = np.zeros((4, 4))
            self._P[:2, :2], self._P[2:, 2:] = R, self._first_speed**2 * np.eye(2)
            self._stamp_ns = self._now_ns
            return
        H = np.eye(2, 4)
        self._x, self._P = _corrected(self._x, self._P, H, pixel - H @ self._x, R)


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
    for px of motion, are the eight states of a Kalman filter. The relation outlives occlusions.
    """

    def __init__(self, width_px: int) -> None:
        self._drift = DRIFT_WIDTHS * width_px
        self._x = np.zeros(8)
        self._P: Array | None = None
        self._origin: NominalPlace | None = None
        self._now: NominalPlace | None = None
        self._stamp_ns = 0

    @property
    def has_update(self) -> bool:
        """Whether a region was ever seen, so that the prediction is more than nominal kinematics."""
        return self._P is not None

    def predict(self, stamp_ns: int, nominal: NominalPlace | None) -> Gaussian | None:
        """Where the region should be, for a nominal place; before the first region, the nominal place itself."""
        self._now = nominal
        if nominal is None:
            return None
        if self._P is None:
            self._stamp_ns = stamp_ns
            return nominal.place
        dt = max(0.0, (stamp_ns - self._stamp_ns) / 1e9)
        self._stamp_ns = stamp_ns
        self._P = self._P + dt * np.diag([self._drift**2] * 2 + [LINEAR_DRIFT**2] * 6)
        H = self._H(nominal)
        return Gaussian(nominal.place.mean + H @ self._x, H @ self._P @ H.T)

    def update(self, pixel: Array, std_px: float) -> None:
        """Take up a region, shape (2,), seen when the nominal place was the one last given."""
        if self._now is None:
            return
        offset, R = pixel - self._now.place.mean, std_px**2 * np.eye(2)
        if self._P is None:
            self._origin = self._now
            self._x = np.concatenate([offset, np.zeros(6)])
            self._P = np.diag([std_px**2] * 2 + [LINEAR_STD**2] * 6)
            return
        # From here on motion counts from this place: what is unsure of M shows in what comes, not in what was.
        moved = np.eye(8)
        moved[:2] = self._H(self._now)
        self._x, self._P, self._origin = moved @ self._x, moved @ self._P @ moved.T, self._now
        H = np.eye(2, 8)
        self._x, self._P = _corrected(self._x, self._P, H, offset - H @ self._x, R)

    def _H(self, nominal: NominalPlace) -> Array:
        origin = self._origin or nominal
        motion_px = (nominal.position_m - origin.position_m) * origin.px_per_m
        return np.hstack([np.eye(2), np.kron(np.eye(2), motion_px[None])])


def _corrected(x: Array, P: Array, H: Array, innovation: Array, R: Array) -> tuple[Array, Array]:
    """The Kalman update in Joseph's form, which keeps P positive."""
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    A = np.eye(len(x)) - K @ H
    return x + K @ innovation, A @ P @ A.T + K @ R @ K.T


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
    """One instrument over time. `area_px` is that of its region alone, None before it was seen."""

    steady: SteadyMotion
    nominal: NominalMotion
    area_px: float | None = None

    @property
    def radius_px(self) -> float | None:
        """Radius of the disc of the same area."""
        return None if self.area_px is None else float(np.sqrt(self.area_px / np.pi))

    def predict(self, stamp_ns: int, place: NominalPlace | None) -> Gaussian | None:
        """Where the region should be; None where nothing tells."""
        steady, nominal = self.steady.predict(stamp_ns), self.nominal.predict(stamp_ns, place)
        return steady if nominal is None else nominal

    def update(self, blob: Blob) -> None:
        std_px = max(MIN_STD_PX, SPREAD_FRACTION * blob.radius_px)
        if self.area_px is not None and blob.area_px < 0.7 * self.area_px:
            std_px += 0.5 * float(np.sqrt(self.area_px / np.pi))  # half is hidden: its middle is elsewhere
        else:
            self.area_px = blob.area_px if self.area_px is None else 0.8 * self.area_px + 0.2 * blob.area_px
        self.steady.update(blob.centre_px, std_px)
        self.nominal.update(blob.centre_px, std_px)

    def coast(self, expected: Gaussian | None) -> None:
        """Nothing was detected: the nominal motion moves the other prediction along."""
        if expected is not None and self.nominal.has_update:
            self.steady.follow(expected)


@dataclass(frozen=True, slots=True)
class Identity:
    """One instrument in one image: its region's index, None where it coasts, its expected place, last radius."""

    blob: int | None
    expected: Gaussian | None
    radius_px: float | None = None


class RegionTracker:
    """Assigns the regions of one camera's images to instruments, frame by frame, in the order of their stamps."""

    def __init__(
        self, count: int, width_px: int, height_px: int, settings: AssociationSettings = DEFAULT
    ) -> None:
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

        `places` are those of the tools by nominal kinematics, as uncertain as they are. `evidence`, shape
        (n_instruments, n_blobs), is the log-likelihood of what else is seen around each region, were it that
        instrument's.
        """
        order = sorted(range(len(blobs)), key=lambda at: -blobs[at].area_px)[:MAX_REGIONS]
        seen = [blobs[at] for at in order]
        said = np.zeros((len(self._tracks), len(blobs))) if evidence is None else np.asarray(evidence)
        expected = [t.predict(stamp_ns, b) for t, b in zip(self._tracks, places, strict=True)]
        cost = self._costs(expected, seen) - said[:, order]
        found = self._assign(expected, seen, cost)
        identities = []
        for track, at, where in zip(self._tracks, found, expected, strict=True):
            if at is None:
                track.coast(where)
            else:
                track.update(seen[at])
            identities.append(Identity(None if at is None else order[at], where, track.radius_px))
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
        hypotheses = [(self._total(h, cost), h) for h in assignments(*cost.shape)]
        best_cost, best = min(hypotheses, key=lambda item: item[0])
        found = list(best)
        for i, a in enumerate(best):
            if a is None:
                continue
            if self._is_uncertain(expected[i]):
                # Another region for this one, or this region for another one.
                others = [c for c, h in hypotheses if h[i] != a and (h[i] is not None or a in h)]
                if min(others, default=np.inf) - best_cost < MARGIN:
                    found[i] = None
            elif self._is_contested(i, a, best, expected, blobs, cost):
                found[i] = None
        return found

    def _is_contested(
        self,
        i: int,
        a: int,
        best: Sequence[int | None],
        expected: Sequence[Gaussian | None],
        blobs: Sequence[Blob],
        cost: Array,
    ) -> bool:
        """Whether a region may as well be, or hold, that of an instrument which has none."""
        for j, (taken, where) in enumerate(zip(best, expected, strict=True)):
            if j == i or taken is not None or where is None or self._is_uncertain(where):
                continue
            if float(cost[j, a] - cost[i, a]) < CONTEST:
                return True
            area_px = self._tracks[i].area_px
            reach_px = 2.0 * blobs[a].radius_px + 3.0 * where.std_px
            near = float(np.linalg.norm(where.mean - blobs[a].centre_px)) < reach_px
            if near and area_px is not None and bool(blobs[a].area_px > MERGED_AREA * area_px):
                return True
        return False

    def _total(self, hypothesis: Sequence[int | None], cost: Array) -> float:
        total: float = self._extra_region_cost * (cost.shape[1] - sum(a is not None for a in hypothesis))
        for i, a in enumerate(hypothesis):
            total += self._settings.miss_cost if a is None else float(cost[i, a])
        return total

    def _is_uncertain(self, where: Gaussian | None) -> bool:
        return where is None or where.std_px > UNCERTAIN_FRACTION * self._width_px


def assignments(track_count: int, blob_count: int) -> Iterator[tuple[int | None, ...]]:
    """Every way to give each track one region or none, no region twice."""
    choices: list[int | None] = [None, *range(blob_count)]
    for hypothesis in product(choices, repeat=track_count):
        taken = [a for a in hypothesis if a is not None]
        if len(taken) == len(set(taken)):
            yield hypothesis
