"""The tool's pose from what both views show of it: edges, the cylinder's end, the distal marker and its disparity.

The unknowns are those of the fit to one view: the shaft's frame in the left camera, and the wrist's bend. What the
right view shows is predicted there, through the pair's geometry. Any of it may be missing; what contradicts the rest is
left out, and what that says of the depth is stated as uncertainty.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from svmdist.estimation.instrument.consistency import chi_square_bound
from svmdist.estimation.instrument.measurement import Deviations
from svmdist.estimation.instrument.shaft_fit import (
    DOUBT_SQUARE,
    GATE_CHI2,
    by_constants,
    doubted,
    first_shaft,
    normal_equations,
    normalised_square,
    pose_at,
)
from svmdist.estimation.instrument.shaft_model import (
    Residual,
    ShaftModel,
    ShaftState,
    bent_tool,
    prior_residual,
)
from svmdist.estimation.instrument.two_views import (
    DISPARITY,
    MARKER,
    RIM,
    SIZE,
    VIEWS,
    DisparityCheck,
    Predicted,
    TwoViews,
    measurements,
)
from svmdist.least_squares import NormalEquations, Steps, minimise
from svmdist.profile.settings import ShaftSettings, StereoSettings
from svmdist.results import Failure, ToolPose
from svmdist.transforms import Array, inverse, make_transform

MISTAKEN_EDGE = 0.03  # how often a long edge belongs to something else; decides what to leave out
MISTAKEN_STUB = 0.2  # the same for a stub: one edge in five
MISTAKEN_RIM = 0.2  # how often the cylinder's end is something else: what lies across the shaft ends it, too
MISTAKEN_MARKER = 0.05  # how often what has its colour is not the marker. A disc in both views never is
MISTAKEN_SIZE = 0.1  # how often the marker's size is not that of the whole marker: blood and jaws hide a part
MISTAKEN_DISPARITY = 0.02  # how often the marker's disparity is wrong
MAX_REFUSED = 4  # parts that may contradict the rest; with more nothing tells which is right
KEPT_DOUBT_STDS = 2.5  # the same in one frame, of a disparity that is not refused

STEPS = Steps(max_steps=20, settled=1e-5, damping=1e-6)
PRIOR = "nominal kinematics"
MAX_CHECK_STD = 0.1  # of the depth: what tells it less certainly is no check of a disparity
CERTAIN = 100.0  # what costs more to refuse than this is not refused
SUSPECTS = 6  # of contradicting measurements, those with the largest residuals are tried to do without
ONE_IN_400 = 2.807  # deviations that one in 400 normal numbers exceeds, to one side or the other


@dataclass(frozen=True, slots=True)
class StereoFit:
    """The tool's pose, and how its disparity stands against the depth by the width of a long shaft."""

    pose: ToolPose
    check: DisparityCheck | None


@dataclass(frozen=True, slots=True)
class _Solution:
    """The state of least squares, its residuals by their names, and its cost and information, shape (8, 8)."""

    state: ShaftState
    found: dict[str, Residual]
    cost: float
    information: Array

    def excess(self) -> dict[str, float]:
        """Each residual's normalised square over what one in 400 true ones exceeds."""
        return {name: normalised_square(one) / _bound(len(one.whitened)) for name, one in self.found.items()}


def fit_two_views(
    seen: TwoViews, model: ShaftModel, deviations: Deviations, settings: ShaftSettings, stereo: StereoSettings
) -> StereoFit | Failure:
    """The pose that fits most of what both views show; or why there is none."""
    measured = measurements(seen, model, deviations, settings)
    failure = Failure("nothing of the instrument is to be seen")
    for start in first_poses(seen, model):
        if isinstance(start, Failure):
            failure = start
            continue
        agreed = _agreeing(start, measured, _penalties(seen), model)
        found = agreed if isinstance(agreed, Failure) else _fitted(agreed, measured, seen, model)
        if isinstance(found, StereoFit) and found.pose.position_std_m <= stereo.max_depth_std_m:
            return found
        if _is_disc_in_both(seen):
            # A disc at one place in both views is the tool, whatever stands beside it.
            alone = _solve(start, {name: measured[name] for name in (MARKER, DISPARITY)}, model)
            if alone is not None and max(alone.excess().values()) <= 1.0:
                return _fitted(alone, measured, seen, model)
        if isinstance(found, StereoFit):
            found = Failure(f"the position is uncertain by {found.pose.position_std_m * 1e3:.1f} mm")
        failure = found
    return failure


