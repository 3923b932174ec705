"""The pinhole camera: projection, held against OpenCV, and the comparison of two cameras."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from svmdist.camera import Camera
from tests.jacobian import check_jacobian

CAMERA = Camera.from_horizontal_fov(640, 480, np.pi / 3)


@settings(max_examples=40)
@given(st.floats(0.1, 3.0), st.integers(2, 4000), st.integers(2, 4000))
def test_the_field_of_view_spans_the_whole_width(fov_rad, width_px, height_px):
    """A ray at half the field of view meets the outer edge of the last pixel, half a pixel past its centre."""
    camera = Camera.from_horizontal_fov(width_px, height_px, fov_rad)
    x_px = camera.project([np.tan(fov_rad / 2), 0.0, 1.0])[0, 0]
    assert x_px == pytest.approx(width_px - 0.5, rel=1e-12)


@pytest.mark.parametrize(
    "lens", [{}, {"D": np.array([-0.3, 0.12, 1e-3, -2e-3, 0.04])}, {"distortion_model": "fisheye"}]
)
def test_a_pixels_ray_is_projected_to_that_pixel(lens):
    """Within 1e-6 px, for an ideal lens, a distorting one, and a fisheye's."""
    camera = replace(CAMERA, **lens)
    pixels = np.random.default_rng(1).uniform([0.0, 0.0], [640.0, 480.0], (40, 2))
    np.testing.assert_allclose(camera.project(0.1 * camera.rays(pixels)), pixels, atol=1e-6)


@pytest.mark.parametrize(
    "change",
    [
        {"width_px": 641},
        {"height_px": 481},
        {"K": CAMERA.K + np.diag([1e-3, 0, 0])},
        {"K": CAMERA.K + np.array([[0, 0, 1e-3], [0, 0, 0], [0, 0, 0]])},
        {"D": np.array([1e-6])},
    ],
)
def test_a_difference_beyond_the_tolerance_makes_another_camera(change):
    """Size, focal length, principal point and distortion distinguish cameras; trailing zeros and frames do not."""
    assert CAMERA.same_optics(Camera(640, 480, CAMERA.K, np.zeros(0), frame_id="other"))
    other = replace(CAMERA, **change)
    assert not CAMERA.same_optics(other, tolerance_px=5e-4)
    assert not other.same_optics(CAMERA, tolerance_px=5e-4)


@pytest.mark.parametrize("skew_px", [0.0, 3.0])
def test_the_projections_derivative(skew_px):
    """Against central differences to 1e-8 of some 2e4 px/m, for stacks of points; the pixels are those of `project`."""
    K = CAMERA.K + skew_px * np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    camera = replace(CAMERA, K=K)
    p_m = np.array([0.0, 0.0, 0.1]) + np.random.default_rng(2).uniform(-0.03, 0.03, (2, 5, 3))
    pixels, J = camera.project_with_derivative(p_m)
    np.testing.assert_allclose(pixels.reshape(-1, 2), camera.project(p_m.reshape(-1, 3)), atol=1e-10)
    check_jacobian(lambda step: camera.project((p_m + step).reshape(-1, 3)).ravel(), J.reshape(-1, 3), absolute=2e-4)


@pytest.mark.parametrize("model", ["plumb_bob", "rational_polynomial", "fisheye"])
@pytest.mark.parametrize("count", range(17))
def test_every_length_of_distortion_projects_or_is_refused(model, count):
    """What the camera takes, OpenCV takes as well: nothing is left for its first use to find."""
    K = np.array([[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]])
    if count > 14 or (model == "fisheye" and count > 4):
        with pytest.raises(ValueError, match="coefficients"):
            Camera(640, 480, K, np.full(count, 0.01), distortion_model=model)
        return
    camera = Camera(640, 480, K, np.full(count, 0.01), distortion_model=model)
    pixels = camera.project([[0.01, 0.02, 0.1], [0.0, 0.0, 0.2]])
    assert np.isfinite(pixels).all()
    np.testing.assert_allclose(pixels[1], [320.0, 240.0])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"K": np.eye(2)}, "K has shape"),
        ({"K": np.diag([0.0, 500.0, 1.0])}, "not calibrated"),
        ({"K": np.diag([1e9, 500.0, 1.0])}, "not calibrated"),
        ({"K": np.diag([np.nan, 500.0, 1.0])}, "not calibrated"),
        ({"D": np.array([1e9])}, "beyond"),
        ({"D": np.array([np.nan])}, "beyond"),
        ({"D": np.zeros((5, 1))}, "D has shape"),
        ({"P": np.eye(3)}, "P has shape"),
        ({"R_rectified_camera": np.eye(4)}, "R has shape"),
        ({"width_px": 0}, "0x480"),
    ],
)
def test_what_is_no_camera_is_refused_where_it_is_made(change, said):
    fields = {"width_px": 640, "height_px": 480, "K": np.diag([500.0, 500.0, 1.0])} | change
    with pytest.raises(ValueError, match=said):
        Camera(**fields)
