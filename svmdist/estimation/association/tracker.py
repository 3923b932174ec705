"""Which coloured region of an image belongs to which instrument, stable through crossings.

A track predicts where its instrument's region is: by the robot's nominal motion where there is one, else at
constant velocity. Regions go to tracks by the assignment that is likeliest as a whole, never by size; a region that two
tracks may claim alike goes to neither of them, and both coast (Bar-Shalom, Willett, Tian 2011, ch. 6 and 7).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from svmdist.estimation.association.motion import Gaussian, NominalMotion, NominalPlace, SteadyMotion
from svmdist.profile.settings import AssociationSettings
from svmdist.transforms import Array

DEFAULT = AssociationSettings()


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
    settings: AssociationSettings
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
        std_px = _centroid_std_px(blob, self.settings)
        if self.area_px is not None and blob.area_px < 0.7 * self.area_px:
            std_px += 0.5 * float(
                np.sqrt(self.area_px / np.pi)
            )  # half of it is hidden: its middle is elsewhere
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
    """One instrument in one image: the index of its region, None where it coasts, and where it was expected.

    `radius_px` is that of its region as it was last seen whole, None before.
    """

    blob: int | None
    expected: Gaussian | None
    radius_px: float | None = None


class RegionTracker:
    """Assigns the regions of one camera's images to instruments, frame by frame, in the order of their stamps."""

    def __init__(
        self, count: int, width_px: int, height_px: int, settings: AssociationSettings = DEFAULT
    ) -> None:
        self._settings = settings
        self._width_px = width_px
        self._extra_region_cost = float(np.log(width_px * height_px / settings.clutter_count))
        self.identities: tuple[Identity, ...] = ()
        """Of the latest image."""
        self._tracks = [
            _Track(SteadyMotion(width_px, settings), NominalMotion(width_px, settings), settings)
            for _ in range(count)
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
        order = sorted(range(len(blobs)), key=lambda at: -blobs[at].area_px)[: self._settings.max_regions]
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
        self.identities = tuple(identities)
        return self.identities

    def _costs(self, expected: Sequence[Gaussian | None], blobs: Sequence[Blob]) -> Array:
        """-log likelihood of each region under each track, shape (n_tracks, n_blobs); inf outside of the gate."""
        cost = np.full((len(expected), len(blobs)), np.inf)
        for i, where in enumerate(expected):
            if where is None:
                continue
            for a, blob in enumerate(blobs):
                S = (
                    where.covariance
                    + (self._settings.spread_fraction * blob.radius_px) ** 2 * np.eye(2)
                    + self._settings.min_std_px**2 * np.eye(2)
                )
                offset = blob.centre_px - where.mean
                d2 = float(offset @ np.linalg.solve(S, offset))
                if self._is_uncertain(where):
                    d2 = min(
                        d2, self._settings.gate_d2
                    )  # a newcomer may be anywhere; only the comparison counts
                if d2 <= self._settings.gate_d2:
                    cost[i, a] = 0.5 * d2 + 0.5 * float(np.log(np.linalg.det(2.0 * np.pi * S)))
        return cost

    def _assign(
        self, expected: Sequence[Gaussian | None], blobs: Sequence[Blob], cost: Array
    ) -> list[int | None]:
        """The likeliest assignment of all, less what is not sure enough."""
        hypotheses = [(self._total(h, cost), h) for h in assignments(*cost.shape)]
        best_cost, best = min(hypotheses, key=lambda item: item[0])
        found = list(best)
        for i, a in enumerate(best):
            if a is None:
                continue
            if self._is_uncertain(expected[i]):
                # Another region for this one, or this region for another one.
                others = [c for c, h in hypotheses if h[i] != a and (h[i] is not None or a in h)]
                if min(others, default=np.inf) - best_cost < self._settings.margin:
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
            if float(cost[j, a] - cost[i, a]) < self._settings.contest:
                return True
            area_px = self._tracks[i].area_px
            reach_px = 2.0 * blobs[a].radius_px + 3.0 * where.std_px
            near = float(np.linalg.norm(where.mean - blobs[a].centre_px)) < reach_px
            if near and area_px is not None and bool(blobs[a].area_px > self._settings.merged_area * area_px):
                return True
        return False

    def _total(self, hypothesis: Sequence[int | None], cost: Array) -> float:
        total: float = self._extra_region_cost * (cost.shape[1] - sum(a is not None for a in hypothesis))
        for i, a in enumerate(hypothesis):
            total += self._settings.miss_cost if a is None else float(cost[i, a])
        return total

    def _is_uncertain(self, where: Gaussian | None) -> bool:
        return where is None or where.std_px > self._settings.uncertain_fraction * self._width_px


def _centroid_std_px(blob: Blob, settings: AssociationSettings) -> float:
    return max(settings.min_std_px, settings.spread_fraction * blob.radius_px)


def assignments(track_count: int, blob_count: int) -> Iterator[tuple[int | None, ...]]:
    """Every way to give each track one region or none, no region twice."""
    choices: list[int | None] = [None, *range(blob_count)]
    for hypothesis in product(choices, repeat=track_count):
        taken = [a for a in hypothesis if a is not None]
        if len(taken) == len(set(taken)):
            yield hypothesis
