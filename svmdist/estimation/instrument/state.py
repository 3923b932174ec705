"""The filter's state, measurements linearised about it, and the most probable one, given prior and measurements.

Maximum a posteriori by iterated, reweighted Gauss–Newton (Bell and Cathey 1993; Lange, Little and Taylor 1989 for
Student's t), so that no gate set before the fit rejects anything.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from svmdist.estimation.instrument.consistency import NU, student_weight
from svmdist.estimation.instrument.error_model import CorrectedLink, CorrectedLinks, Correction, ErrorModel
from svmdist.estimation.instrument.measurement import ONE_FRAME_S, BiasTerm, Linearised, LinkMeasurement
from svmdist.kinematics.robot_state import RobotState
from svmdist.transforms import Array, inverse_right_jacobian

TOOL_SPEED_M_S = 0.05  # standard deviation along each axis, without joints
MOTION_STD = 0.1  # over the motion by the joints: how late something is, is known to a tenth
TINY_M = 1e-9  # stands in for a deviation of zero
MIN_OBSERVABLE = 0.2  # share of parameters' variance along a direction that measurements remove
TURN = slice(3, 6)  # of a state: a rotation vector
MAX_ITERATIONS = 12
TOLERANCE = 1e-2  # of a standard deviation: a step of less has converged


def linearise(measurement: LinkMeasurement, link: CorrectedLink) -> Linearised:
    """A measurement about its link's pose, which goes on to the instant that it shows."""
    found, delay_s = measurement.linearise(link.T_camera_link), measurement.delay_s
    residual, biases = found.residual, found.biases
    if delay_s != 0.0:
        residual = residual - found.H @ link.velocity * delay_s
        std_m = (MOTION_STD * float(np.linalg.norm(link.velocity[:3])) or TOOL_SPEED_M_S) * abs(delay_s)
        biases = *biases, BiasTerm("motion since the stamp", std_m * found.H[:, :3], ONE_FRAME_S)
    return replace(found, residual=residual, H=found.H @ link.derivative, biases=biases)


