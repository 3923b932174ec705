"""Draws the scene as the endoscope sees it: PyBullet's renderers, behind the project's pinhole camera."""

from __future__ import annotations

import importlib.util
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

import cv2
import numpy as np

from svmdist.camera import R_OPENGL_OPENCV, Camera
from svmdist.errors import SimulationError, did_you_mean
from svmdist.samples import Image
from svmdist.simulation.bodies.meshes import DrawnMesh
from svmdist.simulation.bullet import BulletClient, quiet_stdout
from svmdist.simulation.scene import Scene, make_floor
from svmdist.simulation.urdf import LinkVisual, urdf_of
from svmdist.transforms import Array, inverse, quaternion_xyzw_from_rotation

RendererName = Literal["tiny", "egl"]
RENDERERS: tuple[RendererName, ...] = ("tiny", "egl")

NEAR_M, FAR_M = 0.01, 0.4
LIGHT_DIRECTION = (0.35, 0.45, 1.0)
"""Towards the light, in the world: beside the optical axis, as in an endoscope, so that shapes shade."""
OPTICS_SIGMA_PX = 0.8
"""Blur of the optics: no lens draws edges of one pixel, and it hides the renderer's stairs."""


@dataclass(frozen=True)
class _Arm:
    """A robot in the physics world, the indices of its joints there, and its plate's body."""

    scene: Scene
    robot: int
    joint_indices: tuple[int, ...]
    plate: int | None


class Renderer:
    """A physics world with robot, further robots, tissue and floor in it; a context manager.

    `frame_of` poses the robot and returns a BGR image, shape (height, width, 3); `right_frame` then draws the
    same instant for the right camera.
    """

    def __init__(self, scene: Scene, name: str = "tiny", others: Sequence[Scene] = ()) -> None:
        if name not in RENDERERS:
            raise SimulationError(f"no renderer named {name}: {did_you_mean(name, RENDERERS)}")
        self._scene = scene
        self._arms: list[_Arm] = []
        self._client = BulletClient()
        self._folder = tempfile.TemporaryDirectory(prefix="svmdist-")
        self._plugin = -1
        try:
            if name == "egl":
                self._plugin = _load_egl(self._client)
            self._kind = (
                self._client.pb.ER_TINY_RENDERER
                if name == "tiny"
                else self._client.pb.ER_BULLET_HARDWARE_OPENGL
            )
            self._build(Path(self._folder.name), others)
        except BaseException:
            self.close()
            raise
        self._view = _view(scene.T_world_camera)
        self._right_view = _view(scene.T_world_camera @ scene.T_camera_right)
        self._projection = _projection(scene.camera, _PIXEL_SHIFT[name])

    def frame_of(
        self, q: Array, T_world_retractor: Array | None = None, others: Sequence[Array] = ()
    ) -> Image:
        """Draw the robot at joints `q`, shape (n_joints,), and the retractor where it is in the scene.

        `others` are the joints of the further arms.
        """
        for arm, at in zip(self._arms, (q, *others), strict=True):
            for joint, value in zip(arm.joint_indices, at, strict=True):
                self._client.call("resetJointState", arm.robot, joint, float(value))
            plate = arm.scene.plate
            if plate is not None and arm.plate is not None:
                self._place(arm.plate, arm.scene.link_poses(at)[plate.link] @ plate.T_link_tag)
        if T_world_retractor is not None:
            self._place(self._retractor, T_world_retractor)
        return self._draw(self._view)

    def right_frame(self) -> Image:
        """Draw what `frame_of` has posed, as the right camera sees it."""
        return self._draw(self._right_view)

    def _draw(self, view: list[float]) -> Image:
        camera = self._scene.camera
        with quiet_stdout():
            picture = self._client.call(
                "getCameraImage",
                camera.width_px,
                camera.height_px,
                viewMatrix=view,
                projectionMatrix=self._projection,
                lightDirection=LIGHT_DIRECTION,
                lightColor=(1.0, 0.985, 0.96),
                shadow=0,
                lightAmbientCoeff=0.52,
                lightDiffuseCoeff=0.5,
                lightSpecularCoeff=0.12,
                renderer=self._kind,
            )
        rgba = np.asarray(picture[2], np.uint8).reshape(camera.height_px, camera.width_px, 4)
        return self._through_optics(rgba[..., 2::-1])

    def _through_optics(self, image_bgr: Image) -> Image:
        blurred = cv2.GaussianBlur(np.ascontiguousarray(image_bgr), (0, 0), OPTICS_SIGMA_PX)
        return np.asarray(blurred, np.uint8)

    def _build(self, folder: Path, others: Sequence[Scene]) -> None:
        scene = self._scene
        robot = self._load_robot(scene, folder, "robot")
        tissue = self._body(scene.organ.mesh, folder / "organ.obj", (1.0, 1.0, 1.0, 1.0))
        self._place(tissue, scene.T_world_tissue)
        self._paint(tissue, scene.tissue_texture, folder / "tissue.png")
        floor = self._body(make_floor(), folder / "floor.obj", (1.0, 1.0, 1.0, 1.0))
        self._paint(floor, scene.floor_texture, folder / "floor.png")
        self._retractor = self._body(scene.retractor, folder / "retractor.obj", (0.66, 0.67, 0.68, 1.0))
        self._arms.append(self._with_plate(scene, robot, folder, "plate"))
        away = np.eye(4)
        away[2, 3] = 1.0  # behind the camera
        self._place(self._retractor, away)
        for index, other in enumerate(others, start=1):
            robot = self._load_robot(other, folder, f"robot_{index}")
            self._arms.append(self._with_plate(other, robot, folder, f"plate_{index}"))

    def _load_robot(self, scene: Scene, folder: Path, name: str) -> int:
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
            return int(self._client.call("loadURDF", str(urdf), position, quaternion, useFixedBase=True))

    def _with_plate(self, scene: Scene, robot: int, folder: Path, name: str) -> _Arm:
        joints = {
            info[1].decode(): info[0]
            for info in (
                self._client.call("getJointInfo", robot, index)
                for index in range(self._client.call("getNumJoints", robot))
            )
        }
        plate = None
        if scene.plate is not None:
            plate = self._body(scene.plate.mesh, folder / f"{name}.obj", (1.0, 1.0, 1.0, 1.0))
            self._paint(plate, scene.plate.texture, folder / f"{name}.png")
        return _Arm(scene, robot, tuple(joints[joint] for joint in scene.chain.joint_names), plate)

    def _body(self, mesh: DrawnMesh, path: Path, colour_rgba: tuple[float, float, float, float]) -> int:
        pb = self._client.pb
        shape = self._client.call(
            "createVisualShape", pb.GEOM_MESH, fileName=str(mesh.write_obj(path)), rgbaColor=colour_rgba
        )
        return int(self._client.call("createMultiBody", 0, -1, shape))

    def _paint(self, body: int, texture_bgr: Image, path: Path) -> None:
        cv2.imwrite(str(path), texture_bgr)
        texture = self._client.call("loadTexture", str(path))
        self._client.call("changeVisualShape", body, -1, textureUniqueId=texture)

    def _place(self, body: int, T_world_body: Array) -> None:
        self._client.call("resetBasePositionAndOrientation", body, *_pose(T_world_body))

    def close(self) -> None:
        """Leave the physics world and remove its files; a second call does nothing."""
        if self._plugin >= 0:
            self._client.call("unloadPlugin", self._plugin)
            self._plugin = -1
        self._client.close()
        self._folder.cleanup()

    def __enter__(self) -> Renderer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


