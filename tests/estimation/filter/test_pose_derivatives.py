"""Every measurement's derivative by its link's pose against central differences, alone and in stacks."""

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
from svmdist.estimation.instrument.window import stack
from svmdist.transforms import Array, make_transform, rotation_of
from svmdist.vision.lines import tangent_normal

IDEAL = Camera.from_horizontal_fov(640, 480, np.pi / 3)
LENS = replace(IDEAL, D=np.array([-0.3, 0.12, 2e-3, -1e-3, -0.02]))
T_LINK = make_transform(rotation_of([0.4, -0.7, 0.2]), [0.01, -0.02, 0.09])
T_RIGHT_LEFT = make_transform(rotation_of([0.0, 0.01, 0.002]), [-0.005, 0.0, 0.0])
STEP = 1e-6


def numeric_derivative(measurement: LinkMeasurement, T: Array) -> Array:
    """Central differences of the residual by (δp, δθ): truncation and rounding are below 1e-8 of the step's effect."""
    columns = []
    for column in range(6):
        residuals = []
        for sign in (1.0, -1.0):
            step = sign * STEP * np.eye(6)[column]
            moved = make_transform(rotation_of(step[3:]) @ T[:3, :3], T[:3, 3] + step[:3])
            residuals.append(measurement.linearise(moved).residual)
        columns.append((residuals[0] - residuals[1]) / (2.0 * STEP))
    return np.stack(columns, -1)


def measurements(seed: int = 0) -> list[LinkMeasurement]:
    """All kinds, also off the link's origin, through a lens, and with large residuals."""
    rng = np.random.default_rng(seed)
    across = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    axis = across[2]
    root = rng.normal(size=(6, 6))
    T_frame = make_transform(rotation_of([0.1, 0.3, -0.2]), [0.002, 0.004, -0.003])
    near, far = (
        make_transform(rotation_of(turn * rng.normal(size=3)) @ T_LINK[:3, :3], [0.012, -0.02, 0.088])
        for turn in (1e-9, 0.9)
    )
    p_m, pixels = rng.normal(0.0, 0.003, (4, 3)), rng.uniform(0.0, 400.0, (4, 2))
    return [
        PointsMeasurement(
            "origin", None, IDEAL, np.zeros((1, 3)), pixels[:1], np.diag([0.2, 0.3]), 1e-4, 0.7
        ),
        PointsMeasurement("corners", "tag", LENS, p_m, pixels, np.diag(rng.uniform(0.1, 1.0, 8)), 2e-4),
        DisparityMeasurement("ideal", None, IDEAL, IDEAL, T_RIGHT_LEFT, 30.0, np.eye(1), 1e-4, 0.5),
        DisparityMeasurement("lens", None, LENS, IDEAL, T_RIGHT_LEFT, 30.0, np.eye(1), 1e-4),
        SizeMeasurement("size", None, IDEAL, 0.00175, 12.0, np.eye(1), 0.2),
        *(
            ContourMeasurement(
                f"edge {side}",
                "shaft",
                across[0],
                across[:2],
                np.diag([1e-4, 1e-6]),
                np.array([0.001, -0.002, 0.003]),
                axis,
                0.004,
                side,
                np.diag([2e-4, 1e-6]),
            )
            for side in (1, -1)
        ),
        PoseMeasurement("near", "tag", T_frame, near @ T_frame, np.eye(6), root @ root.T),
        PoseMeasurement("far", "tag", T_frame, far, np.eye(6), np.eye(6)),
    ]


@pytest.mark.parametrize("measurement", measurements(), ids=lambda measurement: measurement.name)
def test_derivatives_are_those_of_the_residual(measurement: LinkMeasurement) -> None:
    """To 1e-7 of the largest element; rounding over the step leaves 1e-9 px/m of some 1e4."""
    found = measurement.linearise(T_LINK)
    expected = numeric_derivative(measurement, T_LINK)
    assert found.derivative.shape == (len(measurement.covariance), 6)
    np.testing.assert_allclose(found.derivative, expected, atol=1e-7 * np.abs(expected).max())


