"""Effects on images that the renderer lacks: the lens, a lamp at the endoscope's tip, its shadows, gloss, blood."""

from __future__ import annotations

from dataclasses import dataclass, replace
from statistics import NormalDist

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.camera import Camera
from svmdist.perturbations import Perturbations
from svmdist.samples import Image
from svmdist.transforms import Array, inverse, transform_points

DISTORTION = np.array([-0.2, 0.05, 0.0, 0.0, 0.0])
"""k1, k2, p1, p2, k3 of a lens of strength 1: the corner of a 60° image moves by 11 % of its radius towards the
middle, as in a wide endoscope. Times 2.8 or more, r (1 + k1 r² + k2 r⁴) would no longer grow with r everywhere."""
LENS_MARGIN_PX, LENS_ITERATIONS = 2, 1000  # a few pixels in the corners need as many; most take ten
LAMP_M = np.array([0.0025, -0.005, 0.0])  # in the left camera's frame: between both lenses, at the upper rim of the tip
FULL_LIGHT_M = 0.100  # the automatic exposure is right at this distance from the lamp
GAMMA = 2.2  # cameras give light to the power of 1 / 2.2: a quarter of the light is half of the level
UMBRA = 0.75  # share of the lamp's light in the middle of a complete shadow; the rest comes by way of other tissue
BIAS_M = 0.001  # so that surfaces do not hide themselves
PENUMBRA_PX = 2.5  # a lamp of 2 mm, 24 mm of air under the instrument: 0.5 mm of half-shade
SHININESS = 350.0  # Blinn's exponent: half the highlight 3.6° off the mirror's direction, as of a film of water
BUMP_SLOPE, BUMP_CELLS, BUMP_SPAN_M, BUMP_PX = 0.10, 40, 0.07, 512
"""Slopes (standard deviation) of the film over bumps of 1.75 mm; a texture that repeats every 70 mm."""
BLOOD_BGR, BLOOD_WAVE_COUNT, BLOOD_WAVELENGTHS_M = np.array([18.0, 14.0, 118.0]), 12, (0.003, 0.009)
_BUMP_STREAM, _BLOOD_STREAM = 105, 106
Depths = NDArray[np.float32]
Points = NDArray[np.float32]  # images of positions, shape (h, w, 3): a float32 resolves 10 nm at 0.1 m


@dataclass(frozen=True)
class Lens:
    """Distortion of images of the pinhole camera `wide`: where in them each pixel is, float32 (h, w, 2)."""

    wide: Camera
    at_px: NDArray[np.float32]

    @staticmethod
    def of(camera: Camera, distortion: Array) -> Lens:
        """The lens of a camera's size and K, with OpenCV's coefficients, shape (5,)."""
        width, height, K = camera.width_px, camera.height_px, camera.K
        every_px = np.mgrid[:height, :width][::-1].reshape(2, -1).T.astype(np.float64)
        until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, LENS_ITERATIONS, 1e-12)
        pixels = cv2.undistortPoints(every_px, K, distortion, None, None, K, until).reshape(height, width, 2)
        low = np.minimum(np.floor(pixels.min(axis=(0, 1))).astype(int) - LENS_MARGIN_PX, 0)
        high = np.ceil(pixels.max(axis=(0, 1))).astype(int) + LENS_MARGIN_PX
        size = np.maximum(high, [width - 1, height - 1]) - low + 1
        wide_K = K.copy()
        wide_K[:2, 2] -= low
        wide = replace(camera, width_px=int(size[0]), height_px=int(size[1]), K=wide_K, D=np.zeros(5), P=None)
        return Lens(wide, (pixels - low).astype(np.float32))


@dataclass(frozen=True)
class Surfaces:
    """What stands at each pixel of a pinhole image: shape (h, w), depths are along the optical axis in m."""

    camera: Camera
    depth_m: Depths
    behind_m: Depths  # of tissue and floor, also where something is before them
    is_still: NDArray[np.bool_]  # where they are seen
    bodies: NDArray[np.int64]
    T_camera_part: dict[int, Array]  # of the bodies that are parts of instruments

    def points_m(self, depth_m: Depths) -> Points:
        """The points at depths, shape (h, w), in the camera's frame, shape (h, w, 3)."""
        K = self.camera.K
        row, column = map(np.arange, depth_m.shape)
        x = ((column - K[0, 2]) / K[0, 0]).astype(np.float32) * depth_m
        y = ((row - K[1, 2]) / K[1, 1]).astype(np.float32)[:, None] * depth_m
        return np.stack([x, y, depth_m], -1)


