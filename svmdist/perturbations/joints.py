"""What a robot reports of its joints, perturbed: backlash, drift, noise and steps, and late stamps.

The reported joints are perturbed, not the true ones: images and truth stay, as an existing log demands. With backlash
the motor is ahead of the joint, to where it moves, and the reported joint is the true one plus that lead. It is a play
operator (Krasnosel'skii & Pokrovskii, Systems with Hysteresis, 1989): the lead changes over a travel of twice the
backlash, as in a cable that gives way, so that noise in a logged joint makes no jumps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from svmdist.errors import ProfileError
from svmdist.kinematics import chain_of
from svmdist.perturbations import PATH_STREAM, Perturbations, Place, random_stream
from svmdist.profile import Profile
from svmdist.transforms import Array, Stamps


def late_stamps_ns(stamps_ns: ArrayLike, perturbations: Perturbations, start_ns: int) -> NDArray[np.int64]:
    """The stamps that joints get which were true at `stamps_ns`, any shape; the lag drifts from `start_ns` on."""
    stamps = np.asarray(stamps_ns, np.int64)
    late_ns = 1e6 * perturbations["lag"] + 1e-3 * perturbations["lag_drift"] * (stamps - start_ns)
    return np.asarray(stamps + np.rint(late_ns).astype(np.int64))


def reported_late(values: Array, stamps_ns: Stamps, perturbations: Perturbations) -> Array:
    """Values, (n, k), as reported at their stamps, (n,): interpolated, and extrapolated before the first."""
    if len(stamps_ns) < 2 or not perturbations.has("lag", "lag_drift"):
        return values
    start_ns = int(stamps_ns[0])
    true_at = late_stamps_ns(stamps_ns, perturbations, start_ns) - start_ns
    at = stamps_ns - start_ns
    right = np.clip(np.searchsorted(true_at, at, side="left"), 1, len(at) - 1)
    left = right - 1
    weight = (at - true_at[left]) / (true_at[right] - true_at[left])
    return np.asarray(values[left] + weight[:, None] * (values[right] - values[left]))


METRES_PER_DEG = 1e-4  # of a joint that slides: a cable drum of 12 mm across moves so far in a degree
PROXIMAL_SHARE = 0.5  # backlash of yaw, pitch, insertion and roll, which have shorter cables, over that of the wrist
DRIFT_S = 8.0  # the strength is the deviation of how far a joint drifts in so long
DRIFT_PERIODS_S = np.array([16.0, 24.0, 36.0, 54.0])  # slower than a task, and too many to look like a sine


@dataclass(frozen=True)
class JointUnits:
    """Of the joints of a robot, base first; nothing perturbs the set-up joints, which hold still behind brakes."""

    places: dict[str, int]  # the index of each by its name, and by its aliases
    per_deg: Array  # a degree in a joint's unit, shape (n,)
    backlash_share: Array  # shape (n,)

    @classmethod
    def of(cls, profile: Profile) -> JointUnits:
        """The joints of a profile; raises ProfileError where it has no robot."""
        if profile.robot is None:
            raise ProfileError(f"profile {profile.name} has no [robot]: joints cannot be perturbed")
        chain, first = chain_of(profile.robot), profile.kinematic_error.first_moving_joint
        places = {name: at for at, joint in enumerate(chain.moving_joints) for name in (joint.name, *joint.aliases)}
        per_deg = np.where(chain.is_revolute, np.pi / 180.0, METRES_PER_DEG)
        per_deg[: 0 if first is None else chain.joint_names.index(first)] = 0.0
        # Behind the insertion comes the roll, then the wrist.
        wrist = max(np.flatnonzero(~chain.is_revolute), default=-1) + 2
        return cls(places, per_deg, np.where(np.arange(len(per_deg)) < wrist, PROXIMAL_SHARE, 1.0))


def reported_joints(
    q: Array, stamps_ns: Stamps, units: JointUnits, perturbations: Perturbations, seed: int, arm: int = 0
) -> Array:
    """What an arm reports of joints `q`, shape (n, n_joints) in the order of the robot's, at its stamps, shape (n,)."""
    band = perturbations["backlash"] * units.backlash_share * units.per_deg
    trailing, behind = np.empty_like(q), q[:1]
    for at, row in enumerate(q):
        trailing[at] = behind = np.clip(behind, row - band, row + band)
    reported = q + (q - trailing)
    # A smooth normal process of each joint: 0 at the start, a standard deviation of 1 after 8 s.
    seconds, turns = 1e-9 * (stamps_ns - stamps_ns[:1]), 2.0 * np.pi / DRIFT_PERIODS_S
    waves = random_stream(seed, PATH_STREAM, "joint_drift", arm).normal(0.0, 1.0, (2, q.shape[1], len(turns)))
    drift = sum(
        cosine * (np.cos(turn * seconds) - 1.0)[:, None] + sine * np.sin(turn * seconds)[:, None]
        for turn, (cosine, sine) in zip(turns, waves.transpose(2, 0, 1), strict=True)
    ) / np.sqrt(2.0 * (1.0 - np.cos(turns * DRIFT_S)).sum())
    reported += perturbations["joint_drift"] * units.per_deg * drift
    noise = random_stream(seed, PATH_STREAM, "joint_noise", arm).standard_normal(q.shape)
    reported += perturbations["joint_noise"] * units.per_deg * noise
    step = perturbations["quantisation"] * units.per_deg
    steps = np.divide(reported, step, out=np.zeros_like(q), where=step > 0.0)
    return np.where(step > 0.0, np.rint(steps) * step, reported)


@dataclass(frozen=True)
class ReplayedWorld:
    """A log in a perturbed world; `profile` is the profile as it was read, `seed` that of what is sampled."""

    perturbations: Perturbations
    profile: Profile
    seed: int = 0

    def reported(
        self, instrument: str, names: Sequence[str], stamps_ns: Stamps, positions: Array
    ) -> tuple[Stamps, Array]:
        """The stamps, shape (n,), and joints, shape (n, n_logged), that would be reported for those of a log.

        Before the first one come as many, on the line through the first two, as the lag takes away: the robot moved.
        """
        perturbations = self.perturbations
        if len(stamps_ns) < 2 or not perturbations.changes(Place.JOINTS, Place.CLOCK):
            return stamps_ns, positions
        start_ns, step_ns = int(stamps_ns[0]), int(stamps_ns[1]) - int(stamps_ns[0])
        lag_ns = int(late_stamps_ns(start_ns, perturbations, start_ns)) - start_ns
        before = np.arange(-(-lag_ns // step_ns) if step_ns > 0 and lag_ns > 0 else 0, 0, -1)
        earlier = positions[0] - before[:, None] * (positions[1] - positions[0])
        reported = np.concatenate([earlier, positions])
        at_ns = np.concatenate([start_ns - before * step_ns, stamps_ns])
        late_ns = late_stamps_ns(at_ns, perturbations, start_ns)
        units = JointUnits.of(self.profile.for_instrument(instrument))
        places = np.array([units.places.get(name, -1) for name in names])
        known, q = places >= 0, np.zeros((len(at_ns), len(units.per_deg)))
        q[:, places[known]] = reported[:, known]
        arm = self.profile.instrument_names.index(instrument)
        perturbed = reported_joints(q, late_ns, units, perturbations, self.seed, arm)
        reported[:, known] = perturbed[:, places[known]]
        return late_ns, reported