def test_the_edges_normal_is_that_of_the_cylinder() -> None:
    """Measured as `tangent_normal` predicts it, a contour has no residual, on either side, within 1e-15."""
    for contour in measurements(3):
        if isinstance(contour, ContourMeasurement):
            axis, p_m = T_LINK[:3, :3] @ contour.axis, T_LINK[:3, :3] @ contour.p_axis_m + T_LINK[:3, 3]
            normal = tangent_normal(p_m, axis, contour.radius_m, contour.side)
            seen = replace(contour, normal=normal)
            np.testing.assert_allclose(seen.linearise(T_LINK).residual, 0.0, atol=1e-15)


def test_a_stack_equals_its_members() -> None:
    """Residuals, derivatives and biases of a stack are those of each, to 1e-9 of the largest."""
    frames = [tuple(measurements(seed)) for seed in range(3)]
    # The cameras of one log are the same objects.
    stacks = stack(frames)
    assert len(stacks) == len(frames[0]) - 2  # both edges, and both poses, are of one kind
    poses = np.stack(
        [make_transform(rotation_of([0.01 * k, 0.0, 0.02]), [0.0, 0.0, 1e-3 * k]) for k in range(3)]
    )
    poses = poses @ T_LINK
    for members in stacks:
        at = poses[members.frames]
        together = members.measurement.linearise(at)
        bias = members.measurement.bias_jacobian(at, together.derivative)
        bias = np.broadcast_to(bias, (len(at), *bias.shape[-2:]))
        for k, (frame, place) in enumerate(zip(members.frames, members.places, strict=True)):
            alone = frames[frame][place]
            part = alone.linearise(at[k])
            B = alone.bias_jacobian(at[k], part.derivative)
            for found, expected in (
                (together.residual[k], part.residual),
                (together.derivative[k], part.derivative),
                (bias[k], B),
                (members.measurement.covariance[k], alone.covariance),
            ):
                np.testing.assert_allclose(found, expected, atol=1e-9 * max(1e-9, np.abs(expected).max()))


def test_what_differs_is_no_stack() -> None:
    """Measurements of two links or cameras stay apart; two names, also in one frame, do not."""
    point = PointsMeasurement("a", None, IDEAL, np.zeros((1, 3)), np.zeros((1, 2)), np.eye(2))
    others = (replace(point, name="b"), replace(point, link="tag"), replace(point, camera=LENS))
    stacks = stack([(point, *others), (point,)])
    assert len(stacks) == 3
    np.testing.assert_array_equal(stacks[0].frames, [0, 0, 1])
    np.testing.assert_array_equal(stacks[0].places, [0, 1, 0])
    np.testing.assert_array_equal(stacks[1].places, [2])


@pytest.mark.parametrize("measurement", measurements()[:7], ids=lambda measurement: measurement.name)
def test_what_cannot_be_seen_has_no_finite_residual(measurement: LinkMeasurement) -> None:
    """Behind the camera, or with the camera inside of the shaft; a visible pose beside it in a stack stays as it is."""
    hidden = make_transform(np.eye(3), [0.0, 0.0, -0.05])
    if isinstance(measurement, ContourMeasurement):
        hidden = make_transform(np.eye(3), -measurement.p_axis_m)
    alone = measurement.linearise(hidden)
    assert not np.isfinite(alone.residual).any()
    assert not np.isfinite(alone.derivative).any()
    [members] = stack([(measurement,), (measurement,)])
    both = members.measurement.linearise(np.stack([hidden, T_LINK]))
    assert not np.isfinite(both.residual[0]).any()
    np.testing.assert_allclose(both.residual[1], measurement.linearise(T_LINK).residual, rtol=1e-12)
    assert np.isfinite(both.derivative[1]).all()