def _is_disc_in_both(seen: TwoViews) -> bool:
    left, right = seen.left.marker, seen.right.marker
    return bool(seen.match and left and right and left.disc and right.disc)


def _fitted(
    agreed: _Solution, measured: dict[str, Predicted], seen: TwoViews, model: ShaftModel
) -> StereoFit:
    check = _check(agreed, measured, seen, model)
    pose = pose_at(agreed.state, agreed.information, model)
    return StereoFit(_with_doubt(pose, measured, agreed, check), check)


def _has_width(found: Mapping[str, object]) -> bool:
    return any(all(f"{view} side {side}" in found for side in ("+1", "-1")) for view in VIEWS)


def _check(
    agreed: _Solution, measured: dict[str, Predicted], seen: TwoViews, model: ShaftModel
) -> DisparityCheck | None:
    """The disparity against the depth by the width of a long shaft; None without both."""
    stubs = [name for name, view in zip(VIEWS, (seen.left, seen.right), strict=True) if view.shaft.is_stub]
    names = (name for name in measured if name in agreed.found and name not in (DISPARITY, SIZE))
    others = {name: measured[name] for name in names if not name.startswith(tuple(stubs))}
    if DISPARITY not in measured or not _has_width(others):
        return None
    without = _solve(agreed.state.T, others, model)
    if without is None:
        return None
    residual = measured[DISPARITY](without.state)
    slope = residual.derivative[0]
    of_pose = float(slope @ np.linalg.inv(without.information) @ slope)
    C = by_constants([residual])
    std = float(np.sqrt(of_pose + 1.0 + (C @ C.T)[0, 0]))
    # Whitened numbers over what all of the depth would change: a share of the disparity, or of the depth.
    tool_m = bent_tool(without.state, model)[0][:3, 3]
    per_whole = abs(float(slope @ np.concatenate([tool_m, np.zeros(5)])))
    if of_pose > (MAX_CHECK_STD * per_whole) ** 2:
        return None
    return DisparityCheck(float(residual.whitened[0]) / per_whole, std / per_whole)


def _penalties(seen: TwoViews) -> dict[str, float]:
    """What refusing each measurement costs, -2 log of how often such a one is mistaken."""
    share = {RIM: MISTAKEN_RIM, SIZE: MISTAKEN_SIZE, DISPARITY: MISTAKEN_DISPARITY}
    # Two views do not mistake something for a disc at one place.
    share[MARKER] = 0.0 if _is_disc_in_both(seen) else MISTAKEN_MARKER
    for view, landmarks in zip(VIEWS, (seen.left, seen.right), strict=True):
        edge = MISTAKEN_STUB if landmarks.shaft.is_stub else MISTAKEN_EDGE
        share |= {f"{view} side {side}": edge for side in ("+1", "-1")}
    return {name: -2.0 * float(np.log(max(value, 1e-300))) for name, value in share.items()}


def _agreeing(
    start: Array, measured: dict[str, Predicted], penalties: dict[str, float], model: ShaftModel
) -> _Solution | Failure:
    """The fit to all measurements, or to those that are left when as few as needed are refused."""
    kept = dict(measured)
    solution = _solve(start, kept, model)
    if solution is None:
        return Failure("the fit to both views does not converge")
    for count in range(MAX_REFUSED + 1):
        excess = solution.excess()
        worst = max(excess, key=lambda name: excess[name])
        if excess[worst] <= 1.0:
            return solution
        if count == MAX_REFUSED or len(kept) < 2:
            break
        # The largest residual need not be the wrong measurement: it is the one without which the rest fits best, and
        # of the kind that is often mistaken.
        trials = {
            name: _solve(start, {k: v for k, v in kept.items() if k != name}, model)
            for name in sorted(kept, key=lambda name: -excess[name])[:SUSPECTS]
            if penalties[name] < CERTAIN
        }
        usable = {name: trial for name, trial in trials.items() if trial is not None}
        if not usable:
            break
        out = min(usable, key=lambda name: usable[name].cost + penalties[name])
        solution = usable[out]
        del kept[out]
    return Failure(f"{worst} does not fit the rest")


