"""Errors of constants: what a measurement with a wrong focal length, tag or radius says, against its derivatives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.estimation.instrument.measurement import EXACT, Deviations, LinkMeasurement
from svmdist.profile import CameraError
from svmdist.transforms import Array, make_transform, rotation_of
from svmdist.vision.lines import apparent_radius_px, tangent_normal
from tests.estimation.filter.test_measurement_kinds import (
    AXIS,
    ON_AXIS_M,
    POINTS_M,
    T_FRAME,
    T_LINK,
    T_RIGHT_LEFT,
    true_measurements,
)

STATED = Camera(640, 480, np.array([[550.0, 0.0, 310.0], [0.0, 560.0, 245.0], [0.0, 0.0, 1.0]]))
SMALL = 0.2
"""Of a deviation: an error small enough for derivatives."""
DEVIATIONS = Deviations(
    CameraError(
        focal_std_fraction=4e-3,
        centre_std_px=1.5,
        baseline_std_fraction=0.01,
        right_rotation_std_rad=5e-4,
    ),
    shaft_radius_fraction=0.02,
    marker_radius_fraction=0.03,
    tag_size_fraction=5e-3,
    tag_position_m=3e-4,
    tag_rotation_rad=0.02,
)
LASTING_PX = 0.2
R, P_M = T_LINK[:3, :3], T_LINK[:3, 3]


def camera(x: dict[str, Array]) -> Camera:
    """The true camera, errors in deviations from the stated one."""
    K = STATED.K.copy()
    K[[0, 1], [0, 1]] *= 1.0 + DEVIATIONS.camera.focal_std_fraction * x["focal length"][0]
    K[:2, 2] += DEVIATIONS.camera.centre_std_px * x["principal point"]
    return replace(STATED, K=K)


def points(x: dict[str, Array]) -> LinkMeasurement:
    stated = true_measurements()["points"]
    return replace(
        stated, camera=STATED, pixels=camera(x).project(POINTS_M @ R.T + P_M), deviations=DEVIATIONS
    )  # type: ignore[type-var,arg-type]


def disparity(x: dict[str, Array]) -> LinkMeasurement:
    true_camera = replace(camera(x), K=camera({**x, "principal point": np.zeros(2)}).K)
    T = T_RIGHT_LEFT.copy()
    T[:3, 3] *= 1.0 + DEVIATIONS.camera.baseline_std_fraction * x["baseline"][0]
    turn = rotation_of(DEVIATIONS.camera.right_rotation_std_rad * x["right camera's rotation"])
    right_m = turn @ (T[:3, :3] @ P_M + T[:3, 3])
    px = float(true_camera.project(P_M)[0, 0] - true_camera.project(right_m)[0, 0])
    px += LASTING_PX * float(x["disparity of the marker"][0])
    stated = true_measurements()["disparity"]
    return replace(
        stated, left=STATED, right=STATED, disparity_px=px, lasting_std_px=LASTING_PX, deviations=DEVIATIONS
    )  # type: ignore[type-var]


def size(x: dict[str, Array]) -> LinkMeasurement:
    radius_m = 0.00175 * (1.0 + DEVIATIONS.marker_radius_fraction * x["marker radius"][0])
    px = float(apparent_radius_px(P_M, radius_m, camera(x)))
    return replace(true_measurements()["size"], camera=STATED, radius_px=px, deviations=DEVIATIONS)  # type: ignore[type-var]


def contour(x: dict[str, Array]) -> LinkMeasurement:
    radius_m = 0.004 * (1.0 + DEVIATIONS.shaft_radius_fraction * x["shaft radius"][0])
    true_normal = tangent_normal(R @ ON_AXIS_M + P_M, R @ AXIS, radius_m, 1)
    line = np.linalg.inv(camera(x).K).T @ true_normal
    normal = STATED.K.T @ line
    normal /= np.linalg.norm(normal)
    across = np.stack([R @ AXIS, np.cross(normal, R @ AXIS)])
    stated = true_measurements()["contour"]
    focal_px = (float(STATED.K[0, 0]), float(STATED.K[1, 1]))
    return replace(stated, normal=normal, across=across, focal_px=focal_px, deviations=DEVIATIONS)  # type: ignore[type-var]


def tag(x: dict[str, Array]) -> LinkMeasurement:
    """What a tag's four corners say, were it of the stated size and the camera the stated one."""
    import cv2

    true_size_m = 0.01 * (1.0 + DEVIATIONS.tag_size_fraction * x["tag size"][0])
    shift_m = DEVIATIONS.tag_position_m * x["tag mounting"][:3]
    turn = DEVIATIONS.tag_rotation_rad * x["tag mounting"][3:]
    T_camera_tag = T_LINK @ T_FRAME @ make_transform(rotation_of(turn), shift_m)
    square = 0.5 * np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])
    corners_px = camera(x).project(square * true_size_m @ T_camera_tag[:3, :3].T + T_camera_tag[:3, 3])
    start = T_LINK @ T_FRAME
    _, rvec, tvec = cv2.solvePnP(
        square * 0.01, corners_px, STATED.K, None,
        cv2.Rodrigues(start[:3, :3])[0], start[:3, 3].copy(), True, cv2.SOLVEPNP_ITERATIVE,
    )  # fmt: skip
    measured = make_transform(cv2.Rodrigues(rvec)[0], tvec.ravel())
    focal_px = (float(STATED.K[0, 0]), float(STATED.K[1, 1]))
    stated = true_measurements()["pose"]
    return replace(stated, T_camera_frame=measured, focal_px=focal_px, deviations=DEVIATIONS)  # type: ignore[type-var]


