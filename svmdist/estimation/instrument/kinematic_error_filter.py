"""The error-state filter: the state that heavy-tailed measurements make the most probable, and where to start."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from svmdist.estimation.instrument import measurement as kinds
from svmdist.estimation.instrument.consistency import Consistency, GatingResult, chi_square_bound, student_weight
from svmdist.estimation.instrument.error_model import ErrorModel
from svmdist.estimation.instrument.measurement import ONE_FRAME_S, BiasTerm, Linearised, LinkMeasurement
from svmdist.estimation.instrument.state import ErrorState, Solution, evidence, heavy_tailed, most_probable, robust_cost
from svmdist.kinematics import DHChain, shaft_of
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile.robot import KinematicError
from svmdist.profile.settings import FilterSettings
from svmdist.results import Hinge, ToolPose, across_std_rad
from svmdist.transforms import Array, skew

UNSEEN_SQUARE = 50.0  # a start pays for a measurement that it cannot see as for one so far off
JUMP = np.diag([0.02**2] * 3 + [0.05**2] * 3)  # m², rad²: an endoscope that is pushed
JUMP_PRICE = 13.8  # twice the logarithm of how rarely that happens: in one frame of a thousand
TINY_POSE = np.diag([1e-10] * 3 + [1e-8] * 3)  # m², rad²: an image's pose is never surer

SAME_SQUARE = 6.0  # of a start from where an earlier one led, in its deviations: on average, of six numbers
CONTEST = 5.0  # twice the logarithm: the most probable pose is contested by one a twelfth as probable

Start = tuple[ToolPose | None, Sequence[LinkMeasurement]]
"""A pose of the tool by the images, or None for nominal kinematics, and the measurements made about it."""


@dataclass(frozen=True, slots=True)
class _Way:
    index: int
    x: Array
    tool: ToolPose
    cost: float


class KinematicErrorFilter:
    """Estimates the error of nominal kinematics; `predict` once per frame, then `update` with its measurements."""

    def __init__(self, chain: DHChain, error: KinematicError, settings: FilterSettings | None = None) -> None:
        self._settings = settings or FilterSettings()
        self._shaft = shaft_of(chain)
        self._model = ErrorModel(chain, error)
        self.state, self.consistency = ErrorState(self._model), Consistency(self._settings)
        self._start_x: Array | None = None
        self._rivals_m: list[Array] = []
        self._age_s = 0.0
        self.has_jumped = False
        """Whether the last measurements are rather those of a camera or a base that was moved: they changed nothing."""

    @property
    def covariance(self) -> Array:
        """Covariance of the error state, shape (n, n)."""
        return self.state.P[: self._model.size, : self._model.size]

    def predict(self, robot: RobotState) -> None:
        """Go on to the robot's state at a new instant; raises ValueError where that does not know the camera."""
        elapsed_s = self.state.go_to(robot)
        if elapsed_s is None:
            self.state.start()
        else:
            self._age_s += elapsed_s
            self.state.propagate(elapsed_s)

    def begin(self, starts: Sequence[Start]) -> int:
        """Forget what was measured and begin where prior and measurements are the most probable; gives which start.

        A start is where to linearise first, never a measurement of its own. One that an earlier one led to the
        neighbourhood of would lead to the same.
        """
        every = {measurement.name: measurement for _, seen in starts for measurement in seen}
        ways = list[_Way]()
        for index, (pose, seen) in enumerate(starts):
            if not seen or (pose is not None and any(pose_distance(pose, way.tool) < SAME_SQUARE for way in ways)):
                continue
            self._begin_at(pose)
            x = np.zeros(len(self.state.P)) if self._start_x is None else self._start_x
            parts = self.state.retracted(x).linearise(seen)
            if not all(part.is_finite for part in parts):
                continue
            self.state.augment_state(parts)
            solved = most_probable(self.state, seen, self._padded(x))
            if solved is None:
                continue
            T_camera_tool = self.state.retracted(solved.x).link(None).T_camera_link
            cost = robust_cost(solved, seen)
            for name in every.keys() - {measurement.name for measurement in seen}:
                cost += heavy_tailed(UNSEEN_SQUARE, every[name].covariance)
            tool = ToolPose(T_camera_tool, np.zeros((6, 6)), T_camera_tool[:3, 0])
            ways.append(_Way(index, solved.x, tool, cost))
        ways.sort(key=lambda way: way.cost)
        self._rivals_m = [way.tool.position_m for way in ways[1:] if way.cost < ways[0].cost + CONTEST]
        index = ways[0].index if ways else 0
        self._begin_at(starts[index][0])
        if ways:
            self._start_x = ways[0].x[: self._model.size]
        return index

    def rival_m(self, pose: ToolPose) -> float:
        """How far off the tool is by a start that is nearly as probable; 0 where the deviations of its pose allow that.

        As where one outlier or the other leaves the rest in agreement: nothing shows which of them is the outlier.
        """
        off_m = [tool_m - pose.position_m for tool_m in self._rivals_m]
        information = np.linalg.inv(pose.position_covariance)
        far_m = (off for off in off_m if off @ information @ off > chi_square_bound(3))
        return max((float(np.linalg.norm(off)) for off in far_m), default=0.0)

    def update(self, measurements: Sequence[LinkMeasurement]) -> tuple[GatingResult, ...]:
        """Take up what the image shows; gives the gating result of each measurement."""
        state, start = self.state, self._start_x
        self._start_x, self.has_jumped = None, False
        there = state if start is None else state.retracted(self._padded(start))
        parts = there.linearise(measurements)
        visible = [index for index, part in enumerate(parts) if part.is_finite]
        seen = [measurements[index] for index in visible]
        results, found = list[GatingResult](), None
        if seen:
            state.augment_state([parts[index] for index in visible])
            x = np.zeros(len(state.P)) if start is None else self._padded(start)
            found = most_probable(state, seen, x, is_tracking=start is None)
        if found is not None:
            for one, nis, weight in zip(seen, found.innovations.tolist(), found.weights.tolist(), strict=True):
                results.append(GatingResult(one.name, nis, len(one.covariance), weight, one.source))
            self.has_jumped = start is None and self._prefers_jump(seen, found)
        if found is not None and not self.has_jumped:
            state.retract(found.x)
            # Outliers may pull, but reduce no covariance.
            accepted = np.repeat([one.is_accepted for one in results], [one.degrees_of_freedom for one in results])
            state.update_covariance(found.H[accepted], found.R[np.ix_(accepted, accepted)])
        if start is None:
            self.consistency.add(state.robot.stamp_ns, results)
        late_s = float(state.correction.x[self._model.time_offset])
        self.consistency.watch(state.furthest_parameter(), late_s, self._model.time_offset_std_s(self._age_s))
        return tuple(results)

    def update_scene(self, name: str, part: Linearised) -> GatingResult:
        """Take up a measurement of biases alone, of which no link is a part: the tissue's height by stereo."""
        state, size = self.state, len(part.residual)
        part = replace(part, H=np.zeros((size, self._model.size)))
        state.augment_state([part])
        H = state.full_jacobian([part])
        innovation = part.residual - H[:, self._model.size :] @ state.bias_mean
        S = H @ state.P @ H.T + part.noise
        nis = float(innovation @ np.linalg.solve(S, innovation))
        is_accepted = nis <= chi_square_bound(size, self._settings.gate_z)
        result = GatingResult(name, nis, size, float(student_weight(nis, size)) if is_accepted else 0.0, name)
        if is_accepted:
            state.retract(state.P @ H.T @ np.linalg.solve(S, innovation))
            state.update_covariance(H, part.noise)
        self.consistency.add(state.robot.stamp_ns, [result], of_tool=False)
        return result

    def bias_covariances(self, biases: Sequence[BiasTerm]) -> tuple[Array, Array]:
        """Of a point that biases move by their Jacobians, (3, k): covariance (3, 3), and that with the tool, (6, 3)."""
        part = Linearised(np.zeros(3), np.zeros((3, self._model.size)), tuple(biases), np.zeros((3, 3)))
        self.state.augment_state([part])
        G, P = self.state.full_jacobian([part]), self.state.P
        tool, widening = self.state.link(None).derivative, self.consistency.widening
        return widening * G @ P @ G.T, widening * tool @ P[: self._model.size] @ G.T

    def tool_pose(self) -> ToolPose:
        """The corrected pose of the tool and its covariance; without a shaft its axis is the tool's x."""
        tool, widening = self.state.link(None), self.consistency.widening
        covariance = widening * (tool.derivative @ self.covariance @ tool.derivative.T)
        if self._shaft is None:
            return ToolPose(tool.T_camera_link, covariance, tool.T_camera_link[:3, 0])
        link = self.state.link(self._shaft.link)
        axis, turn = link.T_camera_link[:3, :3] @ self._shaft.axis, link.derivative[3:]
        axis_std_rad = across_std_rad(widening * turn @ self.covariance @ turn.T, axis)
        return ToolPose(tool.T_camera_link, covariance, axis, axis_std_rad)

    def hinge(self, name: str, p_link_m: Array) -> Hinge:
        """The wrist's hinge, from where it is in the frame of a link, shape (3,)."""
        link = self.state.link(name)
        arm_m = link.T_camera_link[:3, :3] @ p_link_m
        J = link.derivative[:3] - skew(arm_m) @ link.derivative[3:]
        return Hinge(link.T_camera_link[:3, 3] + arm_m, self.consistency.widening * (J @ self.covariance @ J.T))

    def corrected_joints(self) -> Array:
        """Reported joints at the corrected time, with offsets and backlash, shape (n_joints,)."""
        return self._model.corrected_joints(self.state.robot, self.state.correction)

    def _padded(self, x: Array) -> Array:
        return np.concatenate([x, np.zeros(len(self.state.P) - len(x))])

    def _prefers_jump(self, measurements: Sequence[LinkMeasurement], found: Solution) -> bool:
        """Whether measurements are more probable after a jump of the base than as outliers, by Bayes' factor."""
        if found.innovations.sum() < chi_square_bound(len(found.R)):
            return False
        there = copy(self.state)
        there.P = self.state.P.copy()
        there.P[:6, :6] += JUMP
        moved = most_probable(there, measurements, np.zeros(len(there.P)))
        as_outliers = evidence(found, self.state.P, measurements)
        return moved is not None and evidence(moved, there.P, measurements) + JUMP_PRICE < as_outliers

    def _begin_at(self, pose: ToolPose | None) -> None:
        """The prior, linearised where a pose puts the tool, and widened where that would surprise it."""
        state = self.state
        state.correction = self._model.no_correction(state.robot)
        state.go_to(state.robot)
        state.start()
        self.consistency.clear()
        self._age_s, self._start_x = 0.0, None
        if pose is None:
            return
        at = [as_measurement(pose)]
        found = most_probable(state, at, np.zeros(len(state.P)), is_robust=False)
        if found is None:
            return
        surprise = max(1.0, found.nis / 6.0)
        if surprise > 1.0:
            state.P[:6] *= np.sqrt(surprise)
            state.P[:, :6] *= np.sqrt(surprise)
            found = most_probable(state, at, found.x, is_robust=False) or found
        self._start_x = found.x


def as_measurement(pose: ToolPose) -> LinkMeasurement:
    """A pose by the images as a measurement of the tool."""
    in_view = kinds.pose(np.eye(4), pose.T_camera_tool, np.zeros((6, 6)))
    covariance = pose.covariance + TINY_POSE
    return LinkMeasurement(name="pose", in_view=in_view, covariance=covariance, correlation_time_s=ONE_FRAME_S)


def pose_distance(image: ToolPose, predicted: ToolPose) -> float:
    """Squared deviation of an image's pose from a predicted one: six degrees of freedom."""
    measurement = as_measurement(image)
    found = measurement.linearise(predicted.T_camera_tool)
    v, J = found.residual, found.H
    return float(v @ np.linalg.solve(measurement.covariance + J @ predicted.covariance @ J.T, v))
