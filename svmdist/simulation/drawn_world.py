"""A physics world whose bodies are drawn: it loads robots and meshes, places them, and takes pictures."""

from __future__ import annotations

import importlib.util
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.errors import SimulationError
from svmdist.samples import Image
from svmdist.simulation.bodies.meshes import DrawnMesh
from svmdist.simulation.bullet import BulletClient, quiet_stdout
from svmdist.simulation.closing import Closing
from svmdist.simulation.room.surfaces import NO_PART
from svmdist.simulation.scene import Scene, make_floor, risen
from svmdist.simulation.temporary import writing_temporary_files
from svmdist.simulation.urdf import LinkVisual, part_link, urdf_of
from svmdist.transforms import Array, quaternion_xyzw_from_rotation

LIGHT_DIRECTION = (0.35, 0.45, 1.0)
"""Towards the light, in the world: beside the optical axis, as in an endoscope, so that shapes shade."""
_WHITE = (1.0, 1.0, 1.0, 1.0)
_AWAY: Array = np.eye(4)
_AWAY[2, 3] = 1.0  # behind the camera


@dataclass(frozen=True)
class Picture:
    """A BGR image, shape (h, w, 3), its depth buffer, float32 (h, w), and where a body was drawn, bool (h, w).

    `bodies`, int64 (h, w), has PyBullet's numbers of body and link.
    """

    image_bgr: Image
    depth: NDArray[np.float32]
    drawn: NDArray[np.bool_]
    bodies: NDArray[np.int64]


@dataclass(frozen=True)
class Lights:
    """The renderer's lamp: the direction towards it in the world, and how much of a level it and all around give."""

    direction: tuple[float, float, float] = LIGHT_DIRECTION
    ambient: float = 0.52
    diffuse: float = 0.5

    @staticmethod
    def of(scene: Scene) -> Lights:
        """As the room has it: on the way from the ideal world's lamp to one beside the lens, and less light around."""
        share = scene.room.light
        if not share:
            return Lights()
        start = Lights()
        to_lens = -scene.T_world_camera[:3, 2]
        x, y, z = (a + share * (b - a) for a, b in zip(start.direction, to_lens.tolist(), strict=True))
        return Lights((x, y, z), start.ambient + share * (0.18 - start.ambient), start.diffuse + share * 0.35)


@dataclass(frozen=True)
class _Arm:
    """A robot in the physics world, its joints there, those that draw its parts, and its plate's body, by number."""

    scene: Scene
    robot: int
    joint_indices: tuple[int, ...]
    part_indices: tuple[int, ...]
    plate: int | None


