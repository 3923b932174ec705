"""The first frames solved as a batch: where to linearise before anything is known (Levenberg–Marquardt)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from svmdist.estimation.instrument.consistency import chi_square_bound
from svmdist.estimation.instrument.corrected_links import CorrectedLink, Correction, NominalFrames
from svmdist.estimation.instrument.error_model import ErrorModel
from svmdist.estimation.instrument.measurement import LinkMeasurement
from svmdist.estimation.instrument.state import Linearised, linearise
from svmdist.kinematics.robot_state import RobotState
from svmdist.least_squares import Minimum, NormalEquations, Steps, minimise
from svmdist.profile.settings import FilterSettings
from svmdist.transforms import Array, skew

WINDOW_DEPTH_OFFSETS_M = (0.0, 0.03, -0.03)  # depth is the least observable at first
WINDOW_DEPTH_OFFSET_FRAMES = 3  # up to so many; later the last solution is a start
WINDOW_MAX_STEPS = 20  # levenberg–Marquardt steps from each start
WINDOW_MAX_DEVIATION = 2.0  # over the gate's bound: beyond, its weight is less than a half

Loss = Callable[[Array], tuple[Array, Array]]


def huber(deviation: Array) -> tuple[Array, Array]:
    """Squares within the bound, straight on beyond it (Huber 1964)."""
    root = np.sqrt(np.maximum(deviation, 1.0))
    return np.where(deviation <= 1.0, deviation, 2.0 * root - 1.0), 1.0 / root


def geman_mcclure(deviation: Array) -> tuple[Array, Array]:
    """Squares near zero, bounded far out (Geman and McClure 1987); half the bound's full height at four bounds."""
    height = 1.0 + 0.25 * deviation
    return deviation / height, 1.0 / height**2


Stack = tuple[LinkMeasurement, NDArray[np.intp], NDArray[np.intp]]
"""Measurements that differ in their numbers only, as one; the frame of each, and its place there."""


def stack(frames: Iterable[tuple[LinkMeasurement, ...]]) -> list[Stack]:
    """Sort the measurements of frames into stacks."""
    groups: dict[tuple[object, ...], list[tuple[LinkMeasurement, int, int]]] = {}
    for index, measurements in enumerate(frames):
        for place, measurement in enumerate(measurements):
            groups.setdefault(_kind(measurement), []).append((measurement, index, place))
    stacks: list[Stack] = []
    for members in groups.values():
        alike, indices, places = zip(*members, strict=True)
        names = alike[0].STACKED
        stacked = {name: np.stack([np.asarray(getattr(one, name)) for one in alike]) for name in names}
        stacks.append((replace(alike[0], **stacked), np.array(indices), np.array(places)))
    return stacks


def _kind(measurement: LinkMeasurement) -> tuple[object, ...]:
    """What must agree in a stack: the class, the shapes of what is stacked, and all that is no name."""
    key: list[object] = [type(measurement)]
    for field in fields(measurement):
        value = getattr(measurement, field.name)
        if field.name in measurement.STACKED:
            key.append(np.shape(value))
        elif field.name not in ("name", "bias_name"):
            # Strings and numbers are equal by value; a camera is the same one throughout a log.
            key.append(value if isinstance(value, str | int | float | tuple | None) else id(value))
    return tuple(key)


FIRST_DAMPING = 1e-4
MAX_TIME_STEPS = 4
# A joint that turns at 1 rad/s with 10 rad/s² leaves its tangent by 5 µrad within as long
TIME_SETTLED_S = 1e-3
COST_SETTLED = 1e-3  # A step that lowers a sum of squares by less moves nothing that a deviation would notice


@dataclass(frozen=True, slots=True)
class _Weighed:
    """A stack about a correction: what of it is visible, (k,), its information, (k, m, m), with noise and bias."""

    part: Linearised
    visible: NDArray[np.bool_]
    information: Array
    deviation: Array
    bound: float


