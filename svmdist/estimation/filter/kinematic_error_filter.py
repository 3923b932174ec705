"""An error-state Kalman filter over what kinematics get wrong: the camera-to-base transform, and joint offsets.

`correction` holds the state. What a measurement gets wrong again and again (shading beside an edge, a part that
jaws hide) would pass for knowledge if it were averaged as noise: each kind of measurement has a Gauss–Markov bias
in the state (Gelb 1974, "Applied Optimal Estimation", sec. 3.8).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from svmdist.estimation.filter.correction import Correction, ErrorModel
from svmdist.estimation.filter.linearisation import Linearised, block_diagonal
from svmdist.estimation.filter.measurement import LinkMeasurement
from svmdist.estimation.filter.state import ErrorState
from svmdist.estimation.filter.window import MeasurementsAt, Window
from svmdist.estimation.gate import GatingResult, chi_square_bound
from svmdist.kinematics.dh import DHChain
from svmdist.kinematics.robot_state import RobotState
from svmdist.kinematics.shaft_axis import shaft_of
from svmdist.profile import KinematicError
from svmdist.results import ToolPose
from svmdist.settings.filter import FilterSettings
from svmdist.transforms import Array

DEFAULT = FilterSettings()
SETTLED = 1e-3
"""Of its standard deviation: an element of the state that moves by less has come to rest."""


@dataclass(frozen=True, slots=True)
class _MostProbable:
    """The most probable change x of the state, with derivatives, noise and gain there, and its squared deviation.

    `nis` is xᵀ P⁻¹ x + rᵀ R⁻¹ r at its minimum: what prior and measurements have to give way, together.
    """

    x: Array
    H: Array
    R: Array
    K: Array
    nis: float


class KinematicErrorFilter:
    """Estimates the error of nominal kinematics; `predict` once per frame, then `update` with its measurements.

    The state is the error state of `ErrorModel`, then the biases of measurements in units of their deviations.
    """

    def __init__(self, chain: DHChain, error: KinematicError, settings: FilterSettings = DEFAULT) -> None:
        self._settings = settings
        self._shaft = shaft_of(chain)
        self._model = ErrorModel(chain, error)
        self._state = ErrorState(self._model)
        self._rejections = 0

    @property
    def covariance(self) -> Array:
        """Covariance of the error state, shape (n, n)."""
        return self._state.P[: self._model.size, : self._model.size]

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
            self._state.propagate(max(0.0, (robot.stamp_ns - before) / 1e9))

    def update(self, measurements: Sequence[LinkMeasurement]) -> tuple[GatingResult, ...]:
        """Take up what the image shows, all at once; tells what passed the gate.

        An iterated update: Gauss–Newton on the prior and all accepted residuals (Bell and Cathey 1993).
        """
        self._state.augment_state(measurements)
        parts = self._state.linearise(measurements)
        results = tuple(self._gate(*pair) for pair in zip(measurements, parts, strict=True))
        accepted = [index for index, result in enumerate(results) if result.is_accepted]
        if accepted:
            self._rejections = 0
            self._correct([measurements[index] for index in accepted], [parts[index] for index in accepted])
            self._keep_in_window(measurements)
        elif measurements:
            self._rejections += 1
            if self._rejections >= self._settings.max_rejections:
                self._start()
        return results

    def tool_pose(self) -> ToolPose:
        """The corrected pose of the tool and its covariance."""
        tool = self._state.link(None)
        covariance = tool.derivative @ self.covariance @ tool.derivative.T
        return ToolPose(tool.T_camera_link, covariance, self.shaft_axis())

    def corrected_joints(self) -> Array:
        """Reported joints with the offsets found, shape (n_joints,)."""
        return self._model.joints(self._state.robot, self._state.correction)

    def shaft_axis(self) -> Array:
        """The shaft's direction towards the tip in the camera frame, shape (3,); the tool's x without a shaft."""
        if self._shaft is None:
            return np.asarray(self._state.link(None).T_camera_link[:3, 0])
        return np.asarray(self._state.link(self._shaft.link).T_camera_link[:3, :3] @ self._shaft.axis)

    def _start(self) -> None:
        prior = self._state.start()
        self._window = Window(self._model, self._state.anchor_m, prior, self._settings)
        self._rejections = 0

    def _gate(self, measurement: LinkMeasurement, part: Linearised) -> GatingResult:
        """Whether some state near the present one explains a measurement.

        Centimetres off, a camera is far from linear, and a derivative taken there belittles what a state can explain:
        what fails is judged again at the state that it makes the most probable.
        """
        size, nis = len(part.residual), np.inf
        if part.is_finite:
            H = self._state.full_jacobian([measurement], [part])
            innovation = part.residual - H[:, self._model.size :] @ self._state.bias_mean
            nis = float(innovation @ np.linalg.solve(H @ self._state.P @ H.T + part.noise, innovation))
        bound = chi_square_bound(size, self._settings.gate_z)
        if nis > bound:
            found = self._most_probable([measurement], [part])
            nis = nis if found is None else min(nis, found.nis)
        return GatingResult(measurement.name, nis, size, nis <= bound)

    def _correct(self, measurements: Sequence[LinkMeasurement], parts: Sequence[Linearised]) -> None:
        """Go to the most probable state; covariance in Joseph's form at the last linearisation."""
        found = self._most_probable(measurements, parts)
        if found is not None:
            self._state.retract(found.x)
            self._state.update_covariance(found.K, found.H, found.R)

    def _most_probable(
        self, measurements: Sequence[LinkMeasurement], parts: Sequence[Linearised]
    ) -> _MostProbable | None:
        """The state that measurements make the most probable; None where no start leads to one that shows them all.

        `parts` are the measurements about the present state.
        """
        size = sum(len(part.residual) for part in parts)
        bound = chi_square_bound(size, self._settings.gate_z)
        best = self._descend(measurements, np.zeros(len(self._state.P)), parts)
        if best is not None and best.nis <= bound:
            return best
        for start in self._other_depths():
            found = self._descend(measurements, start)
            if found is not None and (best is None or found.nis < best.nis):
                best = found
            if best is not None and best.nis <= bound:
                break
        return best

    def _other_depths(self) -> Iterator[Array]:
        """While depth is as good as unknown, the most probable states at other depths.

        Of robots that err by centimetres some report their tool behind the camera, where nothing can be seen.
        """
        tool = self._state.link(None)
        along = self._state.P[:, : self._model.size] @ tool.derivative[2]
        variance_m2 = float(tool.derivative[2] @ along[: self._model.size])
        if variance_m2 > self._settings.depth_unknown_std_m**2:
            for depth_m in self._settings.depth_candidates_m:
                yield along * (depth_m - tool.T_camera_link[2, 3]) / variance_m2

    def _descend(
        self, measurements: Sequence[LinkMeasurement], x: Array, parts: Sequence[Linearised] | None = None
    ) -> _MostProbable | None:
        """x ← K (r + H x) until x rests; None where a measurement's link leaves the view.

        In this form neither P nor the information has to be inverted: P is nearly singular where a joint's error is
        as good as known. `parts` are the measurements about the state after x, where they are known.
        """
        P, size = self._state.P, self._model.size
        R = block_diagonal([measurement.covariance for measurement in measurements])
        deviations = np.sqrt(np.diag(P) + 1e-18)
        there = self._state
        for _ in range(self._settings.max_iterations):
            if parts is None:
                there = self._state.retracted(x)
                parts = there.linearise(measurements)
            if not all(part.is_finite for part in parts):
                return None
            H = self._state.full_jacobian(measurements, parts)
            residual = np.concatenate([part.residual for part in parts]) - H[:, size:] @ there.bias_mean
            innovation = residual + H @ x
            # Solved with a unit-free H P: the units of the state differ by orders of magnitude.
            HP = H @ P
            solved = np.linalg.solve(HP @ H.T + R, np.column_stack([HP, innovation]))
            K = np.asarray(solved[:, :-1].T, np.float64)
            step = K @ innovation - x
            x, parts = x + step, None
            if float(np.max(np.abs(step) / deviations)) < SETTLED:
                break
        return _MostProbable(x, H, R, K, float(innovation @ solved[:, -1]))

    def _keep_in_window(self, measurements: Sequence[LinkMeasurement]) -> None:
        """While the filter is young, keep what it was given, and solve for all of it anew at growing intervals.

        The first frames are linearised tens of millimetres off, where a camera is far from linear; a Kalman
        filter can never take back a linearisation, a batch can.
        """
        solves = self._settings.window_solves
        if len(self._window) < max(solves):
            self._window.add(MeasurementsAt(self._state.robot, tuple(measurements)))
            if len(self._window) in solves:
                solved = self._window.solve(self._state.correction)
                if solved is not None:
                    self._replay(solved)

    def _replay(self, at: Correction) -> None:
        """Filter the window's frames once more, all linearised at the batch's solution.

        The batch takes the biases of measurements for noise; the filter knows that they last.
        """
        size, state = self._model.size, self._state
        state.reset_bias_states(self._window.prior_at(at))
        # What is to be added to `at`: at first all the way back to no correction.
        to_correction = self._window.step_to_prior(at)
        stamp_ns = None
        for frame in self._window.linearised(at):
            if stamp_ns is not None:
                state.propagate(max(0.0, (frame.robot.stamp_ns - stamp_ns) / 1e9))
            stamp_ns = frame.robot.stamp_ns
            if not frame.parts:
                continue
            state.augment_state(frame.measurements)
            H = state.full_jacobian(frame.measurements, frame.parts)
            R = block_diagonal(
                [part.noise / weight for part, weight in zip(frame.parts, frame.weights, strict=True)]
            )
            x = np.concatenate([to_correction, state.bias_mean])
            HP = H @ state.P
            K = np.asarray(np.linalg.solve(HP @ H.T + R, HP).T, np.float64)
            x = x + K @ (np.concatenate([part.residual for part in frame.parts]) - H @ x)
            state.update_covariance(K, H, R)
            to_correction, state.bias_mean = x[:size], x[size:]
        state.correction = at.retract(to_correction)
