"""What a drawn frame says to the filter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from svmdist.estimation.frame import Frame, frame_of
from svmdist.estimation.fused import measurements
from svmdist.estimation.instrument.measurement import LinkMeasurement
from svmdist.estimation.scene import Arm
from svmdist.kinematics.robot_state import RobotState
from svmdist.results import ToolPose
from svmdist.samples import Image, JointSample, Observation, RightView
from svmdist.transforms import Array, inverse, make_transform
from svmdist.vision.segmentation import make_segmenter
from tests.shipped import CHAIN, PROFILE
from tests.synthetic import START_NS, make_scene

SCENE = make_scene()
SECONDS = 0.3
TRUTH = SCENE.T_camera_tool_at(SECONDS)
SEGMENTER = make_segmenter(PROFILE.segmentation)
T_LEFT_RIGHT = make_transform(np.eye(3), [0.005, 0.0, 0.0])


def observed(image: Image | None = None, right: bool = False) -> Observation:
    beside = None
    if right:
        other = replace(SCENE, T_camera_base=inverse(T_LEFT_RIGHT) @ SCENE.T_camera_base)
        beside = RightView(other.frame_at(SECONDS), SCENE.camera, T_LEFT_RIGHT)
    joints = JointSample(START_NS, CHAIN.joint_names, SCENE.joints_at(SECONDS))
    drawn = SCENE.frame_at(SECONDS) if image is None else image
    return Observation(START_NS, drawn, SCENE.camera, joints, beside, SCENE.T_camera_base)


def said(observation: Observation, depth_std_m: float) -> tuple[Frame, dict[str, LinkMeasurement]]:
    """The measurements by name, of a filter that expects the tool where it is."""
    frame = frame_of(observation, Arm(PROFILE), SEGMENTER)
    assert isinstance(frame.robot, RobotState)
    covariance = np.diag([1e-3, 1e-3, depth_std_m, 0.02, 0.02, 0.02]) ** 2
    found = measurements(frame, frame.robot, ToolPose(TRUTH, covariance, TRUTH[:3, 2]))
    assert len({one.name for one in found}) == len(found)
    return frame, {one.name: one for one in found}


def deviation(measurement: LinkMeasurement, T: Array) -> float:
    """The residual at a pose over what noise and bias together allow for each number, the worst of them."""
    residual = measurement.linearise(T)
    B = measurement.bias_jacobian(T, residual.derivative)
    variance = np.diag(measurement.covariance + B @ np.swapaxes(B, -1, -2))
    return float(np.max(np.abs(residual.residual) / np.sqrt(variance)))


@pytest.mark.parametrize("depth_std_m", [1e-4, 0.03])
@pytest.mark.parametrize("right", [False, True])
def test_what_is_seen_is_said(depth_std_m: float, right: bool) -> None:
    """The marker always, its disparity with a right view, its size while the depth is unknown."""
    _, found = said(observed(right=right), depth_std_m)
    assert ("disparity" in found) == right
    assert ("size" in found) == (depth_std_m > 1e-3)
    assert set(found) - {"disparity", "size"} == {"distal marker"}
    for name, size in (("distal marker", 2), ("disparity", 1), ("size", 1)):
        if name in found:
            seen = found[name].linearise(TRUTH)
            assert seen.residual.shape == (size,)
            assert seen.derivative.shape == (size, 6)
            assert found[name].covariance.shape == (size, size)
            assert found[name].link is None


def test_residuals_vanish_at_the_true_pose() -> None:
    """Within three deviations of marker and disparity; the drawn disc of 9 px has not the size of the sphere."""
    for depth_std_m in (1e-4, 0.03):
        _, found = said(observed(right=True), depth_std_m)
        for name in ("distal marker", "disparity"):
            assert deviation(found[name], TRUTH) < 3.0, name
        off = TRUTH.copy()
        off[0, 3] += 5e-3
        assert deviation(found["distal marker"], off) > 5.0