class Window:
    """The first frames of a filter from `anchor_m` (3,), prior covariance (n, n), and that with constants (n, k)."""

    def __init__(
        self,
        model: ErrorModel,
        anchor_m: Array,
        prior: Array,
        settings: FilterSettings,
        with_constants: Mapping[str, Array] | None = None,
    ) -> None:
        self._with_constants = with_constants or {}
        self._model = model
        self._anchor_m = anchor_m
        self._prior = prior
        self._settings = settings
        self._prior_information = np.asarray(np.linalg.inv(prior + 1e-14 * np.eye(len(prior))), np.float64)
        self._frames: list[tuple[RobotState, tuple[LinkMeasurement, ...]]] = []
        self._stacks: list[Stack] = []
        self._nominal: NominalFrames | None = None
        self._time_offset_s = 0.0

    def __len__(self) -> int:
        return len(self._frames)

    def add(self, robot: RobotState, measurements: tuple[LinkMeasurement, ...]) -> None:
        """Keep what one frame showed."""
        self._frames.append((robot, measurements))
        self._nominal = None

    def solve(self, start: Correction) -> Correction | None:
        """The correction that fits prior and frames best, from the start and from other depths."""
        offsets_m = WINDOW_DEPTH_OFFSETS_M if len(self) <= WINDOW_DEPTH_OFFSET_FRAMES else (0.0,)
        self._time_offset_s, self._nominal = start.time_offset_s, None
        minima = [self._descend(start, geman_mcclure)]
        for offset_m in offsets_m:
            shift_m = start.shift_m + np.array([0.0, 0.0, offset_m])
            near = self._descend(replace(start, shift_m=shift_m), huber)
            if near is not None:
                minima.append(self._descend(near.state, geman_mcclure))
        found = [minimum for minimum in minima if minimum is not None]
        if not found:
            return None
        best = min(found, key=lambda minimum: minimum.equations.cost).state
        # Joints go on at their rate for a short time only: with another time offset, read them again.
        for _ in range(MAX_TIME_STEPS):
            if abs(best.time_offset_s - self._time_offset_s) < TIME_SETTLED_S:
                break
            self._time_offset_s, self._nominal = best.time_offset_s, None
            again = self._descend(best, geman_mcclure)
            if again is None:
                break
            best = again.state
        return best

    def prior_at(self, at: Correction) -> Array:
        """The prior's covariance in the error state about a correction, shape (n, n)."""
        back = np.linalg.inv(_tangent(at))
        return np.asarray(back @ self._prior @ back.T)

    def prior_with_constants_at(self, at: Correction) -> dict[str, Array]:
        """The same of its covariance with constants, shape (n, k) each."""
        back = np.linalg.inv(_tangent(at))
        return {name: back @ covariance for name, covariance in self._with_constants.items()}

    def step_to_prior(self, at: Correction) -> Array:
        """The error state about a correction that leads to the prior's mean, shape (n,)."""
        return np.asarray(-np.linalg.solve(_tangent(at), at.vector()))

    def linearised(self, at: Correction) -> Iterator[tuple[RobotState, list[Linearised], list[float]]]:
        """Each frame's measurements about a correction with weights, without what is not visible or far off."""
        found: dict[tuple[int, int], tuple[Linearised, float]] = {}
        for (_, frames, places), weighed in self._weighed(at):
            weights = geman_mcclure(weighed.deviation)[1]
            for k, place in enumerate(zip(frames, places, strict=True)):
                # What the batch's solution does not explain is no noise, however large: it is left out.
                if weighed.visible[k] and weighed.deviation[k] <= WINDOW_MAX_DEVIATION:
                    found[place] = weighed.part.member(k), float(weights[k])
        for index, (robot, measurements) in enumerate(self._frames):
            kept = [found[index, place] for place in range(len(measurements)) if (index, place) in found]
            yield robot, [part for part, _ in kept], [weight for _, weight in kept]

    def _descend(self, start: Correction, loss: Loss) -> Minimum[Correction] | None:
        steps = Steps(WINDOW_MAX_STEPS, damping=FIRST_DAMPING, cost_settled=COST_SETTLED)
        return minimise(start, lambda at: self._normal(at, loss), Correction.retract, steps)

    def _normal(self, at: Correction, loss: Loss) -> NormalEquations | None:
        """Cost, gradient and information of prior and window at a correction; None where something is not visible."""
        state, A = at.vector(), _tangent(at)
        information = A.T @ self._prior_information @ A
        gradient = -A.T @ self._prior_information @ state
        cost = float(state @ self._prior_information @ state)
        for _, weighed in self._weighed(at):
            if not weighed.visible.all():
                return None
            losses, weights = loss(weighed.deviation)
            cost += weighed.bound * float(losses.sum())
            H = weighed.part.H.copy()
            H[..., self._model.columns.play] = 0.0  # as noise, in the information
            WH = (weights[:, None, None] * (weighed.information @ H)).reshape(-1, len(state))
            information += WH.T @ H.reshape(-1, len(state))
            gradient += WH.T @ weighed.part.residual.ravel()
        return NormalEquations(cost, gradient, information)

    def _weighed(self, at: Correction) -> Iterator[tuple[Stack, _Weighed]]:
        if self._nominal is None:
            robots = [robot.shifted(self._time_offset_s) for robot, _ in self._frames]
            self._nominal = NominalFrames.stack([self._model.nominal(robot) for robot in robots])
            self._stacks = stack(measurements for _, measurements in self._frames)
        links = self._model.links(self._nominal, at, self._anchor_m)
        for members in self._stacks:
            measurement, rows, _ = members
            link = links.link(measurement.link)
            part = linearise(measurement, CorrectedLink(link.T_camera_link[rows], link.derivative[rows]))
            visible = np.asarray(np.isfinite(part.residual).all(-1))
            H = part.H[..., self._model.columns.play]
            play = self._model.play_covariance[self._model.columns.play, self._model.columns.play]
            covariance = part.covariance + H @ play @ np.swapaxes(H, -1, -2)
            covariance[~visible] = np.eye(covariance.shape[-1])
            information = np.asarray(np.linalg.inv(covariance), np.float64)
            r = np.where(visible[:, None], part.residual, 0.0)[..., None]
            squares = (np.swapaxes(r, -1, -2) @ information @ r)[..., 0, 0]
            bound = chi_square_bound(r.shape[-2], self._settings.gate_z)
            yield members, _Weighed(part, visible, information, squares / bound, bound)


def _tangent(at: Correction) -> Array:
    """Derivative of the correction's vector by the error state about it, shape (n, n), to first order in the turn."""
    state = at.vector()
    A = np.eye(len(state))
    A[3:6, 3:6] -= 0.5 * skew(state[3:6])
    return A
