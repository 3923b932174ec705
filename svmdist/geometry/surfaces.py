"""What can be near: capsules for instruments; plane, mesh and cloud for tissue. All in m, in one frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from svmdist.geometry.patches import Bounds, Patches, is_closed
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


@dataclass(frozen=True)
class Mesh:
    """Triangles: `vertices_m` of shape (v, 3) and `faces` (f, 3), counter-clockwise seen from outside.

    A closed mesh has an inside; of an open one, what its faces' normals point away from counts as inside
    as far as the winding number exceeds a half. What is derived from both is computed when first asked for; what
    tells only how the faces hang together is shared with the meshes that are made by moving the vertices.
    """

    vertices_m: Array
    faces: NDArray[np.int64]

    @cached_property
    def triangles_m(self) -> Array:
        """Corners of every face, shape (f, 3, 3)."""
        return np.asarray(self.vertices_m[self.faces])

    @cached_property
    def patches(self) -> Patches:
        """Compact groups of the faces."""
        return Patches.of(self.vertices_m, self.faces)

    @cached_property
    def bounds(self) -> Bounds:
        """Boxes and balls about the patches."""
        return self.patches.bounds(self.vertices_m)

    @cached_property
    def is_closed(self) -> bool:
        """Whether every edge is run once in each direction."""
        return is_closed(self.faces)

    def with_vertices(self, vertices_m: Array) -> Mesh:
        """The same faces over vertices that stand elsewhere, shape (v, 3): moved, or bent a little."""
        other = Mesh(vertices_m, self.faces)
        vars(other).update(patches=self.patches, is_closed=self.is_closed)
        return other

    def transformed(self, T_other_this: Array) -> Mesh:
        """The same mesh in another frame, by a transform of shape (4, 4)."""
        return PosedMesh(transform_points(T_other_this, self.vertices_m), self.faces, self, T_other_this)


@dataclass(frozen=True)
class PosedMesh(Mesh):
    """A mesh that stands as another one, `shape`, by the transform `T_here_shape`, shape (4, 4).

    What is near it can be asked in the shape's frame, where bounds are known already if it was asked before.
    """

    shape: Mesh
    T_here_shape: Array


@dataclass(frozen=True, slots=True)
class Cloud:
    """Points of a surface, shape (n, 3). It has no inside."""

    points_m: Array


Surface = Plane | Mesh | Cloud
