"""How high tissue stands over where the profile has it: measured by a stereo surface, and what constants do to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.estimation.dome import DomeModel
from svmdist.estimation.instrument.measurement import Deviations
from svmdist.estimation.surface import StereoSurface
from svmdist.estimation.tissue import tissue_frame
from svmdist.estimation.tissue_tracking import TissueHeight, by_constants, measured_height
from svmdist.geometry.surfaces import Plane, meet_plane, pixel_rays
from svmdist.profile import CameraError, Dome, Tissue
from svmdist.samples import RightView
from svmdist.transforms import Array, make_transform, rotation_of, transform_points
from svmdist.vision.stereo import rectified_pair

CAMERA = Camera.from_horizontal_fov(640, 480, np.pi / 3)
NORMAL = np.array([0.1, -0.15, -0.98]) / np.linalg.norm([0.1, -0.15, -0.98])
OFFSET_M = -0.108
TISSUE = Tissue(
    plane_normal=tuple(NORMAL.tolist()),
    plane_distance_m=-OFFSET_M,
    plane_distance_std_m=1e-3,
    plane_tilt_std_rad=0.02,
    motion_std_m=2e-3,
    motion_time_s=0.6,
)
CENTROID_PX = np.array([[350.0, 220.0]])
ORIGIN_M = meet_plane(pixel_rays(CAMERA, CENTROID_PX), Plane(NORMAL, OFFSET_M))[0]
T = tissue_frame(ORIGIN_M, NORMAL)
ANGLE = np.linspace(0.0, 2.0 * np.pi, 180, endpoint=False)
OUTLINE_M = transform_points(T, np.stack([0.028 * np.cos(ANGLE), 0.022 * np.sin(ANGLE), 0.0 * ANGLE], -1))
DOME = DomeModel.over(OUTLINE_M, T, Dome(height_m=0.008, height_std_m=1.4e-4, apex_std_m=2e-3))
BASELINE_M = 0.005
RIGHT = RightView(
    np.zeros((480, 640, 3), np.uint8), CAMERA, make_transform(np.eye(3), [BASELINE_M, 0.0, 0.0])
)
DEVIATIONS = Deviations(
    CameraError(
        focal_std_fraction=4e-3, centre_std_px=1.5, baseline_std_fraction=0.01, right_rotation_std_rad=5e-4
    )
)
HEIGHT = TissueHeight.of(TISSUE, ORIGIN_M)


def surface(lifted_m: float = 0.0, radius: float = 0.8) -> Array:
    """Points of the dome, lifted along the normal, in the camera frame, shape (n, 3)."""
    rng = np.random.default_rng(2)
    share, angle = radius * np.sqrt(rng.uniform(0, 1, 400)), rng.uniform(0, 2 * np.pi, 400)
    flat_m = np.stack([0.028 * share * np.cos(angle), 0.022 * share * np.sin(angle)], -1)
    return transform_points(T, np.column_stack([flat_m, DOME.height_m(flat_m) + lifted_m]))


def measure(points_m: Array, deviations: Deviations = DEVIATIONS):
    return measured_height(
        StereoSurface(points_m, 4e-4),
        DOME,
        HEIGHT,
        CAMERA,
        RIGHT,
        deviations,
    )


@pytest.mark.parametrize("lifted_m", [-3e-3, 0.0, 2e-3])
def test_a_lifted_surface_is_as_high_as_it_is(lifted_m: float) -> None:
    """To rounding; of the derivatives by constant and motion each is its deviation."""
    found = measure(surface(lifted_m))
    assert found is not None
    part, over_m = found
    assert over_m == pytest.approx(lifted_m, abs=1e-12)
    assert part.residual == pytest.approx([lifted_m], abs=1e-12)
    by_name = {bias.name: bias for bias in part.biases}
    beside_m = ORIGIN_M - OFFSET_M * NORMAL
    assert by_name["tissue plane"].jacobian[0, 0] == pytest.approx(
        np.hypot(1e-3, 0.02 * np.linalg.norm(beside_m))
    )
    assert by_name["tissue motion"].jacobian[0, 0] == 2e-3
    assert by_name["tissue motion"].correlation_time_s == 0.6


def test_too_few_points_tell_nothing() -> None:
    assert measure(surface()[:30]) is None


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_turned_right_camera_lifts_the_surface_as_stated(axis: int) -> None:
    """The same disparities read with a wrong rotation, to a tenth of the largest effect: one point stands for all."""
    pair = rectified_pair(CAMERA, RIGHT)
    assert not isinstance(pair, str)
    points_m, turn_rad = surface(radius=0.1), 2e-4

    def read(turn: Array) -> Array:
        right_m = (points_m - [BASELINE_M, 0.0, 0.0]) @ rotation_of(turn).T
        left_px, right_px = CAMERA.project(points_m), CAMERA.project(right_m)
        return pair.points(left_px, left_px[:, 0] - right_px[:, 0])  # type: ignore[union-attr]

    turned = measure(read(turn_rad * np.eye(3)[axis]))
    assert turned is not None
    rotation = next(bias for bias in turned[0].biases if bias.name == "right camera's rotation")
    stated = rotation.jacobian[0] * turn_rad / 5e-4
    assert turned[1] == pytest.approx(stated[axis], abs=0.1 * np.abs(stated).max())


def test_a_longer_baseline_and_focal_length_lift_alike() -> None:
    """Depth goes with both: what is nearer to the camera is higher, by a fraction of its depth."""
    found = measure(surface(radius=0.1))
    assert found is not None
    by_name = {bias.name: float(bias.jacobian[0, 0]) for bias in found[0].biases}
    depth_m = float(np.median(surface(radius=0.1)[:, 2]))
    assert by_name["baseline"] == pytest.approx(0.01 * depth_m * abs(NORMAL[2]), rel=0.02)
    assert by_name["focal length"] == pytest.approx(4e-3 * depth_m * abs(NORMAL[2]), rel=0.02)


def test_where_the_outlines_ray_meets_the_plane_follows_height_and_camera() -> None:
    """Against central differences of the meeting point, to 1 %."""
    biases = by_constants(ORIGIN_M, Plane(NORMAL, OFFSET_M), HEIGHT, CAMERA, DEVIATIONS)
    by_name = {bias.name: bias.jacobian for bias in biases}

    def met(offset_m: float = OFFSET_M, K: Array = CAMERA.K) -> Array:
        return meet_plane(pixel_rays(replace(CAMERA, K=K), CENTROID_PX), Plane(NORMAL, offset_m))[0]

    step_m = 1e-5
    by_height = (met(OFFSET_M + step_m) - met(OFFSET_M - step_m)) / (2 * step_m)
    np.testing.assert_allclose(by_name["tissue motion"][:, 0], 2e-3 * by_height, rtol=0.01)
    longer, shorter = CAMERA.K.copy(), CAMERA.K.copy()
    longer[[0, 1], [0, 1]] *= 1.001
    shorter[[0, 1], [0, 1]] *= 0.999
    by_focal = (met(K=longer) - met(K=shorter)) / 0.002
    np.testing.assert_allclose(by_name["focal length"][:, 0], 4e-3 * by_focal, atol=1e-7)
    for axis in (0, 1):
        shifted = CAMERA.K.copy()
        shifted[axis, 2] += 0.1
        by_centre = (met(K=shifted) - ORIGIN_M) / 0.1
        np.testing.assert_allclose(by_name["principal point"][:, axis], 1.5 * by_centre, atol=1e-7)
