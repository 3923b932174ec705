"""Which coloured region of an image belongs to which instrument, stable through crossings.

Several ways to name all regions until now are kept (multiple hypotheses, Reid 1979): what a first image leaves open,
the instruments' motion does.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

from svmdist.profile.settings import AssociationSettings
from svmdist.transforms import Array

GATE_D2 = 18.4  # squared Mahalanobis distance in two dimensions that a right region exceeds once in 10,000
CLUTTER_COUNT = 0.05  # regions of nothing that an image of any size has, on average
CONTEST = 3.5  # a region is named where all other namings are less than a thirtieth (e^-3.5) as likely
UNLIKELY, MOST_PASTS = 10.0, 8  # namings less likely than the best by e^-10 are dropped, and beyond so many
ALIKE_S = 0.1  # images within so long give no more information than one
UNCERTAIN_FRACTION = 0.08  # of the width: a prediction less certain than this identifies nothing any more
TAIL = 4.0  # degrees of freedom of Student's t, of a robot whose base may be anywhere
MAX_REGIONS = 6  # the largest; assignments grow with their number to the power of the tracks
SPREAD_FRACTION = 0.2  # of a region's radius: shading and jaws move its centroid
MIN_STD_PX = 1.0  # standard deviation of a centroid at least, by segmentation
FIRST_SPEED_WIDTHS = 0.6  # standard deviation of the speed of what was detected once, in widths per s
LINEAR_STD = 0.4  # of seen over nominal motion: the nominal depth is off by as much
DRIFT_WIDTHS = 0.01  # how the offset between seen and nominal place drifts, in widths per square root of s
LATE_S = 0.03  # by which joints' stamps are off those of images
LINEAR_DRIFT = 0.05  # how the relation of seen and nominal motion drifts, as the depth changes, per square root of s


@dataclass(frozen=True, slots=True)
class Gaussian:
    """A place in the image: mean, shape (2,) in px, and covariance, shape (2, 2) in px²."""

    mean: Array
    covariance: Array

    @property
    def std_px(self) -> float:
        """Along the direction in which it is least sure."""
        return float(np.sqrt(max(np.linalg.eigvalsh(self.covariance)[-1], 0.0)))


class NominalPlace(NamedTuple):
    """Where the tool is by nominal kinematics: in the image, in the camera frame, (3,) in m, and its scale."""

    place: Gaussian
    position_m: Array
    px_per_m: float


@dataclass(frozen=True, slots=True)
class Blob:
    """One connected coloured region: its centroid, shape (2,), and its area."""

    centre_px: Array
    area_px: float

    @property
    def radius_px(self) -> float:
        """Radius of the disc of the same area."""
        return float(np.sqrt(self.area_px / np.pi))


class LinearMotion:
    """A Kalman filter of a place (2,) in px, and of M (2, k), by which causes (k,) move it: time, or nominal motion."""

    def __init__(self, causes: int, first_std: float) -> None:
        self._x: Array | None = None
        # With the standard deviation of each number of M before it was seen to move.
        self._P = np.diag([0.0] * 2 + [first_std**2] * (2 * causes))

    @property
    def slope(self) -> Array:
        """M, shape (2, k): 0 before it was seen to move."""
        return np.zeros((2, len(self._P) // 2 - 1)) if self._x is None else self._x[2:].reshape(2, -1)

    def after(self, by: Array) -> Gaussian | None:
        """The place after a cause, shape (k,); None before the first place."""
        if self._x is None:
            return None
        H = np.hstack([np.eye(2), np.kron(np.eye(2), by[None])])
        return Gaussian(H @ self._x, H @ self._P @ H.T)

    def move(self, by: Array, noise: Array | float = 0.0) -> None:
        """Go on by a cause, with the covariance that this adds to place and M, row by row."""
        if self._x is None:
            return
        F = np.eye(len(self._x))
        F[:2, 2:] = np.kron(np.eye(2), by[None])
        self._x, self._P = F @ self._x, F @ self._P @ F.T + noise

    def update(self, seen: Gaussian) -> None:
        """Take up a place, in Joseph's form, which keeps P positive; the first one sets the state."""
        size, R = len(self._P), seen.covariance
        if self._x is None:
            self._x, self._P = np.pad(seen.mean, (0, size - 2)), self._P + np.pad(R, (0, size - 2))
            return
        H = np.eye(2, size)
        K = self._P @ H.T @ np.linalg.inv(H @ self._P @ H.T + R)
        A = np.eye(size) - K @ H
        self._x, self._P = self._x + K @ (seen.mean - H @ self._x), A @ self._P @ A.T + K @ R @ K.T


