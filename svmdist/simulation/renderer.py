"""Draws the scene as the endoscope sees it: PyBullet's renderers, behind the project's pinhole camera.

TinyRenderer draws in software and spends five sixths of its time on the tissue and the floor, which never move.
They are drawn once for each camera. Each frame draws what moves, in a world of its own, and the depth buffers tell
which of the two is in front. The result is that of one picture of everything, to the last bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.errors import SimulationError, did_you_mean
from svmdist.perturbations.video import dimmed
from svmdist.samples import Image
from svmdist.simulation.bodies.meshes import DrawnMesh
from svmdist.simulation.closing import Closing
from svmdist.simulation.drawn_world import DrawnWorld, Picture
from svmdist.simulation.photo import PhotoRenderer
from svmdist.simulation.plan import Moment
from svmdist.simulation.room.shading import LAMP_M, Lamp, Shader
from svmdist.simulation.room.surfaces import Surfaces, metric_depth_m
from svmdist.simulation.scene import Scene, risen
from svmdist.simulation.views import PIXEL_SHIFT, projection_matrix, view_matrix
from svmdist.transforms import Array, inverse, make_transform, transform_points

RendererName = Literal["tiny", "egl", "mitsuba"]
RENDERERS: tuple[RendererName, ...] = ("tiny", "egl", "mitsuba")

OPTICS_SIGMA_PX = 0.8
"""Blur of the optics: no lens draws edges of one pixel, and it hides the renderer's stairs."""
DEPTH_TIE = 2.5e-7
"""Four steps of a float32 below 1, which is 0.25 µm here. TinyRenderer compares depths before it scales and rounds
them for its depth buffer. Surfaces that are nearer to each other than that are drawn in one picture again."""

_STILL_BODIES = -2
"""In place of the numbers that tissue and floor have in a world of their own."""


