"""Renders the scene as the endoscope sees it: PyBullet's TinyRenderer, behind the project's pinhole camera.

It spends five sixths of its time on tissue and floor, which rarely move: they are rendered once for each camera, what
moves in each frame, and the depth buffers show which is in front, as one picture of everything would, bit for bit.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.camera import R_OPENGL_OPENCV, Camera
from svmdist.samples import Image
from svmdist.simulation.bullet import BulletWorld, quiet
from svmdist.simulation.effects import DISTORTION, LAMP_M, Depths, Lens, Shader, Surfaces
from svmdist.simulation.meshes import DrawnMesh, Part, Rgba, floor_texture, make_floor, make_retractor, tissue_texture
from svmdist.simulation.organ import Organ
from svmdist.simulation.plan import SceneState
from svmdist.simulation.scene import Scene, raised
from svmdist.transforms import Array, inverse, make_transform, transform_points
from svmdist.vision.degradations import dimmed

NEAR_M, FAR_M = 0.01, 0.4
PIXEL_SHIFT = (-0.5, 0.5)
"""TinyRenderer samples pixels at a corner: silhouettes of spheres all over the image agree with `Camera.project` to
0.03 px."""
OPTICS_SIGMA_PX = 0.8  # blur of the optics, which also hides the renderer's stairs
DEPTH_TIE = 2.5e-7
"""Four steps of a float32 below 1, 0.25 µm here: TinyRenderer compares depths before it scales and rounds them.
Surfaces that are nearer to each other than that are rendered in one picture again."""
LIGHT_DIRECTION = np.array([0.35, 0.45, 1.0])  # towards the light, in the world: beside the optical axis, to shade
AMBIENT = 0.52  # of what the far lamp gives; of the one at the endoscope's tip it is 0.18
_AWAY: Array = raised(1.0)  # behind the camera


def projection_matrix(camera: Camera) -> list[float]:
    """OpenGL's projection matrix, column by column; the image's borders, -0.5 and size - 0.5, are at -1 and 1."""
    width, height, K = camera.width_px, camera.height_px, camera.K
    centre_x, centre_y = K[0, 2] + 0.5 + PIXEL_SHIFT[0], K[1, 2] + 0.5 + PIXEL_SHIFT[1]
    P = np.zeros((4, 4))
    P[0, 0], P[0, 2] = 2.0 * K[0, 0] / width, 1.0 - 2.0 * centre_x / width
    P[1, 1], P[1, 2] = 2.0 * K[1, 1] / height, 2.0 * centre_y / height - 1.0
    P[2, 2], P[2, 3] = (FAR_M + NEAR_M) / (NEAR_M - FAR_M), 2.0 * FAR_M * NEAR_M / (NEAR_M - FAR_M)
    P[3, 2] = -1.0
    return P.T.ravel().tolist()


def metric_depth_m(buffer: Depths) -> Depths:
    """Depths along the optical axis in m of OpenGL's depth buffer, 0 at NEAR_M and 1 at FAR_M."""
    return np.asarray(FAR_M * NEAR_M / (FAR_M - buffer.astype(np.float64) * (FAR_M - NEAR_M)), np.float32)


@dataclass(frozen=True)
class Picture:
    """A BGR image, shape (h, w, 3), its depth buffer, float32 (h, w), and body numbers, int64 (h, w), -1 for none."""

    image_bgr: Image
    depth: Depths
    bodies: NDArray[np.int64]