def first_poses(seen: TwoViews, model: ShaftModel) -> Iterator[Array | Failure]:
    """First `T_left_shaft`, (4, 4): by the sides in either view, by the triangulated marker; or what is missing."""
    tool_m = None if seen.match is None else seen.pair.point(seen.match.left_px, seen.match.disparity_px)[0]
    right_model = model
    if model.R_camera_shaft is not None:
        right_model = replace(model, R_camera_shaft=seen.T_right_left[:3, :3] @ model.R_camera_shaft)
    views = (
        (seen.left, model, seen.left_camera, np.eye(4)),
        (seen.right, right_model, seen.right_camera, inverse(seen.T_right_left)),
    )
    for has_sides in (True, False):
        for landmarks, expected, camera, T_left_view in views:
            if (len(landmarks.shaft.contours) == 2) != has_sides:
                continue
            first = first_shaft(landmarks.shaft, landmarks.marker, expected, camera)
            if isinstance(first, Failure):
                yield first
                continue
            T = T_left_view @ first
            if tool_m is not None:  # disparity is nearer to the truth than the width of a stub
                yield make_transform(T[:3, :3], tool_m - T[:3, :3] @ model.T_shaft_tool[:3, 3])
            yield np.asarray(T)
    if tool_m is not None and (R := model.R_camera_shaft) is not None:
        yield make_transform(R, tool_m - R @ model.T_shaft_tool[:3, 3])


def _solve(start: Array, measured: dict[str, Predicted], model: ShaftModel) -> _Solution | None:
    def residuals(state: ShaftState) -> dict[str, Residual]:
        found = {name: predict(state) for name, predict in measured.items()}
        return found | {PRIOR: prior_residual(state, start, model)}

    def linearised(state: ShaftState) -> NormalEquations:
        return normal_equations(list(residuals(state).values()))

    least = minimise(ShaftState(start, np.zeros(2)), linearised, ShaftState.retracted, STEPS)
    if least is None:
        return None
    return _Solution(least.state, residuals(least.state), least.equations.cost, least.equations.information)


def _bound(count: int) -> float:
    """The gate of two numbers, for as many as a residual has, at one in 400."""
    return GATE_CHI2 * chi_square_bound(count, ONE_IN_400) / chi_square_bound(2, ONE_IN_400)


def _with_doubt(
    pose: ToolPose, measured: dict[str, Predicted], agreed: _Solution, check: DisparityCheck | None
) -> ToolPose:
    """The pose as uncertain in depth as size or disparity contradict it, where no two others agree about the depth."""
    found = agreed.found
    has_width = _has_width(found)
    variance, is_alone = 0.0, has_width + (SIZE in found) < 2
    if check is not None and (DISPARITY in found or is_alone):
        bound = KEPT_DOUBT_STDS if DISPARITY in found else np.sqrt(DOUBT_SQUARE)
        if abs(check.off) > bound * check.std:
            variance = check.off**2
    if SIZE in measured and has_width + (DISPARITY in found) < 2:
        residual = measured[SIZE](agreed.state)
        bound = KEPT_DOUBT_STDS**2 if SIZE in found else DOUBT_SQUARE
        if normalised_square(residual) > bound:
            towards = np.concatenate([pose.position_m, np.zeros(5)])  # of a depth that is larger by its whole
            off = float(residual.whitened[0]) / float(residual.derivative[0] @ towards)
            variance = max(variance, off**2)
    return doubted(pose, variance) if variance else pose
