"""The filter finds kinematic errors again: consistent, through occlusion, and unharmed by outliers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.estimation.cylinder import tangent_normal
from svmdist.estimation.filter import KinematicErrorFilter, chi_square_bound, linearise, shaft_of
from svmdist.estimation.observations import (
    ContourObservation,
    LinkObservation,
    PointsObservation,
    PoseObservation,
    pose_derivative,
)
from svmdist.kinematics.chain import chain_of
from svmdist.kinematics.dh import forward_kinematics, frame_transforms
from svmdist.kinematics.inverse import solve_position
from svmdist.kinematics.jacobian import row_index
from svmdist.profile import load_profile
from svmdist.transforms import (
    Array,
    inverse,
    make_transform,
    rotation_of,
    rotation_z,
    transform_points,
)

PROFILE = load_profile()
assert PROFILE.robot is not None
assert PROFILE.simulation is not None
assert PROFILE.instrument is not None
CHAIN = chain_of(PROFILE.robot)
SHAFT = shaft_of(CHAIN)
assert SHAFT is not None
RADIUS_M = PROFILE.instrument.shaft_radius_m
CAMERA = Camera.from_horizontal_fov(640, 480, PROFILE.simulation.horizontal_fov_rad)
T_WORLD_BASE = make_transform(rotation_z(PROFILE.simulation.base_yaw_rad), PROFILE.simulation.base_position_m)
T_WORLD_CAMERA = make_transform(np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, PROFILE.simulation.camera_height_m])
T_CAMERA_BASE = inverse(T_WORLD_CAMERA) @ T_WORLD_BASE
POINT_STD_PX, LINE_STD_PX = 0.4, 0.2


@dataclass(frozen=True)
class Run:
    """By frame: error in m, normalised error squared, standard deviation in m, rejected observations."""

    error_m: Array
    nees: Array
    std_m: Array
    rejected: Array


@cache
def joints_path(seed: int, frame_count: int) -> Array:
    """A figure over the field, the wrist in motion, shape (n, n_joints)."""
    assert PROFILE.simulation is not None
    rng = np.random.default_rng(seed)
    s, phase = np.arange(frame_count) / 80.0, rng.uniform(0.0, 2 * np.pi, 3)
    p_world_m = np.stack(
        [
            0.034 * np.sin(6 * np.pi * s + phase[0]),
            0.024 * np.sin(4 * np.pi * s + phase[1]),
            PROFILE.simulation.working_height_m + 0.002 * np.sin(3 * np.pi * s + phase[2]),
        ],
        -1,
    )
    q = np.tile([PROFILE.simulation.posture[name] for name in CHAIN.joint_names], (frame_count, 1))
    for name, swing in (("wrist_pitch", 0.3), ("wrist_yaw", 0.4), ("roll", 0.3)):
        q[:, CHAIN.joint_names.index(name)] += swing * np.sin(2.6 * np.pi * s + phase[0])
    p_base_m = transform_points(inverse(T_WORLD_BASE), p_world_m)
    return solve_position(CHAIN, q, p_base_m, ["yaw", "pitch", "insertion"], tolerance_m=1e-7)


def sights(q: Array, rng: np.random.Generator, shift_px: float = 0.0) -> list[LinkObservation]:
    """The tool's pixel and the shaft's two edges, with noise; the pixel may be wrong by a shift."""
    assert SHAFT is not None
    p_tool_m = (T_CAMERA_BASE @ forward_kinematics(CHAIN, q))[None, :3, 3]
    pixel = CAMERA.project(p_tool_m) + POINT_STD_PX * rng.normal(size=(1, 2)) + shift_px
    seen: list[LinkObservation] = [
        PointsObservation(
            "region", None, CAMERA, np.zeros((1, 3)), pixel, np.eye(2) * (POINT_STD_PX**2 + 1e-12)
        )
    ]
    T_camera_shaft = T_CAMERA_BASE @ frame_transforms(CHAIN, q)[row_index(CHAIN, SHAFT.link)]
    axis, tip_m = T_camera_shaft[:3, :3] @ SHAFT.axis, T_camera_shaft[:3, 3]
    for side in (1, -1):
        line = tangent_normal(tip_m, axis, RADIUS_M, side) @ np.linalg.inv(CAMERA.K)
        line = line / np.hypot(*line[:2])
        pixels = CAMERA.project(np.stack([tip_m - 0.005 * axis, tip_m - 0.025 * axis]))
        offsets = LINE_STD_PX * rng.normal(size=2) - pixels @ line[:2] - line[2]
        pixels = pixels + offsets[:, None] * line[:2]
        seen.append(
            ContourObservation(
                "edge",
                SHAFT.link,
                CAMERA,
                pixels,
                np.eye(2) * LINE_STD_PX**2,
                SHAFT.p_axis_m,
                SHAFT.axis,
                RADIUS_M,
                side,
            )
        )
    return seen


def wrong_kinematics(rng: np.random.Generator) -> tuple[Array, Array]:
    """Joint offsets and a believed camera-to-base transform, drawn at the profile's scale about the camera."""
    error = PROFILE.kinematic_error
    is_revolute = np.array([row.joint == "revolute" for row in CHAIN.rows])
    offsets = rng.normal(size=len(CHAIN.rows)) * np.where(is_revolute, error.joint_std_rad, error.joint_std_m)
    offsets[: CHAIN.joint_names.index("yaw")] = 0.0
    turn = rotation_of(rng.normal(size=3) * error.camera_base_std_rad)
    return offsets, make_transform(turn, rng.normal(size=3) * error.camera_base_std_m) @ T_CAMERA_BASE


