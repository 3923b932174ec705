"""The smallest distance between the surfaces of instrument and organ, or of two instruments, by PyBullet.

Bullet's algorithms are tuned for objects of about one metre, and their collision margins would drown a
distance of a millimetre. These worlds of their own therefore count in millimetres, a thousand times as
large, with margins of zero.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from svmdist.simulation.bodies.meshes import Mesh
from svmdist.simulation.bullet import BulletClient
from svmdist.simulation.clearance.relief_meter import ReliefMeter
from svmdist.simulation.scene import Scene
from svmdist.transforms import Array, quaternion_xyzw_from_rotation

SCALE = 1000.0
SEARCH_RADIUS_M = 0.2


class _Meter:
    """A physics world of convex bodies in millimetres; a context manager."""

    def __init__(self) -> None:
        self._client = BulletClient()

    def _bodies(self, scene: Scene) -> list[tuple[str, int]]:
        """The parts of a scene's instrument, a fiducial plate among them, with the links that carry them."""
        parts = [(part.link, self._body(part.mesh)) for part in scene.parts]
        if scene.plate is not None:
            mesh = scene.plate.mesh.transformed(scene.plate.T_link_tag)
            parts.append((scene.plate.link, self._body(mesh)))
        return parts

    def _body(self, mesh: Mesh) -> int:
        with tempfile.TemporaryDirectory(prefix="svmdist-") as folder:
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

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class ClearanceMeter(_Meter):
    """Measures clearances of one scene.

    A fiducial plate counts as a part of the instrument. Every part and the smooth organ is convex, so that
    Bullet's convex hulls are the real meshes. An organ with relief is not: `ReliefMeter` measures there.
    """

    def __init__(self, scene: Scene) -> None:
        super().__init__()
        self._scene = scene
        self._relief = None if scene.organ.is_convex else ReliefMeter(scene)
        if self._relief is not None:
            return
        try:
            self._tissue = self._body(scene.organ.mesh)
            self._parts = self._bodies(scene)
        except BaseException:
            self.close()
            raise
        self._place(self._tissue, scene.T_world_tissue)

    def clearance_m(self, q: Array) -> float:
        """Smallest distance in m at joints `q`, shape (n_joints,); negative is penetration depth."""
        if self._relief is not None:
            return self._relief.clearance_m(q)
        poses = self._scene.link_poses(q)
        smallest = np.inf
        for link, body in self._parts:
            self._place(body, poses[link])
            smallest = min(smallest, self._distance_mm(body, self._tissue, SEARCH_RADIUS_M * SCALE))
        return float(smallest / SCALE)

    def forget(self) -> None:
        """Forget the last pose, so that what is measured next does not depend on it, not even in the last bit."""
        if self._relief is not None:
            self._relief.forget()


class BetweenMeter(_Meter):
    """Measures the clearance between the instruments of two scenes that share a world."""

    def __init__(self, first: Scene, second: Scene) -> None:
        super().__init__()
        self._scenes = first, second
        try:
            self._parts = self._bodies(first), self._bodies(second)
        except BaseException:
            self.close()
            raise

    def clearance_m(self, q_first: Array, q_second: Array) -> float:
        """Smallest distance in m at joints of shape (n_joints,) each; negative is penetration depth."""
        for scene, parts, q in zip(self._scenes, self._parts, (q_first, q_second), strict=True):
            poses = scene.link_poses(q)
            for link, body in parts:
                self._place(body, poses[link])
        smallest = SEARCH_RADIUS_M * SCALE
        for _, body in self._parts[0]:
            for _, other in self._parts[1]:
                # Pairs that are farther apart than the nearest so far need no distance.
                smallest = min(smallest, self._distance_mm(body, other, max(smallest, 0.0)))
        return float(smallest / SCALE)
