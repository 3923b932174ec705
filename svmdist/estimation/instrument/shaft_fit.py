"""The shaft's pose by weighted least squares over everything that an image and the wrist tell of it.

Unknown are the six of the shaft's frame and two of the wrist's bend. `shaft_start` starts the iteration; Gauss-Newton
ends it, and the inverse of its normal matrix is the covariance.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.instrument.cylinder import tangent_normal
from svmdist.estimation.instrument.pose import ToolPose
from svmdist.estimation.instrument.shaft_model import ShaftModel, apparent_radius_px
from svmdist.estimation.instrument.shaft_sight import ShaftSight
from svmdist.estimation.instrument.shaft_start import first_shaft
from svmdist.transforms import Array, make_transform, rotation_of, rotation_vector

STEPS = 12
SETTLED = 1e-5
"""A step below this, in m and rad, ends the iteration: the next would be its square."""
GATE = 12.0
"""Squared deviation, in units of the variance, that one in 400 true observations of two numbers exceeds."""
RIM_MODEL_STD_M = 0.0002
"""A bevel, and glare on it, hide where exactly the dark ends."""
FREE_RAD, FREE_M = 3.0, 0.1
"""Standard deviations of an angle and of a place of which nothing is known: half a turn, a whole scene."""


@dataclass(frozen=True, slots=True)
class _Block:
    """One observation's residual, divided by its standard deviation."""

    name: str
    whitened: Array


@dataclass(frozen=True, slots=True)
class ShaftFit:
    """The tool's pose, the shaft's frame `T_camera_shaft`, and the observations that carried them."""

    pose: ToolPose
    T_camera_shaft: Array
    used: tuple[str, ...]


def fit_shaft(sight: ShaftSight, model: ShaftModel, camera: Camera) -> ShaftFit | str:
    """The pose that fits most of what was seen without contradiction; or why there is none, in words."""
    reason = ""
    for trusted in _readings(sight):
        fit = _fit(trusted, model, camera)
        if isinstance(fit, ShaftFit):
            return fit
        reason = reason or fit
    return reason


def _readings(sight: ShaftSight) -> Iterator[ShaftSight]:
    """What may be taken for true, the whole first: a wrong landmark must not cost the frame."""
    yield sight
    if sight.rim is not None:
        yield replace(sight, rim=None)
    if sight.contours and sight.knuckle is not None:
        whole = sight.knuckle.radius_px is not None
        # The knuckle's size and a long shaft's width tell a mistake of the other; a stub is easily mistaken.
        if whole and not sight.is_stub:
            yield replace(sight, rim=None, knuckle=replace(sight.knuckle, radius_px=None))
        if whole:
            yield replace(sight, rim=None, contours=())
        if sight.rim is not None and not sight.is_stub:
            yield replace(sight, knuckle=None)


def _fit(sight: ShaftSight, model: ShaftModel, camera: Camera) -> ShaftFit | str:
    start = first_shaft(sight, model, camera)
    if isinstance(start, str):
        return start
    T, bend, normal_matrix, blocks = _solve(start, sight, model, camera)
    if not np.all(np.isfinite(normal_matrix)):
        return "the fit does not converge"
    worst = max(blocks, key=lambda block: float(block.whitened @ block.whitened))
    if float(worst.whitened @ worst.whitened) > GATE:
        return f"{worst.name} does not fit the rest"
    covariance = np.linalg.inv(normal_matrix)
    T_tool = _tool(T, bend, model)
    J = _numeric(lambda x: _difference(_tool(*_moved(T, bend, x), model), T_tool))
    pose = ToolPose(T_tool, J @ covariance @ J.T, T[:3, 2].copy())
    return ShaftFit(pose, T, tuple(block.name for block in blocks))


def _solve(
    T: Array, sight: ShaftSight, model: ShaftModel, camera: Camera
) -> tuple[Array, Array, Array, list[_Block]]:
    bend = np.zeros(2)
    T_start = T
    whitenings = [contour.plane.whitening for contour in sight.contours]
    for _ in range(STEPS):
        here = (T, bend)

        def residual(x: Array, here: tuple[Array, Array] = here) -> Array:
            blocks = _residuals(*_moved(*here, x), sight, model, camera, T_start, whitenings)
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
    return T, bend, normal_matrix, _residuals(T, bend, sight, model, camera, T_start, whitenings)


def _residuals(
    T: Array,
    bend: Array,
    sight: ShaftSight,
    model: ShaftModel,
    camera: Camera,
    T_start: Array,
    whitenings: list[Array],
) -> list[_Block]:
    hinge_m, d = T[:3, 3], T[:3, 2]
    blocks = []
    for contour, whitening in zip(sight.contours, whitenings, strict=True):
        predicted = tangent_normal(hinge_m, d, model.radius_m, contour.side)
        off = whitening @ (predicted - contour.plane.normal)
        blocks.append(_Block(f"side {contour.side:+d}", off))
    if sight.rim is not None:
        foot = hinge_m - d * float(d @ hinge_m)
        point_m = hinge_m - model.neck_m * d - model.radius_m * foot / np.linalg.norm(foot)
        off_px = float((sight.rim.pixel - camera.project(point_m)[0]) @ sight.rim.towards_tip)
        std_px = float(np.hypot(sight.rim.std_px, RIM_MODEL_STD_M * camera.K[0, 0] / point_m[2]))
        blocks.append(_Block("rim", np.array([off_px / std_px])))
    if sight.knuckle is not None:
        knuckle = sight.knuckle
        tool_m = _tool(T, bend, model)[:3, 3]
        off = (knuckle.centre_px - camera.project(tool_m)[0]) / knuckle.std_px
        blocks.append(_Block("knuckle", off))
        if knuckle.radius_px is not None:
            predicted_px = apparent_radius_px(tool_m, model.knuckle_radius_m, camera)
            off_size = (knuckle.radius_px - predicted_px) / knuckle.radius_std_px
            blocks.append(_Block("size", np.array([off_size])))
    R_prior = model.R_camera_shaft if model.R_camera_shaft is not None else T_start[:3, :3]
    std_rad = model.rotation_std_rad if model.R_camera_shaft is not None else FREE_RAD
    turn = rotation_vector(T[:3, :3] @ R_prior.T)
    away = (hinge_m - T_start[:3, 3]) / FREE_M
    belief = np.concatenate([turn / std_rad, bend / model.bend_std_rad, away])
    return [*blocks, _Block("belief", belief)]


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
