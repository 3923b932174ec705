"""Nominal parameters, the cameras' in a log and the instrument's, tag's and plane's in a profile, against true ones.

Nominal is true, times or plus the strength.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import cv2
import numpy as np

from svmdist.camera import Camera
from svmdist.errors import UsageError
from svmdist.perturbations import Perturbations, direction
from svmdist.profile import Profile
from svmdist.profile.robot import OtherInstrument
from svmdist.profile.toml import StrictModel
from svmdist.samples import Image, RightView
from svmdist.transforms import Array, rotation_of
from svmdist.vision.degradations import dimmed, subsampled

TURN_DEG_PER_MM = 4.0  # rotation of a tag that is glued on a millimetre off: a plate of 9 mm that lies on one edge

Model = TypeVar("Model", bound=StrictModel)


def nominal_camera(camera: Camera, perturbations: Perturbations, *, right: bool = False) -> Camera:
    """A camera as a log has it: the right one of a pair with its baseline in P, which of others stays."""
    P = camera.P
    if perturbations.has("focal", "principal_point"):
        scale, shift_px = 1.0 + 1e-2 * perturbations["focal"], perturbations["principal_point"]
        P = None if P is None else _intrinsics(P, scale, shift_px)
        camera = replace(camera, K=_intrinsics(camera.K, scale, shift_px), P=P)
    if right and P is not None and P[0, 3] and perturbations.has("baseline"):  # a pair
        P = P.copy()
        P[0, 3] -= P[0, 0] * 1e-3 * perturbations["baseline"]
        camera = replace(camera, P=P)
    return camera


def right_turn(perturbations: Perturbations) -> Array:
    """The unmodelled rotation of the right camera in its own axes, shape (3, 3)."""
    # A log states that its pair is rectified: the pair is not, and no method would accept one that says so.
    axes = ("right_pitch", "right_yaw", "right_roll")  # about x, y and z
    return rotation_of(np.deg2rad([perturbations[name] for name in axes]))


def zoomed_camera(camera: Camera, zoom: float) -> Camera:
    """The camera that sees what another one sees, enlarged about the middle of the image."""
    enlarge = np.diag([zoom, zoom, 1.0])
    enlarge[:2, 2] = (1 - zoom) * (np.array([camera.width_px, camera.height_px]) - 1) / 2.0
    return replace(camera, K=enlarge @ camera.K, P=None if camera.P is None else enlarge @ camera.P)


def _intrinsics(matrix: Array, scale: float, shift_px: float) -> Array:
    """K, shape (3, 3), or P, shape (3, 4), with other focal lengths and another principal point."""
    changed = matrix.copy()
    changed[:2, :2] *= scale
    changed[:2, 3:] *= scale
    changed[:2, 2] += shift_px
    return changed


def perturbed_image(image_bgr: Image, perturbations: Perturbations) -> Image:
    """Apply to an image of either camera, shape (height, width, 3), what can be applied at replay."""
    zoom, chroma = perturbations["zoom"], perturbations["chroma"]
    if zoom != 1.0:  # about the image's middle; of a smaller one the border is black
        height, width = image_bgr.shape[:2]
        T = np.column_stack([zoom * np.eye(2), (1.0 - zoom) * 0.5 * np.array([width - 1, height - 1])])
        image_bgr = np.asarray(cv2.warpAffine(image_bgr, T, (width, height), flags=cv2.INTER_CUBIC), np.uint8)
    image_bgr = dimmed(image_bgr, perturbations["border"], perturbations["vignette"])
    return subsampled(image_bgr, chroma) if chroma else image_bgr


def perturbed_right_view(right: RightView, perturbations: Perturbations) -> RightView:
    """Apply the same to the right view, and what concerns the right camera alone; what comes into view is black."""
    image_bgr, camera = right.image_bgr, right.camera
    # Hartley & Zisserman, Multiple View Geometry, sec. 8.4; the lens' distortion is taken to turn along.
    if perturbations.has("right_yaw", "right_pitch", "right_roll"):
        H = camera.K @ right_turn(perturbations).T @ np.linalg.inv(camera.K)
        size = (camera.width_px, camera.height_px)
        image_bgr = np.asarray(cv2.warpPerspective(image_bgr, H, size, flags=cv2.INTER_CUBIC), np.uint8)
    return replace(right, image_bgr=perturbed_image(image_bgr, perturbations))


def built_profile(profile: Profile, perturbations: Perturbations, seed: int) -> Profile:
    """The world of which the profile is nominal: `nominal_profile` of it is the profile again."""
    built = nominal_profile(profile, perturbations, seed, -1)
    if built.simulation is None or not perturbations.has("plane"):
        return built
    height_m = built.simulation.camera_height_m - 1e-3 * perturbations["plane"]
    return _with(built, simulation=_with(built.simulation, camera_height_m=height_m))


def plane_tilt(perturbations: Perturbations, seed: int) -> Array:
    """The rotation from the true to the nominal normal of the plane, in the camera's axes, shape (3, 3)."""
    return rotation_of(np.array([*direction(seed, "plane_tilt", 2), 0.0]) * np.deg2rad(perturbations["plane_tilt"]))


