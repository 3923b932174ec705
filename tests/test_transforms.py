"""Laws of rigid transforms and of a polygon's centroid, against SciPy and OpenCV as independent references."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from svmdist import transforms
from tests.jacobian import check_jacobian

quick = settings(max_examples=60)
angles_rad = st.floats(-2 * np.pi, 2 * np.pi)
lengths_m = st.floats(-10.0, 10.0)
vectors_m = st.tuples(lengths_m, lengths_m, lengths_m)
axes = st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1)).filter(lambda axis: np.linalg.norm(axis) > 1e-3)


def rotation_about(axis: tuple[float, float, float], angle_rad: float) -> np.ndarray:
    """Rotation by SciPy about any axis, shape (3, 3)."""
    unit = np.array(axis) / np.linalg.norm(axis)
    return Rotation.from_rotvec(unit * angle_rad).as_matrix()


@quick
@given(axes, angles_rad, vectors_m)
def test_a_transform_times_its_inverse_is_the_identity(axis, angle_rad, t_m):
    """T @ inverse(T) = inverse(T) @ T = I within 1e-13 relative to the translation's size."""
    T = transforms.make_transform(rotation_about(axis, angle_rad), t_m)
    np.testing.assert_allclose(T @ transforms.inverse(T), np.eye(4), atol=2e-13)
    np.testing.assert_allclose(transforms.inverse(T) @ T, np.eye(4), atol=2e-13)


def test_stacks_broadcast():
    """One rotation with five translations, inverses of a stack and products with points."""
    t_m = np.arange(15.0).reshape(5, 3)
    T = transforms.make_transform(transforms.rotation_z(0.3), t_m)
    np.testing.assert_array_equal(T[:, :3, 3], t_m)
    np.testing.assert_array_equal(T[:, 3], np.tile([0.0, 0.0, 0.0, 1.0], (5, 1)))
    np.testing.assert_array_equal(transforms.inverse(T), np.stack([transforms.inverse(member) for member in T]))
    p_m = np.random.default_rng(3).normal(size=(20, 3))
    expected = (T[1] @ np.column_stack([p_m, np.ones(20)]).T).T[:, :3]
    np.testing.assert_allclose(transforms.transform_points(T[1], p_m), expected, atol=1e-14)


@quick
@given(axes, angles_rad)
def test_a_rotation_survives_the_round_trip_through_a_quaternion(axis, angle_rad):
    """R -> quaternion -> R returns R within 1e-14 at every angle."""
    R = rotation_about(axis, angle_rad)
    q = transforms.quaternion_xyzw_from_rotation(R)
    expected = Rotation.from_matrix(R).as_quat(canonical=True)
    assert q[3] >= 0.0
    assert min(np.abs(q - expected).max(), np.abs(q + expected).max()) < 1e-14  # the sign of w = 0 is free
    np.testing.assert_allclose(transforms.rotation_from_quaternion_xyzw(q), R, atol=1e-14)


@pytest.mark.parametrize("offset_rad", [0.0, 1e-16, 1e-12, 1e-9, 1e-6, -1e-9, -1e-12])
@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (-1, 1, 1), (1, -2, 3)])
def test_half_turns_survive_the_round_trip(axis, offset_rad):
    """Near half a turn, where the textbook formula loses all digits, the round trip still holds 1e-14."""
    R = rotation_about(axis, np.pi + offset_rad)
    np.testing.assert_allclose(
        transforms.rotation_from_quaternion_xyzw(transforms.quaternion_xyzw_from_rotation(R)), R, atol=1e-14
    )


@pytest.mark.parametrize("quaternion", [[0, 0, 0, 0], [np.nan, 0, 0, 1], [np.inf, 0, 0, 1]])
def test_a_quaternion_that_names_no_rotation_is_refused(quaternion):
    """Zero and non-finite quaternions raise ValueError instead of giving NaN."""
    with pytest.raises(ValueError, match="finite quaternion"):
        transforms.rotation_from_quaternion_xyzw(quaternion)


