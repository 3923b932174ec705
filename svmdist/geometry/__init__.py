"""Shapes, all in m and in one frame: capsules for instruments; plane, mesh (of a file) and cloud for tissue; rays."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from svmdist.errors import ProfileError
from svmdist.files import read_regular, reading
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
    parts = zip(*((group.start_m, group.end_m, group.radius_m) for group in groups), strict=True)
    return Capsules(*map(np.concatenate, parts))


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
        return np.asarray(self.triangles_m.mean(1))

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
    """Points of a surface, shape (n, 3), with a standard deviation each, (n,). It has no inside."""

    points_m: Array
    std_m: Array

    def std_at_m(self, point_m: Array) -> float:
        """The deviation of the point nearest to one, shape (3,)."""
        return float(self.std_m[np.argmin(np.sum((self.points_m - point_m) ** 2, -1))])


Surface = Plane | Mesh | Cloud


def meet_plane(rays: Array, plane: Plane) -> Array:
    """Points, shape (n, 3), where rays from the origin, shape (n, 3), meet a plane; NaN where they do not."""
    slope = rays @ plane.normal
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(np.abs(slope) > 1e-9, plane.offset_m / slope, np.nan)
    return np.where(depth > 0.0, depth, np.nan)[:, None] * rays


MAX_TRIANGLES = 20_000  # each is looked at in every frame; an organ of 60 mm has edges of 0.7 mm then
MAX_FILE_BYTES = 64 << 20
MIN_SIZE_M, MAX_SIZE_M = 1e-3, 1.0  # across; beyond it, the unit is another one than the profile says
MAX_COORDINATE = 1e9  # of a corner, in whatever unit: its square is a number still
FLAT = 1e-6  # volume over the cube of the diagonal below which nothing is enclosed
STL_HEADER_BYTES = 84
STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


@lru_cache(maxsize=4)
def read_closed_mesh(path: Path, metres_per_unit: float) -> Mesh:
    """Read a closed mesh and bring it to m, in its own frame; each file is read once in a process.

    Vertices at the same place become one; faces that run into themselves are dropped; a mesh that is inside out is
    turned. Raises ProfileError, in one line, where the file cannot be read, or bounds no solid.
    """
    triangles = _triangles(path)
    count = len(triangles)
    if count == 0:
        raise ProfileError(f"{path}: an empty mesh: no face in it")
    if count > MAX_TRIANGLES:
        raise ProfileError(f"{path}: {count} triangles; at most {MAX_TRIANGLES} are taken: decimate the mesh first")
    if not (np.abs(triangles) <= MAX_COORDINATE).all():  # false for what is no number, too
        raise ProfileError(f"{path}: not every coordinate is a finite number within ±{MAX_COORDINATE:g}")
    triangles = triangles * metres_per_unit
    vertices_m, index = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    faces = np.asarray(index.reshape(-1, 3), np.int64)
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    if len(faces) == 0:
        raise ProfileError(f"{path}: an empty mesh: every face of it runs into itself")
    size_m = float(np.linalg.norm(np.ptp(vertices_m, axis=0)))
    if not MIN_SIZE_M <= size_m <= MAX_SIZE_M:
        size = f"{size_m * 1e3:.4g} mm across, where 1 mm to 1 m is expected"
        raise ProfileError(f"{path}: {size}: is tissue.mesh_unit right?")
    _require_closed(path, faces, len(vertices_m))
    # By tetrahedra from the middle: positive where faces turn outwards.
    triangles = vertices_m[faces]
    a, b, c = np.moveaxis(triangles - triangles.mean((0, 1)), 1, 0)
    volume_m3 = float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)
    if abs(volume_m3) < FLAT * size_m**3:
        raise ProfileError(f"{path}: a degenerate mesh: it is flat and encloses nothing")
    return Mesh(vertices_m, faces if volume_m3 > 0.0 else faces[:, ::-1])


def _triangles(path: Path) -> Array:
    """The corners of every face as the file has them, shape (f, 3, 3)."""
    reader = {".obj": _read_obj, ".stl": _read_stl}.get(path.suffix.lower())
    if reader is None:
        raise ProfileError(f"{path}: expected a mesh in a file .obj or .stl, found {path.suffix or 'no ending'}")
    with reading(path, ProfileError, " the mesh"):
        content = read_regular(path, MAX_FILE_BYTES)
    try:
        return reader(content)
    except (ValueError, IndexError, OverflowError) as problem:
        raise ProfileError(f"{path}: not a mesh in {path.suffix[1:].upper()}: {problem}") from None


def _read_obj(content: bytes) -> Array:
    """Wavefront OBJ: `v x y z` and `f a b c …`, counted from 1, or backwards from -1; polygons become fans."""
    vertices: list[list[float]] = []
    faces: list[tuple[int, int, int]] = []
    for number, line in enumerate(content.decode("utf-8", "replace").replace("\\\n", " ").splitlines(), 1):
        words = line.partition("#")[0].split()
        try:
            if words[:1] == ["v"]:
                vertices.append([float(word) for word in (words[1], words[2], words[3])])
            elif words[:1] == ["f"]:
                numbers = [int(word.partition("/")[0]) for word in words[1:]]
                corners = [number - 1 if number > 0 else len(vertices) + number for number in numbers]
                if len(corners) < 3 or not all(0 <= corner < len(vertices) for corner in corners):
                    raise ValueError
                faces += [(corners[0], *pair) for pair in pairwise(corners[1:])]
        except (ValueError, IndexError):
            raise ValueError(f"line {number} is no {'vertex' if words[0] == 'v' else 'face'}") from None
    return np.array(vertices, np.float64).reshape(-1, 3)[np.array(faces, np.int64).reshape(-1, 3)]


def _read_stl(content: bytes) -> Array:
    """STL, binary by its length, else text."""
    if len(content) >= STL_HEADER_BYTES:
        count = int.from_bytes(content[80:84], "little")
        if len(content) == STL_HEADER_BYTES + count * STL_TRIANGLE.itemsize:
            return np.frombuffer(content, STL_TRIANGLE, count, STL_HEADER_BYTES)["corners"].astype(np.float64)
    if not content.lstrip()[:5].lower() == b"solid":
        raise ValueError("neither text that begins with `solid`, nor as long as its count of triangles says")
    lines = [line.split() for line in content.decode("utf-8", "replace").splitlines()]
    corners = [[float(word) for word in words[1:4]] for words in lines if words[:1] == ["vertex"]]
    return np.array(corners, np.float64).reshape(-1, 3, 3)


def _require_closed(path: Path, faces: NDArray[np.int64], vertex_count: int) -> None:
    """Every edge is run once in each direction: the surface has no border, and one outside."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    forward, counts = np.unique(start * vertex_count + end, return_counts=True)
    undirected = np.unique(np.sort(np.stack([start, end], -1), axis=1), axis=0, return_counts=True)[1]
    if count := int(np.count_nonzero(undirected > 2)):
        raise ProfileError(f"{path}: {count} edges have more than two faces: the surface runs through itself")
    if (counts > 1).any():
        raise ProfileError(f"{path}: faces are not all turned the same way: turn them outwards")
    if lonely := int(np.count_nonzero(~np.isin(end * vertex_count + start, forward))):
        raise ProfileError(f"{path}: an open mesh: {lonely} edges have one face only; close it, its underside too")