class _Track:
    """One instrument over time: by constant velocity, and by its nominal motion; `alone` is its region by itself.

    A robot that is wrong about where its camera stands still knows its own motion. What it gets wrong about how that
    looks, by a wrong depth, place and turn, is linear to first order: seen = nominal + offset, which M moves for a
    motion in space. The relation outlives occlusions.
    """

    def __init__(self, width_px: int, settings: AssociationSettings) -> None:
        self.alone: Blob | None = None  # when last seen, None before
        self._acceleration = settings.acceleration_widths * width_px
        self._drift = np.diag([(DRIFT_WIDTHS * width_px) ** 2] * 2 + [LINEAR_DRIFT**2] * 6)
        self._steady = LinearMotion(1, FIRST_SPEED_WIDTHS * width_px)
        self._offset = LinearMotion(3, LINEAR_STD)
        self._seen_at: NominalPlace | None = None  # where it was nominally when it was last seen
        self._moved_px = np.zeros(3)  # nominally since then, in px of image
        self._late = np.zeros((2, 2))  # covariance in px² by stamps that are late, at its speed
        self._stamp_ns = 0

    def predict(self, stamp_ns: int, nominal: NominalPlace | None) -> Gaussian | None:
        """Where the region should be; None if unknown."""
        dt = max(0.0, (stamp_ns - self._stamp_ns) / 1e9)
        self._stamp_ns = stamp_ns
        G = self._acceleration * np.vstack([0.5 * dt * dt * np.eye(2), dt * np.eye(2)])
        self._steady.move(np.array([dt]), G @ G.T)
        self._offset.move(np.zeros(3), dt * self._drift)
        if nominal is None:
            return self._steady.after(np.zeros(1))
        speed = self._steady.slope[:, 0]
        self._late = LATE_S**2 * np.outer(speed, speed)
        before = self._seen_at or nominal
        self._moved_px = (nominal.position_m - before.position_m) * before.px_per_m
        offset = self._offset.after(self._moved_px)
        if offset is None:
            return nominal.place
        return Gaussian(nominal.place.mean + offset.mean, offset.covariance + self._late)

    def update(self, blob: Blob | None, expected: Gaussian | None, nominal: NominalPlace | None) -> None:
        """Take up a region; without one, nominal motion that was ever corrected moves the other prediction along."""
        if blob is None:
            if expected is not None and self._seen_at is not None:
                self._steady.update(expected)
            return
        std_px = max(MIN_STD_PX, SPREAD_FRACTION * blob.radius_px)
        if self.alone is None:
            self.alone = blob
        elif blob.area_px < 0.7 * self.alone.area_px:
            std_px += 0.5 * self.alone.radius_px  # half is hidden: its middle is elsewhere
        else:
            self.alone = Blob(blob.centre_px, 0.8 * self.alone.area_px + 0.2 * blob.area_px)
        covariance = std_px**2 * np.eye(2)
        self._steady.update(Gaussian(blob.centre_px, covariance))
        if nominal is not None:
            # From here on motion counts from this place: what is unsure of M shows in what comes, not in what was.
            self._offset.move(self._moved_px)
            self._seen_at = nominal
            self._offset.update(Gaussian(blob.centre_px - nominal.place.mean, covariance + self._late))

    def copied(self) -> _Track:
        """Another one with the same past: its filters replace their arrays, and never change them."""
        track = copy(self)
        track._steady, track._offset = copy(self._steady), copy(self._offset)
        return track


class Identity(NamedTuple):
    """One instrument in one image: its region's index, None where it coasts, its expected place, last radius."""

    blob: int | None
    expected: Gaussian | None  # None, too, where what is seen may be this instrument or another one
    radius_px: float | None


Assignment = tuple[int | None, ...]
"""The region of each instrument, or None."""


class _Naming(NamedTuple):
    """One way to name all regions until now: -log likelihoods of the `total`, of this image, and of those `before`."""

    total: float
    cost: float
    before: float
    regions: Assignment
    tracks: Sequence[_Track]  # that those before lead to
    expected: Sequence[Gaussian | None]  # where these are in this image


