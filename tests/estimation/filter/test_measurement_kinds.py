"""Each kind of measurement by itself: no residual where it is true, derivatives, stacks, and what cannot be seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.estimation.instrument.measurement import LinkMeasurement
from svmdist.estimation.instrument.measurement_kinds import (
    ContourMeasurement,
    DisparityMeasurement,
    PointsMeasurement,
    PoseMeasurement,
    SizeMeasurement,
)
from svmdist.transforms import Array, make_transform, rotation_of
from svmdist.vision.lines import apparent_radius_px, tangent_normal

CAMERA = Camera.from_horizontal_fov(640, 480, np.pi / 3)
T_LINK = make_transform(rotation_of([0.4, -0.7, 0.2]), [0.01, -0.02, 0.09])
T_RIGHT_LEFT = make_transform(rotation_of([0.0, 0.01, 0.0]), [-0.005, 0.0, 0.0])
T_FRAME = make_transform(rotation_of([0.1, 0.3, -0.2]), [0.002, 0.004, -0.003])
POINTS_M = np.array([[0.0, 0.001, 0.002], [0.001, -0.002, 0.0]])
AXIS, ON_AXIS_M = np.array([0.8, 0.6, 0.0]), np.array([0.0, 0.001, 0.0])
STEP = 1e-6


def true_measurements() -> dict[str, LinkMeasurement]:
    """One of each kind, as `T_LINK` would give it without noise."""
    R, p_m = T_LINK[:3, :3], T_LINK[:3, 3]
    pixels = CAMERA.project(POINTS_M @ R.T + p_m)
    right_m = T_RIGHT_LEFT[:3, :3] @ p_m + T_RIGHT_LEFT[:3, 3]
    disparity_px = float(CAMERA.project(p_m)[0, 0] - CAMERA.project(right_m)[0, 0])
    point_m = R @ POINTS_M[0] + p_m
    point_right_m = T_RIGHT_LEFT[:3, :3] @ point_m + T_RIGHT_LEFT[:3, 3]
    point_disparity_px = float(CAMERA.project(point_m)[0, 0] - CAMERA.project(point_right_m)[0, 0])
    size_px = float(apparent_radius_px(p_m, 0.00175, CAMERA))
    normal = tangent_normal(R @ ON_AXIS_M + p_m, R @ AXIS, 0.004, 1)
    across = np.stack([R @ AXIS, np.cross(normal, R @ AXIS)])
    I2, I6 = np.eye(2), np.eye(6)
    return {
        "points": PointsMeasurement("points", None, CAMERA, POINTS_M, pixels, np.eye(4)),
        "disparity": DisparityMeasurement(
            "disparity", None, CAMERA, CAMERA, T_RIGHT_LEFT, disparity_px, np.eye(1)
        ),
        "disparity of a point": DisparityMeasurement(
            "disparity",
            None,
            CAMERA,
            CAMERA,
            T_RIGHT_LEFT,
            point_disparity_px,
            np.eye(1),
            p_link_m=POINTS_M[0],
        ),
        "size": SizeMeasurement("size", None, CAMERA, 0.00175, size_px, np.eye(1), 0.2),
        "contour": ContourMeasurement("contour", None, normal, across, I2, ON_AXIS_M, AXIS, 0.004, 1, I2),
        "pose": PoseMeasurement("pose", None, T_FRAME, T_LINK @ T_FRAME, I6, I6),
    }


SEEN = true_measurements()


def moved(T: Array, step: Array) -> Array:
    return make_transform(rotation_of(step[3:]) @ T[:3, :3], T[:3, 3] + step[:3])


@pytest.mark.parametrize("kind", SEEN)
def test_there_is_no_residual_at_the_truth(kind: str) -> None:
    """To rounding, in px, rad and m."""
    np.testing.assert_allclose(SEEN[kind].linearise(T_LINK).residual, 0.0, atol=1e-9)


@pytest.mark.parametrize("kind", SEEN)
@pytest.mark.parametrize("seed", range(4))
def test_derivatives_are_those_of_central_differences(kind: str, seed: int) -> None:
    """Some millimetres and degrees off: to 1e-6 of the largest, which rounding over steps of 1e-6 leaves."""
    rng = np.random.default_rng(seed)
    T = moved(T_LINK, rng.normal(0.0, 1.0, 6) * ([2e-3] * 3 + [0.05] * 3))
    numeric = np.stack(
        [
            (SEEN[kind].linearise(moved(T, step)).residual - SEEN[kind].linearise(moved(T, -step)).residual)
            / (2.0 * STEP)
            for step in STEP * np.eye(6)
        ],
        -1,
    )
    derivative = SEEN[kind].linearise(T).derivative
    np.testing.assert_allclose(derivative, numeric, atol=1e-6 * np.abs(numeric).max())


@pytest.mark.parametrize("kind", SEEN)
def test_many_poses_are_as_each_alone(kind: str) -> None:
    """Along leading axes, to rounding."""
    rng = np.random.default_rng(7)
    poses = np.stack([moved(T_LINK, 1e-3 * rng.normal(size=6)) for _ in range(3)])
    together = SEEN[kind].linearise(poses)
    for index, T in enumerate(poses):
        alone = SEEN[kind].linearise(T)
        np.testing.assert_allclose(together.residual[index], alone.residual, atol=1e-12)
        np.testing.assert_allclose(together.derivative[index], alone.derivative, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("kind", ["points", "disparity", "size"])
def test_what_is_behind_the_camera_is_marked(kind: str) -> None:
    """Beside a pose that is before it, which stays as it is alone."""
    behind = T_LINK.copy()
    behind[2, 3] = -0.05
    both = SEEN[kind].linearise(np.stack([behind, T_LINK]))
    assert np.isinf(both.residual[0]).all()
    assert np.isnan(both.derivative[0]).all()
    np.testing.assert_allclose(both.residual[1], 0.0, atol=1e-9)


def test_inside_of_the_shaft_there_is_no_contour() -> None:
    inside = make_transform(np.eye(3), -ON_AXIS_M)
    assert np.isinf(SEEN["contour"].linearise(inside).residual).all()


@pytest.mark.parametrize("kind", SEEN)
def test_a_bias_has_the_stated_shape(kind: str) -> None:
    seen = SEEN[kind].linearise(T_LINK)
    bias = SEEN[kind].bias_jacobian(T_LINK, seen.derivative)
    assert bias.shape == (len(seen.residual), SEEN[kind].bias_size)


@pytest.mark.parametrize("kind", ["contour", "pose"])
def test_where_nothing_of_an_error_lasts_there_is_no_bias(kind: str) -> None:
    """Alone, and beside others in a stack."""
    one = SEEN[kind]
    none = replace(one, bias_covariance=np.zeros_like(one.bias_covariance))  # type: ignore[attr-defined,type-var]
    root = one.bias_jacobian(T_LINK, np.empty(0))
    np.testing.assert_array_equal(none.bias_jacobian(T_LINK, np.empty(0)), np.zeros_like(root))
    stack = replace(one, bias_covariance=np.stack([none.bias_covariance, one.bias_covariance]))  # type: ignore[attr-defined,type-var]
    np.testing.assert_array_equal(stack.bias_jacobian(T_LINK, np.empty(0)), [np.zeros_like(root), root])
