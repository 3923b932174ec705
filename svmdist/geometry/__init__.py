"""Shapes, all in m and in one frame: capsules for instruments; plane, mesh and cloud for tissue; and rays."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from svmdist.camera import Camera, fisheye_coefficients
from svmdist.transforms import Array, transform_points


@dataclass(frozen=True, slots=True)
class Capsules:
    """Segments, shape (n, 3) for each end, with a radius each, (n,); one whose ends coincide is a sphere."""

    start_m: Array
    end_m: Array
    radius_m: Array

    def __len__(self) -> int:
        return len(self.radius_m)

    def transformed(self, T_other_this: Array) -> Capsules:
        """The same capsules in another frame, by a transform of shape (4, 4)."""
        start_m, end_m = (transform_points(T_other_this, points) for points in (self.start_m, self.end_m))
        return Capsules(start_m, end_m, self.radius_m)


def join(*groups: Capsules) -> Capsules:
    """All capsules of several groups, as one."""
    return Capsules(
        np.concatenate([group.start_m for group in groups]),
        np.concatenate([group.end_m for group in groups]),
        np.concatenate([group.radius_m for group in groups]),
    )


@dataclass(frozen=True, slots=True)
class Plane:
    """The half-space below a plane: points with `normal · p <= offset_m`; `normal`, shape (3,), has length 1."""

    normal: Array
    offset_m: float


@dataclass(frozen=True)
class Mesh:
    """Triangles: `vertices_m`, shape (v, 3), and `faces`, (f, 3), counter-clockwise seen from outside."""

    vertices_m: Array
    faces: NDArray[np.int64]

    @cached_property
    def triangles_m(self) -> Array:
        """Corners of every face, shape (f, 3, 3)."""
        return np.asarray(self.vertices_m[self.faces])

    @cached_property
    def middles_m(self) -> Array:
        """Centroid of every face, shape (f, 3)."""
        a, b, c = (self.vertices_m[corner] for corner in self.faces.T)
        return np.asarray((a + b + c) / 3.0)

    @cached_property
    def reach_m(self) -> Array:
        """Largest distance of a point of each face from its centroid, shape (f,)."""
        away = self.triangles_m - self.middles_m[:, None]
        return np.asarray(np.sqrt(np.einsum("fki,fki->kf", away, away).max(0)))

    def transformed(self, T_other_this: Array) -> Mesh:
        """The same mesh in another frame, by a transform of shape (4, 4)."""
        return Mesh(transform_points(T_other_this, self.vertices_m), self.faces)


@dataclass(frozen=True, slots=True)
class Cloud:
    """Points of a surface, shape (n, 3). It has no inside."""

    points_m: Array


Surface = Plane | Mesh | Cloud


def pixel_rays(camera: Camera, points_px: ArrayLike) -> Array:
    """Directions in the camera frame, shape (n, 3) with z = 1, of pixels, shape (n, 2); undistorted."""
    points = np.atleast_2d(np.asarray(points_px, np.float64))
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-12)
    if camera.distortion_model == "fisheye":
        straight = cv2.fisheye.undistortPoints(points[:, None], camera.K, fisheye_coefficients(camera.D))
    else:
        straight = cv2.undistortPoints(
            points[:, None], camera.K, camera.D if len(camera.D) else None, None, None, None, criteria
        )
    return np.column_stack([np.asarray(straight).reshape(-1, 2), np.ones(len(points))])


def meet_plane(rays: Array, plane: Plane) -> Array:
    """Points, shape (n, 3), where rays from the origin, shape (n, 3), meet a plane; NaN where they do not."""
    slope = rays @ plane.normal
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(np.abs(slope) > 1e-9, plane.offset_m / slope, np.nan)
    return np.where(depth > 0.0, depth, np.nan)[:, None] * rays
