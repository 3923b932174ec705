"""The shaft's pose by weighted least squares over everything that an image and the wrist tell of it.

Unknown are the six of the shaft's frame and two of the wrist's bend. `shaft_start` starts the iteration; Gauss–Newton
ends it, and the inverse of its normal matrix is the covariance.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.detection.distal_marker import DistalMarker
from svmdist.estimation.detection.shaft import ShaftDetection
from svmdist.estimation.instrument.pose import ToolPose
from svmdist.estimation.shaft_pose.model import ShaftModel
from svmdist.estimation.shaft_pose.start import first_shaft
from svmdist.results import Failure
from svmdist.settings.shaft import ShaftSettings
from svmdist.transforms import Array, make_transform, rotation_of, rotation_vector
from svmdist.vision.cylinder import tangent_normal
from svmdist.vision.sphere import apparent_radius_px

DEFAULT = ShaftSettings()
STEPS = 12
SETTLED = 1e-5
"""A step below this, in m and rad, ends the iteration: the next would be its square."""
FREE_RAD, FREE_M = 3.0, 0.1
"""Standard deviations of an angle and of a place of which nothing is known: half a turn, a whole scene."""


@dataclass(frozen=True, slots=True)
class _Landmarks:
    """What of the image a fit takes for true."""

    shaft: ShaftDetection
    marker: DistalMarker | None


@dataclass(frozen=True, slots=True)
class _Block:
    """One measurement's residual, divided by its standard deviation."""

    name: str
    whitened: Array


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
    settings: ShaftSettings = DEFAULT,
) -> ShaftFit | Failure:
    """The pose that fits most of what was seen without contradiction; or why there is none."""
    failure = None
    for trusted in _readings(_Landmarks(shaft, marker)):
        fit = _fit(trusted, model, camera, settings)
        if isinstance(fit, ShaftFit):
            return fit
        failure = failure or fit
    return failure or Failure("nothing of the shaft is to be seen")


def _readings(seen: _Landmarks) -> Iterator[_Landmarks]:
    """What may be taken for true, the whole first: a wrong landmark must not cost the frame."""
    yield seen
    shaft, marker = seen.shaft, seen.marker
    without_rim = replace(shaft, rim=None)
    if shaft.rim is not None:
        yield _Landmarks(without_rim, marker)
    if shaft.contours and marker is not None:
        is_whole = marker.radius_px is not None
        # The marker's size and a long shaft's width tell a mistake of the other; a stub is easily mistaken.
        if is_whole and not shaft.is_stub:
            yield _Landmarks(without_rim, replace(marker, radius_px=None))
        if is_whole:
            yield _Landmarks(replace(without_rim, contours=()), marker)
        if shaft.rim is not None and not shaft.is_stub:
            yield _Landmarks(shaft, None)


def _fit(seen: _Landmarks, model: ShaftModel, camera: Camera, settings: ShaftSettings) -> ShaftFit | Failure:
    start = first_shaft(seen.shaft, seen.marker, model, camera)
    if isinstance(start, Failure):
        return start
    T, bend, normal_matrix, blocks = _solve(start, seen, model, camera, settings)
    if not np.all(np.isfinite(normal_matrix)):
        return Failure("the fit does not converge")
    worst = max(blocks, key=lambda block: float(block.whitened @ block.whitened))
    if float(worst.whitened @ worst.whitened) > settings.gate_chi2:
        return Failure(f"{worst.name} does not fit the rest")
    covariance = np.linalg.inv(normal_matrix)
    T_tool = _tool(T, bend, model)
    J = _numeric(lambda x: _difference(_tool(*_moved(T, bend, x), model), T_tool))
    pose = ToolPose(T_tool, J @ covariance @ J.T, T[:3, 2].copy())
    return ShaftFit(pose, T, tuple(block.name for block in blocks))


