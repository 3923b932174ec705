"""Where the fit of a shaft starts: the closed form of both sides, or the robot's belief and the knuckle's size."""

from __future__ import annotations

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.instrument.cylinder import CylinderAxis, axis_of_cylinder
from svmdist.estimation.instrument.shaft_model import ShaftModel, apparent_radius_px
from svmdist.estimation.instrument.shaft_sight import ShaftSight
from svmdist.transforms import Array, make_transform
from svmdist.vision.edges import straightened


def first_shaft(sight: ShaftSight, model: ShaftModel, camera: Camera) -> Array | str:
    """A first `T_camera_shaft`, shape (4, 4): by the closed form, or by belief; or why there is none."""
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


def _ray(pixel: Array, camera: Camera) -> Array:
    x, y = straightened(camera, pixel[None])[0]
    return np.array([x, y, 1.0])