SIZES = {
    "focal length": 1,
    "principal point": 2,
    "baseline": 1,
    "right camera's rotation": 3,
    "disparity of the marker": 1,
    "marker radius": 1,
    "shaft radius": 1,
    "tag size": 1,
    "tag mounting": 6,
}
KINDS: dict[str, Callable[[dict[str, Array]], LinkMeasurement]] = {
    "points": points,
    "disparity": disparity,
    "size": size,
    "contour": contour,
    "tag": tag,
}


def errors(name: str = "", axis: int = 0) -> dict[str, Array]:
    """No errors of constants but a small one."""
    found = {key: np.zeros(count) for key, count in SIZES.items()}
    if name:
        found[name][axis] = SMALL
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_by_constants_are_those_of_wrong_constants(kind: str) -> None:
    """Each constant off by a fifth of its deviation, one after the other; 0.15 of the largest effect are allowed.

    A tag's are of first order in its size over its distance: beside its turn, its depth.
    """
    right = KINDS[kind](errors())
    at_truth = right.linearise(T_LINK).residual
    biases = right.shared_biases(T_LINK)
    assert biases
    for bias in biases:
        for axis in range(bias.jacobian.shape[-1]):
            wrong = KINDS[kind](errors(bias.name, axis)).linearise(T_LINK).residual
            effect = (wrong - at_truth) / SMALL
            rows = slice(0, 3) if kind == "tag" and bias.name != "tag mounting" else slice(None)
            np.testing.assert_allclose(
                bias.jacobian[..., axis][rows],
                effect[rows],
                atol=0.15 * float(np.abs(effect[rows]).max()) + 1e-9,
                err_msg=f"{bias.name}, {axis}",
            )


@pytest.mark.parametrize("kind", KINDS)
def test_exact_constants_have_no_effect(kind: str) -> None:
    exact = replace(KINDS[kind](errors()), deviations=EXACT)  # type: ignore[type-var]
    for bias in exact.shared_biases(T_LINK):
        if bias.name == "disparity of the marker":  # the marker's own, no constant
            continue
        np.testing.assert_array_equal(bias.jacobian, 0.0)
