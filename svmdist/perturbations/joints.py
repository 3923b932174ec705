"""What a robot reports of its joints, perturbed: backlash, drift, noise and steps, and late stamps.

The reported joints are perturbed, not the true ones: images and truth stay, so that the same can be applied to an
existing log. With backlash the motor is ahead of the joint, on the side to which the joint moves; the reported joint
is the true one plus that lead. It is a play operator (Krasnosel'skii & Pokrovskii, Systems with Hysteresis, 1989): the
lead changes over a travel of twice the backlash, as in a cable that gives way, so that noise in a logged joint makes
no jumps.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from svmdist.errors import ProfileError
from svmdist.perturbations.chosen import Perturbations, path_stream
from svmdist.perturbations.table import Place
from svmdist.profile import Profile
from svmdist.samples import JointSample
from svmdist.transforms import Array

MAX_STAMP_NS = (1 << 63) - 1


def later_ns(stamp_ns: int, lag_ns: int) -> int:
    """A stamp that is later by a lag, within 64 bits."""
    return min(stamp_ns + lag_ns, MAX_STAMP_NS)


def late_stamps_ns(stamps_ns: ArrayLike, perturbations: Perturbations, start_ns: int) -> NDArray[np.int64]:
    """The stamps that joints get which were true at `stamps_ns`, any shape; the lag drifts from `start_ns` on."""
    stamps = np.asarray(stamps_ns, np.int64)
    late_ns = 1e6 * perturbations["lag"] + 1e-3 * perturbations["lag_drift"] * (stamps - start_ns)
    return np.asarray(stamps + np.rint(late_ns).astype(np.int64))


def reported_late(values: Array, stamps_ns: NDArray[np.int64], perturbations: Perturbations) -> Array:
    """What is reported at the stamps, shape (n,), of values over the same stamps, shape (n, k).

    Values are interpolated linearly between stamps, and extrapolated before the first one: the robot moved then, too.
    """
    if len(stamps_ns) < 2 or not perturbations.has("lag", "lag_drift"):
        return values
    start_ns = int(stamps_ns[0])
    true_at = late_stamps_ns(stamps_ns, perturbations, start_ns) - start_ns
    at = stamps_ns - start_ns
    right = np.clip(np.searchsorted(true_at, at, side="left"), 1, len(at) - 1)
    left = right - 1
    weight = (at - true_at[left]) / (true_at[right] - true_at[left])
    return np.asarray(values[left] + weight[:, None] * (values[right] - values[left]))


METRES_PER_DEG = 1e-4
"""What a degree is for a joint that slides: 0.1 mm. A cable drum of 12 mm across moves so far in a degree."""
PROXIMAL_SHARE = 0.5
"""Backlash of yaw, pitch, insertion and roll, which have shorter cables, over that of the wrist."""
DRIFT_S = 8.0
DRIFT_PERIODS_S = np.array([16.0, 24.0, 36.0, 54.0])  # slower than a task, and too many to look like a sine


@dataclass(frozen=True)
class JointUnits:
    """The joints of a robot by name, base first; a degree in a joint's unit, and its share of the backlash, shape (n,).

    The set-up joints hold still behind brakes: nothing perturbs them.
    """

    names: tuple[str, ...]
    aliases: dict[str, str]
    per_deg: Array
    backlash_share: Array

    @classmethod
    def of(cls, profile: Profile) -> JointUnits:
        """The joints of a profile; raises ProfileError where it has no robot."""
        if profile.robot is None:
            raise ProfileError(f"profile {profile.name} has no [robot]: joints cannot be perturbed")
        joints = [joint for joint in profile.robot.joints if joint.type != "fixed"]
        first = profile.kinematic_error.first_moving_joint
        names = tuple(joint.name for joint in joints)
        begin = 0 if first is None else names.index(first)
        sliding = [index for index, joint in enumerate(joints) if joint.type == "prismatic"]
        # Behind the insertion comes the roll, then the wrist.
        wrist = (sliding[-1] if sliding else -1) + 2
        per_deg = np.full(len(joints), np.pi / 180.0)
        per_deg[sliding] = METRES_PER_DEG
        per_deg[:begin] = 0.0
        share = np.where(np.arange(len(joints)) < wrist, PROXIMAL_SHARE, 1.0)
        aliases = {alias: joint.name for joint in joints for alias in joint.aliases}
        return cls(names, aliases, per_deg, share)

    def places(self, logged: Sequence[str]) -> NDArray[np.intp]:
        """For each joint of a log its place among these, -1 for one that is none of them; shape (n_logged,)."""
        by_name = {name: index for index, name in enumerate(self.names)}
        return np.array([by_name.get(self.aliases.get(name, name), -1) for name in logged], np.intp)


class JointPerturber:
    """Perturbs the joints of one arm, sample after sample, reproducibly by seed and arm."""

    def __init__(self, units: JointUnits, perturbations: Perturbations, seed: int, arm: int = 0) -> None:
        self._units = units
        self._backlash = perturbations["backlash"] * units.backlash_share * units.per_deg
        self._trailing: Array | None = None
        self._noise = perturbations["joint_noise"] * units.per_deg
        self._noise_stream = path_stream(seed, "joint_noise", arm)
        self._step = perturbations["quantisation"] * units.per_deg
        self._drift = perturbations["joint_drift"] * units.per_deg
        shape = (2, len(units.names), len(DRIFT_PERIODS_S))
        self._drift_waves = path_stream(seed, "joint_drift", arm).normal(0.0, 1.0, shape)
        self._start_ns: int | None = None

    def perturbed(self, q: Array, stamp_ns: int) -> Array:
        """What is reported at the stamp of joints `q`, shape (n,), in the order of the robot's."""
        if self._start_ns is None:
            self._start_ns = stamp_ns
        trailing = q if self._trailing is None else self._trailing
        self._trailing = np.clip(trailing, q - self._backlash, q + self._backlash)
        reported = q + (q - self._trailing)
        reported = reported + self._drift * self._wander(1e-9 * (stamp_ns - self._start_ns))
        reported = reported + self._noise * self._noise_stream.standard_normal(len(q))
        steps = np.divide(reported, self._step, out=np.zeros(len(q)), where=self._step > 0.0)
        return np.where(self._step > 0.0, np.rint(steps) * self._step, reported)

    def of_log(self, names: Sequence[str], positions: Array, stamp_ns: int) -> Array:
        """The same for joints as a log names them, shape (n_logged,); those of no robot stay."""
        places = self._units.places(names)
        known = places >= 0
        q = np.zeros(len(self._units.names))
        q[places[known]] = positions[known]
        reported = positions.copy()
        reported[known] = self.perturbed(q, stamp_ns)[places[known]]
        return reported

    def _wander(self, seconds: float) -> Array:
        """A smooth normal process of each joint, shape (n,): 0 at the start, a standard deviation of 1 after 8 s."""
        turn = 2.0 * np.pi / DRIFT_PERIODS_S
        cosine, sine = self._drift_waves
        path = cosine * (np.cos(turn * seconds) - 1.0) + sine * np.sin(turn * seconds)
        return np.asarray(path.sum(axis=-1) / np.sqrt(2.0 * (1.0 - np.cos(turn * DRIFT_S)).sum()))


