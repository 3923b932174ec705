"""An error-state Kalman filter over what kinematics get wrong: the camera-to-base transform, and joint offsets.

The nominal state is the believed kinematics with corrections; the error state is small and flat, lives in
R^n and is reset to zero after each update (Solà 2017, "Quaternion kinematics for the error-state Kalman
filter", sec. 6). Joints that hold still err like a wrong base, so their errors are lumped into the camera-
to-base transform's (Richter et al. 2021). `docs/method.md` derives both and what can be observed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from svmdist.errors import KinematicsError, did_you_mean
from svmdist.estimation.observations import LinkObservation, pose_derivative
from svmdist.estimation.pose import ToolPose
from svmdist.kinematics.dh import DHChain, frame_transforms
from svmdist.kinematics.jacobian import pose_jacobian, row_index
from svmdist.profile import KinematicError
from svmdist.transforms import Array, rotation_of, rotation_vector, skew

GATE_Z = 3.09
"""Normal quantile of the gate: an observation less likely than 1 in 1,000 is rejected."""
MAX_ITERATIONS = 8
WINDOW_SOLVES = (1, 2, 3, 5, 8, 12, 20)
"""Numbers of frames after which a young filter solves for all of them anew."""
WINDOW_DEPTH_STARTS = 8
"""Up to so many frames the batch also starts from other depths: the least observable of all at first."""
MAX_WINDOW_STEPS = 20
MAX_REJECTIONS = 8
"""After as many frames in a row without an accepted observation the filter has lost the arm and starts anew."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """What became of an observation: its normalised innovation squared, and whether it passed the gate."""

    name: str
    nis: float
    size: int
    is_accepted: bool


@dataclass(frozen=True, slots=True)
class _Link:
    """The corrected pose of a link, shape (4, 4), and its derivative by the error state, shape (6, n)."""

    T_camera_link: Array
    derivative: Array


@dataclass(frozen=True, slots=True)
class _Moment:
    """Believed joints, shape (n_joints,), and `T_camera_base`, shape (4, 4), of one instant."""

    q: Array
    T_camera_base: Array


@dataclass(frozen=True, slots=True)
class Correction:
    """What is added to believed kinematics: a shift in m, a turn, shape (3, 3), and joint offsets."""

    shift_m: Array
    turn: Array
    q_offset: Array

    def moved(self, step: Array) -> Correction:
        """The correction after an error state, shape (n,), was found in it."""
        turn = rotation_of(step[3:6]) @ self.turn
        return Correction(self.shift_m + step[:3], turn, self.q_offset + step[6:])

    def vector(self) -> Array:
        """Shift, rotation vector and offsets, shape (n,)."""
        return np.concatenate([self.shift_m, rotation_vector(self.turn), self.q_offset])


@dataclass(frozen=True, slots=True)
class _Solution:
    """Normal equations of a window at a correction."""

    cost: float
    gradient: Array
    information: Array
    correction: Correction


class KinematicErrorFilter:
    """Estimates the error of believed kinematics; `predict` once a frame, then `update` with what was seen.

    The error state is (δp, δφ, δq): displacement in m and rotation vector in rad of everything behind the
    set-up joints, in the camera frame about an anchor point, and the offsets of the joints that move.
    """

    def __init__(self, chain: DHChain, error: KinematicError) -> None:
        self._chain = chain
        self._error = error
        names = chain.joint_names
        if error.first_moving_joint is not None and error.first_moving_joint not in names:
            raise KinematicsError(
                f"no joint {error.first_moving_joint} to be the first moving one:"
                f" {did_you_mean(error.first_moving_joint, names)}"
            )
        self._still_count = names.index(error.first_moving_joint) if error.first_moving_joint else 0
        is_revolute = np.array([row.joint == "revolute" for row in chain.rows if row.joint != "fixed"])
        self._joint_std = np.where(is_revolute, error.joint_std_rad, error.joint_std_m)
        moving = is_revolute[self._still_count :]
        self._drift = np.concatenate(
            [
                np.full(3, error.drift_m_per_sqrt_s),
                np.full(3, error.drift_rad_per_sqrt_s),
                np.where(moving, error.drift_rad_per_sqrt_s, error.drift_m_per_sqrt_s),
            ]
        )
        self._size = 6 + len(moving)
        self._P: Array = np.zeros((self._size, self._size))
        self._stamp_ns: int | None = None
        self._rejections = 0

    @property
    def covariance(self) -> Array:
        """Covariance of the error state, shape (n, n)."""
        return self._P

    @property
    def is_started(self) -> bool:
        """Whether there was a first `predict`."""
        return self._stamp_ns is not None

    def predict(self, stamp_ns: int, q: Array, T_camera_base: Array) -> None:
        """Go on to an instant with believed joints, shape (n_joints,), and `T_camera_base`, shape (4, 4)."""
        if self._stamp_ns is None:
            self._q, self._T_camera_base = q, T_camera_base
            self._start()
        else:
            elapsed_s = max(0.0, (stamp_ns - self._stamp_ns) / 1e9)
            self._q, self._T_camera_base = q, T_camera_base
            self._P = self._P + np.diag(self._drift**2 * elapsed_s)
        self._stamp_ns = stamp_ns

    def update(self, observations: Sequence[LinkObservation]) -> tuple[Verdict, ...]:
        """Take up what the image shows, all at once; tells what passed the gate.

        An iterated update: Gauss–Newton on the prior and all accepted residuals (Bell and Cathey 1993).
        """
        links = self._links({observation.link for observation in observations})
        verdicts = tuple(self._judge(observation, links[observation.link]) for observation in observations)
        accepted = [o for o, verdict in zip(observations, verdicts, strict=True) if verdict.is_accepted]
        if accepted:
            self._rejections = 0
            self._iterate(accepted)
            self._remember(observations)
        elif observations:
            self._rejections += 1
            if self._rejections >= MAX_REJECTIONS:
                self._start()
        return verdicts

    def tool_pose(self) -> ToolPose:
        """The corrected pose of the tool and its covariance."""
        tool = self._link(None)
        covariance = tool.derivative @ self._P @ tool.derivative.T
        return ToolPose(tool.T_camera_link, covariance, self.shaft_axis())

    def corrected_joints(self) -> Array:
        """Believed joints with the offsets found, shape (n_joints,)."""
        q = self._q.copy()
        q[self._still_count :] += self._correction.q_offset
        return q

    def shaft_axis(self) -> Array:
        """The shaft's direction towards the tip in the camera frame, shape (3,); the tool's x without a shaft."""
        shaft = shaft_of(self._chain)
        if shaft is None:
            return np.asarray(self._link(None).T_camera_link[:3, 0])
        return np.asarray(self._link(shaft.link).T_camera_link[:3, :3] @ shaft.axis)

    def _start(self) -> None:
        """Believe the kinematics, with the covariance that the profile states."""
        T_base_tool = frame_transforms(self._chain, self._q)[-1] @ self._chain.T_last_tool
        self._anchor_m = (self._T_camera_base @ T_base_tool)[:3, 3]
        self._correction = Correction(np.zeros(3), np.eye(3), np.zeros(self._size - 6))
        # A wrong transform may turn about either of its ends, the base or the camera: the shift at the anchor
        # has the spread of the worse one, and no correlation with the turn, which would choose between them.
        self._P = np.zeros((self._size, self._size))
        turn_var = self._error.camera_base_std_rad**2
        arm = skew(self._anchor_m - self._T_camera_base[:3, 3])
        self._P[:3, :3] = self._error.camera_base_std_m**2 * np.eye(3) + turn_var * arm @ arm.T
        self._P[3:6, 3:6] = turn_var * np.eye(3)
        self._P[6:, 6:] = np.diag(self._joint_std[self._still_count :] ** 2)
        self._prior_information: Array = np.asarray(
            np.linalg.inv(self._P + 1e-14 * np.eye(self._size)), np.float64
        )
        self._window: list[tuple[_Moment, tuple[LinkObservation, ...]]] = []
        self._rejections = 0

    def _link(self, name: str | None) -> _Link:
        return self._links({name})[name]

    def _links(self, names: set[str | None], moment: _Moment | None = None) -> dict[str | None, _Link]:
        """Corrected poses of some links at an instant, by default the present one."""
        moment = moment or _Moment(self._q, self._T_camera_base)
        q = moment.q.copy()
        q[self._still_count :] += self._correction.q_offset
        frames = frame_transforms(self._chain, q)
        links = {}
        for name in names:
            last = (
                frames[-1] @ self._chain.T_last_tool if name is None else frames[row_index(self._chain, name)]
            )
            T_believed = moment.T_camera_base @ last
            lever_m = self._correction.turn @ (T_believed[:3, 3] - self._anchor_m)
            T = np.eye(4)
            T[:3, :3] = self._correction.turn @ T_believed[:3, :3]
            T[:3, 3] = self._anchor_m + self._correction.shift_m + lever_m
            derivative = np.zeros((6, self._size))
            derivative[:, :6] = np.eye(6)
            derivative[:3, 3:6] = -skew(lever_m)
            turned = self._correction.turn @ moment.T_camera_base[:3, :3]
            J = pose_jacobian(self._chain, q, name)[:, self._still_count :]
            derivative[:3, 6:], derivative[3:, 6:] = turned @ J[:3], turned @ J[3:]
            links[name] = _Link(T, derivative)
        return links

    def _judge(self, observation: LinkObservation, link: _Link) -> Verdict:
        residual, H = linearise(observation, link)
        if not (np.all(np.isfinite(residual)) and np.all(np.isfinite(H))):
            return Verdict(observation.name, np.inf, len(residual), False)
        S = H @ self._P @ H.T + observation.covariance
        nis = float(residual @ np.linalg.solve(S, residual))
        return Verdict(observation.name, nis, len(residual), nis <= chi_square_bound(len(residual)))

    def _iterate(self, observations: Sequence[LinkObservation]) -> None:
        """x ← x̂ + K (r + H (x - x̂)) until x rests; covariance in Joseph's form at the last linearisation."""
        start = self._correction
        x = np.zeros(self._size)
        P = self._P
        R = _block_diagonal([observation.covariance for observation in observations])
        for _ in range(MAX_ITERATIONS):
            links = self._links({observation.link for observation in observations})
            parts = [linearise(observation, links[observation.link]) for observation in observations]
            residual = np.concatenate([part[0] for part in parts])
            H = np.concatenate([part[1] for part in parts])
            if not (np.all(np.isfinite(residual)) and np.all(np.isfinite(H))):
                self._correction = start
                return
            # Solved with a unit-free H P: the units of the state differ by orders of magnitude.
            K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
            step = K @ (residual + H @ x) - x
            x = x + step
            self._correction = start.moved(x)
            if float(np.max(np.abs(step) / np.sqrt(np.diag(P) + 1e-18))) < 1e-3:
                break
        keep = np.eye(self._size) - K @ H
        P = keep @ P @ keep.T + K @ R @ K.T
        self._P = 0.5 * (P + P.T)

    def _remember(self, observations: Sequence[LinkObservation]) -> None:
        """While the filter is young, keep what it saw, and solve for all of it anew at growing intervals.

        The first frames are linearised tens of millimetres off, where a camera is far from linear; a Kalman
        filter can never take back a linearisation, a batch can. The drift is nothing over these frames.
        """
        if len(self._window) < WINDOW_SOLVES[-1]:
            self._window.append((_Moment(self._q, self._T_camera_base), tuple(observations)))
            if len(self._window) in WINDOW_SOLVES:
                self._solve_window()

    def _solve_window(self) -> None:
        """Levenberg–Marquardt on prior and window, from the present estimate and from other depths."""
        depths_m = (0.0, 0.03, -0.03) if len(self._window) <= WINDOW_DEPTH_STARTS else (0.0,)
        start = self._correction
        solutions = []
        for depth_m in depths_m:
            shift_m = start.shift_m + np.array([0.0, 0.0, depth_m])
            self._correction = Correction(shift_m, start.turn, start.q_offset)
            solutions.append(self._descend())
        best = min(solutions, key=lambda solution: solution.cost)
        self._correction = best.correction if np.isfinite(best.cost) else start
        if np.isfinite(best.cost):
            self._P = np.asarray(np.linalg.inv(best.information), np.float64)

    def _descend(self) -> _Solution:
        """Minimise from the present correction; leaves it changed."""
        damping = 1e-4
        solution = self._window_normal()
        for _ in range(MAX_WINDOW_STEPS):
            if not np.isfinite(solution.cost):
                break
            damped = solution.information + damping * np.diag(np.diag(solution.information))
            step = np.asarray(np.linalg.solve(damped, solution.gradient), np.float64)
            before = self._correction
            self._correction = before.moved(step)
            trial = self._window_normal()
            if trial.cost <= solution.cost:
                gain = solution.cost - trial.cost
                solution, damping = trial, max(0.1 * damping, 1e-9)
                if gain < 1e-3:
                    break
            else:
                self._correction = before
                damping *= 10.0
        return solution

    def _window_normal(self) -> _Solution:
        """Cost, gradient and information of prior and window at the present correction.

        Residuals beyond the gate count by Huber's weights: one wild detection must not bend the start.
        """
        state = self._correction.vector()
        A = np.eye(self._size)
        A[3:6, 3:6] -= 0.5 * skew(state[3:6])
        information = A.T @ self._prior_information @ A
        gradient = -A.T @ self._prior_information @ state
        cost = float(state @ self._prior_information @ state)
        for moment, observations in self._window:
            links = self._links({observation.link for observation in observations}, moment)
            for observation in observations:
                residual, H = linearise(observation, links[observation.link])
                if not (np.all(np.isfinite(residual)) and np.all(np.isfinite(H))):
                    cost = np.inf
                    continue
                W = np.linalg.inv(observation.covariance)
                length = float(np.sqrt(residual @ W @ residual))
                bound = float(np.sqrt(chi_square_bound(len(residual))))
                weight = min(1.0, bound / max(length, 1e-12))
                cost += length**2 if weight == 1.0 else 2.0 * bound * length - bound**2
                information += weight * H.T @ W @ H
                gradient += weight * H.T @ W @ residual
        return _Solution(cost, gradient, information, self._correction)


