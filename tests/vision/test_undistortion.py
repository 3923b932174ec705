"""Images of lenses and of turned cameras against what ideal cameras see."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.samples import Image, Observation, RightView
from svmdist.transforms import Array, make_transform, rotation_of
from svmdist.vision.frame_context import as_pinholes, seen_through
from svmdist.vision.stereo import RectifiedPair, rectified_pair

IDEAL = Camera.from_horizontal_fov(640, 480, np.pi / 3)
LENSES = {
    "plumb_bob": replace(IDEAL, D=np.array([-0.2, 0.05, 1e-3, -5e-4, 0.01])),
    "rational_polynomial": replace(
        IDEAL,
        D=np.array([0.3, -0.1, 1e-4, 2e-4, 0.02, 0.5, -0.05, 0.01]),
        distortion_model="rational_polynomial",
    ),
    "fisheye": replace(IDEAL, D=np.array([0.05, -0.01, 0.002, 0.0]), distortion_model="fisheye"),
}
POINTS_M = np.array(
    [[-0.03, -0.02, 0.09], [0.03, -0.02, 0.1], [0.0, 0.0, 0.08], [-0.02, 0.02, 0.1], [0.025, 0.018, 0.085]]
)


def drawn(camera: Camera, points_m: Array = POINTS_M) -> Image:
    """White discs of 6 px at points of the camera frame, to a sixteenth of a pixel."""
    image = np.zeros((480, 640, 3), np.uint8)
    for x, y in camera.project(points_m):
        cv2.circle(image, (round(x * 16), round(y * 16)), 96, (255, 255, 255), -1, cv2.LINE_AA, 4)
    return image


def centres(image: Image) -> Array:
    """Centroids of the discs, sorted along x, shape (n, 2)."""
    count, labels = cv2.connectedComponents((image[..., 0] > 20).astype(np.uint8))
    ys, xs = np.mgrid[:480, :640]
    found = []
    for label in range(1, count):
        weight = image[..., 0] * (labels == label).astype(np.float64)
        found.append([(weight * xs).sum() / weight.sum(), (weight * ys).sum() / weight.sum()])
    return np.array(sorted(found))


@pytest.mark.parametrize("lens", LENSES)
def test_points_are_where_an_ideal_camera_sees_them(lens: str) -> None:
    """Within 0.15 px all over the image, of which distortion moves some by more than 5 px."""
    camera = LENSES[lens]
    seen = as_pinholes(Observation(0, drawn(camera), camera))
    assert not seen.camera.has_distortion
    expected = np.array(sorted(IDEAL.project(POINTS_M).tolist()))
    assert np.abs(camera.project(POINTS_M) - IDEAL.project(POINTS_M)).max() > 5.0
    np.testing.assert_allclose(centres(seen.image_bgr), expected, atol=0.15)


@pytest.mark.parametrize("lens", LENSES)
def test_pixels_go_back_through_the_lens(lens: str) -> None:
    """Where the pinhole has a point, the lens shows it where it projects it."""
    camera = LENSES[lens]
    np.testing.assert_allclose(
        seen_through(camera, IDEAL.project(POINTS_M)), camera.project(POINTS_M), atol=1e-9
    )
    np.testing.assert_array_equal(seen_through(IDEAL, IDEAL.project(POINTS_M)), IDEAL.project(POINTS_M))


def test_an_ideal_pair_stays_the_same_object() -> None:
    """Nothing is mapped, nothing copied."""
    T = make_transform(np.eye(3), [0.005, 0.0, 0.0])
    seen = Observation(0, drawn(IDEAL), IDEAL, right=RightView(drawn(IDEAL), IDEAL, T))
    assert as_pinholes(seen) is seen


def test_a_turned_and_distorted_right_camera_becomes_parallel() -> None:
    """A camera turned by degrees, with a lens and a K of its own: rows agree, and disparity is f b / z, in 0.2 px."""
    own = replace(
        LENSES["plumb_bob"], K=IDEAL.K * np.array([[1.02], [1.02], [1.0]]) + np.diag([1.0, -1.0, 0.0])
    )
    T_left_right = make_transform(rotation_of([0.02, -0.03, 0.015]), [0.005, 0.0, 0.0])
    in_right_m = (POINTS_M - T_left_right[:3, 3]) @ T_left_right[:3, :3]
    camera = LENSES["plumb_bob"]
    seen = as_pinholes(
        Observation(0, drawn(camera), camera, right=RightView(drawn(own, in_right_m), own, T_left_right))
    )
    assert seen.right is not None
    pair = rectified_pair(seen.camera, seen.right)
    assert isinstance(pair, RectifiedPair)
    left_px, right_px = centres(seen.image_bgr), centres(seen.right.image_bgr)
    depths_m = POINTS_M[np.argsort(IDEAL.project(POINTS_M)[:, 0]), 2]
    np.testing.assert_allclose(left_px[:, 1], right_px[:, 1], atol=0.2)
    np.testing.assert_allclose(
        left_px[:, 0] - right_px[:, 0], [pair.disparity_at(z) for z in depths_m], atol=0.2
    )
