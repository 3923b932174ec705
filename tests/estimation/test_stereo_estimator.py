"""The stereo estimator: what it refuses, and its geometry of one point."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.estimation.instrument.shaft_detection import DistalMarker
from svmdist.estimation.instrument.two_views import StereoMatch, match_distal_marker
from svmdist.profile import load_profile
from svmdist.samples import Observation, RightView, Status
from svmdist.vision.stereo import RectifiedPair
from tests.measuring import Measuring
from tests.synthetic import make_scene

BASELINE_M = 0.005
CAMERA = Camera.from_horizontal_fov(640, 480, np.pi / 3)
PAIR = RectifiedPair(CAMERA.K, BASELINE_M, 0.0)
P_M = np.array([0.012, -0.007, 0.091])


def disparity_px(p_m: np.ndarray) -> float:
    left, right = (CAMERA.project(p_m - [shift, 0.0, 0.0])[0] for shift in (0.0, BASELINE_M))
    return float(left[0] - right[0])


def _observation(T_left_right: np.ndarray | None = None) -> Observation:
    scene = make_scene()
    image = scene.frame_at(0.3)
    T = np.eye(4)
    T[0, 3] = BASELINE_M
    far_px = round(CAMERA.K[0, 0] * BASELINE_M / 0.09)
    right = RightView(
        np.roll(image, -far_px, axis=1), scene.camera, T if T_left_right is None else T_left_right
    )
    return Observation(1, image, scene.camera, None, right, scene.T_camera_base)


def test_a_point_and_its_disparity_give_it_back() -> None:
    """Projecting a point in both views and reprojecting the disparity is the identity; the Jacobian is right."""
    left = CAMERA.project(P_M)[0]
    found, J = PAIR.point(left, disparity_px(P_M))
    np.testing.assert_allclose(found, P_M, atol=1e-12)
    np.testing.assert_allclose(PAIR.points(left[None], np.array([disparity_px(P_M)]))[0], P_M, atol=1e-12)
    step = 1e-5
    for axis, (du, dv, dd) in enumerate(np.eye(3) * step):
        ahead, _ = PAIR.point(left + np.array([du, dv]), disparity_px(P_M) + dd)
        np.testing.assert_allclose((ahead - found) / step, J[:, axis], atol=1e-7)


def test_a_marker_of_which_a_part_is_hidden_tells_hardly_a_depth() -> None:
    """A whole one does, within what its hidden parts may differ by; one cut in one view by as much as that moves it."""
    whole = DistalMarker(CAMERA.project(P_M)[0], 0.5, 10.7, 0.2)
    right = replace(whole, centre_px=whole.centre_px - [disparity_px(P_M), 0.0])
    seen = match_distal_marker(whole, right, PAIR, 0.00175, CAMERA)
    assert isinstance(seen, StereoMatch)
    assert seen.disparity_px == pytest.approx(disparity_px(P_M))
    assert 0.1 < seen.disparity_std_px < 0.2
    for part in (replace(right, radius_px=None, area_px=120.0), replace(right, radius_px=7.0)):
        said = match_distal_marker(replace(whole, area_px=360.0), part, PAIR, 0.00175, CAMERA)
        assert isinstance(said, StereoMatch)
        assert said.disparity_std_px > 8.0 * seen.disparity_std_px
    assert "one view" in str(match_distal_marker(whole, None, PAIR, 0.00175, CAMERA))
    higher = replace(right, centre_px=right.centre_px + np.array([0.0, 9.0]))
    assert "agree" in str(match_distal_marker(whole, higher, PAIR, 0.00175, CAMERA))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda T: T + 2.0 * BASELINE_M * np.outer([0, 1, 0, 0], [0, 0, 0, 1]), "beside"),
        (lambda T: np.where(T == BASELINE_M, -BASELINE_M, T), "swapped"),
    ],
)
def test_a_pair_that_is_not_rectified_is_refused(change, said) -> None:
    """A right camera far above the left one, or swapped views, are a rejection that says so."""
    T = np.eye(4)
    T[0, 3] = BASELINE_M
    row = Measuring("stereo", load_profile()).estimate(_observation(change(T)))
    assert row.status is Status.NO_STEREO
    assert said in row.detail


def test_one_camera_is_not_enough() -> None:
    """Without a right view the frame is rejected, with what the left one shows."""
    row = Measuring("stereo", load_profile()).estimate(replace(_observation(), right=None))
    assert row.status is Status.NO_STEREO
    assert row.tissue_x_px is not None
    assert row.spatial_m is None


def test_without_joints_there_is_no_direction() -> None:
    """A log without joint states near the image cannot tell where the jaws point."""
    assert Measuring("stereo", load_profile()).estimate(_observation()).status is Status.NO_JOINTS