def linearise(observation: LinkObservation, link: _Link) -> tuple[Array, Array]:
    """Residual, shape (m,), and H = -∂residual/∂state, shape (m, n), at a link's corrected pose."""
    residual = observation.residual(link.T_camera_link[None])[0]
    return residual, -pose_derivative(observation, link.T_camera_link) @ link.derivative


@dataclass(frozen=True, slots=True)
class ShaftAxis:
    """The instrument's shaft on the chain: a point in m and the direction to the tip, (3,), in the row's frame."""

    link: str
    p_axis_m: Array
    axis: Array


def shaft_of(chain: DHChain) -> ShaftAxis | None:
    """The shaft is what the last prismatic joint pushes, along its own axis; None for a chain without one."""
    prismatic = [row for row in chain.rows if row.joint == "prismatic"]
    if not prismatic:
        return None
    row = prismatic[-1]
    if chain.convention == "modified":
        return ShaftAxis(row.name, np.zeros(3), np.array([0.0, 0.0, 1.0]))
    # The row's frame is Trans_x(a) Rot_x(α) away from the axis.
    axis = np.array([0.0, np.sin(row.alpha_rad), np.cos(row.alpha_rad)])
    return ShaftAxis(row.name, np.array([-row.a_m, 0.0, 0.0]), axis)


def chi_square_bound(freedom: int, z: float = GATE_Z) -> float:
    """Quantile of the chi-square distribution at the normal quantile z (Wilson and Hilferty 1931)."""
    c = 2.0 / (9.0 * freedom)
    return float(freedom * (1.0 - c + z * np.sqrt(c)) ** 3)


def _block_diagonal(blocks: Sequence[Array]) -> Array:
    size = sum(len(block) for block in blocks)
    joined = np.zeros((size, size))
    at = 0
    for block in blocks:
        joined[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return joined
