"""The filter's state: the correction of believed kinematics, and the measurements' own errors."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np

from svmdist.estimation.filter.correction import CorrectedLink, ErrorModel
from svmdist.estimation.filter.linearisation import Linearised, linearise
from svmdist.estimation.filter.measurements import LinkMeasurement
from svmdist.kinematics.robot_state import RobotState
from svmdist.transforms import Array


class ErrorState:
    """The correction, its error state's covariance `P` with that of own errors behind it, and their mean.

    The own errors are in units of their deviations.
    """

    def __init__(self, model: ErrorModel) -> None:
        self.model = model
        self.robot: RobotState | None = None
        self.correction = model.no_correction()
        self.anchor_m: Array = np.zeros(3)
        self.P: Array = np.zeros((model.size, model.size))
        self.bias_mean: Array = np.zeros(0)
        self._bias_slices: dict[str, slice] = {}
        self._correlation_times_s: Array = np.zeros(0)

    def start(self) -> Array:
        """Believe the kinematics, with the covariance that the profile states: gives that."""
        self.anchor_m = self.model.anchor_m(self.now())
        self.correction = self.model.no_correction()
        prior = self.model.prior(self.now())
        self.reset_bias_states(prior)
        return prior

    def retracted(self, x: Array) -> ErrorState:
        """The state after a step of error state and own errors, shape (n,); the covariance stays."""
        there = copy(self)
        there._bias_slices = dict(self._bias_slices)
        there.retract(x)
        return there

    def retract(self, x: Array) -> None:
        """Take a step of error state and own errors, shape (n,), into correction and mean."""
        size = self.model.size
        self.correction, self.bias_mean = self.correction.retracted(x[:size]), self.bias_mean + x[size:]

    def update_covariance(self, K: Array, H: Array, R: Array) -> None:
        """The covariance after an update, in Joseph's form."""
        keep = np.eye(len(self.P)) - K @ H
        P = keep @ self.P @ keep.T + K @ R @ K.T
        self.P = 0.5 * (P + P.T)

    def reset_bias_states(self, P: Array) -> None:
        """Begin anew with a covariance of the correction, shape (n, n), and no errors of measurements."""
        self.P, self.bias_mean = P, np.zeros(0)
        self._bias_slices, self._correlation_times_s = {}, np.zeros(0)

    def augment_state(self, measurement: LinkMeasurement, count: int) -> None:
        """The first sight of a kind adds its own error to the state, of variance one."""
        if measurement.bias_name in self._bias_slices or count == 0:
            return
        at = len(self.P)
        grown = np.eye(at + count)
        grown[:at, :at] = self.P
        self.P = grown
        self._bias_slices[measurement.bias_name] = slice(at, at + count)
        self.bias_mean = np.concatenate([self.bias_mean, np.zeros(count)])
        self._correlation_times_s = np.concatenate(
            [self._correlation_times_s, np.full(count, measurement.correlation_time_s)]
        )

    def propagate(self, elapsed_s: float) -> None:
        """Time passes: the correction drifts, own errors fade towards their bias_jacobian of one."""
        keep = np.exp(-elapsed_s / self._correlation_times_s)
        factor = np.concatenate([np.ones(self.model.size), keep])
        added = np.concatenate([self.model.drift**2 * elapsed_s, 1.0 - keep**2])
        self.P = factor[:, None] * self.P * factor + np.diag(added)
        self.bias_mean = keep * self.bias_mean

    def now(self) -> RobotState:
        """The robot's state now; raises ValueError before the first instant."""
        if self.robot is None:
            raise ValueError("the filter knows no joints yet: predict comes first")
        return self.robot

    def links(self, names: set[str | None]) -> dict[str | None, CorrectedLink]:
        """Links under the correction, by name; None is the tool."""
        links = self.model.links(names, [self.now()], self.correction, self.anchor_m)
        return {name: at_moments[0] for name, at_moments in links.items()}

    def linearise(self, measurements: Sequence[LinkMeasurement]) -> list[Linearised]:
        """The measurements about the present state; makes room for their own errors."""
        links = self.links({measurement.link for measurement in measurements})
        seen = []
        for measurement in measurements:
            link = links[measurement.link]
            part = linearise(measurement, link.T_camera_link, link.derivative)
            self.augment_state(measurement, part.bias_jacobian.shape[1])
            seen.append(part)
        return seen

    def full_jacobian(self, measurement: LinkMeasurement, part: Linearised) -> Array:
        """The derivative of the residual by the whole state, shape (m, n)."""
        H = np.zeros((len(part.residual), len(self.P)))
        H[:, : self.model.size] = part.H
        if part.bias_jacobian.size:
            H[:, self._bias_slices[measurement.bias_name]] = part.bias_jacobian
        return H
