"""Light from the endoscope's tip, shadows, wet highlights and blood, put onto drawn images by their depths.

The renderer knows one far lamp and no shadows. Here every pixel's place in space is known from the depth buffer, so
that light can fall off with distance, be kept away by the instrument, and be mirrored by wet tissue as the eye sees it.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.camera import Camera
from svmdist.samples import Image
from svmdist.simulation.room.settings import Room
from svmdist.simulation.room.surfaces import Points, Surfaces, metric_depth_m
from svmdist.transforms import Array, inverse, transform_points

LAMP_M = np.array([0.0025, -0.005, 0.0])
"""Where the lamp is for the left camera: between both lenses of a stereo endoscope, at the upper rim of its tip."""
FULL_LIGHT_M = 0.100
"""The automatic exposure is right at this distance from the lamp."""
GAMMA = 2.2
"""Cameras give light to the power of 1 / 2.2: a quarter of the light is half of the level."""
UMBRA = 0.75
"""Of the lamp's light, in the middle of a shadow that is complete; the rest comes by way of other tissue."""
BIAS_M = 0.001
PENUMBRA_PX = 2.5
"""A lamp of 2 mm, 24 mm of air under the instrument: 0.5 mm of half-shade."""
SHININESS = 350.0
"""Exponent of Blinn's highlight: half its strength 3.6° off the mirror's direction, as a film of water is."""
HIGHLIGHT = 260.0
BUMP_SLOPE, BUMP_CELLS, BUMP_SPAN_M, BUMP_PX = 0.10, 40, 0.07, 512
"""Slopes (standard deviation) of the film over bumps of 1.75 mm; a texture that repeats every 70 mm."""
NORMAL_SIGMA_PX = 3.0
BLOOD_BGR = np.array([18.0, 14.0, 118.0])
BLOOD_WAVE_COUNT = 12
BLOOD_WAVELENGTHS_M = (0.003, 0.009)
_BUMP_STREAM, _BLOOD_STREAM = 105, 106


@dataclass(frozen=True)
class Lamp:
    """The lamp as one camera sees it, shape (3,) in m, and what it sees of moving things, with the camera's K.

    `depth_m`, float32 (h, w), has the depths of a pinhole camera at the lamp's place; None where there is no shadow.
    """

    place_m: Array
    depth_m: NDArray[np.float32] | None

    @staticmethod
    def of(place_m: Array, buffer: NDArray[np.float32] | None) -> Lamp:
        """By the depth buffer of a picture that was taken from there."""
        return Lamp(place_m, None if buffer is None else metric_depth_m(buffer))


