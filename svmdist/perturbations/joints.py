"""What the robot reports of its joints, perturbed: backlash, drift, noise and steps, sample after sample.

The reported joints are perturbed, not the true ones: images and truth stay as they are, so that the same can be done
to a log that is recorded already. With backlash the motor is ahead of the joint, on the side to which the joint moves;
the reported joint is the true one plus that lead, which turns over within a travel of twice the backlash. That is a
cable that gives way, and not a gap that is crossed at once: noise in a logged joint then makes no jumps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svmdist.errors import ProfileError
from svmdist.perturbations.chosen import Perturbations, path_stream
from svmdist.perturbations.play import Play
from svmdist.profile import Profile
from svmdist.transforms import Array

METRES_PER_DEG = 1e-4
"""What a degree is for a joint that slides: 0.1 mm. A cable drum of 12 mm across moves so far in a degree."""
PROXIMAL_SHARE = 0.5
"""Backlash of yaw, pitch, insertion and roll, which have shorter cables, over that of the wrist."""
DRIFT_S = 8.0
DRIFT_PERIODS_S = np.array([16.0, 24.0, 36.0, 54.0])
"""Slower than a task, and too many to look like a sine."""


@dataclass(frozen=True)
class JointUnits:
    """The joints of a robot by name, base first: what a degree is in a joint's unit, and its share of the backlash.

    Shapes (n,). The set-up joints hold still behind brakes: nothing perturbs them.
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
        per_deg = np.array(
            [METRES_PER_DEG if joint.type == "prismatic" else np.pi / 180.0 for joint in joints]
        )
        per_deg[:begin] = 0.0
        share = np.where(np.arange(len(joints)) < wrist, PROXIMAL_SHARE, 1.0)
        aliases = {alias: joint.name for joint in joints for alias in joint.aliases}
        return cls(names, aliases, per_deg, share)

    def places(self, logged: Sequence[str]) -> NDArray[np.intp]:
        """For each joint of a log its place among these, -1 for one that is none of them; shape (n_logged,)."""
        by_name = {name: index for index, name in enumerate(self.names)}
        return np.array([by_name.get(self.aliases.get(name, name), -1) for name in logged], np.intp)


class JointPerturber:
    """Perturbs the joints of one arm, sample after sample; the same seed, arm and samples give the same."""

    def __init__(self, units: JointUnits, perturbations: Perturbations, seed: int, arm: int = 0) -> None:
        self._units = units
        self._play = Play(perturbations["backlash"] * units.backlash_share * units.per_deg)
        self._noise = perturbations["joint_noise"] * units.per_deg
        self._noise_stream = path_stream(seed, "joint_noise", arm)
        self._step = perturbations["quantisation"] * units.per_deg
        self._drift = perturbations["joint_drift"] * units.per_deg
        count = len(units.names)
        self._drift_waves = path_stream(seed, "joint_drift", arm).normal(
            0.0, 1.0, (2, count, len(DRIFT_PERIODS_S))
        )
        self._start_ns: int | None = None

    def perturbed(self, q: Array, stamp_ns: int) -> Array:
        """What is reported at the stamp of joints `q`, shape (n,), in the order of the robot's."""
        if self._start_ns is None:
            self._start_ns = stamp_ns
        reported = q + self._play.lead(q)
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
