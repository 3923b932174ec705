"""An error-state Kalman filter over what kinematics get wrong: the camera-to-base transform, and joint offsets.

`correction` holds the state. What an measurement gets wrong again and again (shading beside an edge, a part that
jaws hide) would pass for knowledge if it were averaged as noise: each kind of measurement has a Gauss–Markov error
of its own in the state (Gelb 1974, "Applied Optimal Estimation", sec. 3.8).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from svmdist.estimation.filter.correction import Correction, ErrorModel
from svmdist.estimation.filter.linearisation import Linearised, block_diagonal
from svmdist.estimation.filter.measurements import LinkMeasurement
from svmdist.estimation.filter.state import ErrorState
from svmdist.estimation.filter.window import WINDOW_SOLVES, MeasurementsAt, Window, geman_mcclure
from svmdist.estimation.gate import chi_square_bound
from svmdist.estimation.instrument.pose import ToolPose
from svmdist.kinematics.dh import DHChain
from svmdist.kinematics.robot_state import RobotState
from svmdist.kinematics.shaft_axis import shaft_of
from svmdist.profile import KinematicError
from svmdist.transforms import Array

MAX_ITERATIONS = 8
DEPTHS_M = (0.05, 0.1, 0.2)
"""Where an endoscope's tool may be, about a factor of two apart."""
DEPTH_UNKNOWN_M = 0.01
MAX_REJECTIONS = 8
"""After as many frames in a row without an accepted measurement the filter has lost the arm and starts anew."""


@dataclass(frozen=True, slots=True)
class GatingResult:
    """What became of an measurement: its normalised innovation squared, and whether it passed the gate."""

    name: str
    nis: float
    size: int
    is_accepted: bool


@dataclass(frozen=True, slots=True)
class _Solved:
    """The most probable change x of the state, with derivatives, noise and gain there, and its squared deviation.

    `nis` is xᵀ P⁻¹ x + rᵀ R⁻¹ r at its minimum: what prior and measurements have to give way, together.
    """

    x: Array
    H: Array
    R: Array
    K: Array
    nis: float


