"""The first frames solved as a batch: where to linearise before anything is known (Levenberg–Marquardt)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from svmdist.estimation.filter.correction import Correction, ErrorModel
from svmdist.estimation.filter.linearisation import Linearised, linearise
from svmdist.estimation.filter.measurements import LinkMeasurement
from svmdist.estimation.gate import chi_square_bound
from svmdist.kinematics.robot_state import RobotState
from svmdist.transforms import Array, skew

WINDOW_SOLVES = (1, 2, 3, 5, 8, 12, 20)
"""Numbers of frames after which a young filter solves for all of them anew."""
DEPTH_STARTS_M = (0.0, 0.03, -0.03)
"""The batch also starts from other depths, the least observable of all at first: a working range's half."""
DEPTH_START_COUNT = 3
"""Up to so many frames it does; later the last solution is a start that needs no others."""
MAX_STEPS = 20
Loss = Callable[[float], tuple[float, float]]
"""Of a squared deviation over the gate's bound: cost over the bound, and weight."""


@dataclass(frozen=True, slots=True)
class MeasurementsAt:
    """The measurements of one frame, and the robot's state there."""

    robot: RobotState
    measurements: tuple[LinkMeasurement, ...]


@dataclass(frozen=True, slots=True)
class _Solution:
    """Normal equations of a window at a correction."""

    cost: float
    gradient: Array
    information: Array
    correction: Correction


class Window:
    """The first frames of a filter that starts at `anchor_m`, shape (3,), with a prior covariance (n, n)."""

    def __init__(self, model: ErrorModel, anchor_m: Array, prior: Array) -> None:
        self._model = model
        self._anchor_m = anchor_m
        self._prior = prior
        self._prior_information = np.asarray(np.linalg.inv(prior + 1e-14 * np.eye(len(prior))), np.float64)
        self._frames: list[MeasurementsAt] = []

    def __len__(self) -> int:
        return len(self._frames)

    def add(self, frame: MeasurementsAt) -> None:
        """Keep what one frame showed."""
        self._frames.append(frame)

    def solve(self, start: Correction) -> Correction | None:
        """The correction that fits prior and frames best, from the start and from other depths.

        From afar every residual is beyond the gate, and Huber's loss draws it in; a wild detection it would let pull
        for ever, so that a loss without a pull far out decides.
        """
        depths_m = DEPTH_STARTS_M if len(self) <= DEPTH_START_COUNT else (0.0,)
        solutions = [self._descend(start, geman_mcclure)]
        for depth_m in depths_m:
            shift_m = start.shift_m + np.array([0.0, 0.0, depth_m])
            near = self._descend(Correction(shift_m, start.turn, start.q_offset), huber)
            solutions.append(self._descend(near.correction, geman_mcclure))
        best = min(solutions, key=lambda solution: solution.cost)
        return best.correction if np.isfinite(best.cost) else None

    def prior_at(self, at: Correction) -> Array:
        """The prior's covariance in the error state about a correction, shape (n, n)."""
        back = np.linalg.inv(_tangent(at))
        return np.asarray(back @ self._prior @ back.T)

    def step_to_prior(self, at: Correction) -> Array:
        """The error state about a correction that leads to the prior's mean, shape (n,)."""
        return np.asarray(-np.linalg.solve(_tangent(at), at.vector()))

    def linearised(
        self, at: Correction, loss: Loss
    ) -> Iterator[tuple[MeasurementsAt, list[tuple[LinkMeasurement, Linearised, float]]]]:
        """Every frame's measurements about a correction with weights; what is out of sight is left out."""
        names = {measurement.link for frame in self._frames for measurement in frame.measurements}
        links = self._model.links(names, [frame.robot for frame in self._frames], at, self._anchor_m)
        for index, frame in enumerate(self._frames):
            parts = []
            for measurement in frame.measurements:
                link = links[measurement.link][index]
                part = linearise(measurement, link.T_camera_link, link.derivative)
                if part.is_finite:
                    parts.append((measurement, part, loss(_deviation(part))[1]))
            yield frame, parts

    def _descend(self, start: Correction, loss: Loss) -> _Solution:
        damping = 1e-4
        solution = self._normal(start, loss)
        for _ in range(MAX_STEPS):
            if not np.isfinite(solution.cost):
                break
            damped = solution.information + damping * np.diag(np.diag(solution.information))
            step = np.asarray(np.linalg.solve(damped, solution.gradient), np.float64)
            trial = self._normal(solution.correction.retracted(step), loss)
            if trial.cost <= solution.cost:
                gain = solution.cost - trial.cost
                solution, damping = trial, max(0.1 * damping, 1e-9)
                if gain < 1e-3:
                    break
            else:
                damping *= 10.0
        return solution

    def _normal(self, at: Correction, loss: Loss) -> _Solution:
        """Cost, gradient and information of prior and window at a correction."""
        state, A = at.vector(), _tangent(at)
        information = A.T @ self._prior_information @ A
        gradient = -A.T @ self._prior_information @ state
        cost = float(state @ self._prior_information @ state)
        for frame, parts in self.linearised(at, loss):
            if len(parts) < len(frame.measurements):
                cost = np.inf
            for _, part, weight in parts:
                W = np.linalg.inv(part.covariance)
                cost += chi_square_bound(len(part.residual)) * loss(_deviation(part))[0]
                information += weight * part.H.T @ W @ part.H
                gradient += weight * part.H.T @ W @ part.residual
        return _Solution(cost, gradient, information, at)


def _tangent(at: Correction) -> Array:
    """Derivative of the correction's vector by the error state about it, shape (n, n), to first order in the turn."""
    state = at.vector()
    A = np.eye(len(state))
    A[3:6, 3:6] -= 0.5 * skew(state[3:6])
    return A


def huber(deviation: float) -> tuple[float, float]:
    """Squares within the bound, straight on beyond it (Huber 1964)."""
    root = float(np.sqrt(deviation))
    return (deviation, 1.0) if deviation <= 1.0 else (2.0 * root - 1.0, 1.0 / root)


def geman_mcclure(deviation: float) -> tuple[float, float]:
    """Squares near zero, bounded far out (Geman and McClure 1987); half the bound's full height at four bounds."""
    scaled = 0.25 * deviation
    return deviation / (1.0 + scaled), 1.0 / (1.0 + scaled) ** 2


def _deviation(part: Linearised) -> float:
    """The residual's normalised square over the gate's bound."""
    squared = float(part.residual @ np.linalg.solve(part.covariance, part.residual))
    return squared / chi_square_bound(len(part.residual))