class Shader:
    """Adds light and dirt to images, by the perturbations light, shadow, wet and blood; the seed sets where."""

    def __init__(self, perturbations: Perturbations, seed: int) -> None:
        self._strength = perturbations
        rng = np.random.default_rng([seed, _BUMP_STREAM])
        cells = rng.normal(0.0, 1.0, (BUMP_CELLS, BUMP_CELLS))
        tiled = cv2.resize(np.tile(cells, (3, 3)), (3 * BUMP_PX, 3 * BUMP_PX), interpolation=cv2.INTER_CUBIC)
        film = tiled[BUMP_PX : 2 * BUMP_PX, BUMP_PX : 2 * BUMP_PX]
        slopes = np.stack([np.roll(film, -1, axis) - np.roll(film, 1, axis) for axis in (1, 0)], -1)
        self._slopes = (slopes * (BUMP_SLOPE / slopes.std())).astype(np.float32)
        rng = np.random.default_rng([seed, _BLOOD_STREAM])
        toward = rng.normal(0.0, 1.0, (BLOOD_WAVE_COUNT, 3))
        toward /= np.linalg.norm(toward, axis=1, keepdims=True)
        self._blood_waves: Array = toward * (2.0 * np.pi / rng.uniform(*BLOOD_WAVELENGTHS_M, (BLOOD_WAVE_COUNT, 1)))
        self._blood_phases = rng.uniform(0.0, 2.0 * np.pi, BLOOD_WAVE_COUNT)

    def shaded(
        self, image_bgr: Image, surfaces: Surfaces, lamp_m: Array, lamp_depth_m: Depths | None, T_camera_tissue: Array
    ) -> Image:
        """Shade an image by a lamp in the camera's frame, (3,); `T_camera_tissue`, (4, 4), carries the film of water.

        The lamp's depths, float32 (h, w), are what a camera with the same K and axes sees from it; None: no shadow.
        """
        levels = image_bgr.astype(np.float32)
        if self._strength["blood"]:
            self._stain(levels, surfaces)
        behind_m = surfaces.points_m(surfaces.behind_m)
        gain = np.ones(surfaces.depth_m.shape, np.float32)
        if light := self._strength["light"]:
            d_m = _lengths(surfaces.points_m(surfaces.depth_m) - lamp_m.astype(np.float32))
            gain *= (FULL_LIGHT_M / d_m) ** (2.0 * light / GAMMA)
        unlit = np.zeros_like(gain)
        if lamp_depth_m is not None:
            unlit = self._strength["shadow"] * shadow(surfaces.camera, behind_m, lamp_m, lamp_depth_m)
            gain *= np.where(surfaces.is_still, (1.0 - UMBRA * unlit) ** (1.0 / GAMMA), 1.0)
        levels *= gain[..., None]
        if wet := self._strength["wet"]:
            glints = self._glints(behind_m, lamp_m, T_camera_tissue) * (1.0 - unlit) * surfaces.is_still
            levels += (260.0 * wet * glints)[..., None]
        return np.asarray(cv2.convertScaleAbs(np.clip(levels, 0.0, 255.0)), np.uint8)

    def _stain(self, levels: NDArray[np.float32], surfaces: Surfaces) -> None:
        """Put blood onto the parts: patches that stay where they are on each."""
        points_m = surfaces.points_m(surfaces.depth_m)
        above = NormalDist().inv_cdf(1.0 - self._strength["blood"])  # a sum of waves is nearly normal
        for body, T_camera_part in surfaces.T_camera_part.items():
            here = surfaces.bodies == body
            p_m = transform_points(inverse(T_camera_part), points_m[here])
            waves = np.cos(p_m @ self._blood_waves.T + self._blood_phases).sum(axis=1)
            share = np.clip(0.5 + 4.0 * (waves / np.sqrt(0.5 * BLOOD_WAVE_COUNT) - above), 0.0, 0.95)[:, None]
            # Blood is shaded as what it lies on: half of it in its shade, half in the open.
            shade = 0.6 + 0.4 * levels[here].mean(axis=1, keepdims=True) / 128.0
            levels[here] = (1.0 - share) * levels[here] + share * BLOOD_BGR * shade

    def _glints(self, points_m: Points, lamp_m: Array, T_camera_tissue: Array) -> NDArray[np.float32]:
        """Blinn's highlights of the lamp on the film over tissue and floor, 0 to about 1, shape (h, w)."""
        T_tissue_camera = inverse(T_camera_tissue).astype(np.float32)
        x_m, y_m = (points_m @ T[:3] + T[3] for T in T_tissue_camera[:2])
        column_px, row_px = (np.mod(at_m * (BUMP_PX / BUMP_SPAN_M), BUMP_PX) for at_m in (x_m, y_m))
        slopes = cv2.remap(self._slopes, column_px, row_px, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        smooth_m = cv2.GaussianBlur(points_m, (0, 0), 3.0)  # over the facets of meshes
        across: Points = np.cross(np.gradient(smooth_m, axis=0), np.gradient(smooth_m, axis=1))
        across /= _lengths(across)[..., None]
        normals = np.asarray(across + slopes @ T_tissue_camera[:2, :3], np.float32)
        to_lamp = lamp_m.astype(np.float32) - points_m
        d_m = _lengths(to_lamp)
        half = to_lamp / d_m[..., None] - points_m / _lengths(points_m)[..., None]
        cosine = np.einsum("ijk,ijk->ij", normals, half) / (_lengths(normals) * _lengths(half))
        return np.asarray(np.clip(cosine, 0.0, 1.0) ** SHININESS * (FULL_LIGHT_M / d_m) ** (2.0 / GAMMA))


def shadow(camera: Camera, points_m: Points, lamp_m: Array, lamp_depth_m: Depths) -> NDArray[np.float32]:
    """How much of the lamp is hidden from points of the camera's frame, shape (h, w, 3): 0 to 1, shape (h, w)."""
    from_lamp_m = points_m - lamp_m.astype(np.float32)
    K = camera.K.astype(np.float32)
    column_px, row_px = (from_lamp_m[..., k] / from_lamp_m[..., 2] * K[k, k] + K[k, 2] for k in range(2))
    first_m = cv2.remap(lamp_depth_m, column_px, row_px, cv2.INTER_NEAREST, None, cv2.BORDER_CONSTANT, 1e3)
    hidden = (first_m < from_lamp_m[..., 2] - BIAS_M).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(hidden, (0, 0), PENUMBRA_PX), np.float32)


def _lengths(vectors: Points) -> NDArray[np.float32]:
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", vectors, vectors)))
