"""Rigid transforms on plain arrays: products, inverses, rotation vectors, quaternions; and a polygon's centroid.

`T_a_b` maps coordinates of frame b to frame a, `p_a = T_a_b @ p_b`, so that names cancel in a product:
`T_camera_tool = T_camera_base @ T_base_tool`. Every function takes stacks: leading axes broadcast.
"""

from __future__ import annotations

import mmap
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import AfterValidator, PlainSerializer, PlainValidator

# OpenBLAS ends the process, with a line of its own, where it gets no memory to work in: it takes it here, after as much
# was to be had. Without, this raises OSError, which commands say in a line.
mmap.mmap(-1, 1 << 26).close()
_ = np.ones((128, 128)) @ np.ones((128, 128))

AS_LISTS = PlainSerializer(lambda array: array.tolist())  # nested ones; NaN is null there
Array = Annotated[NDArray[np.float64], PlainValidator(lambda value: np.asarray(value, np.float64)), AS_LISTS]
Stamps = Annotated[NDArray[np.int64], PlainValidator(lambda value: np.asarray(value, np.int64)), AS_LISTS]
"""Stamps in ns, shape (n,)."""


def frame_name(name: str) -> str:
    """The name of a frame as tf2 has it: tf of old wrote /base for base."""
    return name.removeprefix("/")


FrameName = Annotated[str, AfterValidator(frame_name)]


def rotation_error(R: Array) -> Array:
    """How far matrices, shape (..., 3, 3), are from rotations: the largest of R Rᵀ - I; infinite for mirrors."""
    off = np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max((-1, -2))
    return np.where(np.linalg.det(R) < 0.0, np.inf, off)


def make_transform(R: ArrayLike, t_m: ArrayLike) -> Array:
    """Build homogeneous transforms from rotations, shape (..., 3, 3), and translations in m, shape (..., 3)."""
    R, t_m = np.asarray(R, np.float64), np.asarray(t_m, np.float64)
    T = np.zeros((*np.broadcast_shapes(R.shape[:-2], t_m.shape[:-1]), 4, 4))
    T[..., :3, :3] = R
    T[..., :3, 3] = t_m
    T[..., 3, 3] = 1.0
    return T


def inverse(T_a_b: Array) -> Array:
    """Invert rigid transforms, shape (..., 4, 4), by transposing the rotation: gives T_b_a."""
    R_b_a = np.swapaxes(T_a_b[..., :3, :3], -1, -2)
    return make_transform(R_b_a, -(R_b_a @ T_a_b[..., :3, 3:])[..., 0])


def transform_points(T_a_b: Array, p_b_m: ArrayLike) -> Array:
    """Map points of frame b, shape (n, 3) in m, to frame a with one transform of shape (4, 4)."""
    return np.asarray(np.asarray(p_b_m, np.float64) @ T_a_b[:3, :3].T + T_a_b[:3, 3])


def rotation_x(angle_rad: float) -> Array:
    """Rotation about x by an angle in rad, shape (3, 3)."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def rotation_z(angle_rad: float) -> Array:
    """Rotation about z by an angle in rad, shape (3, 3)."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def rotation_of(vector_rad: ArrayLike) -> Array:
    """exp([v]): rotations, shape (..., 3, 3), by rotation vectors in rad, shape (..., 3) (Rodrigues 1840)."""
    v = np.asarray(vector_rad, np.float64)
    angle_rad = np.linalg.norm(v, axis=-1)[..., None, None]
    K = skew(v)
    # sin θ / θ and (1 - cos θ) / θ² by sinc: no digit is lost and nothing divided by zero at small angles.
    first, second = np.sinc(angle_rad / np.pi), 0.5 * np.sinc(angle_rad / (2.0 * np.pi)) ** 2
    return np.asarray(np.eye(3) + first * K + second * (K @ K))


def rotation_vector(R: Array) -> Array:
    """The vectors v in rad, shape (..., 3), with exp([v]) = R, shape (..., 3, 3), for less than half a turn."""
    twice_sine = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], -1)
    sine = 0.5 * np.linalg.norm(twice_sine, axis=-1)
    angle_rad = np.arctan2(sine, 0.5 * (np.trace(R, axis1=-2, axis2=-1) - 1.0))
    small = sine < 1e-9
    scale = np.where(small, 1.0, angle_rad / np.where(small, 1.0, sine))
    return np.asarray(0.5 * twice_sine * scale[..., None])


def skew(v: ArrayLike) -> Array:
    """[v], shape (..., 3, 3), with [v] u = v x u, of vectors (..., 3)."""
    v = np.asarray(v, np.float64)
    return (v @ SKEW).reshape(*v.shape, 3)


# The matrices [x], [y] and [z] of the axes, a row each.
SKEW = np.array([[0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0], [0, -1, 0, 1, 0, 0, 0, 0, 0]], np.float64)


