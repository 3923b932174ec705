"""The smallest distance between the surfaces of instrument and organ, or of two instruments, by PyBullet.

Bullet's algorithms are tuned for objects of about one metre, and their collision margins would drown a
distance of a millimetre. These worlds of their own therefore count in millimetres, a thousand times as
large, with margins of zero.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from svmdist.simulation.bodies.meshes import DrawnMesh
from svmdist.simulation.bullet import BulletClient
from svmdist.simulation.clearance.bounds import HalfSpaces, PartBounds
from svmdist.simulation.clearance.relief_meter import PartSamples, ReliefMeter, seen_from_tissue
from svmdist.simulation.closing import Closing
from svmdist.simulation.scene import Scene
from svmdist.simulation.temporary import writing_temporary_files
from svmdist.transforms import Array, quaternion_xyzw_from_rotation, transform_points

SCALE = 1000.0
SEARCH_RADIUS_M = 0.2
SLACK_M = 1e-5
"""Bounds count as so much lower: Bullet's distances are right within some µm of the meshes' own."""


class _Meter(Closing):
    """A physics world of convex bodies in millimetres; a context manager."""

    def __init__(self) -> None:
        self._client = BulletClient()

    def _bodies(self, parts: list[tuple[str, DrawnMesh]]) -> list[int]:
        return [self._body(mesh) for _, mesh in parts]

    def _body(self, mesh: DrawnMesh) -> int:
        with writing_temporary_files(), tempfile.TemporaryDirectory(prefix="svmdist-") as folder:
            file = mesh.write_obj(Path(folder) / "part.obj", SCALE)
            shape = self._client.call("createCollisionShape", self._client.pb.GEOM_MESH, fileName=str(file))
        body = int(self._client.call("createMultiBody", 0, shape))
        self._client.call("changeDynamics", body, -1, collisionMargin=0.0)
        return body

    def _place(self, body: int, T_world_body: Array) -> None:
        self._client.call(
            "resetBasePositionAndOrientation",
            body,
            (T_world_body[:3, 3] * SCALE).tolist(),
            quaternion_xyzw_from_rotation(T_world_body[:3, :3]).tolist(),
        )

    def _distance_mm(self, body: int, other: int, within_mm: float) -> float:
        """Distance of two bodies, inf where it is above `within_mm`."""
        points = self._client.call("getClosestPoints", body, other, within_mm)
        return min((float(point[8]) for point in points), default=np.inf)

    def close(self) -> None:
        """Leave the physics world; a second call does nothing."""
        self._client.close()


class ClearanceMeter(_Meter):
    """Measures clearances of one scene.

    A fiducial plate counts as a part of the instrument. Every part and the smooth organ is convex, so that
    Bullet's convex hulls are the real meshes. An organ with relief is not: `ReliefMeter` measures there. The tissue
    is at rest: `Pressing` tells clearances where it gives way. `samples` are those of the instrument's surface.
    """

    def __init__(self, scene: Scene) -> None:
        super().__init__()
        self._scene = scene
        self.samples = PartSamples(scene)
        self._relief = None if scene.organ.is_convex else ReliefMeter(scene, self.samples)
        if self._relief is not None:
            return
        parts = parts_of(scene)
        self._bounds = PartBounds.of(parts)
        vertices_m = transform_points(scene.T_world_tissue, scene.organ.mesh.vertices_m)
        self._organ = HalfSpaces.about(vertices_m)
        try:
            self._tissue = self._body(scene.organ.mesh)
            self._parts = self._bodies(parts)
        except BaseException:
            self.close()
            raise
        self._place(self._tissue, scene.T_world_tissue)

    def clearance_m(self, q: Array) -> float:
        """Smallest distance in m at joints `q`, shape (n_joints,); negative is penetration depth."""
        return float(self.clearances_m(q[None])[0])

    def clearances_m(self, q: Array, rise_m: Array | None = None) -> Array:
        """Smallest distances in m, shape (n,), at joints `q`, shape (n, n_joints).

        `rise_m`, shape (n,), is how far the tissue has risen from its place at rest.
        """
        if self._relief is not None:
            return self._relief.clearances_m(q, rise_m)
        T_world_part = self._bounds.stacked(seen_from_tissue(self._scene, q, rise_m))
        least_m = self._bounds.least_m(T_world_part, self._organ)
        return np.array([self._smallest_m(*each) for each in zip(T_world_part, least_m, strict=True)])

    def _smallest_m(self, T_world_part: Array, least_m: Array) -> float:
        """The clearance with parts at poses, shape (k, 4, 4), which are no nearer than bounds, shape (k,)."""
        smallest_m = np.inf
        for part in np.argsort(least_m):
            if least_m[part] - SLACK_M >= smallest_m:
                break
            self._place(self._parts[part], T_world_part[part])
            distance_mm = self._distance_mm(self._parts[part], self._tissue, SEARCH_RADIUS_M * SCALE)
            smallest_m = min(smallest_m, distance_mm / SCALE)
        return float(smallest_m)


class BetweenMeter(_Meter):
    """Measures the clearance between the instruments of two scenes that share a world."""

    def __init__(self, first: Scene, second: Scene) -> None:
        super().__init__()
        self._scenes = first, second
        parts = parts_of(first), parts_of(second)
        self._bounds = PartBounds.of(parts[0]), PartBounds.of(parts[1])
        try:
            self._parts = self._bodies(parts[0]), self._bodies(parts[1])
        except BaseException:
            self.close()
            raise

    def clearance_m(self, q_first: Array, q_second: Array) -> float:
        """Smallest distance in m at joints of shape (n_joints,) each; negative is penetration depth."""
        return float(self.clearances_m(q_first[None], q_second[None])[0])

    def clearances_m(self, q_first: Array, q_second: Array) -> Array:
        """Smallest distances in m, shape (n,), at joints of shape (n, n_joints) each."""
        T_first, T_second = (
            bounds.stacked(scene.link_poses(q))
            for bounds, scene, q in zip(self._bounds, self._scenes, (q_first, q_second), strict=True)
        )
        least_m = self._bounds[0].least_between_m(T_first, self._bounds[1], T_second)
        return np.array([self._smallest_m(*each) for each in zip(T_first, T_second, least_m, strict=True)])

    def _smallest_m(self, T_first: Array, T_second: Array, least_m: Array) -> float:
        """The clearance with parts at poses, (k, 4, 4) and (l, 4, 4), which are no nearer than bounds, (k, l)."""
        smallest_m, placed = SEARCH_RADIUS_M, set[tuple[int, int]]()
        for flat in np.argsort(least_m, axis=None):
            i, j = divmod(int(flat), least_m.shape[1])
            if least_m[i, j] - SLACK_M >= smallest_m:
                break
            for side, part, poses in ((0, i, T_first), (1, j, T_second)):
                if (side, part) not in placed:
                    self._place(self._parts[side][part], poses[part])
                    placed.add((side, part))
            # Pairs that are farther apart than the nearest so far need no distance.
            within_mm = max(smallest_m, 0.0) * SCALE
            distance_mm = self._distance_mm(self._parts[0][i], self._parts[1][j], within_mm)
            smallest_m = min(smallest_m, distance_mm / SCALE)
        return float(smallest_m)


def parts_of(scene: Scene) -> list[tuple[str, DrawnMesh]]:
    """The parts of a scene's instrument, a fiducial plate among them, each in the frame of the link that carries it."""
    parts: list[tuple[str, DrawnMesh]] = [(part.link, part.mesh) for part in scene.parts]
    if scene.plate is not None:
        parts.append((scene.plate.link, scene.plate.mesh.transformed(scene.plate.T_link_tag)))
    return parts