@dataclass(frozen=True)
class ReplayedWorld:
    """A log in a perturbed world, or with a time offset applied.

    `profile` is the profile as it was read, `seed` that of what is drawn. The stamps of the images are late by
    `lag_ns`: whatever the robot reports gets stamps that are as late.
    """

    perturbations: Perturbations
    profile: Profile
    seed: int = 0
    lag_ns: int = 0

    def joints_of(self, instrument: str) -> ReplayedJoints | None:
        """The perturbed joints of an instrument; None where nothing changes."""
        perturber = None
        if self.perturbations.changes(Place.JOINTS) or self.perturbations.changes(Place.CLOCK):
            units = JointUnits.of(self.profile.for_instrument(instrument))
            arm = self.profile.instrument_names.index(instrument)
            perturber = JointPerturber(units, self.perturbations, self.seed, arm)
        return ReplayedJoints(self, perturber) if perturber or self.lag_ns else None


class ReplayedJoints:
    """Perturbs one arm's joint samples in the order of the log, on the clock of its images."""

    def __init__(self, world: ReplayedWorld, perturber: JointPerturber | None) -> None:
        self._world, self._perturber = world, perturber
        self._first: JointSample | None = None
        self._started = False

    def replayed(self, sample: JointSample) -> Iterator[JointSample]:
        """Yield what is reported in place of a sample; in a perturbed world the first one comes with the second."""
        if self._perturber is None:
            yield replace(sample, stamp_ns=later_ns(sample.stamp_ns, self._world.lag_ns))
        elif self._first is None:
            self._first = sample
        else:
            if not self._started:
                self._started = True
                for earlier in self._before(self._first, sample):
                    yield self._reported(self._perturber, earlier, self._first.stamp_ns)
                yield self._reported(self._perturber, self._first, self._first.stamp_ns)
            yield self._reported(self._perturber, sample, self._first.stamp_ns)

    def _before(self, first: JointSample, second: JointSample) -> Iterator[JointSample]:
        """Samples before the first two, on the line through them, as many as the lag takes away: the robot moved."""
        step_ns, perturbations = second.stamp_ns - first.stamp_ns, self._world.perturbations
        lag_ns = int(late_stamps_ns(first.stamp_ns, perturbations, first.stamp_ns)) - first.stamp_ns
        if step_ns <= 0 or lag_ns <= 0 or first.names != second.names:
            return
        for count in range(-(-lag_ns // step_ns), 0, -1):
            positions = first.positions - count * (second.positions - first.positions)
            yield replace(first, stamp_ns=first.stamp_ns - count * step_ns, positions=positions)

    def _reported(self, perturber: JointPerturber, sample: JointSample, start_ns: int) -> JointSample:
        stamp_ns = int(late_stamps_ns(sample.stamp_ns, self._world.perturbations, start_ns))
        positions = perturber.of_log(sample.names, np.asarray(sample.positions, np.float64), stamp_ns)
        return replace(sample, stamp_ns=later_ns(stamp_ns, self._world.lag_ns), positions=positions)