class DrawnWorld(Closing):
    """A physics world in which bodies are drawn; a context manager.

    `still` puts the tissue and the floor into it, `moving` the robots with their plates and the retractor.
    `turn` counts the pictures taken so far.
    """

    def __init__(
        self, scene: Scene, others: Sequence[Scene] = (), *, egl: bool = False, still: bool, moving: bool
    ) -> None:
        self.turn = 0
        self._scene = scene
        self._camera = scene.drawn_camera
        self._lights = Lights.of(scene)
        self._arms: list[_Arm] = []
        self._poses: list[dict[str, Array]] = []
        self._tissue: int | None = None
        self._tissue_texture: int | None = None
        self._shaped: int | None = None
        self._shaped_mesh: DrawnMesh | None = None
        self._floor: int | None = None
        self._retractor: int | None = None
        with writing_temporary_files():
            self._folder = tempfile.TemporaryDirectory(prefix="svmdist-")
        self.client = BulletClient()
        self._plugin = -1
        try:
            pb = self.client.pb
            if egl:
                self._plugin = _load_egl(self.client)
            self.kind = pb.ER_BULLET_HARDWARE_OPENGL if egl else pb.ER_TINY_RENDERER
            with writing_temporary_files():
                self._build(scene, others, still, moving)
        except BaseException:
            self.close()
            raise

    def pose(self, q: Array, T_world_retractor: Array | None, others: Sequence[Array]) -> None:
        """Put the robots at their joints, shape (n_joints,) each, and the retractor at its pose, or out of view."""
        self._poses = [arm.scene.link_poses(at) for arm, at in zip(self._arms, (q, *others), strict=True)]
        for arm, at, poses in zip(self._arms, (q, *others), self._poses, strict=True):
            for joint, value in zip(arm.joint_indices, at, strict=True):
                self.client.call("resetJointState", arm.robot, joint, float(value))
            plate = arm.scene.plate
            if plate is not None and arm.plate is not None:
                self.place(arm.plate, poses[plate.link] @ plate.T_link_tag)
        if self._retractor is not None:
            self.place(self._retractor, _AWAY if T_world_retractor is None else T_world_retractor)

    def raise_tissue(self, rise_m: float) -> None:
        """Put tissue and floor so far above their place at rest."""
        if self._tissue is not None and self._floor is not None:
            at_rest, shaped = self._tissue, self._shaped
            self.place(at_rest if shaped is None else shaped, risen(rise_m) @ self._scene.T_world_tissue)
            self.place(self._floor, risen(rise_m))

    def shape_tissue(self, mesh: DrawnMesh | None) -> None:
        """Draw the organ with another mesh in its frame, or as it is at rest; `raise_tissue` then puts it in its place.

        Bodies are drawn in the order in which they came, and the shaped one is always the last.
        """
        if self._tissue is None or mesh is self._shaped_mesh:
            return
        if self._shaped is not None:
            self.client.call("removeBody", self._shaped)
            self._shaped = None
        self._shaped_mesh = mesh
        if mesh is not None:
            self.place(self._tissue, _AWAY)
            self._shaped = self._add_mesh(mesh)
            assert self._tissue_texture is not None  # the tissue is painted
            self.client.call("changeVisualShape", self._shaped, -1, textureUniqueId=self._tissue_texture)

    def is_still(self, picture: Picture) -> NDArray[np.bool_]:
        """Where a picture shows tissue or floor, shape (h, w)."""
        still = (self._tissue, self._shaped, self._floor)
        return np.isin(picture.bodies, [body for body in still if body is not None])

    def parts(self, picture: Picture) -> tuple[NDArray[np.int16], tuple[Array, ...]]:
        """Which instrument's part is seen where, int16 (h, w), numbers of poses `T_world_part`, (4, 4) each."""
        part = np.full(picture.bodies.shape, NO_PART, np.int16)
        frames: list[Array] = []
        for arm, poses in zip(self._arms, self._poses, strict=True):
            for drawn, index in zip(arm.scene.parts, arm.part_indices, strict=True):
                part[picture.bodies == arm.robot + ((index + 1) << 24)] = len(frames)
                frames.append(poses[drawn.link])
            plate = arm.scene.plate
            if plate is not None and arm.plate is not None:
                part[picture.bodies == arm.plate] = len(frames)
                frames.append(poses[plate.link] @ plate.T_link_tag)
        return part, tuple(frames)

    def picture(self, view: list[float], projection: list[float], turn: int) -> Picture:
        """Take the picture that is number `turn` of a recording.

        TinyRenderer draws the same scene in two ways, by turns, which differ by one level in single pixels. The
        picture of an even turn is therefore always an even one here, whatever was drawn before.
        """
        if (self.turn - turn) % 2:
            self._draw(1, 1, view, projection)
        width, height = self._camera.width_px, self._camera.height_px
        _, _, rgba, depth, raw = self._draw(width, height, view, projection)
        bodies = np.asarray(raw).reshape(height, width)
        return Picture(
            np.asarray(
                cv2.cvtColor(np.asarray(rgba, np.uint8).reshape(height, width, 4), cv2.COLOR_RGBA2BGR),
                np.uint8,
            ),
            np.asarray(depth, np.float32).reshape(height, width),
            bodies >= 0,
            bodies,
        )

    def _draw(self, width: int, height: int, view: list[float], projection: list[float]) -> Any:
        self.turn += 1
        with quiet_stdout():
            return self.client.call(
                "getCameraImage",
                width,
                height,
                viewMatrix=view,
                projectionMatrix=projection,
                lightDirection=self._lights.direction,
                lightColor=(1.0, 0.985, 0.96),
                shadow=0,
                lightAmbientCoeff=self._lights.ambient,
                lightDiffuseCoeff=self._lights.diffuse,
                lightSpecularCoeff=0.12,
                renderer=self.kind,
                # A link's number stands beside that of its body: on tissue and plates, which have none, it is 0.
                flags=self.client.pb.ER_SEGMENTATION_MASK_OBJECT_AND_LINKINDEX,
            )

    def _build(self, scene: Scene, others: Sequence[Scene], still: bool, moving: bool) -> None:
        # Where two surfaces are equally far, the body that came last is drawn: the order is a part of the content.
        robot = self._load_robot(scene, "robot") if moving else -1
        if still:
            self._tissue = self.add_body(scene.organ.mesh, "organ")
            self.place(self._tissue, scene.T_world_tissue)
            self._tissue_texture = self._paint(self._tissue, scene.tissue_texture, "tissue")
            self._floor = self.add_body(make_floor(), "floor")
            self._paint(self._floor, scene.floor_texture, "floor")
        if moving:
            self._retractor = self.add_body(scene.retractor, "retractor", (0.66, 0.67, 0.68, 1.0))
            self._arms.append(self._with_plate(scene, robot, "plate"))
            self.place(self._retractor, _AWAY)
            for index, other in enumerate(others, start=1):
                robot = self._load_robot(other, f"robot_{index}")
                self._arms.append(self._with_plate(other, robot, f"plate_{index}"))

    def _load_robot(self, scene: Scene, name: str) -> int:
        folder = Path(self._folder.name)
        # Every arm has files of its own: PyBullet may keep a mesh by its name.
        visuals = tuple(
            LinkVisual(
                part.link,
                str(part.mesh.write_obj(folder / f"{name}_{part.name}.obj")),
                part.colour_rgba,
            )
            for part in scene.parts
        )
        urdf = folder / f"{name}.urdf"
        urdf.write_text(urdf_of(scene.chain, "robot", visuals), "utf-8")
        position, quaternion = _pose(scene.T_world_base)
        with quiet_stdout():
            return int(self.client.call("loadURDF", str(urdf), position, quaternion, useFixedBase=True))

    def _with_plate(self, scene: Scene, robot: int, name: str) -> _Arm:
        joints = {
            info[1].decode(): info[0]
            for info in (
                self.client.call("getJointInfo", robot, index)
                for index in range(self.client.call("getNumJoints", robot))
            )
        }
        plate = None
        if scene.plate is not None:
            plate = self.add_body(scene.plate.mesh, name)
            self._paint(plate, scene.plate.texture, name)
        parts = tuple(
            joints[f"{part_link(part.link, index)}_fixed"] for index, part in enumerate(scene.parts)
        )
        return _Arm(scene, robot, tuple(joints[joint] for joint in scene.chain.joint_names), parts, plate)

    def add_body(
        self, mesh: DrawnMesh, name: str, colour_rgba: tuple[float, float, float, float] = _WHITE
    ) -> int:
        """Add a mesh at the origin; the name is that of its file. Returns the body's number."""
        file = mesh.write_obj(Path(self._folder.name) / f"{name}.obj")
        shape = self.client.call(
            "createVisualShape", self.client.pb.GEOM_MESH, fileName=str(file), rgbaColor=colour_rgba
        )
        return int(self.client.call("createMultiBody", 0, -1, shape))

    def _add_mesh(self, mesh: DrawnMesh) -> int:
        """Add a mesh at the origin without a file, in half of the time; drawn alike to the last bit."""
        shape = self.client.call(
            "createVisualShape",
            self.client.pb.GEOM_MESH,
            vertices=mesh.vertices_m.tolist(),
            indices=mesh.faces.ravel().tolist(),
            uvs=mesh.uv.tolist(),
            normals=mesh.normals.tolist(),
            rgbaColor=_WHITE,
        )
        return int(self.client.call("createMultiBody", 0, -1, shape))

    def _paint(self, body: int, texture_bgr: Image, name: str) -> int:
        """Put a texture onto a body; its number."""
        file = Path(self._folder.name) / f"{name}.png"
        cv2.imwrite(str(file), texture_bgr)
        texture = int(self.client.call("loadTexture", str(file)))
        self.client.call("changeVisualShape", body, -1, textureUniqueId=texture)
        return texture

    def place(self, body: int, T_world_body: Array) -> None:
        """Put a body at a pose, shape (4, 4)."""
        self.client.call("resetBasePositionAndOrientation", body, *_pose(T_world_body))

    def close(self) -> None:
        """Leave the physics world and remove its files; a second call does nothing."""
        if self._plugin >= 0:
            self.client.call("unloadPlugin", self._plugin)
            self._plugin = -1
        self.client.close()
        self._folder.cleanup()


def _pose(T: Array) -> tuple[list[float], list[float]]:
    return T[:3, 3].tolist(), quaternion_xyzw_from_rotation(T[:3, :3]).tolist()


def _load_egl(client: BulletClient) -> int:
    found = importlib.util.find_spec("eglRenderer")
    if found is None or found.origin is None:
        raise SimulationError("renderer egl: PyBullet's EGL plugin is not installed; use --renderer tiny")
    with quiet_stdout():
        plugin: Any = client.call("loadPlugin", found.origin, "_eglRendererPlugin")
    if plugin < 0:
        raise SimulationError(
            "renderer egl: the EGL plugin cannot be loaded (no EGL driver?); use --renderer tiny"
        )
    return int(plugin)