R4_OPENGL_OPENCV: Array = np.block([[R_OPENGL_OPENCV, np.zeros((3, 1))], [np.zeros((1, 3)), 1.0]])

_PIXEL_SHIFT = {"tiny": (-0.5, 0.5), "egl": (0.0, 0.0)}
"""Where each renderer puts a pixel's centre, against OpenGL: TinyRenderer samples pixels at a corner.
Measured with silhouettes of spheres all over the image, which agree with `Camera.project` to 0.03 px."""


def _view(T_world_camera: Array) -> list[float]:
    """OpenGL's view matrix, column by column."""
    return [float(value) for value in (R4_OPENGL_OPENCV @ inverse(T_world_camera)).T.ravel()]


def _projection(camera: Camera, shift_px: tuple[float, float]) -> list[float]:
    """OpenGL's projection matrix, column by column, for the intrinsics K.

    OpenGL puts the image's borders at -1 and 1; in pixel coordinates they lie at -0.5 and size - 0.5.
    """
    width, height, K = camera.width_px, camera.height_px, camera.K
    centre_x, centre_y = K[0, 2] + 0.5 + shift_px[0], K[1, 2] + 0.5 + shift_px[1]
    P = np.zeros((4, 4))
    P[0, 0], P[0, 2] = 2.0 * K[0, 0] / width, 1.0 - 2.0 * centre_x / width
    P[1, 1], P[1, 2] = 2.0 * K[1, 1] / height, 2.0 * centre_y / height - 1.0
    P[2, 2], P[2, 3] = (FAR_M + NEAR_M) / (NEAR_M - FAR_M), 2.0 * FAR_M * NEAR_M / (NEAR_M - FAR_M)
    P[3, 2] = -1.0
    return [float(value) for value in P.T.ravel()]


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
