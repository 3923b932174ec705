"""Where nominal kinematics put an instrument in an image, against projections of the pose itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.estimation.coloured_regions import NominalInstrument, nominal_instrument
from svmdist.estimation.instrument.error_model import nominal_tool
from svmdist.estimation.scene import Arm
from svmdist.kinematics.robot_state import RobotState
from svmdist.results import Failure, ToolPose
from svmdist.transforms import Array, inverse, make_transform, rotation_of
from tests.rotations import rotation_y
from tests.shipped import CHAIN, POSTURE, PROFILE
from tests.synthetic import make_scene

CAMERA = Camera.from_horizontal_fov(640, 480, np.pi / 3)
TOOL_M = np.array([0.012, -0.008, 0.09])


def unit(v: Array) -> Array:
    return np.asarray(v / np.linalg.norm(v))


def instrument_at(p_m: Array, axis: Array, std_m: float = 1e-4) -> NominalInstrument:
    pose = ToolPose(make_transform(np.eye(3), p_m), std_m**2 * np.eye(6), unit(axis))
    return NominalInstrument(pose, PROFILE.instrument)


def test_the_place_is_the_pose_s_projection() -> None:
    """The mean is the pixel that the camera gives; the scale is the focal length over the depth: rounding only."""
    place = instrument_at(TOOL_M, np.array([1.0, 0.0, 0.5])).place(CAMERA)
    np.testing.assert_allclose(place.place.mean, CAMERA.project(TOOL_M)[0], atol=1e-9)
    np.testing.assert_allclose(place.position_m, TOOL_M)
    assert place.px_per_m == pytest.approx(CAMERA.K[0, 0] / TOOL_M[2])


def test_the_place_s_covariance_is_that_of_projected_samples() -> None:
    """Samples of a correlated position, projected: variances within 5 %.

    20,000 samples leave 1 % (√(2/n)); what is of second order is 1 mm in 90 mm squared, less than that.
    """
    rng = np.random.default_rng(3)
    root = 1e-3 * rng.normal(size=(3, 3))
    tool = instrument_at(TOOL_M, np.array([1.0, 0.0, 0.5]))
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = root @ root.T
    tool = replace(tool, pose=replace(tool.pose, covariance=covariance))
    pixels = CAMERA.project(TOOL_M + rng.normal(size=(20_000, 3)) @ root.T)
    told = tool.place(CAMERA).place.covariance
    seen = np.cov(pixels.T)
    np.testing.assert_allclose(np.diag(told), np.diag(seen), rtol=0.05)
    assert told[0, 1] == pytest.approx(seen[0, 1], abs=0.05 * np.sqrt(seen[0, 0] * seen[1, 1]))


def test_a_tool_behind_the_camera_has_a_finite_place() -> None:
    """Nominal kinematics may err so far; the pixel is far outside or anywhere, but a number."""
    place = instrument_at(np.array([0.01, 0.0, -0.02]), np.array([1.0, 0.0, 0.5])).place(CAMERA)
    assert np.all(np.isfinite(place.place.mean))
    assert np.all(np.isfinite(place.place.covariance))


@pytest.mark.parametrize("axis", [(1.0, 0.2, 0.5), (-0.3, 1.0, -0.4), (-1.0, -1.0, 0.9)])
def test_the_shaft_runs_as_two_of_its_points_do(axis: tuple[float, float, float]) -> None:
    """The image of the tool and of a point 10 mm back along the axis lie on the direction, to 1e-9."""
    direction = unit(np.array(axis))
    tool = instrument_at(TOOL_M, direction)
    tool_px, back_px = CAMERA.project(np.stack([TOOL_M, TOOL_M - 0.01 * direction]))
    found = tool.shaft_from(tool_px, 10.0, CAMERA)
    assert found is not None
    np.testing.assert_allclose(found.direction, unit(back_px - tool_px), atol=1e-9)
    np.testing.assert_allclose(found.tool_px, tool_px)


def test_the_shaft_s_direction_needs_no_depth() -> None:
    """A tool seen at one pixel and believed at three depths: one direction, begin and radius, to rounding."""
    ray, axis = TOOL_M / TOOL_M[2], np.array([0.8, 0.3, 0.4])
    pixel = CAMERA.project(TOOL_M)[0]
    found = [instrument_at(z * ray, axis).shaft_from(pixel, 10.0, CAMERA) for z in (0.03, 0.09, 0.3)]
    for shaft in found:
        assert shaft is not None
        assert found[0] is not None
        np.testing.assert_allclose(shaft.direction, found[0].direction, atol=1e-12)
        assert (shaft.begin_px, shaft.radius_px) == pytest.approx((found[0].begin_px, found[0].radius_px))


def test_the_shaft_s_width_is_that_of_the_scale() -> None:
    """Where the region is a whole marker, the shaft is as much wider as its radius is larger."""
    instrument = PROFILE.instrument
    assert instrument is not None
    found = instrument_at(TOOL_M, np.array([1.0, 0.0, 0.0])).shaft_from(
        np.array([320.0, 240.0]), 12.0, CAMERA
    )
    assert found is not None
    assert found.radius_px == pytest.approx(12.0 * instrument.shaft_radius_m / instrument.knuckle_radius_m)
    assert found.begin_px > 0.0


def test_a_shaft_that_points_at_the_camera_runs_nowhere() -> None:
    pixel = CAMERA.project(TOOL_M)[0]
    assert instrument_at(TOOL_M, TOOL_M).shaft_from(pixel, 10.0, CAMERA) is None
    bare = replace(instrument_at(TOOL_M, np.array([1.0, 0.0, 0.0])), instrument=None)
    assert bare.shaft_from(pixel, 10.0, CAMERA) is None


def test_another_camera_sees_the_same_tool() -> None:
    """The place in a camera beside this one is the projection of the tool's point there; back and forth is nothing."""
    T = make_transform(rotation_y(0.02), [-0.005, 0.001, 0.0])
    tool = instrument_at(TOOL_M, np.array([1.0, 0.0, 0.5]))
    beside = tool.moved(T)
    np.testing.assert_allclose(
        beside.place(CAMERA).place.mean, CAMERA.project(T[:3, :3] @ TOOL_M + T[:3, 3])[0], atol=1e-9
    )
    back = beside.moved(inverse(T))
    np.testing.assert_allclose(back.pose.T_camera_tool, tool.pose.T_camera_tool, atol=1e-15)
    np.testing.assert_allclose(back.pose.axis, tool.pose.axis, atol=1e-15)


def test_it_is_the_tool_that_the_methods_state() -> None:
    """Of a robot whose base is known, `nominal_tool`'s pose; without joints or without the base there is none."""
    arm, scene = Arm(PROFILE), make_scene()
    T_camera_base = make_transform(rotation_of([0.01, 0.0, 0.02]), [0.0, 0.0, 0.001]) @ scene.T_camera_base
    robot = RobotState(CHAIN, 0, POSTURE, T_camera_base)
    found = nominal_instrument(arm, robot)
    assert found is not None
    expected = nominal_tool(CHAIN, PROFILE.kinematic_error, robot)
    np.testing.assert_array_equal(found.pose.T_camera_tool, expected.T_camera_tool)
    np.testing.assert_array_equal(found.pose.covariance, expected.covariance)
    assert nominal_instrument(arm, Failure("no joints")) is None
    assert nominal_instrument(arm, RobotState(CHAIN, 0, POSTURE)) is None
    assert nominal_instrument(Arm(PROFILE.model_copy(update={"robot": None})), robot) is None
