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

from svmdist.errors import SimulationError, did_you_mean
from svmdist.samples import Image
from svmdist.simulation.closing import Closing
from svmdist.simulation.drawn_world import DrawnWorld, Picture
from svmdist.simulation.scene import Scene
from svmdist.simulation.views import PIXEL_SHIFT, projection_matrix, view_matrix
from svmdist.transforms import Array

RendererName = Literal["tiny", "egl"]
RENDERERS: tuple[RendererName, ...] = ("tiny", "egl")

OPTICS_SIGMA_PX = 0.8
"""Blur of the optics: no lens draws edges of one pixel, and it hides the renderer's stairs."""
DEPTH_TIE = 2.5e-7
"""Four steps of a float32 below 1, which is 0.25 µm here. TinyRenderer compares depths before it scales and rounds
them for its depth buffer. Surfaces that are nearer to each other than that are drawn in one picture again."""


class Renderer(Closing):
    """Draws robot, further robots, retractor, tissue and floor; a context manager.

    `frame_of` poses the robot and returns a BGR image, shape (height, width, 3); `right_frame` then draws the
    same instant for the right camera. `turn` numbers the pictures of a recording from 0, those of both cameras
    together; without it, a picture is the next one. It settles the image, whatever was drawn before.
    """

    def __init__(self, scene: Scene, name: str = "tiny", others: Sequence[Scene] = ()) -> None:
        if name not in RENDERERS:
            raise SimulationError(f"no renderer named {name}: {did_you_mean(name, RENDERERS)}")
        self._scene, self._others = scene, tuple(others)
        self._is_tiny = name == "tiny"
        self._views = (
            view_matrix(scene.T_world_camera),
            view_matrix(scene.T_world_camera @ scene.T_camera_right),
        )
        self.projection = projection_matrix(scene.camera, PIXEL_SHIFT[name])
        self._backgrounds: dict[tuple[int, int], Picture] = {}
        self._still: DrawnWorld | None = None
        self._whole: DrawnWorld | None = None
        self._turn = 0
        self._pose: tuple[Array, Array | None, tuple[Array, ...]] | None = None
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
    ) -> Image:
        """Draw the robot at joints `q`, shape (n_joints,), and the retractor where it is in the scene.

        `others` are the joints of the further arms.
        """
        self._pose = q, T_world_retractor, tuple(others)
        self.world.pose(*self._pose)
        return self._draw(0, turn)

    def right_frame(self, *, turn: int | None = None) -> Image:
        """Draw what `frame_of` has posed, as the right camera sees it."""
        return self._draw(1, turn)

    def _draw(self, camera: int, turn: int | None) -> Image:
        turn = self._turn if turn is None else turn
        self._turn = turn + 1
        picture = self.world.picture(self._views[camera], self.projection, turn)
        if not self._is_tiny:
            return _through_optics(picture.image_bgr)
        background = self._background(camera, turn)
        if (picture.drawn & (np.abs(picture.depth - background.depth) <= DEPTH_TIE)).any():
            return _through_optics(self._in_one_picture(camera, turn))
        in_front = picture.drawn & (picture.depth < background.depth)
        image_bgr = background.image_bgr.copy()
        cv2.copyTo(picture.image_bgr, in_front.view(np.uint8), image_bgr)
        return _through_optics(image_bgr)

    def _background(self, camera: int, turn: int) -> Picture:
        """Tissue and floor as a camera sees them in even or in odd turns."""
        key = camera, turn % 2
        if key not in self._backgrounds:
            if self._still is None:
                self._still = DrawnWorld(self._scene, still=True, moving=False)
            self._backgrounds[key] = self._still.picture(self._views[camera], self.projection, turn)
        return self._backgrounds[key]

    def _in_one_picture(self, camera: int, turn: int) -> Image:
        """Draw everything together, as few frames need it: those in which surfaces meet within a pixel's centre."""
        assert self._pose is not None  # nothing is drawn before it is posed
        if self._whole is None:
            self._whole = DrawnWorld(self._scene, self._others, still=True, moving=True)
        self._whole.pose(*self._pose)
        return self._whole.picture(self._views[camera], self.projection, turn).image_bgr

    def close(self) -> None:
        """Leave the physics worlds and remove their files; a second call does nothing."""
        for world in (self.world, self._still, self._whole):
            if world is not None:
                world.close()


def _through_optics(image_bgr: Image) -> Image:
    return np.asarray(cv2.GaussianBlur(image_bgr, (0, 0), OPTICS_SIGMA_PX), np.uint8)
