"""An error-state Kalman filter over what kinematics get wrong: the camera-to-base transform, and joint offsets.

`correction` holds the state. What an observation gets wrong again and again (shading beside an edge, a part that
jaws hide) would pass for knowledge if it were averaged as noise: each kind of observation has a Gauss–Markov error
of its own in the state (Gelb 1974, "Applied Optimal Estimation", sec. 3.8).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from svmdist.estimation.filtering.correction import CorrectedLink, Correction, ErrorModel, Moment
from svmdist.estimation.filtering.linearisation import Linearised, linearise
from svmdist.estimation.filtering.observations import LinkObservation
from svmdist.estimation.filtering.window import WINDOW_SOLVES, Sights, Window, geman_mcclure
from svmdist.estimation.gate import chi_square_bound
from svmdist.estimation.instrument.pose import ToolPose
from svmdist.kinematics.dh import DHChain
from svmdist.kinematics.shaft_axis import shaft_of
from svmdist.profile import KinematicError
from svmdist.transforms import Array

MAX_ITERATIONS = 8
MAX_REJECTIONS = 8
"""After as many frames in a row without an accepted observation the filter has lost the arm and starts anew."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """What became of an observation: its normalised innovation squared, and whether it passed the gate."""

    name: str
    nis: float
    size: int
    is_accepted: bool


class KinematicErrorFilter:
    """Estimates the error of believed kinematics; `predict` once a frame, then `update` with what was seen.

    The state is the error state of `ErrorModel`, then the observations' own errors in units of their deviations.
    """

    def __init__(self, chain: DHChain, error: KinematicError) -> None:
        self._chain = chain
        self._model = ErrorModel(chain, error)
        self._moment: Moment | None = None
        self._rejections = 0

    @property
    def covariance(self) -> Array:
        """Covariance of the error state, shape (n, n)."""
        return self._P[: self._model.size, : self._model.size]

    @property
    def correction(self) -> Correction:
        """What is added to believed kinematics now."""
        return self._correction

    def predict(self, stamp_ns: int, q: Array, T_camera_base: Array) -> None:
        """Go on to an instant with believed joints, shape (n_joints,), and `T_camera_base`, shape (4, 4)."""
        before, self._moment = self._moment, Moment(stamp_ns, q, T_camera_base)
        if before is None:
            self._start()
        else:
            self._pass(max(0.0, (stamp_ns - before.stamp_ns) / 1e9))

    def update(self, observations: Sequence[LinkObservation]) -> tuple[Verdict, ...]:
        """Take up what the image shows, all at once; tells what passed the gate.

        An iterated update: Gauss–Newton on the prior and all accepted residuals (Bell and Cathey 1993).
        """
        verdicts = tuple(
            self._judge(*pair) for pair in zip(observations, self._see(observations), strict=True)
        )
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
        tool = self._links({None})[None]
        covariance = tool.derivative @ self.covariance @ tool.derivative.T
        return ToolPose(tool.T_camera_link, covariance, self.shaft_axis())

    def corrected_joints(self) -> Array:
        """Believed joints with the offsets found, shape (n_joints,)."""
        return self._model.joints(self._now(), self._correction)

    def shaft_axis(self) -> Array:
        """The shaft's direction towards the tip in the camera frame, shape (3,); the tool's x without a shaft."""
        shaft = shaft_of(self._chain)
        if shaft is None:
            return np.asarray(self._links({None})[None].T_camera_link[:3, 0])
        return np.asarray(self._links({shaft.link})[shaft.link].T_camera_link[:3, :3] @ shaft.axis)

    def _start(self) -> None:
        """Believe the kinematics, with the covariance that the profile states."""
        self._anchor_m = self._model.anchor_m(self._now())
        self._correction = self._model.no_correction()
        self._prior = self._model.prior(self._now())
        self._window = Window(self._model, self._anchor_m, self._prior)
        self._forget_own_errors(self._prior)
        self._rejections = 0

    def _forget_own_errors(self, P: Array) -> None:
        self._P = P
        self._own: dict[str, slice] = {}
        self._own_mean: Array = np.zeros(0)
        self._own_s: Array = np.zeros(0)

    def _make_room(self, observation: LinkObservation, count: int) -> None:
        """The first sight of a kind adds its own error to the state, of variance one."""
        if observation.own in self._own or count == 0:
            return
        at = len(self._P)
        grown = np.eye(at + count)
        grown[:at, :at] = self._P
        self._P = grown
        self._own[observation.own] = slice(at, at + count)
        self._own_mean = np.concatenate([self._own_mean, np.zeros(count)])
        self._own_s = np.concatenate([self._own_s, np.full(count, observation.own_s)])

    def _pass(self, elapsed_s: float) -> None:
        """Time passes: the correction drifts, own errors fade towards their spread of one."""
        keep = np.exp(-elapsed_s / self._own_s)
        factor = np.concatenate([np.ones(self._model.size), keep])
        added = np.concatenate([self._model.drift**2 * elapsed_s, 1.0 - keep**2])
        self._P = factor[:, None] * self._P * factor + np.diag(added)
        self._own_mean = keep * self._own_mean

    def _now(self) -> Moment:
        if self._moment is None:
            raise ValueError("the filter knows no joints yet: predict comes first")
        return self._moment

    def _links(self, names: set[str | None]) -> dict[str | None, CorrectedLink]:
        links = self._model.links(names, [self._now()], self._correction, self._anchor_m)
        return {name: at_moments[0] for name, at_moments in links.items()}

    def _see(self, observations: Sequence[LinkObservation]) -> list[Linearised]:
        """The observations about the present state; makes room for their own errors."""
        links = self._links({observation.link for observation in observations})
        seen = []
        for observation in observations:
            link = links[observation.link]
            part = linearise(observation, link.T_camera_link, link.derivative)
            self._make_room(observation, part.spread.shape[1])
            seen.append(part)
        return seen

    def _whole(self, observation: LinkObservation, part: Linearised) -> Array:
        """The derivative of the residual by the whole state, shape (m, n)."""
        H = np.zeros((len(part.residual), len(self._P)))
        H[:, : self._model.size] = part.H
        if part.spread.size:
            H[:, self._own[observation.own]] = part.spread
        return H

    def _judge(self, observation: LinkObservation, part: Linearised) -> Verdict:
        size = len(part.residual)
        if not part.is_finite:
            return Verdict(observation.name, np.inf, size, False)
        H = self._whole(observation, part)
        innovation = part.residual - H[:, self._model.size :] @ self._own_mean
        S = H @ self._P @ H.T + part.noise
        nis = float(innovation @ np.linalg.solve(S, innovation))
        return Verdict(observation.name, nis, size, nis <= chi_square_bound(size))

    def _iterate(self, observations: Sequence[LinkObservation]) -> None:
        """x ← x̂ + K (r + H (x - x̂)) until x rests; covariance in Joseph's form at the last linearisation."""
        start, own_start = self._correction, self._own_mean
        size = self._model.size
        x = np.zeros(len(self._P))
        P = self._P
        R = _block_diagonal([observation.covariance for observation in observations])
        for _ in range(MAX_ITERATIONS):
            parts = self._see(observations)
            if not all(part.is_finite for part in parts):
                self._correction, self._own_mean = start, own_start
                return
            residual = np.concatenate([part.residual for part in parts])
            H = np.concatenate([self._whole(*pair) for pair in zip(observations, parts, strict=True)])
            residual = residual - H[:, size:] @ self._own_mean
            # Solved with a unit-free H P: the units of the state differ by orders of magnitude.
            K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
            step = K @ (residual + H @ x) - x
            x = x + step
            self._correction, self._own_mean = start.moved(x[:size]), own_start + x[size:]
            if float(np.max(np.abs(step) / np.sqrt(np.diag(P) + 1e-18))) < 1e-3:
                break
        keep = np.eye(len(P)) - K @ H
        P = keep @ P @ keep.T + K @ R @ K.T
        self._P = 0.5 * (P + P.T)

    def _remember(self, observations: Sequence[LinkObservation]) -> None:
        """While the filter is young, keep what it saw, and solve for all of it anew at growing intervals.

        The first frames are linearised tens of millimetres off, where a camera is far from linear; a Kalman
        filter can never take back a linearisation, a batch can.
        """
        if len(self._window) < WINDOW_SOLVES[-1]:
            self._window.add(Sights(self._now(), tuple(observations)))
            if len(self._window) in WINDOW_SOLVES:
                solved = self._window.solve(self._correction)
                if solved is not None:
                    self._replay(solved)

    def _replay(self, at: Correction) -> None:
        """Filter the window's frames once more, all linearised at the batch's solution.

        The batch takes the observations' own errors for noise; the filter knows that they last.
        """
        size = self._model.size
        self._forget_own_errors(self._window.prior_at(at))
        # What is to be added to `at`: at first all the way back to no correction.
        to_correction = self._window.step_to_prior(at)
        stamp_ns = self._now().stamp_ns
        for index, (sights, parts) in enumerate(self._window.linearised(at, geman_mcclure)):
            if index > 0:
                self._pass(max(0.0, (sights.moment.stamp_ns - stamp_ns) / 1e9))
            stamp_ns = sights.moment.stamp_ns
            for observation, part, weight in parts:
                self._make_room(observation, part.spread.shape[1])
                H, R = self._whole(observation, part), part.noise / weight
                x = np.concatenate([to_correction, self._own_mean])
                K = np.linalg.solve(H @ self._P @ H.T + R, H @ self._P).T
                x = x + K @ (part.residual - H @ x)
                keep = np.eye(len(self._P)) - K @ H
                P = keep @ self._P @ keep.T + K @ R @ K.T
                self._P = 0.5 * (P + P.T)
                to_correction, self._own_mean = x[:size], x[size:]
        self._correction = at.moved(to_correction)


def _block_diagonal(blocks: Sequence[Array]) -> Array:
    size = sum(len(block) for block in blocks)
    joined = np.zeros((size, size))
    at = 0
    for block in blocks:
        joined[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return joined
