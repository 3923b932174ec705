"""What can be near: capsules for instruments; plane, mesh and cloud for tissue. All in m, in one frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svmdist.transforms import Array, transform_points


@dataclass(frozen=True, slots=True)
class Capsules:
    """Segments with a radius each: `start_m` and `end_m` have shape (n, 3), `radius_m` shape (n,).

    A capsule whose ends coincide is a sphere.
    """

    start_m: Array
    end_m: Array
    radius_m: Array

    def __len__(self) -> int:
        return len(self.radius_m)

    def transformed(self, T_other_this: Array) -> Capsules:
        """The same capsules in another frame, by a transform of shape (4, 4)."""
        return Capsules(
            transform_points(T_other_this, self.start_m),
            transform_points(T_other_this, self.end_m),
            self.radius_m,
        )


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


@dataclass(frozen=True, slots=True)
class Mesh:
    """Triangles: `vertices_m` of shape (v, 3) and `faces` (f, 3), counter-clockwise seen from outside.

    A closed mesh has an inside; of an open one, what its faces' normals point away from counts as inside
    as far as the winding number exceeds a half.
    """

    vertices_m: Array
    faces: NDArray[np.int64]

    @property
    def triangles_m(self) -> Array:
        """Corners of every face, shape (f, 3, 3)."""
        return np.asarray(self.vertices_m[self.faces])

    def transformed(self, T_other_this: Array) -> Mesh:
        """The same mesh in another frame, by a transform of shape (4, 4)."""
        return Mesh(transform_points(T_other_this, self.vertices_m), self.faces)


@dataclass(frozen=True, slots=True)
class Cloud:
    """Points of a surface, shape (n, 3). It has no inside."""

    points_m: Array


Surface = Plane | Mesh | Cloud