class ErrorState:
    """The correction, its error state's covariance `P` with that of the bias states behind it, and their mean."""

    def __init__(self, model: ErrorModel) -> None:
        self.model = model
        self.correction = Correction(np.zeros(model.size), np.eye(3), np.zeros(3))
        self.P: Array = np.zeros((model.size, model.size))
        self.bias_mean: Array = np.zeros(0)
        self._bias_slices: dict[str, slice] = {}
        self._correlation_times_s: Array = np.zeros(0)
        self._robot: RobotState | None = None
        self._links: CorrectedLinks | None = None

    @property
    def robot(self) -> RobotState:
        """The robot's state now; raises ValueError before the first one."""
        if self._robot is None:
            raise ValueError("the filter knows no joints yet: predict comes first")
        return self._robot

    def go_to(self, robot: RobotState) -> float | None:
        """Take over the robot's state, joints at the corrected time; gives the s that have passed, None at first."""
        before, self._robot = self._robot, robot.shifted(float(self.correction.x[self.model.time_offset]))
        self._links = None
        return None if before is None else max(0.0, (robot.stamp_ns - before.stamp_ns) / 1e9)

    def start(self) -> None:
        """Start from nominal kinematics with the covariance of the profile, without biases of measurements."""
        self.correction = self.model.no_correction(self.robot)
        self.P, self.bias_mean = self.model.prior(self.robot), np.zeros(0)
        self._bias_slices, self._correlation_times_s = {}, np.zeros(0)
        for name, covariance in self.model.prior_cross_covariances(self.robot).items():
            size, at = self.model.size, self._append(BiasTerm(name, covariance))
            self.P[:size, at], self.P[at, :size] = covariance, covariance.T

    def retracted(self, x: Array) -> ErrorState:
        """The state after a step of error state and biases, shape (n,); the covariance stays."""
        there = copy(self)
        there.retract(x)
        return there

    def retract(self, x: Array) -> None:
        """Take a step of error state and biases, shape (n,), into correction and mean."""
        size = self.model.size
        self.correction, self.bias_mean = self.correction.retract(x[:size]), self.bias_mean + x[size:]

    def update_covariance(self, H: Array, R: Array) -> None:
        """The covariance after measurements of derivative H, (m, n), and noise R, (m, m), in Joseph's form."""
        HP = H @ self.P
        K = np.asarray(np.linalg.solve(HP @ H.T + R, HP).T)
        keep = np.eye(len(self.P)) - K @ H
        P = keep @ self.P @ keep.T + K @ R @ K.T
        self.P = 0.5 * (P + P.T)

    def augment_state(self, parts: Sequence[Linearised]) -> None:
        """The first measurement of a kind, or by a calibration parameter, adds its bias, of variance one."""
        for bias in (bias for part in parts for bias in part.biases):
            if bias.name not in self._bias_slices:
                self._append(bias)

    def _append(self, bias: BiasTerm) -> slice:
        at, count = len(self.P), bias.jacobian.shape[-1]
        grown = np.eye(at + count)
        grown[:at, :at] = self.P
        self.P = grown
        self.bias_mean = np.append(self.bias_mean, np.zeros(count))
        self._correlation_times_s = np.append(self._correlation_times_s, np.full(count, bias.correlation_time_s))
        added = self._bias_slices[bias.name] = slice(at, at + count)
        return added

    def bias(self, name: str) -> float:
        """The mean of a bias of one number, in units of its deviation; 0 for one that is not there."""
        at = self._bias_slices.get(name)
        return 0.0 if at is None else float(self.bias_mean[at.start - self.model.size])

    def furthest_parameter(self) -> tuple[str, float, float, int]:
        """The calibration parameter furthest from its prior, how far, how far all are, along how many directions.

        Several that are each off a little may together be what no calibration allows: along the observable directions
        their means are compared with what these means would vary by under the prior.
        """
        model, x, places = self.model, self.correction.x, list(range(self.model.size)[self.model.lengths])
        names, std = ["a length of the chain"] * len(places), [max(model.error.length_std_m, TINY_M)] * len(places)
        for name, one in self._bias_slices.items():
            if np.isinf(self._correlation_times_s[one.start - model.size]):
                more = range(one.start, one.stop)
                names += [name] * len(more)
                std += [1.0] * len(more)
                places += more
        if not places:
            return "", 0.0, 0.0, 0
        mean = np.concatenate([x, self.bias_mean])[places] / std
        gained, directions = np.linalg.eigh(np.eye(len(places)) - self.P[np.ix_(places, places)] / np.outer(std, std))
        is_observable = gained > MIN_OBSERVABLE
        off = np.abs(directions.T @ mean)[is_observable] / np.sqrt(gained[is_observable])
        most = int(np.argmax(np.abs(mean)))
        return names[most], float(abs(mean[most])), float(off.max(initial=0.0)), len(off)

    def propagate(self, elapsed_s: float) -> None:
        """Time passes: the correction drifts, biases fade towards their prior, of variance one."""
        keep = np.exp(-elapsed_s / self._correlation_times_s)
        keep_error, added_error = self.model.propagation(elapsed_s)
        factor, added = np.append(keep_error, keep), np.append(added_error, 1.0 - keep**2)
        self.P = factor[:, None] * self.P * factor + np.diag(added)
        self.bias_mean = keep * self.bias_mean
        self.correction = replace(self.correction, x=keep_error * self.correction.x)

    def link(self, name: str | None) -> CorrectedLink:
        """A link under the correction; None is the tool. Computed once for a robot's state and a correction."""
        if self._links is None or self._links.correction is not self.correction:
            self._links = CorrectedLinks(self.model, self.robot, self.correction)
        return self._links.link(name)

    def linearise(self, measurements: Sequence[LinkMeasurement]) -> list[Linearised]:
        """The measurements about the present state."""
        return [linearise(measurement, self.link(measurement.link)) for measurement in measurements]

    def full_jacobian(self, parts: Sequence[Linearised]) -> Array:
        """The derivative of the residuals, one below the other, by the whole state, shape (m, n)."""
        H = np.zeros((sum(len(part.residual) for part in parts), len(self.P)))
        at = 0
        for part in parts:
            rows = slice(at, at + len(part.residual))
            H[rows, : self.model.size] = part.H
            for bias in part.biases:
                if bias.name in self._bias_slices:  # a start is linearised without biases of its own
                    H[rows, self._bias_slices[bias.name]] += bias.jacobian
            at = rows.stop
        return H


@dataclass(frozen=True, slots=True)
class Solution:
    """The most probable change x of the state, derivatives and noise there, and statistics per measurement."""

    x: Array
    H: Array
    R: Array
    innovations: Array  # normalised squares against prior and noise
    residuals: Array  # those that are left against noise alone
    weights: Array  # of Student's t
    nis: float  # the square of all of them together
    has_converged: bool