class RegionTracker:
    """Assigns the regions of one camera's images to instruments, frame by frame, in the order of their stamps."""

    def __init__(self, count: int, width_px: int, height_px: int, settings: AssociationSettings) -> None:
        self._width_px, self._settings = width_px, settings
        self._extra_region_cost = float(np.log(width_px * height_px / CLUTTER_COUNT))
        # An instrument of which nothing is known is anywhere in the image, or as likely in none of it.
        self._anywhere_cost = float(np.log(width_px * height_px)) + settings.miss_cost
        # Ways to name all regions until now: their -log likelihoods, and the tracks that they lead to.
        self._pasts = [(0.0, [_Track(width_px, settings) for _ in range(count)])]
        self._stamp_ns: int | None = None

    def update(
        self, stamp_ns: int, places: Sequence[NominalPlace | None], blobs: Sequence[Blob], evidence: Array | None = None
    ) -> tuple[Identity, ...]:
        """Name the regions of the next image; `places` are those of the tools by nominal kinematics.

        `evidence`, (n_instruments, n_blobs), is the log-likelihood of what else is seen around it, were it that one's.
        """
        order = sorted(range(len(blobs)), key=lambda at: -blobs[at].area_px)[:MAX_REGIONS]
        seen, likelihood = [blobs[at] for at in order], 0.0 if evidence is None else evidence[:, order]
        namings: list[_Naming] = []
        for before, tracks in self._pasts:
            expected = [t.predict(stamp_ns, p) for t, p in zip(tracks, places, strict=True)]
            costs = self._costs(expected, places, seen) - likelihood
            for cost, regions in ranked_assignments(costs, self._extra_region_cost, self._settings.miss_cost):
                if np.isfinite(cost):
                    namings.append(_Naming(before + cost, cost, before, regions, tracks, expected))
        namings.sort(key=lambda one: one.total)
        identities = []
        for i, track in enumerate(namings[0].tracks):
            at, where = self._named(i, namings)
            radius_px = track.alone.radius_px if track.alone else None
            identities.append(Identity(None if at is None else order[at], where, radius_px))

        # The likely namings go on as pasts; of those that end with the same regions, all seen, the best alone.
        kept = list[_Naming]()
        for one in namings:
            if one.total - namings[0].total > UNLIKELY or len(kept) == MOST_PASTS:
                break
            if None in one.regions or one.regions not in [other.regions for other in kept]:
                kept.append(one)
        passed_s = np.inf if self._stamp_ns is None else (stamp_ns - self._stamp_ns) / 1e9
        weight, self._stamp_ns = float(np.clip(passed_s / ALIKE_S, 0.0, 1.0)), stamp_ns
        after = [one.before + weight * one.cost for one in kept]
        self._pasts = []
        for one, cost in zip(kept, after, strict=True):
            tracks = [track.copied() for track in one.tracks]
            for track, at, where, place in zip(tracks, one.regions, one.expected, places, strict=True):
                track.update(None if at is None else seen[at], where, place)
            self._pasts.append((cost - min(after), tracks))
        return tuple(identities)

    def _named(self, i: int, namings: Sequence[_Naming]) -> tuple[int | None, Gaussian | None]:
        """An instrument's region and expected place; no region where another naming is nearly as likely."""
        best = namings[0]
        at, where = best.regions[i], best.expected[i]
        for one in namings:
            if one.total - best.total >= CONTEST:
                break
            if one.regions[i] != at and (one.regions[i] is not None or at in one.regions):
                return None, None
        return at, where

    def _costs(
        self, expected: Sequence[Gaussian | None], places: Sequence[NominalPlace | None], blobs: Sequence[Blob]
    ) -> Array:
        """-log likelihood of each region under each track, shape (n_tracks, n_blobs); inf outside of the gate."""
        # An instrument without kinematics may turn at any time: what is none of the others' is its own, wherever that
        # is. Of two such ones nothing tells which is which.
        is_only_one = sum(place is None for place in places) == 1
        outside = [self._anywhere_cost if place is None and is_only_one else np.inf for place in places]
        cost = np.repeat(np.reshape(outside, (-1, 1)), len(blobs), axis=1)
        for i, where in enumerate(expected):
            if where is None:
                continue
            for a, blob in enumerate(blobs):
                spread_px2 = (SPREAD_FRACTION * blob.radius_px) ** 2
                S = where.covariance + spread_px2 * np.eye(2) + MIN_STD_PX**2 * np.eye(2)
                offset = blob.centre_px - where.mean
                d2 = float(offset @ np.linalg.solve(S, offset))
                # A robot's base may be anywhere: its errors have long tails.
                if where.std_px > UNCERTAIN_FRACTION * self._width_px:
                    d2 = min((TAIL + 2.0) * float(np.log1p(d2 / TAIL)), GATE_D2)
                if d2 <= GATE_D2:
                    cost[i, a] = min(cost[i, a], 0.5 * d2 + 0.5 * float(np.log(np.linalg.det(2.0 * np.pi * S))))
        return cost


def ranked_assignments(cost: Array, unnamed_cost: float, miss_cost: float) -> list[tuple[float, Assignment]]:
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
