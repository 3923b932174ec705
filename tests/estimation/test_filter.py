"""The filter finds kinematic errors again, and is as sure of them as it should be."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.estimation.instrument.kinematic_error_filter import KinematicErrorFilter
from svmdist.estimation.instrument.measurement import LinkMeasurement
from svmdist.estimation.instrument.measurement_kinds import ContourMeasurement, PointsMeasurement
from svmdist.kinematics import forward_kinematics, frame_transforms, row_index, shaft_of, solve_position
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile import KinematicError
from svmdist.transforms import Array, inverse, make_transform, rotation_of, rotation_z, transform_points
from svmdist.vision.lines import tangent_normal
from tests.shipped import CHAIN, CONSTANT_ERROR, POSTURE, PROFILE

SHAFT = shaft_of(CHAIN)
RADIUS_M = PROFILE.instrument.shaft_radius_m
CAMERA = Camera.from_horizontal_fov(640, 480, PROFILE.simulation.horizontal_fov_rad)
T_WORLD_BASE = make_transform(rotation_z(PROFILE.simulation.base_yaw_rad), PROFILE.simulation.base_position_m)
T_WORLD_CAMERA = make_transform(np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, PROFILE.simulation.camera_height_m])
T_CAMERA_BASE = inverse(T_WORLD_CAMERA) @ T_WORLD_BASE
POINT_STD_PX = 0.4
EDGE_STD_RAD = np.array([6e-3, 2.5e-4])
"""Along the edge, seen on a short stretch, and across it: 0.2 px in the middle."""
FRAME_COUNT = 40
MOVING = slice(CHAIN.joint_names.index("yaw"), None)


def joints_path(seed: int) -> Array:
    """A figure over the field, the wrist in motion, shape (n, n_joints)."""
    rng = np.random.default_rng(seed)
    s, phase = np.arange(FRAME_COUNT) / 80.0, rng.uniform(0.0, 2 * np.pi, 3)
    x_m, y_m = 0.034 * np.sin(6 * np.pi * s + phase[0]), 0.024 * np.sin(4 * np.pi * s + phase[1])
    z_m = PROFILE.simulation.working_height_m + 0.002 * np.sin(3 * np.pi * s + phase[2])
    q = np.tile(POSTURE, (FRAME_COUNT, 1))
    for name, swing in (("wrist_pitch", 0.3), ("wrist_yaw", 0.4), ("roll", 0.3)):
        q[:, CHAIN.joint_names.index(name)] += swing * np.sin(2.6 * np.pi * s + phase[0])
    p_base_m = transform_points(inverse(T_WORLD_BASE), np.stack([x_m, y_m, z_m], -1))
    return solve_position(CHAIN, q, p_base_m, ["yaw", "pitch", "insertion"])


def measure(q: Array, rng: np.random.Generator) -> list[LinkMeasurement]:
    """The tool's origin and the shaft's two edges, with noise."""
    tool_m = (T_CAMERA_BASE @ forward_kinematics(CHAIN, q))[:3, 3]
    pixel = CAMERA.project(tool_m[None]) + POINT_STD_PX * rng.normal(size=(1, 2))
    covariance = np.eye(2) * POINT_STD_PX**2
    seen: list[LinkMeasurement] = [
        PointsMeasurement("distal marker", None, CAMERA, np.zeros((1, 3)), pixel, covariance, 0.0)
    ]
    T_camera_shaft = T_CAMERA_BASE @ frame_transforms(CHAIN, q)[row_index(CHAIN, SHAFT.link)]
    axis, tip_m = T_camera_shaft[:3, :3] @ SHAFT.axis, T_camera_shaft[:3, 3]
    for side in (1, -1):
        normal = tangent_normal(tip_m, axis, RADIUS_M, side)
        across = np.stack([axis, np.cross(normal, axis)])
        normal = normal + across.T @ (EDGE_STD_RAD * rng.normal(size=2))
        edge = (normal / np.linalg.norm(normal), across, np.diag(EDGE_STD_RAD**2), SHAFT.p_axis_m, SHAFT.axis)
        seen.append(ContourMeasurement("edge", SHAFT.link, *edge, RADIUS_M, side, 1e-16 * np.eye(2)))
    return seen


def reported(path: Array, backlash_rad: float) -> Array:
    """Joints as they are reported, shape (n, n_joints): turning ones trail by the direction of their motion."""
    band = np.where(CHAIN.is_revolute, backlash_rad, 0.0)
    band[: MOVING.start] = 0.0
    found, trailing = path.copy(), path[0]
    for frame, q in enumerate(path):
        trailing = np.clip(trailing, q - band, q + band)
        found[frame] = q + (q - trailing)
    return found


def late_errors(seed: int, error: KinematicError, backlash_rad: float = 0.0) -> tuple[Array, Array]:
    """Errors in m and normalised errors squared after 2 s, of joint offsets and a base drawn by the profile."""
    rng = np.random.default_rng(1000 + seed)
    drawn = PROFILE.kinematic_error
    offsets = rng.normal(size=len(POSTURE)) * np.where(
        CHAIN.is_revolute, drawn.joint_std_rad, drawn.joint_std_m
    )
    offsets[: MOVING.start] = 0.0
    turn = rotation_of(rng.normal(size=3) * drawn.camera_base_std_rad)
    T_nominal = make_transform(turn, rng.normal(size=3) * drawn.camera_base_std_m) @ T_CAMERA_BASE
    kalman, path, rows = KinematicErrorFilter(CHAIN, error), joints_path(seed), []
    for frame, (q, told) in enumerate(zip(path, reported(path, backlash_rad), strict=True)):
        kalman.predict(RobotState(CHAIN, frame * 100_000_000, told + offsets, T_nominal))
        kalman.update(measure(q, rng))
        pose = kalman.tool_pose()
        off_m = pose.position_m - (T_CAMERA_BASE @ forward_kinematics(CHAIN, q))[:3, 3]
        rows.append((np.linalg.norm(off_m), off_m @ np.linalg.solve(pose.position_covariance, off_m)))
    error_m, nees = np.array(rows[20:]).T
    return error_m, nees


def test_converges_and_is_consistent() -> None:
    """From errors of centimetres to below 0.2 mm within 2 s of motion; the covariance covers the errors.

    The mean of the normalised errors squared is that of chi-square with three degrees of freedom, within
    what six correlated runs leave.
    """
    error_m, nees = np.array([late_errors(seed, CONSTANT_ERROR) for seed in range(6)]).transpose(1, 0, 2)
    assert np.sqrt(np.mean(error_m**2)) < 0.2e-3
    assert 0.8 < nees.mean() < 5.5


@pytest.mark.parametrize("is_modelled", [True, False])
def test_backlash_is_followed_and_stated(is_modelled: bool) -> None:
    """Half a degree in every joint: below 0.35 mm, and 90 % of truths in the 95 % ellipsoid (nees 7.81)."""
    error = PROFILE.kinematic_error if is_modelled else CONSTANT_ERROR
    runs = [late_errors(seed, error, np.deg2rad(0.5)) for seed in range(2000, 2004)]
    error_m, nees = np.array(runs).transpose(1, 0, 2)
    if is_modelled:
        assert np.sqrt(np.mean(error_m**2)) < 0.35e-3
        assert np.mean(nees < 7.81) > 0.9
    else:
        assert nees.mean() > 20.0