class Renderer(BulletWorld):
    """Draws what two cameras see of several arms' scenes that share a world; a context manager.

    Perturbations are added in the order of nature: light and dirt on the surfaces, the lens, the field stop.
    """

    def __init__(self, scenes: Sequence[Scene]) -> None:
        super().__init__()
        self._turn = 0
        self._scenes, self._scene = scenes, (scene := scenes[0])
        # The pinhole camera whose images are rendered is wider than the real one where the lens needs it.
        strength = scene.perturbations["lens"] + scene.perturbations["lens_untold"]
        self._lens = Lens.of(scene.camera, strength * DISTORTION) if strength else None
        self._camera = self._lens.wide if self._lens else scene.camera
        self._T_world_cameras = (scene.T_world_camera, scene.T_world_camera @ scene.T_camera_right)
        # From the ideal world's lamp to one beside the lens, and less light around.
        share = scene.perturbations["light"]
        to_lens = -scene.T_world_camera[:3, 2]
        self._light: dict[str, Any] = {
            "renderer": self.pb.ER_TINY_RENDERER,
            "shadow": 0,
            "lightColor": (1.0, 0.985, 0.96),
            "lightDirection": (LIGHT_DIRECTION + share * (to_lens - LIGHT_DIRECTION)).tolist(),
            "lightAmbientCoeff": AMBIENT + share * (0.18 - AMBIENT),
            "lightDiffuseCoeff": 0.5 + share * 0.35,
            "lightSpecularCoeff": 0.12,
        }
        has_surfaces = scene.perturbations.has("light", "shadow", "wet", "blood")
        self._shader = Shader(scene.perturbations, scene.seed) if has_surfaces else None
        # Where two surfaces are equally far, the body that came last is rendered: the order is a part of the content.
        self._parts = [self._add_part(part) for part in scene.parts]
        self._tissue = self._add_mesh(scene.organ.mesh)
        self._tissue_texture = self._paint(self._tissue, tissue_texture(scene.seed))
        self._floor = self._add_mesh(make_floor())
        self._paint(self._floor, floor_texture(scene.seed))
        self._retractor = self._add_mesh(make_retractor(), (0.66, 0.67, 0.68, 1.0))
        self._parts += [self._add_part(part) for other in scenes[1:] for part in other.parts]
        self._dented: int | None = None
        self._moving: dict[int, Array] = {}  # where bodies stand
        self._still: dict[int, Array] = {}
        self._backgrounds: dict[tuple[int, int], Picture] = {}
        self._background_of: tuple[float, Organ | None] = (0.0, None)

    def pose(self, state: SceneState, organ: Organ | None = None) -> None:
        """Place everything; an organ that is not at rest is rendered instead of the scene's."""
        if self._background_of != (state.offset_m, organ):
            self._backgrounds.clear()
        self._background_of = (state.offset_m, organ)
        poses = [scene.part_poses(q) for scene, q in zip(self._scenes, state.q, strict=True)]
        self._moving = dict(zip(self._parts, np.concatenate(poses), strict=True))
        self._moving[self._retractor] = _AWAY if state.T_world_retractor is None else state.T_world_retractor
        # The body of a dented organ, always the last one, is rendered in place of the tissue's.
        if self._dented is not None:
            self.call("removeBody", self._dented)
        self._dented = None if organ is None else self._add_mesh(organ.mesh)
        if self._dented is not None:
            self.call("changeVisualShape", self._dented, -1, textureUniqueId=self._tissue_texture)
        T_raised = raised(state.offset_m)
        self._still = {self._floor: T_raised, self._tissue: _AWAY}
        self._still[self._tissue if self._dented is None else self._dented] = T_raised @ self._scene.T_world_tissue

    def draw(self, camera: int, turn: int) -> Image:
        """Draw what the left (0) or right (1) camera sees, shape (h, w, 3), as picture number `turn` of a recording."""
        image_bgr = self._pinhole(camera, turn)
        if self._lens is not None:
            column_px, row_px = cv2.split(self._lens.at_px)
            image_bgr = np.asarray(cv2.remap(image_bgr, column_px, row_px, cv2.INTER_LINEAR), np.uint8)
        blurred = np.asarray(cv2.GaussianBlur(image_bgr, (0, 0), OPTICS_SIGMA_PX), np.uint8)
        return dimmed(blurred, self._scene.perturbations["border"], self._scene.perturbations["vignette"])

    def _pinhole(self, camera: int, turn: int) -> Image:
        T_world_camera, key = self._T_world_cameras[camera], (camera, turn % 2)
        if key not in self._backgrounds:
            self._backgrounds[key] = self._picture(T_world_camera, turn, moving=False)
        background, picture = self._backgrounds[key], self._picture(T_world_camera, turn, still=False)
        rendered = picture.bodies >= 0
        if (rendered & (np.abs(picture.depth - background.depth) <= DEPTH_TIE)).any():
            # Few frames need it: those in which surfaces meet within a pixel's centre.
            together = self._picture(T_world_camera, turn)
        else:
            in_front = rendered & (picture.depth < background.depth)
            image_bgr = background.image_bgr.copy()
            cv2.copyTo(picture.image_bgr, in_front.view(np.uint8), image_bgr)
            depth = np.where(in_front, picture.depth, background.depth)
            together = Picture(image_bgr, depth, np.where(in_front, picture.bodies, background.bodies))
        return self._shaded(together, background.depth, T_world_camera, turn)

    def _picture(self, T_world_camera: Array, turn: int, *, moving: bool = True, still: bool = True) -> Picture:
        """Take the picture that is number `turn` of a recording, of what moves and of what is still, or one of them."""
        for bodies, is_shown in ((self._moving, moving), (self._still, still)):
            for body, T_world_body in bodies.items():
                self.place(body, T_world_body if is_shown else _AWAY)
        # OpenGL's matrices have 16 numbers, column by column.
        view = (make_transform(R_OPENGL_OPENCV, np.zeros(3)) @ inverse(T_world_camera)).T.ravel().tolist()
        matrices = {"viewMatrix": view, "projectionMatrix": projection_matrix(self._camera)}
        # TinyRenderer renders the same scene in two ways, by turns, which differ by one level in single pixels. The
        # picture of an even turn is therefore always an even one here, whatever was rendered before.
        width, height = self._camera.width_px, self._camera.height_px
        for size in [(1, 1)] * ((self._turn - turn) % 2) + [(width, height)]:
            self._turn += 1
            with quiet():
                _, _, rgba, depth, bodies_px = self.call("getCameraImage", *size, **matrices, **self._light)
        image = cv2.cvtColor(np.asarray(rgba, np.uint8).reshape(height, width, 4), cv2.COLOR_RGBA2BGR)
        depths = np.asarray(depth, np.float32).reshape(height, width)
        return Picture(np.asarray(image, np.uint8), depths, np.asarray(bodies_px).reshape(height, width))

    def _shaded(self, picture: Picture, behind: Depths, T_world_camera: Array, turn: int) -> Image:
        """A picture in the light of its lamp; `behind` is the depth buffer of tissue and floor alone."""
        if self._shader is None:
            return picture.image_bgr
        is_still = np.isin(picture.bodies, [*self._moving], invert=True)
        T_camera_world = inverse(T_world_camera)
        depth_m, behind_m = metric_depth_m(picture.depth), metric_depth_m(behind)
        T_camera_part = {body: T_camera_world @ self._moving[body] for body in self._parts}
        surfaces = Surfaces(self._camera, depth_m, behind_m, is_still, picture.bodies, T_camera_part)
        lamp_world_m = transform_points(self._scene.T_world_camera, LAMP_M[None])[0]
        T_world_lamp = make_transform(T_world_camera[:3, :3], lamp_world_m)
        lamp_m, lamp_depth_m = (T_camera_world @ T_world_lamp)[:3, 3], None
        if self._scene.perturbations["shadow"]:
            lamp_depth_m = metric_depth_m(self._picture(T_world_lamp, turn, still=False).depth)
        T_camera_tissue = T_camera_world @ raised(self._background_of[0]) @ self._scene.T_world_tissue
        return self._shader.shaded(picture.image_bgr, surfaces, lamp_m, lamp_depth_m, T_camera_tissue)

    def _add_part(self, part: Part) -> int:
        body = self._add_mesh(part.mesh, part.colour_rgba)
        if part.texture_bgr is not None:
            self._paint(body, part.texture_bgr)
        return body

    def _add_mesh(self, mesh: DrawnMesh, colour_rgba: Rgba = (1.0, 1.0, 1.0, 1.0)) -> int:
        """Add a mesh at the origin; its body's number."""
        surface = {"vertices": mesh.vertices_m.tolist(), "indices": mesh.faces.ravel().tolist()}
        look = {"uvs": mesh.uv.tolist(), "normals": mesh.normals.tolist(), "rgbaColor": colour_rgba}
        shape = self.call("createVisualShape", self.pb.GEOM_MESH, **surface, **look)
        return int(self.call("createMultiBody", 0, -1, shape))

    def _paint(self, body: int, texture_bgr: Image) -> int:
        """Put a texture onto a body; its number."""
        # PyBullet reads files only: this one is in memory, and stays open, since textures are known by their path.
        file = os.memfd_create("svmdist")
        self.callback(os.close, file)
        os.write(file, cv2.imencode(".png", texture_bgr)[1].tobytes())
        texture = int(self.call("loadTexture", f"/proc/self/fd/{file}"))
        self.call("changeVisualShape", body, -1, textureUniqueId=texture)
        return texture
