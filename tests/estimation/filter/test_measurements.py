"""Measurements against closed forms and drawings: their residuals, their derivatives, and which side is which."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.estimation.instrument.corrected_links import CorrectedLink
from svmdist.estimation.instrument.error_model import ErrorModel
from svmdist.estimation.instrument.measurement import LinkMeasurement
from svmdist.estimation.instrument.measurement_kinds import (
    ContourMeasurement,
    DisparityMeasurement,
    PointsMeasurement,
    PoseMeasurement,
    SizeMeasurement,
)
from svmdist.estimation.instrument.state import linearise
from svmdist.kinematics.robot_state import RobotState
from svmdist.transforms import Array, inverse, make_transform, rotation_of
from tests.rotations import rotation_y
from tests.shipped import CHAIN, POSTURE, PROFILE

CAMERA = Camera.from_horizontal_fov(640, 480, np.pi / 3)
RADIUS_M = 0.004
T_LINK = make_transform(rotation_of([0.4, -0.7, 0.2]), [0.01, -0.02, 0.09])
T_RIGHT_LEFT = make_transform(rotation_y(0.01), [-0.005, 0.0, 0.0])


def measurements() -> list[LinkMeasurement]:
    """One of each kind, of a link near `T_LINK`, with residuals of a few units."""
    normal = np.array([0.0, 0.6, 0.8])
    across = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6]])
    seen = make_transform(rotation_of([0.02, 0.0, 0.01]) @ T_LINK[:3, :3], [0.012, -0.02, 0.088])
    return [
        PointsMeasurement(
            "p", None, CAMERA, np.array([[0.0, 0.001, 0.002]]), np.zeros((1, 2)), np.eye(2), 1e-4
        ),
        DisparityMeasurement("d", None, CAMERA, CAMERA, T_RIGHT_LEFT, 30.0, np.eye(1), 1e-4),
        SizeMeasurement("s", None, CAMERA, 0.00175, 12.0, np.eye(1), 0.2),
        ContourMeasurement(
            "c",
            None,
            normal,
            across,
            np.eye(2),
            np.zeros(3),
            np.array([1.0, 0.0, 0.0]),
            RADIUS_M,
            1,
            np.eye(2),
        ),
        PoseMeasurement("t", None, np.eye(4), seen, np.eye(6), np.eye(6)),
    ]


@pytest.mark.parametrize("measurement", measurements(), ids=lambda measurement: measurement.name)
def test_residuals_change_as_their_derivatives_say(measurement: LinkMeasurement) -> None:
    """Through the whole error state of a real chain, to 1e-4 of the largest, and to no correction at all."""
    model = ErrorModel(CHAIN, PROFILE.kinematic_error)
    robot = RobotState(CHAIN, 0, POSTURE, np.eye(4))
    robot = RobotState(CHAIN, 0, POSTURE, T_LINK @ inverse(robot.T_camera_tool))
    rng = np.random.default_rng(2)
    step = 1e-5 * rng.normal(size=model.size)

    def residual_after(scale: float) -> tuple[Array, Array]:
        correction = model.no_correction().retract(scale * step)
        links = model.links(model.nominal(robot), correction, model.anchor_m(robot))
        part = linearise(measurement, links.link(None))
        return part.residual, part.H

    here, H = residual_after(0.0)
    slope = 0.5 * (residual_after(-1.0)[0] - residual_after(1.0)[0])
    np.testing.assert_allclose(slope, H @ step, atol=1e-4 * np.abs(H @ step).max())
    assert np.all(np.isfinite(here))


def test_a_point_off_the_origin_moves_the_residual_by_its_bias() -> None:
    """A point seen 0.1 mm beside where it is predicted gives the residual that the bias Jacobian tells."""
    offset = np.array([0.3, -1.2, 0.7])
    p_camera_m = (T_LINK @ np.append(1e-4 * offset, 1.0))[:3]
    left_px = CAMERA.project(p_camera_m)
    right_px = CAMERA.project((T_RIGHT_LEFT @ np.append(p_camera_m, 1.0))[:3])
    point = PointsMeasurement("p", None, CAMERA, np.zeros((1, 3)), left_px, np.eye(2), 1e-4)
    disparity_px = float(left_px[0, 0] - right_px[0, 0])
    disparity = DisparityMeasurement("d", None, CAMERA, CAMERA, T_RIGHT_LEFT, disparity_px, np.eye(1), 1e-4)
    for measurement in (point, disparity):
        part = linearise(measurement, CorrectedLink(T_LINK, np.eye(6), 0))
        np.testing.assert_allclose(part.residual, part.bias_jacobian[:, :3] @ offset, rtol=2e-2, atol=1e-3)
        assert part.bias_jacobian[:, 3] == pytest.approx(0.0)  # no shading bias was stated


def test_a_shaded_sphere_is_off_as_far_as_its_ray_is_tilted() -> None:
    """A point drawn outward by 2 px times its ray's tilt: by the bias, in disparity by the views' difference."""
    p_left_m = T_LINK[:3, 3]
    T_right_left = make_transform(np.eye(3), [-0.005, 0.0, 0.0])  # rectified
    true_px = [CAMERA.project(p_m)[0] for p_m in (p_left_m, p_left_m + T_right_left[:3, 3])]
    seen_px = [px + 2.0 * (px - CAMERA.K[:2, 2]) / CAMERA.K[0, 0] for px in true_px]
    point = PointsMeasurement("p", None, CAMERA, np.zeros((1, 3)), seen_px[0][None], np.eye(2), 0.0, 2.0)
    disparity_px = float(seen_px[0][0] - seen_px[1][0])
    disparity = DisparityMeasurement(
        "d", None, CAMERA, CAMERA, T_right_left, disparity_px, np.eye(1), 0.0, 2.0
    )
    for measurement in (point, disparity):
        part = linearise(measurement, CorrectedLink(T_LINK, np.eye(6), 0))
        assert np.abs(part.residual).max() > 0.05
        np.testing.assert_allclose(part.residual, part.bias_jacobian[:, 3], rtol=1e-2)


def test_a_size_is_that_of_a_drawn_sphere() -> None:
    """The disc as large as a sphere's outline, found from the rays that touch it, to 0.02 px."""
    centre_m = np.array([0.02, -0.015, 0.09])
    distance_m, radius_m = float(np.linalg.norm(centre_m)), 0.00175
    towards = centre_m / distance_m
    u = np.cross(towards, [1.0, 0.0, 0.0])
    u /= np.linalg.norm(u)
    angle = np.linspace(0.0, 2.0 * np.pi, 2000, endpoint=False)
    side = np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * np.cross(towards, u)
    sine = radius_m / distance_m
    x, y = CAMERA.project(np.sqrt(1.0 - sine**2) * towards + sine * side).T
    area_px2 = 0.5 * abs(float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))))
    seen = SizeMeasurement("s", None, CAMERA, radius_m, float(np.sqrt(area_px2 / np.pi)), np.eye(1), 0.2)
    T = make_transform(np.eye(3), centre_m)
    assert abs(float(seen.linearise(T).residual[0])) < 0.02


