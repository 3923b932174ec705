"""The true clearance: smallest distance of an instrument to tissue or to another one; negative is penetration depth.

To tissue it is the least signed distance of samples of the instrument's surface to the organ's triangles, so dense that
the organ's curvature between them adds a few µm at most.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from svmdist.geometry import Mesh
from svmdist.simulation.bullet import BulletWorld
from svmdist.simulation.organ import SLACK_M, Organ
from svmdist.simulation.scene import Scene
from svmdist.transforms import Array, inverse

SPACING_M = 0.0004  # longest side of triangles between samples: no point of a part is farther than 0.23 mm from one
REACH_M = 0.07  # the organ is 62 mm long at most: what is farther behind a link's origin is not the nearest
CELL_M = 0.001  # side of the cells that group a part's samples: only those in near cells are looked at one by one
BULLET_SCALE = 1000.0  # Bullet is tuned for objects of about one metre: it counts in millimetres, without margins
SEARCH_RADIUS_M = 0.2  # the largest clearance that is measured between two instruments


class _Samples:
    """The surface of a scene's instrument as samples in the frames of its parts."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        samples = [_sample(part.mesh) for part in scene.parts]
        self._points_m = np.vstack(samples)
        self._part = np.repeat(np.arange(len(samples)), [len(each) for each in samples])
        cells = np.column_stack([self._part, np.floor(self._points_m / CELL_M)])
        _, self._first, self._cell = np.unique(cells, axis=0, return_index=True, return_inverse=True)

    def posed(self, q: Array, offset_m: float) -> Array:
        """The samples in the tissue frame, shape (n, 3), at joints (n_joints,) with the tissue raised by an offset."""
        T_world_part = self._scene.part_poses(q)
        T_world_part[:, 2, 3] -= offset_m
        T = (inverse(self._scene.T_world_tissue) @ T_world_part)[self._part]
        return np.asarray(np.einsum("nij,nj->ni", T[:, :3, :3], self._points_m) + T[:, :3, 3])

    def distance_m(self, points_m: Array, organ: Organ) -> float:
        """The distance of the nearest of the posed samples, where none is inside."""
        least_m, most_m = organ.bounds_m(points_m[self._first])
        is_near = least_m - np.sqrt(3.0) * CELL_M <= most_m.min() + SLACK_M
        points_m = points_m[is_near[self._cell]]
        least_m, most_m = organ.bounds_m(points_m)
        return float(organ.distances_m(points_m[least_m <= most_m.min() + SLACK_M]).min())


def _sample(mesh: Mesh) -> Array:
    """Samples of a part's surface without a gap wider than the spacing, as far as it can be near; shape (n, 3)."""
    near = np.linalg.norm(mesh.vertices_m, axis=1) < REACH_M
    faces, points_m = mesh.faces[near[mesh.faces].any(axis=1)], mesh.vertices_m
    used = np.unique(faces)
    while len(faces):
        corners_m = points_m[faces]
        sides_m = np.linalg.norm(np.roll(corners_m, -1, axis=1) - corners_m, axis=2)  # corner k to the next
        long = sides_m.max(axis=1) > SPACING_M
        faces, start = faces[long], np.argmax(sides_m[long], axis=1)
        a, b, c = (faces[np.arange(len(faces)), (start + turn) % 3] for turn in range(3))
        # Triangles on both sides of an edge share its middle.
        edges, middle = np.unique(np.minimum(a, b) * len(points_m) + np.maximum(a, b), return_inverse=True)
        first, second = np.divmod(edges, len(points_m))
        middle += len(points_m)
        points_m = np.vstack([points_m, 0.5 * (points_m[first] + points_m[second])])
        faces = np.concatenate([np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)])
    return np.asarray(points_m[np.union1d(used, np.arange(len(mesh.vertices_m), len(points_m)))])


class TissueClearance:
    """Clearances of the instruments of several scenes that share a world to its tissue, which may give way (`dent`)."""

    def __init__(self, scenes: Sequence[Scene]) -> None:
        self._arms = [_Samples(scene) for scene in scenes]
        self._organ = scenes[0].organ
        self._is_soft = scenes[0].perturbations["dent"] > 0.0

    def indented(self, q: Sequence[Array], offset_m: float = 0.0) -> Organ | None:
        """The organ as arms at joints, shape (n_joints,) each, press it in; None where none does, or it is hard."""
        if not self._is_soft:
            return None
        inside_m = np.vstack([self._organ.inside(its) for its in self._posed(q, offset_m)])
        return self._organ.dented(inside_m) if len(inside_m) else None

    def clearances_m(self, q: Sequence[Array], offset_m: float = 0.0) -> list[float]:
        """The clearance of each arm at joints, shape (n_joints,) each, to tissue that is raised by an offset.

        An arm that presses soft tissue touches it: 0, where the tissue gives way as far as that. Another one is
        measured to what the others leave.
        """
        posed, organ = self._posed(q, offset_m), self._organ
        inside = [organ.inside(its) for its in posed]
        touches = [self._is_soft and len(its) > 0 and not organ.is_too_deep(its) for its in inside]
        if self._is_soft and any(len(its) for its in inside) and not all(touches):
            organ = organ.dented(np.vstack(inside))
            inside = [organ.inside(its) for its in posed]
        return [
            0.0 if touch else -organ.depth_m(its) if len(its) else arm.distance_m(points_m, organ)
            for arm, points_m, its, touch in zip(self._arms, posed, inside, touches, strict=True)
        ]

    def _posed(self, q: Sequence[Array], offset_m: float) -> list[Array]:
        return [arm.posed(its, offset_m) for arm, its in zip(self._arms, q, strict=True)]


class InstrumentClearance(BulletWorld):
    """Clearances between two scenes' instruments, by Bullet: of convex hulls, which the parts are but for 0.1 mm."""

    def __init__(self, first: Scene, second: Scene) -> None:
        super().__init__()
        self._scenes = (first, second)
        self._bodies: tuple[list[int], list[int]] = [], []
        for scene, bodies in zip(self._scenes, self._bodies, strict=True):
            for part in scene.parts:
                vertices = (part.mesh.vertices_m * BULLET_SCALE).tolist()
                shape = self.call("createCollisionShape", self.pb.GEOM_MESH, vertices=vertices)
                bodies.append(int(self.call("createMultiBody", 0, shape)))
                self.call("changeDynamics", bodies[-1], -1, collisionMargin=0.0)

    def clearance_m(self, q_first: Array, q_second: Array) -> float:
        """The clearance at joints of shape (n_joints,) each, 0.2 m at most."""
        for scene, bodies, q in zip(self._scenes, self._bodies, (q_first, q_second), strict=True):
            for body, T_world_part in zip(bodies, scene.part_poses(q), strict=True):
                self.place(body, T_world_part, BULLET_SCALE)
        smallest_mm = SEARCH_RADIUS_M * BULLET_SCALE
        for body, other in product(*self._bodies):
            # Pairs that are farther apart than the nearest so far need no distance.
            points = self.call("getClosestPoints", body, other, max(smallest_mm, 0.0))
            smallest_mm = min([smallest_mm, *(float(point[8]) for point in points)])
        return smallest_mm / BULLET_SCALE
