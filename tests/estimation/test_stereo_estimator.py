"""The stereo estimator: what it refuses, and its geometry of one point."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from svmdist.estimation.stereo import StereoEstimator, _reproject
from svmdist.profile import load_profile
from svmdist.samples import Observation, RightView, Status
from tests.synthetic import make_scene

BASELINE_M = 0.005


def _observation(T_left_right: np.ndarray | None = None) -> Observation:
    scene = make_scene()
    image = scene.frame_at(0.3)
    T = np.eye(4)
    T[0, 3] = BASELINE_M
    right = RightView(image, scene.camera, T if T_left_right is None else T_left_right)
    return Observation(1, image, scene.camera, None, right, scene.T_camera_base)


def test_a_point_and_its_disparity_give_it_back() -> None:
    """Projecting a point in both views and reprojecting the disparity is the identity; the Jacobian is right."""
    camera = make_scene().camera
    p_m = np.array([0.012, -0.007, 0.091])
    left = camera.project(p_m)[0]
    disparity = left[0] - camera.project(p_m - np.array([BASELINE_M, 0.0, 0.0]))[0][0]
    found, J = _reproject(left, disparity, camera.K, BASELINE_M)
    np.testing.assert_allclose(found, p_m, atol=1e-12)
    step = 1e-5
    for axis, (du, dv, dd) in enumerate(np.eye(3) * step):
        ahead, _ = _reproject(left + np.array([du, dv]), disparity + dd, camera.K, BASELINE_M)
        np.testing.assert_allclose((ahead - found) / step, J[:, axis], atol=1e-7)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda T: T @ np.diag([1.0, -1.0, -1.0, 1.0]), "turned"),
        (lambda T: np.where(T == BASELINE_M, -BASELINE_M, T), "swapped"),
    ],
)
def test_a_pair_that_is_not_rectified_is_refused(change, said) -> None:
    """A turned right camera, or swapped views, are a rejection that says so."""
    T = np.eye(4)
    T[0, 3] = BASELINE_M
    row = StereoEstimator(load_profile()).estimate(_observation(change(T)))
    assert row.status is Status.NO_STEREO
    assert said in row.detail


def test_one_camera_is_not_enough() -> None:
    """Without a right view the frame is rejected, with what the left one shows."""
    row = StereoEstimator(load_profile()).estimate(replace(_observation(), right=None))
    assert row.status is Status.NO_STEREO
    assert row.tool_x_px is not None
    assert row.spatial_m is None


def test_without_joints_there_is_no_direction() -> None:
    """A log without joint states near the image cannot tell where the jaws point."""
    assert StereoEstimator(load_profile()).estimate(_observation()).status is Status.NO_JOINTS
