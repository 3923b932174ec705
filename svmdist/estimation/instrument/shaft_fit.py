"""The shaft's pose by weighted least squares over everything that an image and the wrist tell of it.

Unknown are the six of the shaft's frame and two of the wrist's bend. The closed form of `cylinder` starts the
iteration; Gauss-Newton ends it, and the inverse of its normal matrix is the covariance.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.instrument.cylinder import CylinderAxis, axis_of_cylinder, tangent_normal
from svmdist.estimation.instrument.pose import ToolPose
from svmdist.estimation.instrument.shaft_sight import ShaftSight
from svmdist.transforms import Array, make_transform, rotation_of, rotation_vector
from svmdist.vision.edges import straightened

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
class ShaftModel:
    """The instrument behind its shaft's frame S: origin on the wrist's hinge, z along the shaft to the tip.

    `T_shaft_tool` is the wrist as the joints bend it, `bend_std_rad` how wrong that may be about each axis
    across the shaft. `R_camera_shaft` (3, 3) is what the robot believes, None without its base, with
    `rotation_std_rad`. The dark part ends `neck_m` behind the hinge.
    """

    T_shaft_tool: Array
    bend_std_rad: float
    R_camera_shaft: Array | None
    rotation_std_rad: float
    radius_m: float
    neck_m: float
    knuckle_radius_m: float


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
    start = _start(sight, model, camera)
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


def _start(sight: ShaftSight, model: ShaftModel, camera: Camera) -> Array | str:
    """A first `T_camera_shaft`: from the closed form, or from belief and the knuckle's size."""
    return (_start_from_sides if len(sight.contours) == 2 else _start_from_belief)(sight, model, camera)


def _start_from_sides(sight: ShaftSight, model: ShaftModel, camera: Camera) -> Array | str:
    axis = axis_of_cylinder(sight.contours[0].plane, sight.contours[1].plane, model.radius_m)
    if axis is None:
        return "the shaft's sides are too close together"
    d = _turned_to_tip(axis, sight, model, camera)
    if d is None:
        return "nothing tells the shaft's tip from its base"
    hinge_m = _along_axis(axis.point_m, d, sight, model, camera)
    if hinge_m is None:
        return "the shaft's end is not to be seen"
    return make_transform(_frame_about(d, model.R_camera_shaft), hinge_m)


def _start_from_belief(sight: ShaftSight, model: ShaftModel, camera: Camera) -> Array | str:
    knuckle = sight.knuckle
    if model.R_camera_shaft is None:
        return "a side of the shaft is not to be seen"
    if knuckle is None or knuckle.radius_px is None:
        return "neither both sides of the shaft nor a whole knuckle"
    ray = _ray(knuckle.centre_px, camera)
    tool_m = apparent_radius_px(ray, model.knuckle_radius_m, camera) / knuckle.radius_px * ray
    return make_transform(model.R_camera_shaft, tool_m - model.R_camera_shaft @ model.T_shaft_tool[:3, 3])


def _turned_to_tip(axis: CylinderAxis, sight: ShaftSight, model: ShaftModel, camera: Camera) -> Array | None:
    d = axis.direction
    if sight.towards_tip is not None and sight.middle_px is not None:
        x, y, _ = _ray(sight.middle_px, camera)
        flow = np.array([d[0] - x * d[2], d[1] - y * d[2]])
        return d if flow @ sight.towards_tip > 0 else -d
    if model.R_camera_shaft is None:
        return None
    return d if d @ model.R_camera_shaft[:, 2] > 0 else -d


def _along_axis(p_m: Array, d: Array, sight: ShaftSight, model: ShaftModel, camera: Camera) -> Array | None:
    """The hinge: where the axis passes the landmark's ray, less the landmark's place on the straight tool."""
    if sight.rim is not None:
        ray, ahead_m = _ray(sight.rim.pixel, camera), -model.neck_m
    elif sight.knuckle is not None:
        ray, ahead_m = _ray(sight.knuckle.centre_px, camera), float(model.T_shaft_tool[2, 3])
    else:
        return None
    ray = ray / np.linalg.norm(ray)
    cosine = float(ray @ d)
    if 1.0 - cosine**2 < 1e-4:
        return None
    along_m = (cosine * float(ray @ p_m) - float(d @ p_m)) / (1.0 - cosine**2)
    return np.asarray(p_m + (along_m - ahead_m) * d)


def _frame_about(d: Array, R_believed: Array | None) -> Array:
    """A rotation whose z is `d`, with x as believed, or any."""
    x = np.eye(3)[int(np.argmin(np.abs(d)))] if R_believed is None else R_believed[:, 0]
    y = np.cross(d, x)
    y /= np.linalg.norm(y)
    return np.stack([np.cross(y, d), y, d], -1)


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


def apparent_radius_px(centre_m: Array, radius_m: float, camera: Camera) -> float:
    """Radius of the disc as large as a small sphere's image: f r / z, and 1 / cos θ longer away from the axis."""
    stretch = np.sqrt(float(np.linalg.norm(centre_m)) / abs(float(centre_m[2])))
    return float(camera.K[0, 0] * radius_m / centre_m[2] * stretch)


def _ray(pixel: Array, camera: Camera) -> Array:
    x, y = straightened(camera, pixel[None])[0]
    return np.array([x, y, 1.0])
