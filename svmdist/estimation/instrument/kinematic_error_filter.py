"""The state that measurements make the most probable: Gauss–Newton on prior and residuals (Bell and Cathey 1993).

A camera is far from linear where a state is centimetres off, so that one step of a Kalman filter does not get there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from svmdist.estimation.instrument.consistency import (
    USUAL_CONSTANT_DEVIATIONS,
    WINDOW_SOLVES,
    Consistency,
    GatingResult,
    chi_square_bound,
)
from svmdist.estimation.instrument.corrected_links import Correction
from svmdist.estimation.instrument.error_model import ErrorModel
from svmdist.estimation.instrument.measurement import LinkMeasurement, SharedBias
from svmdist.estimation.instrument.state import ErrorState, Linearised, block_diagonal
from svmdist.estimation.instrument.window import Window
from svmdist.kinematics import DHChain, shaft_of
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile.robot import KinematicError
from svmdist.profile.settings import FilterSettings
from svmdist.results import ToolPose, across_std_rad
from svmdist.transforms import Array

MAX_ITERATIONS = 8  # gauss–Newton steps; two or three are usual, more where frames are cm off
DEPTH_UNKNOWN_STD_M = 0.01  # standard deviation of the tool's depth above which it counts as unknown
MAX_REJECTIONS = 8  # frames in a row with nothing accepted: the filter has lost the arm and restarts
MAX_CONTRADICTIONS = 25  # frames in a row: a filter that went astray recovers by starting anew

SETTLED, NEARLY_SETTLED = 1e-3, 0.1
"""Of its standard deviation: an element of the state that moves by less has come to rest, or will with a next step."""


@dataclass(frozen=True, slots=True)
class MostProbable:
    """The most probable change x of the state, with derivatives, noise and gain there, and its squared deviation."""

    x: Array
    H: Array
    R: Array
    K: Array
    nis: float
    is_settled: bool


def most_probable(
    state: ErrorState,
    measurements: Sequence[LinkMeasurement],
    parts: Sequence[Linearised],
    settings: FilterSettings,
) -> MostProbable | None:
    """The state that measurements make the most probable; None where no start leads to one that shows them all."""
    size = sum(len(part.residual) for part in parts)
    bound = chi_square_bound(size, settings.gate_z)
    best = _descend(state, measurements, np.zeros(len(state.P)), parts)
    if best is not None and best.nis <= bound:
        return best
    for start in _other_depths(state, settings):
        found = _descend(state, measurements, start)
        if found is not None and (best is None or found.nis < best.nis):
            best = found
        if best is not None and best.nis <= bound:
            break
    return best


def _other_depths(state: ErrorState, settings: FilterSettings) -> Iterator[Array]:
    """While depth is as good as unknown, the most probable states at other depths."""
    tool = state.link(None)
    along = state.P[:, : state.model.size] @ tool.derivative[2]
    variance_m2 = float(tool.derivative[2] @ along[: state.model.size])
    if variance_m2 > DEPTH_UNKNOWN_STD_M**2:
        for depth_m in settings.depth_candidates_m:
            yield along * (depth_m - tool.T_camera_link[2, 3]) / variance_m2


def _descend(
    state: ErrorState,
    measurements: Sequence[LinkMeasurement],
    x: Array,
    parts: Sequence[Linearised] | None = None,
) -> MostProbable | None:
    """x ← K (r + H x) until x rests; None where a link leaves the view. P may be nearly singular."""
    P, size = state.P, state.model.size
    R = block_diagonal([measurement.covariance for measurement in measurements])
    deviations = np.sqrt(np.diag(P) + 1e-18)
    there, moved = state, np.inf
    for _ in range(MAX_ITERATIONS):
        if parts is None:
            there = state.retracted(x)
            parts = there.linearise(measurements)
        if not all(part.is_finite for part in parts):
            return None
        H = state.full_jacobian(parts)
        residual = np.concatenate([part.residual for part in parts]) - H[:, size:] @ there.bias_mean
        innovation = residual + H @ x
        # Solved with a unit-free H P: the units of the state differ by orders of magnitude.
        HP = H @ P
        solved = np.linalg.solve(HP @ H.T + R, np.column_stack([HP, innovation]))
        K = np.asarray(solved[:, :-1].T, np.float64)
        step = K @ innovation - x
        longer = float(np.max(np.abs(step) / deviations))
        if longer > moved:  # it swings: half of the way
            step, longer = 0.5 * step, 0.5 * longer
        x, parts, moved = x + step, None, longer
        if moved < SETTLED:
            break
    return MostProbable(x, H, R, K, float(innovation @ solved[:, -1]), moved < NEARLY_SETTLED)


DEFAULT = FilterSettings()


class KinematicErrorFilter:
    """Estimates the error of nominal kinematics; `predict` once per frame, then `update` with its measurements."""

    def __init__(self, chain: DHChain, error: KinematicError, settings: FilterSettings = DEFAULT) -> None:
        self._settings = settings
        self._shaft = shaft_of(chain)
        self._model = ErrorModel(chain, error)
        self._state = ErrorState(self._model)
        self._rejections = self._contradictions = 0
        self._age_s = 0.0
        self.consistency = Consistency(settings)

    @property
    def covariance(self) -> Array:
        """Covariance of the error state, shape (n, n)."""
        return self._state.P[: self._model.size, : self._model.size]

    @property
    def robot(self) -> RobotState:
        """The robot's state that was predicted from: its joints at the time that the correction says."""
        return self._state.robot

    @property
    def correction(self) -> Correction:
        """What is added to nominal kinematics now."""
        return self._state.correction

    def predict(self, robot: RobotState) -> None:
        """Go on to the robot's state at a new instant; raises ValueError where that does not know the camera."""
        before = None if self._state.is_new else self._state.robot.stamp_ns
        self._state.go_to(robot)
        if before is None:
            self._start()
        else:
            elapsed_s = max(0.0, (robot.stamp_ns - before) / 1e9)
            self._age_s += elapsed_s
            self._state.propagate(elapsed_s)

    def update(self, measurements: Sequence[LinkMeasurement]) -> tuple[GatingResult, ...]:
        """Take up what the image shows by one iterated update; gives what passed the gate."""
        parts = self._state.linearise(measurements)
        self._state.augment_state(parts)
        results = [self._gate(*pair) for pair in zip(measurements, parts, strict=True)]
        # What passes alone may contradict the rest: the one that fits least goes until the others agree.
        while accepted := [index for index, result in enumerate(results) if result.is_accepted]:
            chosen = [measurements[index] for index in accepted], [parts[index] for index in accepted]
            if self._correct(*chosen):
                break
            worst = max(accepted, key=lambda index: results[index].nis / results[index].degrees_of_freedom)
            results[worst] = replace(results[worst], is_accepted=False)
        self.consistency.add(self._state.robot.stamp_ns, results)
        self.consistency.watch_constants(self._state.constants())
        self.consistency.watch_time_offset(
            self._state.correction.time_offset_s, self._model.time_offset_std_s(self._age_s)
        )
        self._contradictions = self._contradictions + 1 if self.consistency.contradiction else 0
        if accepted:
            self._rejections = 0
            self._keep_in_window(measurements)
        elif measurements:
            self._rejections += 1
        if self._contradictions >= MAX_CONTRADICTIONS:
            self._start()
            self.consistency.distrust(self._state.robot.stamp_ns)
        elif self._rejections >= MAX_REJECTIONS:
            self._start()
        return tuple(results)

    def update_scene(self, name: str, part: Linearised) -> GatingResult:
        """Take up a measurement of constants alone, of which no link is a part: the tissue's height by stereo."""
        state, size = self._state, len(part.residual)
        part = replace(part, H=np.zeros((size, self._model.size)))
        state.augment_state([part])
        innovation, S, H = state.innovation(part)
        nis = float(innovation @ np.linalg.solve(S, innovation))
        result = GatingResult(name, nis, size, nis <= chi_square_bound(size, self._settings.gate_z), name)
        if result.is_accepted:
            K = np.asarray(np.linalg.solve(S, H @ state.P).T, np.float64)
            state.retract(K @ innovation)
            state.update_covariance(K, H, part.noise)
        self.consistency.add(state.robot.stamp_ns, [result], of_tool=False)
        return result

    def constant(self, name: str) -> float:
        """What a constant of one number was found to be, in units of its deviation; 0 before it was measured."""
        return self._state.bias(name)

    def coupled(self, biases: Sequence[SharedBias]) -> tuple[Array, Array]:
        """Of what biases move by their derivatives, shape (3, k): covariance (3, 3), and that with the tool, (6, 3)."""
        part = Linearised(np.zeros(3), np.zeros((3, self._model.size)), tuple(biases), np.zeros((3, 3)))
        self._state.augment_state([part])
        G, P = self._state.full_jacobian([part]), self._state.P
        tool = self._state.link(None).derivative
        widening = self.consistency.widening
        return widening * G @ P @ G.T, widening * tool @ P[: self._model.size] @ G.T

    def tool_pose(self) -> ToolPose:
        """The corrected pose of the tool and its covariance."""
        tool, widening = self._state.link(None), self.consistency.widening
        covariance = widening * (tool.derivative @ self.covariance @ tool.derivative.T)
        return ToolPose(tool.T_camera_link, covariance, self.shaft_axis(), self._axis_std_rad())

    def corrected_joints(self) -> Array:
        """Reported joints at the corrected time, with offsets and play, shape (n_joints,)."""
        return self._model.joints(self._state.nominal, self._state.correction)

    def shaft_axis(self) -> Array:
        """The shaft's direction towards the tip in the camera frame, shape (3,); the tool's x without a shaft."""
        if self._shaft is None:
            return np.asarray(self._state.link(None).T_camera_link[:3, 0])
        return np.asarray(self._state.link(self._shaft.link).T_camera_link[:3, :3] @ self._shaft.axis)

    def _axis_std_rad(self) -> float | None:
        if self._shaft is None:
            return None
        turn = self._state.link(self._shaft.link).derivative[3:]
        covariance = self.consistency.widening * turn @ self.covariance @ turn.T
        return across_std_rad(covariance, self.shaft_axis())

    def _start(self) -> None:
        prior, with_constants = self._state.start()
        self._window = Window(self._model, self._state.anchor_m, prior, self._settings, with_constants)
        self._rejections = self._contradictions = 0
        self._age_s = 0.0
        self.consistency.clear()

    def _gate(self, measurement: LinkMeasurement, part: Linearised) -> GatingResult:
        """Whether a state near the present one explains a measurement, judged at the most probable one if need be."""
        size, nis = len(part.residual), np.inf
        if part.is_finite:
            innovation, S, _ = self._state.innovation(part)
            nis = float(innovation @ np.linalg.solve(S, innovation))
        bound = chi_square_bound(size, self._settings.gate_z)
        if nis > bound:
            found = most_probable(self._state, [measurement], [part], self._settings)
            nis = nis if found is None else min(nis, found.nis)
        return GatingResult(measurement.name, nis, size, nis <= bound, measurement.source)

    def _correct(self, measurements: Sequence[LinkMeasurement], parts: Sequence[Linearised]) -> bool:
        """Go to the most probable state, covariance in Joseph's form; False where there is none."""
        found = most_probable(self._state, measurements, parts, self._settings)
        bound = chi_square_bound(sum(len(part.residual) for part in parts), self._settings.gate_z)
        if found is None or not found.is_settled or found.nis > bound:
            return False
        self._state.retract(found.x)
        self._state.update_covariance(found.K, found.H, found.R)
        return True

    def _keep_in_window(self, measurements: Sequence[LinkMeasurement]) -> None:
        """While the filter is young, keep what it was given, and solve it anew as a batch at growing intervals."""
        if len(self._window) < max(WINDOW_SOLVES):
            self._window.add(self._state.robot, tuple(measurements))
            if len(self._window) in WINDOW_SOLVES:
                solved = self._window.solve(self._state.correction)
                if solved is not None:
                    self._take_solution(solved)

    def _take_solution(self, at: Correction) -> None:
        """Go on from the batch's solution, unless it asks constants to be what no user would state so wrongly."""
        before, far = copy(self._state), self._furthest_constant()
        self._replay(at)
        if self._furthest_constant() > max(far, USUAL_CONSTANT_DEVIATIONS):
            self._state = before

    def _furthest_constant(self) -> float:
        return max((abs(off) for _, off in self._state.constants()), default=0.0)

    def _replay(self, at: Correction) -> None:
        """Filter the window's frames once more, all linearised at the batch's solution."""
        size, state = self._model.size, self._state
        state.reset_bias_states(self._window.prior_at(at), self._window.prior_with_constants_at(at))
        # What is to be added to `at`: at first all the way back to no correction.
        to_correction = self._window.step_to_prior(at)
        stamp_ns = None
        for robot, parts, weights in self._window.linearised(at):
            if stamp_ns is not None:
                state.correction = at.retract(to_correction)
                state.propagate(max(0.0, (robot.stamp_ns - stamp_ns) / 1e9))
                play = state.model.columns.play
                to_correction[play] = state.correction.play - at.play
            stamp_ns = robot.stamp_ns
            if not parts:
                continue
            state.augment_state(parts)
            H = state.full_jacobian(parts)
            R = block_diagonal([part.noise / weight for part, weight in zip(parts, weights, strict=True)])
            x = np.concatenate([to_correction, state.bias_mean])
            HP = H @ state.P
            K = np.asarray(np.linalg.solve(HP @ H.T + R, HP).T, np.float64)
            x = x + K @ (np.concatenate([part.residual for part in parts]) - H @ x)
            state.update_covariance(K, H, R)
            to_correction, state.bias_mean = x[:size], x[size:]
        state.correction = at.retract(to_correction)
        state.go_to(state.robot)
