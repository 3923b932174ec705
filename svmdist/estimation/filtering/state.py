"""The filter's state: the correction of believed kinematics, and the observations' own errors."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np

from svmdist.estimation.filtering.correction import CorrectedLink, ErrorModel, Moment
from svmdist.estimation.filtering.linearisation import Linearised, linearise
from svmdist.estimation.filtering.observations import LinkObservation
from svmdist.transforms import Array


class ErrorState:
    """The correction, its error state's covariance `P` with that of own errors behind it, and their mean.

    The own errors are in units of their deviations.
    """

    def __init__(self, model: ErrorModel) -> None:
        self.model = model
        self.moment: Moment | None = None
        self.correction = model.no_correction()
        self.anchor_m: Array = np.zeros(3)
        self.P: Array = np.zeros((model.size, model.size))
        self.own_mean: Array = np.zeros(0)
        self._own: dict[str, slice] = {}
        self._own_s: Array = np.zeros(0)

    def start(self) -> Array:
        """Believe the kinematics, with the covariance that the profile states: gives that."""
        self.anchor_m = self.model.anchor_m(self.now())
        self.correction = self.model.no_correction()
        prior = self.model.prior(self.now())
        self.forget_own_errors(prior)
        return prior

    def moved(self, x: Array) -> ErrorState:
        """The state after a step of error state and own errors, shape (n,); the covariance stays."""
        there = copy(self)
        there._own = dict(self._own)
        there.move(x)
        return there

    def move(self, x: Array) -> None:
        """Take a step of error state and own errors, shape (n,), into correction and mean."""
        size = self.model.size
        self.correction, self.own_mean = self.correction.moved(x[:size]), self.own_mean + x[size:]

    def gain(self, K: Array, H: Array, R: Array) -> None:
        """The covariance after an update, in Joseph's form."""
        keep = np.eye(len(self.P)) - K @ H
        P = keep @ self.P @ keep.T + K @ R @ K.T
        self.P = 0.5 * (P + P.T)

    def forget_own_errors(self, P: Array) -> None:
        """Begin anew with a covariance of the correction, shape (n, n), and no errors of observations."""
        self.P, self.own_mean = P, np.zeros(0)
        self._own, self._own_s = {}, np.zeros(0)

    def make_room(self, observation: LinkObservation, count: int) -> None:
        """The first sight of a kind adds its own error to the state, of variance one."""
        if observation.own in self._own or count == 0:
            return
        at = len(self.P)
        grown = np.eye(at + count)
        grown[:at, :at] = self.P
        self.P = grown
        self._own[observation.own] = slice(at, at + count)
        self.own_mean = np.concatenate([self.own_mean, np.zeros(count)])
        self._own_s = np.concatenate([self._own_s, np.full(count, observation.own_s)])

    def pass_time(self, elapsed_s: float) -> None:
        """Time passes: the correction drifts, own errors fade towards their spread of one."""
        keep = np.exp(-elapsed_s / self._own_s)
        factor = np.concatenate([np.ones(self.model.size), keep])
        added = np.concatenate([self.model.drift**2 * elapsed_s, 1.0 - keep**2])
        self.P = factor[:, None] * self.P * factor + np.diag(added)
        self.own_mean = keep * self.own_mean

    def now(self) -> Moment:
        """What the robot believes now; raises ValueError before the first instant."""
        if self.moment is None:
            raise ValueError("the filter knows no joints yet: predict comes first")
        return self.moment

    def links(self, names: set[str | None]) -> dict[str | None, CorrectedLink]:
        """Links under the correction, by name; None is the tool."""
        links = self.model.links(names, [self.now()], self.correction, self.anchor_m)
        return {name: at_moments[0] for name, at_moments in links.items()}

    def see(self, observations: Sequence[LinkObservation]) -> list[Linearised]:
        """The observations about the present state; makes room for their own errors."""
        links = self.links({observation.link for observation in observations})
        seen = []
        for observation in observations:
            link = links[observation.link]
            part = linearise(observation, link.T_camera_link, link.derivative)
            self.make_room(observation, part.spread.shape[1])
            seen.append(part)
        return seen

    def whole(self, observation: LinkObservation, part: Linearised) -> Array:
        """The derivative of the residual by the whole state, shape (m, n)."""
        H = np.zeros((len(part.residual), len(self.P)))
        H[:, : self.model.size] = part.H
        if part.spread.size:
            H[:, self._own[observation.own]] = part.spread
        return H
