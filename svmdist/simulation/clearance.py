"""The smallest distance between the surfaces of instrument and organ, by PyBullet's closest points.

Bullet's algorithms are tuned for objects of about one metre, and their collision margins would drown a
distance of a millimetre. This world of its own therefore counts in millimetres, a thousand times as
large, with margins of zero.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from types import TracebackType

import numpy as np

from svmdist.simulation.bullet import BulletClient
from svmdist.simulation.meshes import Mesh
from svmdist.simulation.scene import Scene
from svmdist.transforms import Array, quaternion_xyzw_from_rotation

SCALE = 1000.0
SEARCH_RADIUS_M = 0.2


class ClearanceMeter:
    """Measures clearances of one scene; a context manager.

    A fiducial plate counts as a part of the instrument. Every part and the organ is convex, so that
    Bullet's convex hulls are the real meshes.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._client = BulletClient()
        try:
            with tempfile.TemporaryDirectory(prefix="svmdist-") as folder:
                self._tissue = self._body(scene.organ.mesh, Path(folder) / "organ.obj")
                self._parts = [
                    (part.link, self._body(part.mesh, Path(folder) / f"{part.name}.obj"))
                    for part in scene.parts
                ]
                if scene.plate is not None:
                    mesh = scene.plate.mesh.transformed(scene.plate.T_link_tag)
                    self._parts.append((scene.plate.link, self._body(mesh, Path(folder) / "plate.obj")))
        except BaseException:
            self.close()
            raise
        self._place(self._tissue, scene.T_world_tissue)

    def clearance_m(self, q: Array) -> float:
        """Smallest distance in m at joints `q`, shape (n_joints,); negative is penetration depth."""
        poses = self._scene.link_poses(q)
        smallest = np.inf
        for link, body in self._parts:
            self._place(body, poses[link])
            points = self._client.call("getClosestPoints", body, self._tissue, SEARCH_RADIUS_M * SCALE)
            smallest = min(smallest, *(point[8] for point in points)) if points else smallest
        return float(smallest / SCALE)

    def _body(self, mesh: Mesh, path: Path) -> int:
        file = mesh.write_obj(path, SCALE)
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

    def close(self) -> None:
        """Leave the physics world; a second call does nothing."""
        self._client.close()

    def __enter__(self) -> ClearanceMeter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
