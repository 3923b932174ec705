"""Where the fit of a shaft starts: the closed form of both sides, or nominal kinematics and the marker's size."""

from __future__ import annotations

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.detection.distal_marker import DistalMarker
from svmdist.estimation.detection.shaft import ShaftDetection
from svmdist.estimation.shaft_pose.model import ShaftModel
from svmdist.results import Failure
from svmdist.transforms import Array, make_transform
from svmdist.vision.cylinder import CylinderAxis, axis_of_cylinder
from svmdist.vision.lines import undistorted
from svmdist.vision.sphere import apparent_radius_px


def first_shaft(
    shaft: ShaftDetection, marker: DistalMarker | None, model: ShaftModel, camera: Camera
) -> Array | Failure:
    """A first `T_camera_shaft`, shape (4, 4): by the closed form, or by nominal kinematics; or why there is none."""
    if len(shaft.contours) == 2:
        return _start_from_sides(shaft, marker, model, camera)
    return _start_from_nominal(marker, model, camera)


def _start_from_sides(
    shaft: ShaftDetection, marker: DistalMarker | None, model: ShaftModel, camera: Camera
) -> Array | Failure:
    axis = axis_of_cylinder(shaft.contours[0].plane, shaft.contours[1].plane, model.radius_m)
    if axis is None:
        return Failure("the shaft's sides are too close together")
    d = _turned_to_tip(axis, shaft, model, camera)
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


def _turned_to_tip(
    axis: CylinderAxis, shaft: ShaftDetection, model: ShaftModel, camera: Camera
) -> Array | None:
    d = axis.direction
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
        ray, ahead_m = (
            _ray(shaft.rim.pixel, camera),
            model.outline_end_m if shaft.rim.is_outline else -model.neck_m,
        )
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
    """A rotation whose z is `d`, with the nominal x, or any."""
    x = np.eye(3)[int(np.argmin(np.abs(d)))] if R_nominal is None else R_nominal[:, 0]
    y = np.cross(d, x)
    y /= np.linalg.norm(y)
    return np.stack([np.cross(y, d), y, d], -1)


def _ray(pixel: Array, camera: Camera) -> Array:
    x, y = undistorted(camera, pixel[None])[0]
    return np.array([x, y, 1.0])