def most_probable(
    state: ErrorState,
    measurements: Sequence[LinkMeasurement],
    x: Array,
    *,
    is_robust: bool = True,
    is_tracking: bool = False,
) -> Solution | None:
    """The state that prior and heavy-tailed measurements make the most probable, from x; None where one is unseen.

    A tracked measurement is weighed by the worse of its first innovation and its last residual: an outlier
    remains one where biases and calibration parameters would fit it.
    """
    P, size = state.P, state.model.size
    degrees = np.array([len(measurement.covariance) for measurement in measurements])
    at_row = np.repeat(np.arange(len(degrees)), degrees)  # which measurement
    begins, own = np.cumsum(degrees) - degrees, at_row[:, None] == at_row
    noise = np.zeros(own.shape)
    noise[own] = np.concatenate([np.ravel(measurement.covariance) for measurement in measurements])
    places = {measurement.name: at for at, measurement in enumerate(measurements)}
    rests = [[places[name] for name in measurement.rests_on if name in places] for measurement in measurements]
    certainty, deviations, moved = np.linalg.inv(noise), np.sqrt(np.diag(P) + 1e-18), np.inf
    weights, first = np.ones(len(degrees)), np.zeros(0)
    found: Solution | None = None
    for _ in range(MAX_ITERATIONS):
        there = state.retracted(x)
        parts = there.linearise(measurements)
        there_H = state.full_jacobian(parts)
        residual = np.concatenate([part.residual for part in parts]) - there_H[:, size:] @ there.bias_mean
        H = by_state(there_H, x)
        if not (np.isfinite(residual).all() and np.isfinite(H).all()):
            return None
        innovation = residual + H @ x
        # Solved with a unit-free H P: the units of the state differ by orders of magnitude.
        HP = H @ P
        S = HP @ H.T
        of_rows = innovation * np.linalg.solve(np.where(own, S, 0.0) + noise, innovation)
        innovations = np.add.reduceat(of_rows, begins)
        residuals = np.add.reduceat(residual * (certainty @ residual), begins)
        first = first if len(first) else innovations
        before = first if is_tracking else innovations
        if is_robust:
            weights = student_weight(np.maximum(before, residuals), degrees)
            for at, others in enumerate(rests):
                if others:
                    weights[at] = min(weights[at], weights[others].max())
        R = noise / weights[at_row]
        solved = np.linalg.solve(S + R, np.column_stack([HP, innovation]))
        step = np.asarray(solved[:, :-1].T @ innovation - x, np.float64)
        # In deviations of the prior, and of what is measured: a prior that knows nothing has large ones.
        longer = float(max(np.max(np.abs(step) / deviations), np.max(np.abs(H @ step) / np.sqrt(np.diag(R)))))
        if longer > moved:  # it swings: half of the way
            step, longer = 0.5 * step, 0.5 * longer
        nis = float(innovation @ solved[:, -1])
        found = Solution(x + step, there_H, R, before, residuals, weights, nis, longer < TOLERANCE)
        if found.has_converged:
            break
        x, moved = x + step, longer
    return found


def by_state(H: Array, x: Array) -> Array:
    """Derivatives by a state x, (m, n), of those by what is added to it there."""
    if not x[TURN].any():
        return H
    by_x = H.copy()
    # A change of its rotation vector turns about another axis: by the left Jacobian, J_l(v) = J_r(-v).
    by_x[:, TURN] = H[:, TURN] @ np.linalg.inv(inverse_right_jacobian(-x[TURN]))
    return by_x


def robust_cost(found: Solution, measurements: Sequence[LinkMeasurement]) -> float:
    """Minus twice the logarithm of prior and heavy-tailed likelihood at a solution, but for constants."""
    fits = zip(found.residuals.tolist(), measurements, strict=True)
    of_prior = found.nis - float(found.weights @ found.residuals)
    return of_prior + sum(heavy_tailed(square, seen.covariance) for square, seen in fits)


def evidence(found: Solution, P: Array, measurements: Sequence[LinkMeasurement]) -> float:
    """Minus twice the logarithm of the measurements' probability under a prior (Laplace's approximation)."""
    logdet = np.linalg.slogdet(found.H @ P @ found.H.T + found.R)[1] - np.linalg.slogdet(found.R)[1]
    return robust_cost(found, measurements) + float(logdet)


def heavy_tailed(square: float, covariance: Array) -> float:
    """Minus twice the logarithm of Student's density, but for a constant."""
    size = len(covariance)
    return (NU + size) * float(np.log1p(square / NU)) + float(np.linalg.slogdet(covariance)[1])