class Shader:
    """Puts a room's light and dirt onto images; a seed settles where."""

    def __init__(self, room: Room, seed: int) -> None:
        self._room = room
        rng = np.random.default_rng([seed, _BUMP_STREAM])
        cells = rng.normal(0.0, 1.0, (BUMP_CELLS, BUMP_CELLS))
        tiled = cv2.resize(np.tile(cells, (3, 3)), (3 * BUMP_PX, 3 * BUMP_PX), interpolation=cv2.INTER_CUBIC)
        film = tiled[BUMP_PX : 2 * BUMP_PX, BUMP_PX : 2 * BUMP_PX]
        slopes = np.stack([np.roll(film, -1, axis) - np.roll(film, 1, axis) for axis in (1, 0)], -1)
        self._slopes = (slopes * (BUMP_SLOPE / slopes.std())).astype(np.float32)
        rng = np.random.default_rng([seed, _BLOOD_STREAM])
        toward = rng.normal(0.0, 1.0, (BLOOD_WAVE_COUNT, 3))
        toward /= np.linalg.norm(toward, axis=1, keepdims=True)
        length_m = rng.uniform(*BLOOD_WAVELENGTHS_M, (BLOOD_WAVE_COUNT, 1))
        self._blood_waves: Array = toward * (2.0 * np.pi / length_m)
        self._blood_phases = rng.uniform(0.0, 2.0 * np.pi, BLOOD_WAVE_COUNT)

    def shaded(self, image_bgr: Image, surfaces: Surfaces, lamp: Lamp, T_camera_tissue: Array) -> Image:
        """The image with what the room adds to it; `T_camera_tissue`, shape (4, 4), carries the film of water."""
        room, levels = self._room, image_bgr.astype(np.float32)
        if room.blood:
            self._stain(levels, surfaces)
        behind_m = surfaces.points_m(surfaces.behind_m)
        gain = np.ones(surfaces.depth_m.shape, np.float32)
        if room.light:
            d_m = _lengths(surfaces.points_m(surfaces.depth_m) - lamp.place_m.astype(np.float32))
            gain *= (FULL_LIGHT_M / d_m) ** (2.0 * room.light / GAMMA)
        unlit = np.zeros_like(gain)
        if lamp.depth_m is not None:
            unlit = room.shadow * shadow(surfaces.camera, behind_m, lamp)
            gain *= np.where(surfaces.is_still, (1.0 - UMBRA * unlit) ** (1.0 / GAMMA), 1.0)
        levels *= gain[..., None]
        if room.wet:
            glints = self._glints(behind_m, lamp, T_camera_tissue) * (1.0 - unlit) * surfaces.is_still
            levels += (HIGHLIGHT * room.wet * glints)[..., None]
        return np.asarray(cv2.convertScaleAbs(np.clip(levels, 0.0, 255.0)), np.uint8)

    def _stain(self, levels: NDArray[np.float32], surfaces: Surfaces) -> None:
        """Put blood onto the parts: patches that stay where they are on each."""
        points_m = surfaces.points_m(surfaces.depth_m)
        above = NormalDist().inv_cdf(1.0 - self._room.blood)  # a sum of waves is nearly normal
        for index, T_camera_part in enumerate(surfaces.T_camera_part):
            here = surfaces.part == index
            if not here.any():
                continue
            p_m = transform_points(inverse(T_camera_part), points_m[here])
            waves = np.cos(p_m @ self._blood_waves.T + self._blood_phases).sum(axis=1)
            share = np.clip(0.5 + 4.0 * (waves / np.sqrt(0.5 * BLOOD_WAVE_COUNT) - above), 0.0, 0.95)[:, None]
            # Blood is shaded as what it lies on: half of it in its shade, half in the open.
            shade = 0.6 + 0.4 * levels[here].mean(axis=1, keepdims=True) / 128.0
            levels[here] = (1.0 - share) * levels[here] + share * BLOOD_BGR * shade

    def _glints(self, points_m: Points, lamp: Lamp, T_camera_tissue: Array) -> NDArray[np.float32]:
        """Blinn's highlights of the lamp on the film over tissue and floor, 0 to about 1, shape (h, w)."""
        T_tissue_camera = inverse(T_camera_tissue).astype(np.float32)
        column_px, row_px = (
            np.mod(
                (points_m @ T_tissue_camera[k, :3] + T_tissue_camera[k, 3]) * (BUMP_PX / BUMP_SPAN_M), BUMP_PX
            )
            for k in range(2)
        )
        slopes = np.asarray(
            cv2.remap(self._slopes, column_px, row_px, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        )
        normals = np.asarray(_normals(points_m) + slopes @ T_tissue_camera[:2, :3], np.float32)
        to_lamp = lamp.place_m.astype(np.float32) - points_m
        d_m = _lengths(to_lamp)
        half = to_lamp / d_m[..., None] - points_m / _lengths(points_m)[..., None]
        cosine = np.einsum("ijk,ijk->ij", normals, half) / (_lengths(normals) * _lengths(half))
        return np.asarray(np.clip(cosine, 0.0, 1.0) ** SHININESS * (FULL_LIGHT_M / d_m) ** (2.0 / GAMMA))


def shadow(camera: Camera, points_m: Points, lamp: Lamp) -> NDArray[np.float32]:
    """How much of the lamp is hidden from points of the camera's frame, shape (h, w, 3): 0 to 1, shape (h, w)."""
    assert lamp.depth_m is not None
    from_lamp_m = points_m - lamp.place_m.astype(np.float32)
    K = camera.K.astype(np.float32)
    column_px, row_px = (from_lamp_m[..., k] / from_lamp_m[..., 2] * K[k, k] + K[k, 2] for k in range(2))
    first_m = cv2.remap(
        lamp.depth_m,
        column_px,
        row_px,
        cv2.INTER_NEAREST,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=1e3,
    )
    hidden = (first_m < from_lamp_m[..., 2] - BIAS_M).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(hidden, (0, 0), PENUMBRA_PX), np.float32)


def _normals(points_m: Points) -> Points:
    """Unit normals towards the camera, shape (h, w, 3), smooth over the facets of meshes."""
    smooth_m = cv2.GaussianBlur(points_m, (0, 0), NORMAL_SIGMA_PX)
    along_x, along_y = np.gradient(smooth_m, axis=1), np.gradient(smooth_m, axis=0)
    across = np.stack(
        [
            along_y[..., j] * along_x[..., k] - along_y[..., k] * along_x[..., j]
            for j, k in ((1, 2), (2, 0), (0, 1))
        ],
        -1,
    )
    return np.asarray(across / _lengths(across)[..., None])


def _lengths(vectors: Points) -> NDArray[np.float32]:
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", vectors, vectors)))
