"""Draws the scene by path tracing with Mitsuba 3: light that bounces, rough metal, wet tissue; seconds an image.

It is for a few images that look as a camera's do, from another program than all others. The lamp is at the
endoscope's tip, as with the perturbation `light`; of the room it shows shapes, colours, motion, lens and border.
"""

from __future__ import annotations

import importlib
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from svmdist.camera import Camera
from svmdist.errors import SimulationError
from svmdist.perturbations.video import dimmed
from svmdist.samples import Image
from svmdist.simulation.bodies.instrument import STEEL_RGBA, Rgba
from svmdist.simulation.bodies.meshes import DrawnMesh
from svmdist.simulation.closing import Closing
from svmdist.simulation.room.shading import FULL_LIGHT_M, LAMP_M
from svmdist.simulation.scene import Scene, make_floor, risen
from svmdist.simulation.temporary import writing_temporary_files
from svmdist.transforms import Array, make_transform, transform_points

VARIANT = "scalar_rgb"
"""The one that needs no LLVM and no GPU."""
SAMPLE_COUNT = 24
"""Paths a pixel. Twice as many halve the noise's variance and take twice as long."""
DEPTH = 4
"""Surfaces a path meets at most: light comes from tissue by way of tissue."""
LAMP_RADIUS_M = 0.0012
ALBEDO_GAMMA = 2.2
WHITE = 0.8
"""Of what a white surface at FULL_LIGHT_M gives back across the lamp's rays, so much is white in the image."""
R4_MITSUBA_OPENCV: Array = np.diag([-1.0, -1.0, 1.0, 1.0])
"""Mitsuba's cameras look along +z with +x to the left and +y up."""


