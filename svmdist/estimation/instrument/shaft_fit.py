"""The shaft's pose by weighted least squares over everything that an image and the wrist say of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.instrument import shaft_model
from svmdist.estimation.instrument.measurement import Deviations
from svmdist.estimation.instrument.shaft_detection import DistalMarker, ShaftDetection
from svmdist.estimation.instrument.shaft_model import Landmarks, Residual, ShaftModel, ShaftState
from svmdist.least_squares import NormalEquations, Steps, minimise
from svmdist.profile.settings import ShaftSettings
from svmdist.results import Failure, ToolPose, across_std_rad
from svmdist.transforms import Array, make_transform
from svmdist.vision.lines import apparent_radius_px, axis_of_cylinder, undistorted

GATE_CHI2 = 12.0  # squared deviation that one in 400 true measurements of two numbers exceeds
DOUBT_SQUARE = 2.25  # of the marker's size against the depth by the shaft: 1.5 deviations, more than chance
STEPS = Steps(
    max_steps=12, settled=1e-5
)  # a step below it, in m and rad, is the last: the next would be its square


def normal_equations(found: Sequence[Residual]) -> NormalEquations:
    """Cost, gradient and information of all residuals; errors of constants are solved for and left out."""
    r = np.concatenate([residual.whitened for residual in found])
    J = np.concatenate([residual.derivative for residual in found])
    C = by_constants(found)
    weighted = np.linalg.solve(np.eye(len(r)) + C @ C.T, np.column_stack([J, r]))
    return NormalEquations(float(r @ weighted[:, -1]), J.T @ weighted[:, -1], J.T @ weighted[:, :-1])


def normalised_square(residual: Residual) -> float:
    """The residual's normalised square, with what constants may do to it."""
    C = by_constants([residual])
    covariance = np.eye(len(residual.whitened)) + C @ C.T
    return float(residual.whitened @ np.linalg.solve(covariance, residual.whitened))


def by_constants(found: Sequence[Residual]) -> Array:
    """Derivative of all residuals, one below the other, by every constant, shape (m, k): several may share one."""
    columns: dict[str, Array] = {}
    rows, at = sum(len(residual.whitened) for residual in found), 0
    for residual in found:
        after = at + len(residual.whitened)
        for bias in residual.constants:
            column = columns.setdefault(bias.name, np.zeros((rows, bias.jacobian.shape[-1])))
            column[at:after] += bias.jacobian
        at = after
    return np.concatenate([np.zeros((rows, 0)), *columns.values()], -1)


def first_shaft(
    shaft: ShaftDetection, marker: DistalMarker | None, model: ShaftModel, camera: Camera
) -> Array | Failure:
    """A first `T_camera_shaft`, shape (4, 4): by the closed form, or by nominal kinematics; or why there is none."""
    if len(shaft.contours) != 2:
        return _start_from_nominal(marker, model, camera)
    axis = axis_of_cylinder(shaft.contours[0].plane, shaft.contours[1].plane, model.radius_m)
    if axis is None:
        return Failure("the shaft's sides are too close together")
    d = _turned_to_tip(axis.direction, shaft, model, camera)
    if d is None:
        return Failure("nothing tells the shaft's tip from its base")
    hinge_m = _along_axis(axis.point_m, d, shaft, marker, model, camera)
    if hinge_m is None:
        return Failure("the shaft's end is not to be seen")
    return make_transform(_frame_about(d, model.R_camera_shaft), hinge_m)


def _start_from_nominal(marker: DistalMarker | None, model: ShaftModel, camera: Camera) -> Array | Failure:
    if model.R_camera_shaft is None:
        return Failure("a side of the shaft is not to be seen")
    if marker is None or marker.radius_px is None:
        return Failure("neither both sides of the shaft nor a whole distal marker")
    ray = _ray(marker.centre_px, camera)
    tool_m = apparent_radius_px(ray, model.knuckle_radius_m, camera) / marker.radius_px * ray
    return make_transform(model.R_camera_shaft, tool_m - model.R_camera_shaft @ model.T_shaft_tool[:3, 3])


def _turned_to_tip(d: Array, shaft: ShaftDetection, model: ShaftModel, camera: Camera) -> Array | None:
    if shaft.towards_tip is not None and shaft.middle_px is not None:
        x, y, _ = _ray(shaft.middle_px, camera)
        flow = np.array([d[0] - x * d[2], d[1] - y * d[2]])
        return d if flow @ shaft.towards_tip > 0 else -d
    if model.R_camera_shaft is None:
        return None
    return d if d @ model.R_camera_shaft[:, 2] > 0 else -d


def _along_axis(
    p_m: Array,
    d: Array,
    shaft: ShaftDetection,
    marker: DistalMarker | None,
    model: ShaftModel,
    camera: Camera,
) -> Array | None:
    """The hinge: where the axis passes the landmark's ray, less the landmark's place on the straight tool."""
    if shaft.rim is not None:
        ray = _ray(shaft.rim.pixel, camera)
        ahead_m = model.outline_end_m if shaft.rim.is_outline else -model.neck_m
    elif marker is not None:
        ray, ahead_m = _ray(marker.centre_px, camera), float(model.T_shaft_tool[2, 3])
    else:
        return None
    ray = ray / np.linalg.norm(ray)
    cosine = float(ray @ d)
    if 1.0 - cosine**2 < 1e-4:
        return None
    along_m = (cosine * float(ray @ p_m) - float(d @ p_m)) / (1.0 - cosine**2)
    return np.asarray(p_m + (along_m - ahead_m) * d)