class Renderer(Closing):
    """Draws robot, further robots, retractor, tissue and floor; a context manager.

    `frame_of` poses the robot and returns a BGR image, shape (height, width, 3); `right_frame` then draws the
    same instant for the right camera. `turn` numbers the pictures of a recording from 0, those of both cameras
    together; without it, a picture is the next one. It settles the image, whatever was drawn before.

    What the scene's room adds comes in the order of nature: light and dirt on the surfaces, the lens, the field stop.
    `seed` settles where there is dirt.
    """

    def __init__(
        self, scene: Scene, name: str = "tiny", others: Sequence[Scene] = (), *, seed: int = 0
    ) -> None:
        if name not in PIXEL_SHIFT:  # which are PyBullet's own
            raise SimulationError(f"no renderer named {name}: {did_you_mean(name, RENDERERS)}")
        self._scene, self._others = scene, tuple(others)
        self._is_tiny = name == "tiny"
        self._T_world_cameras = (scene.T_world_camera, scene.T_world_camera @ scene.T_camera_right)
        self._views = tuple(view_matrix(T) for T in self._T_world_cameras)
        self.projection = projection_matrix(scene.drawn_camera, PIXEL_SHIFT[name])
        self._backgrounds: dict[tuple[int, int], Picture] = {}
        self._background_rise_m = 0.0
        self._tissue: DrawnMesh | None = None
        self._background_tissue: DrawnMesh | None = None
        self._still: DrawnWorld | None = None
        self._whole: DrawnWorld | None = None
        self._turn = 0
        self._moment: Moment | None = None
        self._shader = Shader(scene.room, seed) if scene.room.needs_surfaces else None
        self.world = DrawnWorld(scene, others, egl=not self._is_tiny, still=not self._is_tiny, moving=True)

    @property
    def view(self) -> list[float]:
        """The left camera's view matrix."""
        return self._views[0]

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
        """Draw the robot at joints `q`, shape (n_joints,), and the retractor where it is in the scene.

        `others` are the joints of the further arms. Tissue and floor have risen by `rise_m`; `tissue` is the organ's
        mesh where it is not as at rest.
        """
        self._moment = Moment((q, *others), T_world_retractor, rise_m)
        self._tissue = tissue
        self._pose(self.world)
        return self._draw(0, turn)

    def right_frame(self, *, turn: int | None = None) -> Image:
        """Draw what `frame_of` has posed, as the right camera sees it."""
        return self._draw(1, turn)

    def _draw(self, camera: int, turn: int | None) -> Image:
        turn = self._turn if turn is None else turn
        self._turn = turn + 1
        image_bgr = self._pinhole(camera, turn)
        if self._scene.lens is not None:
            image_bgr = self._scene.lens.image(image_bgr)
        room = self._scene.room
        return dimmed(_through_optics(image_bgr), room.border, room.vignette)

    def _pinhole(self, camera: int, turn: int) -> Image:
        """What a pinhole shows of everything."""
        picture = self.world.picture(self._views[camera], self.projection, turn)
        if not self._is_tiny:
            return self._shaded(self.world, picture, picture.depth, camera, turn)
        background = self._background(camera, turn)
        if (picture.drawn & (np.abs(picture.depth - background.depth) <= DEPTH_TIE)).any():
            whole = self._in_one_picture(camera, turn)
            assert self._whole is not None
            return self._shaded(self._whole, whole, background.depth, camera, turn)
        in_front = picture.drawn & (picture.depth < background.depth)
        image_bgr = background.image_bgr.copy()
        cv2.copyTo(picture.image_bgr, in_front.view(np.uint8), image_bgr)
        if self._shader is None:
            return image_bgr
        together = Picture(
            image_bgr,
            np.where(in_front, picture.depth, background.depth),
            in_front | background.drawn,
            np.where(in_front, picture.bodies, _STILL_BODIES),
        )
        return self._shaded(self.world, together, background.depth, camera, turn)

    def _shaded(
        self, world: DrawnWorld, picture: Picture, behind: NDArray[np.float32], camera: int, turn: int
    ) -> Image:
        """A picture in the room's light; `behind` is the depth buffer of tissue and floor alone."""
        if self._shader is None:
            return picture.image_bgr
        assert self._moment is not None  # nothing is drawn before it is posed
        part, T_world_part = world.parts(picture)
        T_camera_world = inverse(self._T_world_cameras[camera])
        surfaces = Surfaces(
            self._scene.drawn_camera,
            metric_depth_m(picture.depth),
            metric_depth_m(behind),
            (picture.bodies == _STILL_BODIES) | world.is_still(picture),
            part,
            tuple(T_camera_world @ T for T in T_world_part),
        )
        lamp_world_m = transform_points(self._scene.T_world_camera, LAMP_M[None])[0]
        T_world_lamp = make_transform(self._T_world_cameras[camera][:3, :3], lamp_world_m)
        seen = None
        if self._scene.room.shadow:
            seen = self.world.picture(view_matrix(T_world_lamp), self.projection, turn).depth
        lamp = Lamp.of((T_camera_world @ T_world_lamp)[:3, 3], seen)
        T_camera_tissue = T_camera_world @ risen(self._moment.rise_m) @ self._scene.T_world_tissue
        return self._shader.shaded(picture.image_bgr, surfaces, lamp, T_camera_tissue)

    def _background(self, camera: int, turn: int) -> Picture:
        """Tissue and floor as a camera sees them in even or in odd turns."""
        rise_m = 0.0 if self._moment is None else self._moment.rise_m
        is_same = rise_m == self._background_rise_m and self._tissue is self._background_tissue
        if not is_same:
            self._backgrounds.clear()
        key = camera, turn % 2
        if key not in self._backgrounds:
            if self._still is None:
                self._still = DrawnWorld(self._scene, still=True, moving=False)
            if not is_same:
                self._still.shape_tissue(self._tissue)
                self._still.raise_tissue(rise_m)
                self._background_rise_m, self._background_tissue = rise_m, self._tissue
            self._backgrounds[key] = self._still.picture(self._views[camera], self.projection, turn)
        return self._backgrounds[key]

    def _in_one_picture(self, camera: int, turn: int) -> Picture:
        """Draw everything together, as few frames need it: those in which surfaces meet within a pixel's centre."""
        if self._whole is None:
            self._whole = DrawnWorld(self._scene, self._others, still=True, moving=True)
        self._pose(self._whole)
        return self._whole.picture(self._views[camera], self.projection, turn)

    def _pose(self, world: DrawnWorld) -> None:
        assert self._moment is not None  # nothing is drawn before it is posed
        world.pose(self._moment.q[0], self._moment.T_world_retractor, self._moment.q[1:])
        room = self._scene.room
        if room.dent:
            world.shape_tissue(self._tissue)
        if room.dent or room.moves_tissue:
            world.raise_tissue(self._moment.rise_m)

    def close(self) -> None:
        """Leave the physics worlds and remove their files; a second call does nothing."""
        for world in (self.world, self._still, self._whole):
            if world is not None:
                world.close()


def _through_optics(image_bgr: Image) -> Image:
    return np.asarray(cv2.GaussianBlur(image_bgr, (0, 0), OPTICS_SIGMA_PX), np.uint8)


def make_renderer(scene: Scene, name: str, others: Sequence[Scene], seed: int) -> Renderer | PhotoRenderer:
    """The renderer of a name; raises SimulationError for a name that there is not, or one that is not installed."""
    if name == "mitsuba":
        return PhotoRenderer(scene, others)
    return Renderer(scene, name, others, seed=seed)