def cross(a: Array, b: Array) -> Array:
    """Vector products a x b along the last axis, shape (..., 3): NumPy's takes four times as long for a few."""
    next_a, next_b = a.take(NEXT, -1), b.take(NEXT, -1)
    return np.asarray((a * next_b - next_a * b).take(NEXT, -1))


NEXT = np.array([1, 2, 0])  # x → y → z → x


def inverse_right_jacobian(vector_rad: ArrayLike) -> Array:
    """J⁻¹, shape (..., 3, 3), with exp([v]) exp([δ]) = exp([v + J⁻¹ δ]) to first order, for v (..., 3) in rad.

    I + ½ [v] + (1 / θ² - (1 + cos θ) / (2 θ sin θ)) [v]², below a full turn (Solà 2018, "A micro Lie theory", eq. 144).
    """
    v = np.asarray(vector_rad, np.float64)
    K = skew(v)
    half = 0.5 * np.sqrt((v * v).sum(-1))
    small = half < 1e-3  # the difference loses its digits; the series' third term is below 1e-14
    safe = half + small
    factor = np.where(small, 1.0 / 12.0 + half**2 / 180.0, 0.25 * (1.0 - safe / np.tan(safe)) / safe**2)
    return np.asarray(np.eye(3) + 0.5 * K + factor[..., None, None] * (K @ K))


def rotation_from_quaternion_xyzw(quaternion_xyzw: ArrayLike) -> Array:
    """Rotations, shape (..., 3, 3), from quaternions x, y, z, w, shape (..., 4); ValueError for one that is zero."""
    q = np.asarray(quaternion_xyzw, np.float64)
    norm = np.linalg.norm(q, axis=-1, keepdims=True)
    if not np.all(np.isfinite(norm) & (norm > 1e-9)):
        raise ValueError("a rotation needs a finite quaternion that is not zero")
    x, y, z, w = np.moveaxis(q / norm, -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, -1) for row in rows], -2)


def known_rotations(q: ArrayLike) -> Array:
    """Rotations, shape (n, 3, 3), from quaternions, shape (n, 4); NaN where one of its numbers is not finite."""
    q = np.asarray(q, np.float64)
    R, known = np.full((len(q), 3, 3), np.nan), np.isfinite(q).all(axis=1)
    R[known] = rotation_from_quaternion_xyzw(q[known])
    return R


def quaternion_xyzw_from_rotation(R: Array) -> Array:
    """Unit quaternions x, y, z, w with w >= 0, shape (..., 4), from rotations, shape (..., 3, 3) (Shepperd 1978)."""
    (m00, m01, m02), (m10, m11, m12), (m20, m21, m22) = np.moveaxis(np.asarray(R, np.float64), (-2, -1), (0, 1))
    a, b, c = m21 - m12, m02 - m20, m10 - m01
    xy, xz, yz = m10 + m01, m02 + m20, m21 + m12
    rows = (
        (1 + m00 - m11 - m22, xy, xz, a),
        (xy, 1 - m00 + m11 - m22, yz, b),
        (xz, yz, 1 - m00 - m11 + m22, c),
        (a, b, c, 1 + m00 + m11 + m22),
    )
    candidates = np.stack([np.stack(row, -1) for row in rows], -2)
    # The largest squared component as pivot is accurate near half a turn, too.
    pivots = np.argmax(np.einsum("...ii->...i", candidates), -1)
    q = np.take_along_axis(candidates, pivots[..., None, None], -2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.asarray(np.where(q[..., 3:] < 0, -q, q))


def rotation_angle(R_a: Array, R_b: Array) -> Array:
    """Angle in rad between rotations, shape (...), accurate down to 1e-16 unlike arccos of the trace."""
    chord = np.linalg.norm(R_a - R_b, axis=(-2, -1))  # = 2 sqrt(2) sin(angle / 2)
    return np.asarray(2.0 * np.arcsin(np.clip(chord / (2.0 * np.sqrt(2.0)), 0.0, 1.0)))


def polygon_centroid(polygon: NDArray[np.generic]) -> Array:
    """Centroid of the area in a simple polygon, (n, 2) or as OpenCV's contours (n, 1, 2): shape (2,), in its unit.

    By the shoelace formula, in either sense of rotation. Without area it is the mean of the corners.
    """
    corners = np.asarray(polygon, np.float64).reshape(-1, 2)
    (x, y), (next_x, next_y) = corners.T, np.roll(corners, -1, 0).T
    cross = x * next_y - next_x * y
    twice_area = cross.sum()
    if abs(twice_area) <= 1e-12 * np.square(corners).max():  # rounding
        return np.asarray(corners.mean(0))
    moments = np.array([((x + next_x) * cross).sum(), ((y + next_y) * cross).sum()])
    return np.asarray(moments / (3.0 * twice_area))
