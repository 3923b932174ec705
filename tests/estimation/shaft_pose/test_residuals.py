"""Residuals of a shaft's pose: their derivatives are those of central differences, at any state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.estimation.instrument.shaft_detection import Contour, DistalMarker, Rim
from svmdist.estimation.instrument.shaft_model import (
    BentTool,
    Residual,
    ShaftModel,
    ShaftState,
    contour_residual,
    marker_residuals,
    prior_residual,
    rim_residual,
    tip_residual,
)
from svmdist.profile.settings import ShaftSettings
from svmdist.transforms import Array, make_transform, rotation_of, rotation_vector
from svmdist.vision.lines import TangentPlane, tangent_normal
from svmdist.vision.silhouette import WristPoint

IDEAL = Camera.from_horizontal_fov(640, 480, np.pi / 3)
CAMERA = Camera(640, 480, IDEAL.K, np.array([-0.12, 0.03, 1e-3, -5e-4, 0.0]))
WRIST = make_transform(rotation_of(np.array([0.2, -0.1, 0.4])), [0.001, -0.002, 0.009])
MODEL = ShaftModel(
    WRIST,
    0.02,
    rotation_of(np.array([0.3, 0.9, -0.2])),
    0.05,
    0.004,
    0.006,
    0.00175,
    0.0,
    0.003,
    0.001,
    0.009,
)
STEP = 1e-6
PLANE = TangentPlane(np.array([0.6, 0.0, 0.8]), np.diag([0.0, 1e-6, 4e-6]))
MARKER = DistalMarker(np.array([310.0, 250.0]), 0.5, 11.0, 0.2)
TIP = WristPoint(np.array([310.0, 250.0]), 4.0, np.array([330.0, 265.0]))
RIM = Rim(np.array([300.0, 240.0]), np.array([0.6, 0.8]), 0.4)


def states() -> list[ShaftState]:
    rng = np.random.default_rng(4)
    return [
        ShaftState(
            make_transform(rotation_of(rng.normal(0.0, 0.8, 3)), [*rng.normal(0.0, 0.01, 2), 0.09]),
            rng.normal(0.0, 0.3, 2),
        )
        for _ in range(8)
    ]


RESIDUALS: dict[str, Callable[[ShaftState], Residual]] = {
    "contour": lambda state: contour_residual(Contour(PLANE, 1), PLANE.whitening, state, MODEL.radius_m),
    "rim": lambda state: rim_residual(RIM, state, MODEL, CAMERA, ShaftSettings()),
    "outline's end": lambda state: rim_residual(
        replace(RIM, is_outline=True), state, MODEL, CAMERA, ShaftSettings()
    ),
    "tip": lambda state: tip_residual(TIP, BentTool.of(state, MODEL), MODEL, CAMERA),
    "marker": lambda state: marker_residuals(MARKER, BentTool.of(state, MODEL), MODEL, CAMERA)[0],
    "size": lambda state: marker_residuals(MARKER, BentTool.of(state, MODEL), MODEL, CAMERA)[1],
    "prior": lambda state: prior_residual(state, np.eye(4), MODEL),
}


@pytest.mark.parametrize("name", RESIDUALS)
@pytest.mark.parametrize("index", range(8))
def test_derivatives_are_those_of_central_differences(name: str, index: int) -> None:
    """Within 1e-6 of the largest: truncation and rounding of differences over 1e-6 m and rad leave less."""
    state = states()[index]
    residual = RESIDUALS[name](state)
    numeric = np.stack(
        [
            # A residual falls where what is predicted grows.
            (
                RESIDUALS[name](state.retracted(-step)).whitened
                - RESIDUALS[name](state.retracted(step)).whitened
            )
            / (2.0 * STEP)
            for step in STEP * np.eye(8)
        ],
        -1,
    )
    np.testing.assert_allclose(residual.derivative, numeric, atol=1e-6 * np.abs(numeric).max())


@pytest.mark.parametrize("index", range(8))
def test_the_bent_tool_moves_as_its_derivative_says(index: int) -> None:
    """Place and turn of the tool after a small step, to second order of a step of 1e-6."""
    state = states()[index]
    tool = BentTool.of(state, MODEL)

    def moved(step: Array) -> Array:
        T = BentTool.of(state.retracted(step), MODEL).T
        return np.concatenate([T[:3, 3], rotation_vector(T[:3, :3] @ tool.T[:3, :3].T)])

    numeric = np.stack([(moved(step) - moved(-step)) / (2.0 * STEP) for step in STEP * np.eye(8)], -1)
    np.testing.assert_allclose(tool.derivative, numeric, atol=1e-8)


def test_a_straight_wrist_is_the_model() -> None:
    """Without bend the tool stands where the model has it."""
    state = ShaftState(states()[0].T, np.zeros(2))
    np.testing.assert_allclose(BentTool.of(state, MODEL).T, state.T @ WRIST, atol=1e-12)


def test_what_is_predicted_leaves_no_residual() -> None:
    """A plane that touches the shaft of a state, and the nominal rotation, agree with it."""
    T = make_transform(np.asarray(MODEL.R_camera_shaft), [0.0, 0.01, 0.09])
    state = ShaftState(T, np.zeros(2))
    plane = TangentPlane(tangent_normal(T[:3, 3], T[:3, 2], MODEL.radius_m, -1), PLANE.covariance)
    off = contour_residual(Contour(plane, -1), plane.whitening, state, MODEL.radius_m)
    np.testing.assert_allclose(off.whitened, 0.0, atol=1e-9)
    np.testing.assert_allclose(prior_residual(state, T, MODEL).whitened, 0.0, atol=1e-9)