def _frame_about(d: Array, R_nominal: Array | None) -> Array:
    x = np.eye(3)[int(np.argmin(np.abs(d)))] if R_nominal is None else R_nominal[:, 0]
    y = np.cross(d, x)
    y /= np.linalg.norm(y)
    return np.stack([np.cross(y, d), y, d], -1)


def _ray(pixel: Array, camera: Camera) -> Array:
    x, y = undistorted(camera, pixel[None])[0]
    return np.array([x, y, 1.0])


@dataclass(frozen=True, slots=True)
class ShaftFit:
    """The tool's pose, the shaft's frame `T_camera_shaft`, and the measurements that carried them."""

    pose: ToolPose
    T_camera_shaft: Array
    used: tuple[str, ...]


def fit_shaft(
    shaft: ShaftDetection,
    marker: DistalMarker | None,
    model: ShaftModel,
    camera: Camera,
    settings: ShaftSettings,
    deviations: Deviations,
) -> ShaftFit | Failure:
    """The pose that fits most of what was seen without contradiction; or why there is none."""
    if shaft.is_stub and shaft.contours and marker is None:
        # Anything dark at the border has two short sides; nothing here would contradict them.
        return Failure("too little of the shaft is to be seen, and neither wrist nor distal marker")
    failure = None
    for trusted in _readings(Landmarks(shaft, marker)):
        fit = _fit(trusted, model, camera, settings, deviations)
        if isinstance(fit, ShaftFit):
            return _with_doubt(fit, marker, model, camera, deviations)
        failure = failure or fit
    return failure or Failure("nothing of the shaft is to be seen")


def _readings(seen: Landmarks) -> Iterator[Landmarks]:
    """What may be taken for true, the whole first: a wrong landmark must not cost the frame."""
    yield seen
    shaft, marker = seen.shaft, seen.marker
    without_rim = replace(shaft, rim=None)
    if shaft.rim is not None:
        yield Landmarks(without_rim, marker)
    if shaft.contours and marker is not None:
        is_whole = marker.radius_px is not None
        # The marker's size and a long shaft's width tell a mistake of the other; a stub is easily mistaken.
        if is_whole and not shaft.is_stub:
            yield Landmarks(without_rim, replace(marker, radius_px=None))
        if is_whole:
            yield Landmarks(replace(without_rim, contours=()), marker)
        if shaft.rim is not None and not shaft.is_stub:
            yield Landmarks(shaft, None)


def _fit(
    seen: Landmarks, model: ShaftModel, camera: Camera, settings: ShaftSettings, deviations: Deviations
) -> ShaftFit | Failure:
    start = first_shaft(seen.shaft, seen.marker, model, camera)
    if isinstance(start, Failure):
        return start
    whitenings = [contour.plane.whitening for contour in seen.shaft.contours]

    def residuals(state: ShaftState) -> list[Residual]:
        found = [
            shaft_model.contour_residual(contour, whitening, state, model, camera, deviations)
            for contour, whitening in zip(seen.shaft.contours, whitenings, strict=True)
        ]
        if seen.shaft.rim is not None:
            found.append(shaft_model.rim_residual(seen.shaft.rim, state, model, camera, settings))
        if seen.marker is not None:
            found.append(shaft_model.marker_residual(seen.marker, state, model, camera, deviations))
        if seen.marker is not None and seen.marker.radius_px is not None:
            found.append(shaft_model.size_residual(seen.marker, state, model, camera, deviations))
        if seen.shaft.wrist is not None:
            found.append(shaft_model.tip_residual(seen.shaft.wrist, state, model, camera))
        return [*found, shaft_model.prior_residual(state, start, model)]

    first = ShaftState(start, np.zeros(2))
    least = minimise(first, lambda state: normal_equations(residuals(state)), ShaftState.retracted, STEPS)
    if least is None:
        return Failure("the fit does not converge")
    found = residuals(least.state)
    squares = [normalised_square(residual) for residual in found]
    worst = int(np.argmax(squares))
    if squares[worst] > GATE_CHI2:
        return Failure(f"{found[worst].name} does not fit the rest")
    pose = pose_at(least.state, least.equations.information, model)
    return ShaftFit(pose, least.state.T, tuple(residual.name for residual in found))


def pose_at(state: ShaftState, information: Array, model: ShaftModel) -> ToolPose:
    """The tool's pose at a minimum, with its covariance by the information, shape (8, 8)."""
    T, by_state = shaft_model.bent_tool(state, model)
    axis, of_state = state.T[:3, 2].copy(), np.asarray(np.linalg.inv(information))
    return ToolPose(T, by_state @ of_state @ by_state.T, axis, across_std_rad(of_state[3:6, 3:6], axis))


def doubted(pose: ToolPose, variance: float) -> ToolPose:
    """The pose with a variance added along the line of sight, over the depth's square."""
    covariance = pose.covariance.copy()
    covariance[:3, :3] += variance * np.outer(pose.position_m, pose.position_m)
    return replace(pose, covariance=covariance)


def _with_doubt(
    fit: ShaftFit, marker: DistalMarker | None, model: ShaftModel, camera: Camera, deviations: Deviations
) -> ShaftFit:
    """The fit, as uncertain in depth as the size of a whole marker contradicts it, whether it took that or not."""
    if marker is None or marker.radius_px is None:
        return fit
    expected_px = float(apparent_radius_px(fit.pose.position_m, model.knuckle_radius_m, camera))
    off_px = marker.radius_px - expected_px
    std_px = float(np.hypot(marker.radius_std_px, deviations.marker_radius_fraction * expected_px))
    if off_px**2 < DOUBT_SQUARE * std_px**2:
        return fit
    return replace(fit, pose=doubted(fit.pose, (off_px / expected_px) ** 2))