def test_a_measured_pose_has_derivatives_by_its_rotation() -> None:
    """By (δp, δθ) of a link, -I and [arm] at a residual near zero, also for a frame that is off the link's origin.

    With T_seen = T_link T_link_frame, a turn δθ of the link moves the predicted frame by δθ x arm and turns it.
    """
    rng = np.random.default_rng(5)
    T_link_frame = make_transform(rotation_of([0.1, 0.3, -0.2]), [0.002, 0.004, -0.003])
    T_seen = T_LINK @ T_link_frame
    for turn_rad in (0.0, 1e-7, 2e-3):
        seen = make_transform(rotation_of([turn_rad, 0.0, 0.0]) @ T_seen[:3, :3], T_seen[:3, 3])
        measurement = PoseMeasurement("tag", None, T_link_frame, seen, np.eye(6), np.eye(6))
        D = measurement.linearise(T_LINK).derivative
        step = 1e-4 * rng.normal(size=6)
        expected = np.concatenate([-step[:3] - np.cross(step[3:], T_seen[:3, 3] - T_LINK[:3, 3]), -step[3:]])
        np.testing.assert_allclose(D @ step, expected, atol=2e-3 * np.abs(step).max())


@pytest.mark.parametrize(
    ("axis", "side", "edge_px"), [((1, 0, 0), 1, (0, 1)), ((1, 0, 0), -1, (0, -1)), ((0, 1, 0), 1, (-1, 0))]
)
def test_sides_of_a_drawn_shaft(axis: tuple[int, int, int], side: int, edge_px: tuple[int, int]) -> None:
    """Right of a shaft that runs to the image's right is below it (y is down), of one that runs down is its left.

    The silhouette is drawn from points of the cylinder's surface: the plane through the camera and the edge on that
    side is the measurement.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, 4000)
    across = np.cross(axis, [0.0, 0.0, 1.0])
    ring = RADIUS_M * (np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * np.array([0.0, 0.0, 1.0]))
    ends = []
    for along_m in (-0.01, 0.01):
        p_m = ring + along_m * np.array(axis, np.float64) + [0.0, 0.0, 0.1]
        ends.append(p_m[np.argmax(CAMERA.project(p_m) @ edge_px)])
    normal = np.cross(ends[0], ends[1])
    normal *= np.sign(normal[2]) / np.linalg.norm(normal)  # the shaft's axis is ahead on the optical axis
    seen = ContourMeasurement(
        "edge",
        None,
        normal,
        np.eye(3)[:2],
        np.eye(2),
        np.zeros(3),
        np.array(axis, np.float64),
        RADIUS_M,
        side,
        np.eye(2),
    )
    T = make_transform(np.eye(3), [0.0, 0.0, 0.1])
    np.testing.assert_allclose(seen.linearise(T).residual, 0.0, atol=1e-6)