class PhotoRenderer(Closing):
    """Draws what `Renderer` draws, by path tracing; a context manager with the same methods."""

    def __init__(self, scene: Scene, others: Sequence[Scene] = ()) -> None:
        self._mi = _load_mitsuba()
        self._scenes = (scene, *others)
        self._scene = scene
        with writing_temporary_files():
            self._folder = tempfile.TemporaryDirectory(prefix="svmdist-")
        self._turn = 0
        self._posed: Any = None
        try:
            with writing_temporary_files():
                self._files = {
                    id(mesh): str(mesh.write_obj(Path(self._folder.name) / f"{number}.obj"))
                    for number, mesh in enumerate(self._meshes())
                }
                self._floor_file = str(make_floor().write_obj(Path(self._folder.name) / "floor.obj"))
        except BaseException:
            self.close()
            raise

    def frame_of(
        self,
        q: Array,
        T_world_retractor: Array | None = None,
        others: Sequence[Array] = (),
        *,
        turn: int | None = None,
        rise_m: float = 0.0,
        tissue: DrawnMesh | None = None,
    ) -> Image:
        """Draw the robot at joints `q`, shape (n_joints,), as `Renderer.frame_of` does."""
        scene = self._scene
        bodies: dict[str, Any] = {}
        T_rise = risen(rise_m)
        surface = _wet(self._texture(scene.tissue_texture), 0.28)
        file = self._files[id(scene.organ.mesh)]
        if tissue is not None:  # Mitsuba reads the file at once
            file = str(tissue.write_obj(Path(self._folder.name) / "tissue.obj"))
        bodies["tissue"] = self._body(file, T_rise @ scene.T_world_tissue, surface)
        floor = _wet(self._texture(scene.floor_texture), 0.5)
        bodies["floor"] = self._body(self._floor_file, T_rise, floor)
        for number, (its, at) in enumerate(zip(self._scenes, (q, *others), strict=True)):
            poses = its.link_poses(at)
            for part in its.parts:
                bodies[f"{part.name}_{number}"] = self._body(
                    self._files[id(part.mesh)], poses[part.link], _painted(part.colour_rgba)
                )
            if its.plate is not None:
                T_world_plate = poses[its.plate.link] @ its.plate.T_link_tag
                paper = {"type": "diffuse", "reflectance": self._texture(its.plate.texture)}
                bodies[f"plate_{number}"] = self._body(self._files[id(its.plate.mesh)], T_world_plate, paper)
        if T_world_retractor is not None:
            bodies["retractor"] = self._body(
                self._files[id(scene.retractor)], T_world_retractor, _painted(STEEL_RGBA)
            )
        lamp_m = transform_points(scene.T_world_camera, LAMP_M[None])[0]
        # What a square metre of the lamp gives, so that a white surface at FULL_LIGHT_M gives back 1.
        radiance = FULL_LIGHT_M**2 / LAMP_RADIUS_M**2
        self._posed = self._mi.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "path", "max_depth": DEPTH, "hide_emitters": True},
                "lamp": {
                    "type": "disk",
                    "to_world": self._transform(
                        make_transform(scene.T_world_camera[:3, :3], lamp_m)
                        @ np.diag([LAMP_RADIUS_M, LAMP_RADIUS_M, 1.0, 1.0])
                    ),
                    "emitter": {"type": "area", "radiance": {"type": "rgb", "value": radiance}},
                },
                **bodies,
            }
        )
        return self._draw(0, turn)

    def right_frame(self, *, turn: int | None = None) -> Image:
        """Draw what `frame_of` has posed, as the right camera sees it."""
        return self._draw(1, turn)

    def _draw(self, camera: int, turn: int | None) -> Image:
        turn = self._turn if turn is None else turn
        self._turn = turn + 1
        scene, room = self._scene, self._scene.room
        T_world_camera = scene.T_world_camera @ (np.eye(4), scene.T_camera_right)[camera]
        sensor = self._mi.load_dict(self._sensor(scene.drawn_camera, T_world_camera))
        light = np.asarray(self._mi.render(self._posed, sensor=sensor, seed=turn, spp=SAMPLE_COUNT))
        levels = 255.0 * np.clip(light[..., 2::-1] / WHITE, 0.0, 1.0) ** (1.0 / ALBEDO_GAMMA)
        image_bgr = np.rint(levels).astype(np.uint8)
        if scene.lens is not None:
            image_bgr = scene.lens.image(image_bgr)
        return dimmed(image_bgr, room.border, room.vignette)

    def _sensor(self, camera: Camera, T_world_camera: Array) -> dict[str, Any]:
        width, height, K = camera.width_px, camera.height_px, camera.K
        return {
            "type": "perspective",
            "fov_axis": "x",
            "fov": float(np.rad2deg(2.0 * np.arctan(0.5 * width / K[0, 0]))),
            # In pixel coordinates the image's middle is at (size - 1) / 2.
            "principal_point_offset_x": float((K[0, 2] - 0.5 * (width - 1)) / width),
            "principal_point_offset_y": float((K[1, 2] - 0.5 * (height - 1)) / height),
            "near_clip": 0.005,
            "far_clip": 1.0,
            "to_world": self._transform(T_world_camera @ R4_MITSUBA_OPENCV),
            "film": {
                "type": "hdrfilm",
                "width": width,
                "height": height,
                "pixel_format": "rgb",
                # As wide as the blur of the optics in the other renderers.
                "rfilter": {"type": "gaussian", "stddev": 0.8},
            },
            "sampler": {"type": "independent", "sample_count": SAMPLE_COUNT},
        }

    def _body(self, file: str, T_world_body: Array, bsdf: dict[str, Any]) -> dict[str, Any]:
        return {
            "type": "obj",
            "filename": file,
            "to_world": self._transform(T_world_body),
            "bsdf": {"type": "twosided", "bsdf": bsdf},
        }

    def _texture(self, texture_bgr: Image) -> dict[str, Any]:
        rgb = cv2.cvtColor(texture_bgr, cv2.COLOR_BGR2RGB).astype(np.float32) / 255.0
        # The first row of a texture is at v = 1 for OpenGL, as for Mitsuba.
        return {"type": "bitmap", "data": self._mi.TensorXf(rgb**ALBEDO_GAMMA), "raw": True}

    def _transform(self, T: Array) -> Any:
        return self._mi.ScalarTransform4f(np.asarray(T, np.float64))

    def _meshes(self) -> list[DrawnMesh]:
        plates = [scene.plate.mesh for scene in self._scenes if scene.plate is not None]
        parts = [part.mesh for scene in self._scenes for part in scene.parts]
        return [self._scene.organ.mesh, self._scene.retractor, *parts, *plates]

    def close(self) -> None:
        """Remove the files; a second call does nothing."""
        self._posed = None
        self._folder.cleanup()


def _wet(colour: dict[str, Any], roughness: float) -> dict[str, Any]:
    """Tissue under a film of water."""
    return {"type": "principled", "base_color": colour, "roughness": roughness, "specular": 0.5}


def _painted(colour_rgba: Rgba) -> dict[str, Any]:
    """Grey is brushed metal, which mirrors some of a dark room, and anything else paint."""
    rgb = np.array(colour_rgba[:3])
    value = {"type": "rgb", "value": (rgb**ALBEDO_GAMMA).tolist()}
    is_metal = np.ptp(rgb) < 0.05 and rgb.max() > 0.3
    if is_metal:
        return {"type": "principled", "base_color": value, "metallic": 0.4, "roughness": 0.45}
    return {"type": "principled", "base_color": value, "roughness": 0.5, "specular": 0.5}


def _load_mitsuba() -> Any:
    try:
        mitsuba = importlib.import_module("mitsuba")
    except ImportError as problem:
        raise SimulationError(
            f"renderer mitsuba: run pip install 'svmdist[photo]', or use --renderer tiny ({problem})"
        ) from None
    mitsuba.set_variant(VARIANT)
    return mitsuba