class KinematicErrorFilter:
    """Estimates the error of believed kinematics; `predict` once a frame, then `update` with what was seen.

    The state is the error state of `ErrorModel`, then the measurements' own errors in units of their deviations.
    """

    def __init__(self, chain: DHChain, error: KinematicError) -> None:
        self._chain = chain
        self._model = ErrorModel(chain, error)
        self._state = ErrorState(self._model)
        self._rejections = 0

    @property
    def covariance(self) -> Array:
        """Covariance of the error state, shape (n, n)."""
        return self._state.P[: self._model.size, : self._model.size]

    @property
    def correction(self) -> Correction:
        """What is added to believed kinematics now."""
        return self._state.correction

    def predict(self, robot: RobotState) -> None:
        """Go on to the robot's state at a new instant; it must know where the camera is."""
        before, self._state.robot = self._state.robot, robot
        if before is None:
            self._start()
        else:
            self._state.propagate(max(0.0, (robot.stamp_ns - before.stamp_ns) / 1e9))

    def update(self, measurements: Sequence[LinkMeasurement]) -> tuple[GatingResult, ...]:
        """Take up what the image shows, all at once; tells what passed the gate.

        An iterated update: Gauss–Newton on the prior and all accepted residuals (Bell and Cathey 1993).
        """
        results = tuple(
            self._gate(*pair) for pair in zip(measurements, self._state.linearise(measurements), strict=True)
        )
        accepted = [o for o, result in zip(measurements, results, strict=True) if result.is_accepted]
        if accepted:
            self._rejections = 0
            self._iterate(accepted)
            self._keep_in_window(measurements)
        elif measurements:
            self._rejections += 1
            if self._rejections >= MAX_REJECTIONS:
                self._start()
        return results

    def tool_pose(self) -> ToolPose:
        """The corrected pose of the tool and its covariance."""
        tool = self._state.links({None})[None]
        covariance = tool.derivative @ self.covariance @ tool.derivative.T
        return ToolPose(tool.T_camera_link, covariance, self.shaft_axis())

    def corrected_joints(self) -> Array:
        """Believed joints with the offsets found, shape (n_joints,)."""
        return self._model.joints(self._state.now(), self._state.correction)

    def shaft_axis(self) -> Array:
        """The shaft's direction towards the tip in the camera frame, shape (3,); the tool's x without a shaft."""
        shaft = shaft_of(self._chain)
        if shaft is None:
            return np.asarray(self._state.links({None})[None].T_camera_link[:3, 0])
        return np.asarray(self._state.links({shaft.link})[shaft.link].T_camera_link[:3, :3] @ shaft.axis)

    def _start(self) -> None:
        prior = self._state.start()
        self._window = Window(self._model, self._state.anchor_m, prior)
        self._rejections = 0

    def _gate(self, measurement: LinkMeasurement, part: Linearised) -> GatingResult:
        """Whether some state near the present one explains an measurement.

        Centimetres off, a camera is far from linear, and a derivative taken there belittles what a state can explain:
        what fails is judged again at the state that it makes the most probable.
        """
        size, nis = len(part.residual), np.inf
        if part.is_finite:
            H = self._state.full_jacobian(measurement, part)
            innovation = part.residual - H[:, self._model.size :] @ self._state.bias_mean
            nis = float(innovation @ np.linalg.solve(H @ self._state.P @ H.T + part.noise, innovation))
        bound = chi_square_bound(size)
        if nis > bound:
            solved = self._most_probable([measurement])
            nis = nis if solved is None else min(nis, solved.nis)
        return GatingResult(measurement.name, nis, size, nis <= bound)

    def _iterate(self, measurements: Sequence[LinkMeasurement]) -> None:
        """Go to the most probable state; covariance in Joseph's form at the last linearisation."""
        solved = self._most_probable(measurements)
        if solved is None:
            return
        self._state.retract(solved.x)
        self._state.update_covariance(solved.K, solved.H, solved.R)

    def _most_probable(self, measurements: Sequence[LinkMeasurement]) -> _Solved | None:
        """The state that measurements make the most probable; None where no start leads to one that shows them all."""
        bound = chi_square_bound(sum(len(measurement.covariance) for measurement in measurements))
        best = None
        for start in self._starts():
            solved = self._descend(measurements, start)
            if solved is not None and (best is None or solved.nis < best.nis):
                best = solved
            if best is not None and best.nis <= bound:
                break
        return best

    def _starts(self) -> Iterator[Array]:
        """The present state; while depth is as good as unknown, also the most probable ones at other depths.

        Of robots that err by centimetres some believe their tool behind the camera, where nothing can be seen.
        """
        yield np.zeros(len(self._state.P))
        tool = self._state.links({None})[None]
        along = self._state.P[:, : self._model.size] @ tool.derivative[2]
        variance_m2 = float(tool.derivative[2] @ along[: self._model.size])
        if variance_m2 > DEPTH_UNKNOWN_M**2:
            for depth_m in DEPTHS_M:
                yield along * (depth_m - tool.T_camera_link[2, 3]) / variance_m2

    def _descend(self, measurements: Sequence[LinkMeasurement], x: Array) -> _Solved | None:
        """x ← K (r + H x) until x rests; None where an measurement's link leaves the view."""
        P, size = self._state.P, self._model.size
        R = block_diagonal([measurement.covariance for measurement in measurements])
        for _ in range(MAX_ITERATIONS):
            there = self._state.retracted(x)
            parts = there.linearise(measurements)
            if not all(part.is_finite for part in parts):
                return None
            H = np.concatenate([there.full_jacobian(*pair) for pair in zip(measurements, parts, strict=True)])
            residual = np.concatenate([part.residual for part in parts]) - H[:, size:] @ there.bias_mean
            innovation = residual + H @ x
            # Solved with a unit-free H P: the units of the state differ by orders of magnitude.
            S = H @ P @ H.T + R
            K = np.linalg.solve(S, H @ P).T
            step = K @ innovation - x
            x = x + step
            if float(np.max(np.abs(step) / np.sqrt(np.diag(P) + 1e-18))) < 1e-3:
                break
        return _Solved(x, H, R, K, float(innovation @ np.linalg.solve(S, innovation)))

    def _keep_in_window(self, measurements: Sequence[LinkMeasurement]) -> None:
        """While the filter is young, keep what it saw, and solve for all of it anew at growing intervals.

        The first frames are linearised tens of millimetres off, where a camera is far from linear; a Kalman
        filter can never take back a linearisation, a batch can.
        """
        if len(self._window) < WINDOW_SOLVES[-1]:
            self._window.add(MeasurementsAt(self._state.now(), tuple(measurements)))
            if len(self._window) in WINDOW_SOLVES:
                solved = self._window.solve(self._state.correction)
                if solved is not None:
                    self._replay(solved)

    def _replay(self, at: Correction) -> None:
        """Filter the window's frames once more, all linearised at the batch's solution.

        The batch takes the measurements' own errors for noise; the filter knows that they last.
        """
        size = self._model.size
        self._state.reset_bias_states(self._window.prior_at(at))
        # What is to be added to `at`: at first all the way back to no correction.
        to_correction = self._window.step_to_prior(at)
        stamp_ns = self._state.now().stamp_ns
        for index, (frame, parts) in enumerate(self._window.linearised(at, geman_mcclure)):
            if index > 0:
                self._state.propagate(max(0.0, (frame.robot.stamp_ns - stamp_ns) / 1e9))
            stamp_ns = frame.robot.stamp_ns
            for measurement, part, weight in parts:
                self._state.augment_state(measurement, part.bias_jacobian.shape[1])
                H, R = self._state.full_jacobian(measurement, part), part.noise / weight
                x = np.concatenate([to_correction, self._state.bias_mean])
                S = H @ self._state.P @ H.T + R
                K = np.asarray(np.linalg.solve(S, H @ self._state.P).T, np.float64)
                x = x + K @ (part.residual - H @ x)
                self._state.update_covariance(K, H, R)
                to_correction, self._state.bias_mean = x[:size], x[size:]
        self._state.correction = at.retracted(to_correction)