def run(seed: int, frame_count: int = 40, dark: range = range(0), wild: range = range(0)) -> Run:
    rng = np.random.default_rng(1000 + seed)
    offsets, T_believed = wrong_kinematics(rng)
    kalman = KinematicErrorFilter(CHAIN, PROFILE.kinematic_error)
    rows = []
    for frame, q in enumerate(joints_path(seed, frame_count)):
        kalman.predict(frame * 100_000_000, q + offsets, T_believed)
        seen = sights(q, rng, 40.0 if frame in wild else 0.0)
        verdicts = kalman.update([] if frame in dark else seen)
        pose = kalman.tool_pose()
        error = pose.position_m - (T_CAMERA_BASE @ forward_kinematics(CHAIN, q))[:3, 3]
        nees = error @ np.linalg.solve(pose.position_covariance, error)
        std_m = np.sqrt(np.trace(pose.position_covariance))
        rows.append(
            (np.linalg.norm(error), nees, std_m, sum(not verdict.is_accepted for verdict in verdicts))
        )
    return Run(*np.array(rows).T)


def test_derivatives_of_observations() -> None:
    """Residuals change as their derivatives say, for every kind of observation, to 1e-4 of the largest."""
    rng = np.random.default_rng(2)
    q = joints_path(0, 2)[0]
    kalman = KinematicErrorFilter(CHAIN, PROFILE.kinematic_error)
    kalman.predict(0, q, T_CAMERA_BASE)
    for observation in sights(q, rng):
        link = kalman._link(observation.link)
        residual, H = linearise(observation, link)
        step = 1e-6 * rng.normal(size=H.shape[1])
        kalman._correction = kalman._correction.moved(step)
        ahead = observation.residual(kalman._link(observation.link).T_camera_link[None])[0]
        kalman._correction = kalman._correction.moved(-step)
        np.testing.assert_allclose(
            residual - ahead, H @ step, atol=1e-4 * np.abs(H).max() * np.abs(step).max()
        )
        assert pose_derivative(observation, link.T_camera_link).shape == (len(residual), 6)