@quick
@given(axes, st.one_of(st.floats(0.0, 3.1), st.sampled_from([0.0, 1e-12, 1e-9, 1e-7])))
def test_the_angle_between_rotations_is_exact_when_small(axis, angle_rad):
    """rotation_angle recovers the angle within 1e-14 below a right angle, where arccos would lose 1e-8."""
    R = rotation_about((0.2, 1.0, -0.4), 1.1)
    found = float(transforms.rotation_angle(R, R @ rotation_about(axis, angle_rad)))
    assert found == pytest.approx(angle_rad, abs=1e-14 if angle_rad < 1.5 else 1e-7)


@quick
@given(axes, st.floats(-3.1, 3.1))
def test_rotation_vectors_agree_with_scipy(axis, angle_rad):
    vector_rad = np.array(axis) / np.linalg.norm(axis) * angle_rad
    R = transforms.rotation_of(vector_rad)
    np.testing.assert_allclose(R, Rotation.from_rotvec(vector_rad).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(transforms.rotation_vector(R), vector_rad, atol=1e-9)
    np.testing.assert_allclose(transforms.skew(vector_rad) @ axis, np.cross(vector_rad, axis), atol=1e-12)


@pytest.mark.parametrize("angle_rad", [0.0, 1e-9, 1e-4, 1.9e-3, 2.1e-3, 0.3, 2.0, 3.0])
def test_the_inverse_right_jacobian_is_the_vectors_derivative(angle_rad):
    """A turn δ behind exp([v]) changes v by J⁻¹ δ, against central differences to 1e-8, on both sides of the series."""
    v = angle_rad * np.array([0.6, -0.48, 0.64])
    R = transforms.rotation_of(v)
    check_jacobian(
        lambda turn: transforms.rotation_vector(R @ transforms.rotation_of(turn)),
        transforms.inverse_right_jacobian(v),
        absolute=1e-8,
    )


def convex(seed: int, size: float = 1.0) -> np.ndarray:
    """A random convex polygon about (300, 200) times the size."""
    points = np.random.default_rng(seed).uniform(200, 400, (12, 2)).astype(np.float32)
    return np.asarray(cv2.convexHull(points)[:, 0] * size, np.float64)


@pytest.mark.parametrize("size", [1e-4, 1.0, 10.0])
def test_it_agrees_with_opencvs_moments(size):
    """In single precision, in any unit, from any first corner, in both senses, and as OpenCV's contours."""
    for seed in range(20):
        moments = cv2.moments(convex(seed).astype(np.float32))
        expected = np.array([moments["m10"], moments["m01"]]) / moments["m00"]
        corners = convex(seed, size)
        for same in (corners, np.roll(corners, 3, axis=0), corners[::-1], corners[:, None]):
            np.testing.assert_allclose(transforms.polygon_centroid(same), size * expected, rtol=1e-6)


@pytest.mark.parametrize("corners", [[[3, 4]], [[0, 0], [4, 2]], [[1, 1], [2, 2], [6, 6]], [[5, 5]] * 4])
def test_without_area_it_is_the_mean_of_the_corners(corners):
    """A point, a segment and points on one line have no area to divide by."""
    np.testing.assert_allclose(transforms.polygon_centroid(np.array(corners)), np.mean(corners, axis=0))


@pytest.mark.parametrize(("rotation", "axis"), [(transforms.rotation_x, 0), (transforms.rotation_z, 2)])
@pytest.mark.parametrize("angle_rad", [0.0, 0.4, np.pi / 2, -2.5, np.pi])
def test_elementary_rotations_turn_by_the_right_hand_rule(rotation, axis, angle_rad):
    """rotation_x, _y and _z equal the rotation vector along their axis within 1e-15."""
    expected = Rotation.from_rotvec(np.eye(3)[axis] * angle_rad).as_matrix()
    np.testing.assert_allclose(rotation(angle_rad), expected, atol=1e-15)