def _solve(
    T: Array, seen: _Landmarks, model: ShaftModel, camera: Camera, settings: ShaftSettings
) -> tuple[Array, Array, Array, list[_Block]]:
    bend = np.zeros(2)
    T_start = T
    whitenings = [contour.plane.whitening for contour in seen.shaft.contours]
    for _ in range(STEPS):
        here = (T, bend)

        def residual(x: Array, here: tuple[Array, Array] = here) -> Array:
            blocks = _residuals(*_moved(*here, x), seen, model, camera, settings, T_start, whitenings)
            return np.concatenate([block.whitened for block in blocks])

        J, r = _numeric(residual), residual(np.zeros(8))
        normal_matrix = J.T @ J
        if not np.all(np.isfinite(normal_matrix)) or not np.all(np.isfinite(r)):
            return T, bend, np.full((8, 8), np.nan), []
        step: Array = np.asarray(-np.linalg.solve(normal_matrix, J.T @ r), np.float64)
        step = np.asarray(step * min(1.0, 0.5 / max(float(np.linalg.norm(step[3:])), 1e-12)), np.float64)
        T, bend = _moved(T, bend, step)
        if float(np.abs(step).max()) < SETTLED:
            break
    return T, bend, normal_matrix, _residuals(T, bend, seen, model, camera, settings, T_start, whitenings)


def _residuals(
    T: Array,
    bend: Array,
    seen: _Landmarks,
    model: ShaftModel,
    camera: Camera,
    settings: ShaftSettings,
    T_start: Array,
    whitenings: list[Array],
) -> list[_Block]:
    hinge_m, d = T[:3, 3], T[:3, 2]
    blocks = []
    for contour, whitening in zip(seen.shaft.contours, whitenings, strict=True):
        predicted = tangent_normal(hinge_m, d, model.radius_m, contour.side)
        off = whitening @ (predicted - contour.plane.normal)
        blocks.append(_Block(f"side {contour.side:+d}", off))
    if seen.shaft.rim is not None:
        foot = hinge_m - d * float(d @ hinge_m)
        point_m = hinge_m - model.neck_m * d - model.radius_m * foot / np.linalg.norm(foot)
        off_px = float((seen.shaft.rim.pixel - camera.project(point_m)[0]) @ seen.shaft.rim.towards_tip)
        std_px = float(
            np.hypot(seen.shaft.rim.std_px, settings.end_model_std_m * camera.K[0, 0] / point_m[2])
        )
        blocks.append(_Block("rim", np.array([off_px / std_px])))
    if seen.marker is not None:
        marker = seen.marker
        tool_m = _tool(T, bend, model)[:3, 3]
        off = (marker.centre_px - camera.project(tool_m)[0]) / marker.std_px
        blocks.append(_Block("distal marker", off))
        if marker.radius_px is not None:
            predicted_px = apparent_radius_px(tool_m, model.knuckle_radius_m, camera)
            off_size = (marker.radius_px - predicted_px) / marker.radius_std_px
            blocks.append(_Block("size", np.array([off_size])))
    R_prior = model.R_camera_shaft if model.R_camera_shaft is not None else T_start[:3, :3]
    std_rad = model.rotation_std_rad if model.R_camera_shaft is not None else FREE_RAD
    turn = rotation_vector(T[:3, :3] @ R_prior.T)
    away = (hinge_m - T_start[:3, 3]) / FREE_M
    prior = np.concatenate([turn / std_rad, bend / model.bend_std_rad, away])
    return [*blocks, _Block("nominal kinematics", prior)]


def _tool(T: Array, bend: Array, model: ShaftModel) -> Array:
    turned = make_transform(rotation_of(np.array([bend[0], bend[1], 0.0])), np.zeros(3))
    return np.asarray(T @ turned @ model.T_shaft_tool)


def _moved(T: Array, bend: Array, x: Array) -> tuple[Array, Array]:
    """The state after a step (δp, δθ, bend), shape (8,), in the camera frame."""
    return make_transform(rotation_of(x[3:6]) @ T[:3, :3], T[:3, 3] + x[:3]), bend + x[6:]


def _difference(T: Array, T_from: Array) -> Array:
    turn = rotation_vector(T[:3, :3] @ T_from[:3, :3].T)
    return np.concatenate([T[:3, 3] - T_from[:3, 3], turn])


def _numeric(function: Callable[[Array], Array], step: float = 1e-6) -> Array:
    columns = []
    for index in range(8):
        x = np.zeros(8)
        x[index] = step
        columns.append((function(x) - function(-x)) / (2.0 * step))
    return np.stack(columns, -1)
