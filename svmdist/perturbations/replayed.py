"""What the robot of a log reports as it would have been reported, sample after sample as it is read."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from svmdist.perturbations.chosen import Perturbations
from svmdist.perturbations.clock import late_stamps_ns, later_ns
from svmdist.perturbations.joints import JointPerturber, JointUnits
from svmdist.perturbations.perturbation import Place
from svmdist.profile import Profile
from svmdist.samples import JointSample


@dataclass(frozen=True)
class ReplayedWorld:
    """A log in a perturbed world, or with a clock put right: what differs from how it was read.

    That is what is perturbed, the profile as it was read, the seed of what is drawn, and the lag that is taken off: by
    how much the stamps of the images are late. Whatever the robot reports gets stamps that are as late.
    """

    perturbations: Perturbations
    profile: Profile
    seed: int = 0
    lag_ns: int = 0

    def joints_of(self, instrument: str) -> ReplayedJoints | None:
        """What is done to the joints of one of the instruments; None where nothing is."""
        if not (self.perturbations.changes(Place.JOINTS) or self.perturbations.changes(Place.CLOCK)):
            return ReplayedJoints(None, self.perturbations, self.lag_ns) if self.lag_ns else None
        units = JointUnits.of(self.profile.for_instrument(instrument))
        arm = self.profile.instrument_names.index(instrument)
        perturber = JointPerturber(units, self.perturbations, self.seed, arm)
        return ReplayedJoints(perturber, self.perturbations, self.lag_ns)


class ReplayedJoints:
    """Perturbs one arm's joint samples in the order of the log, and puts them on the clock of its images."""

    def __init__(
        self, perturber: JointPerturber | None, perturbations: Perturbations, lag_ns: int = 0
    ) -> None:
        self._perturber = perturber
        self._perturbations = perturbations
        self._lag_ns = lag_ns
        self._first: JointSample | None = None
        self._started = False

    def replayed(self, sample: JointSample) -> Iterator[JointSample]:
        """Yield what is reported in place of a sample: in a perturbed world the first one comes with the second."""
        if self._perturber is None:
            yield replace(sample, stamp_ns=later_ns(sample.stamp_ns, self._lag_ns))
        elif self._started:
            yield self._reported(sample)
        elif self._first is None:
            self._first = sample
        else:
            self._started = True
            for earlier in self._before(self._first, sample):
                yield self._reported(earlier)
            yield self._reported(self._first)
            yield self._reported(sample)

    def _before(self, first: JointSample, second: JointSample) -> Iterator[JointSample]:
        """Samples on the line through the first two, so many before them as the lag takes away: the robot moved."""
        step_ns = second.stamp_ns - first.stamp_ns
        lag_ns = int(late_stamps_ns(first.stamp_ns, self._perturbations, first.stamp_ns)) - first.stamp_ns
        if step_ns <= 0 or lag_ns <= 0 or first.names != second.names:
            return
        for count in range(-(-lag_ns // step_ns), 0, -1):
            positions = first.positions - count * (second.positions - first.positions)
            yield replace(first, stamp_ns=first.stamp_ns - count * step_ns, positions=positions)

    def _reported(self, sample: JointSample) -> JointSample:
        assert self._perturber is not None
        assert self._first is not None  # it came before
        stamp_ns = int(late_stamps_ns(sample.stamp_ns, self._perturbations, self._first.stamp_ns))
        positions = self._perturber.of_log(sample.names, np.asarray(sample.positions, np.float64), stamp_ns)
        return replace(sample, stamp_ns=later_ns(stamp_ns, self._lag_ns), positions=positions)