def nominal_profile(profile: Profile, perturbations: Perturbations, seed: int, sign: int = 1) -> Profile:
    """The nominal profile of a world that is as this one has it; of `sign` -1 the world of a nominal profile."""

    def scaled(length_m: float, name: str) -> float:
        return float(length_m * (1.0 + 1e-2 * perturbations[name]) ** sign)

    def tool(part: Profile | OtherInstrument) -> dict[str, object]:
        robot, instrument = part.robot, part.instrument
        if robot is not None and perturbations.has("wrist_length"):
            joints = list(robot.joints)
            # The wrist's length is the last one along a link's x axis: from its pitch to its yaw.
            for index in [index for index, joint in enumerate(joints) if joint.a_m][-1:]:
                a_m = joints[index].a_m + sign * 1e-3 * perturbations["wrist_length"]
                joints[index] = _with(joints[index], a_m=a_m)
            robot = _with(robot, joints=tuple(joints))
        if instrument is not None and perturbations.has("shaft_radius", "knuckle_radius"):
            shaft_m = scaled(instrument.shaft_radius_m, "shaft_radius")
            knuckle_m = scaled(instrument.knuckle_radius_m, "knuckle_radius")
            instrument = _with(instrument, shaft_radius_m=shaft_m, knuckle_radius_m=knuckle_m)
        return {"robot": robot, "instrument": instrument}

    fiducial, tissue = profile.fiducial, profile.tissue
    if fiducial is not None and perturbations.has("tag_size", "tag_mount"):
        fiducial = _with(fiducial, size_m=scaled(fiducial.size_m, "tag_size"))
        if mount_mm := sign * perturbations["tag_mount"]:
            shift_m = 1e-3 * mount_mm * direction(seed, "tag_mount", 3)
            turn = rotation_of(np.deg2rad(TURN_DEG_PER_MM) * mount_mm * direction(seed, "tag_mount turn", 3))
            position_m = tuple((np.array(fiducial.position_m) + shift_m).tolist())
            R = tuple(tuple(row) for row in (np.array(fiducial.rotation) @ turn).tolist())
            fiducial = _with(fiducial, position_m=position_m, rotation=R)
    if tissue is not None and perturbations.has("plane", "plane_tilt"):
        distance_m = tissue.plane_distance_m + sign * 1e-3 * perturbations["plane"]
        if distance_m <= 0.0:
            raise UsageError(f"perturbation plane: the plane would be {-1e3 * distance_m:g} mm behind the camera")
        R_nominal = plane_tilt(perturbations, seed)
        normal = (R_nominal if sign > 0 else R_nominal.T) @ tissue.plane_normal
        plane_normal = tuple((normal / np.linalg.norm(normal)).tolist())
        tissue = _with(tissue, plane_distance_m=distance_m, plane_normal=plane_normal)
    others = tuple(_with(other, **tool(other)) for other in profile.other_instruments)
    return _with(profile, **tool(profile), fiducial=fiducial, tissue=tissue, other_instruments=others)


def _with(model: Model, **update: object) -> Model:
    """A copy of a part of a profile; the ranges of the table keep its values possible."""
    return model.model_copy(update=update)