def test_a_measured_pose_has_derivatives_by_its_rotation() -> None:
    """By (δp, δθ) of a link, -I and [arm] at a residual near zero, also for a frame that is off the link's origin.

    With T_seen = T_link T_link_seen, a turn δθ of the link moves the predicted frame by δθ x arm and turns it.
    """
    rng = np.random.default_rng(5)
    T_camera_link = make_transform(rotation_of([0.4, -0.7, 0.2]), [0.01, -0.02, 0.09])
    T_link_seen = make_transform(rotation_of([0.1, 0.3, -0.2]), [0.002, 0.004, -0.003])
    T_seen = T_camera_link @ T_link_seen
    for turn_rad in (0.0, 1e-7, 2e-3):
        seen = make_transform(rotation_of([turn_rad, 0.0, 0.0]) @ T_seen[:3, :3], T_seen[:3, 3])
        D = pose_derivative(PoseObservation("tag", None, T_link_seen, seen, np.eye(6)), T_camera_link)
        step = 1e-4 * rng.normal(size=6)
        expected = np.concatenate(
            [-step[:3] - np.cross(step[3:], T_seen[:3, 3] - T_camera_link[:3, 3]), -step[3:]]
        )
        np.testing.assert_allclose(D @ step, expected, atol=2e-3 * np.abs(step).max())


@pytest.mark.parametrize(
    ("axis", "side", "edge_px"), [((1, 0, 0), 1, (0, 1)), ((1, 0, 0), -1, (0, -1)), ((0, 1, 0), 1, (-1, 0))]
)
def test_sides_of_a_drawn_shaft(axis: tuple[int, int, int], side: int, edge_px: tuple[int, int]) -> None:
    """Right of a shaft that runs to the image's right is below it (y is down), of one that runs down is its left.

    The silhouette is drawn from points of the cylinder's surface: the edge on that side passes the observation.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, 4000)
    across = np.cross(axis, [0.0, 0.0, 1.0])
    ring = RADIUS_M * (np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * np.array([0.0, 0.0, 1.0]))
    ends = []
    for along_m in (-0.01, 0.01):
        p_m = ring + along_m * np.array(axis, np.float64) + [0.0, 0.0, 0.1]
        pixels = CAMERA.project(p_m)
        ends.append(pixels[np.argmax(pixels @ edge_px)])
    seen = ContourObservation(
        "edge",
        None,
        CAMERA,
        np.array(ends),
        np.eye(2),
        np.zeros(3),
        np.array(axis, np.float64),
        RADIUS_M,
        side,
    )
    T = make_transform(np.eye(3), [0.0, 0.0, 0.1])
    np.testing.assert_allclose(seen.residual(T[None]), 0.0, atol=1e-3)


def test_chi_square_bound() -> None:
    """The gate agrees with the tables at 1 in 1,000 to 2.5 %, on the generous side."""
    for freedom, value in ((2, 13.816), (6, 22.458), (8, 26.124)):
        assert chi_square_bound(freedom) == pytest.approx(value, rel=2.5e-2)


def test_converges_and_is_consistent() -> None:
    """From errors of centimetres to below 0.2 mm within 2 s of motion; the covariance tells the truth.

    The mean of the normalised errors squared is that of chi-square with three degrees of freedom, within
    what twelve correlated runs leave.
    """
    runs = [run(seed) for seed in range(8)]
    late = np.concatenate([result.error_m[20:] for result in runs])
    assert np.sqrt(np.mean(late**2)) < 0.2e-3
    nees = np.mean([result.nees[20:].mean() for result in runs])
    assert 0.8 < nees < 5.5


def test_one_second_of_occlusion() -> None:
    """Kinematics corrected before carry on below 1 mm while nothing is seen, with growing uncertainty."""
    result = run(3, 40, dark=range(25, 35))
    assert np.sqrt(np.mean(result.error_m[25:35] ** 2)) < 1e-3
    assert result.std_m[34] > result.std_m[24]


def test_wild_detections_are_rejected() -> None:
    """A pixel 57 px off is told apart and moves nothing."""
    result = run(4, 40, wild=range(25, 30))
    assert np.all(result.rejected[25:30] >= 1)
    assert result.error_m[25:].max() < 0.4e-3
