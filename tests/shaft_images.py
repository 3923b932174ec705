"""Images of a dark shaft with a steel tip and a coloured distal marker, ray by ray from exact geometry.

Nothing of the simulation is in them: a cylinder, a thinner one and a sphere are intersected with the rays of
the pixels' parts, over a flat background, in the frame of whatever endoscope.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from svmdist.camera import Camera
from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision.lines import undistorted

RADIUS_M, KNUCKLE_RADIUS_M, END_M, WRIST_M = 0.004, 0.00175, 0.00627, 0.0091
PALE_BGR, RED_BGR = (170.0, 185.0, 205.0), (70.0, 60.0, 190.0)
KNUCKLE_BGR = (178.0, 158.0, 0.0)
STRIP_PX = 16
"""Rows that are drawn at once: the rays of a whole picture would be moved through memory with every step."""


@dataclass(frozen=True)
class ShaftImage:
    """One picture to draw: the hinge (3,) and the shaft's direction to the tip (3,), the scene and its faults."""

    camera: Camera
    hinge_m: Array
    direction: Array
    background_bgr: tuple[float, float, float] = PALE_BGR
    stripe: bool = False
    glints: int = 0
    marker: bool = True
    gradient: float = 0.0
    vignette: float = 0.0
    blur_px: float = 0.8
    noise: float = 2.0
    border: str = "none"

    @property
    def tool_m(self) -> Array:
        """The tool's origin with a straight wrist, shape (3,)."""
        return self.hinge_m + WRIST_M * self.direction

    def draw(self, parts: int = 3, seed: int = 0) -> Image:
        """The picture, BGR, each pixel the mean of `parts` squared rays."""
        height = self.camera.height_px
        strips = [np.arange(top, min(top + STRIP_PX, height)) for top in range(0, height, STRIP_PX)]
        image = np.vstack([self._traced(rows, parts) for rows in strips])
        image = cv2.GaussianBlur(self._glinting(image, seed), (0, 0), self.blur_px)
        image *= self._border()[..., None]
        image += np.random.default_rng(seed).normal(0.0, self.noise, image.shape)
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)

    def _traced(self, rows: Array, parts: int) -> Array:
        """Rows of the sharp picture, shape (n, w, 3): what each pixel's rays meet first, and their mean."""
        width, height = self.camera.width_px, self.camera.height_px
        offsets = (np.arange(parts) + 0.5) / parts - 0.5
        x = (np.arange(width)[:, None] + offsets).ravel()
        y = (rows[:, None] + offsets).ravel()
        grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
        rays = np.column_stack([undistorted(self.camera, grid), np.ones(len(grid))])
        colour = np.tile(np.array(self.background_bgr), (len(rays), 1))
        depth = np.full(len(rays), np.inf)
        self._cylinder(rays, colour, depth, RADIUS_M, (-0.3, -END_M), (32.0, 30.0, 30.0), self.stripe)
        self._cylinder(rays, colour, depth, 0.0027, (-END_M, 0.0), (150.0, 150.0, 148.0), False)
        if self.marker:
            self._sphere(rays, colour, depth)
        if self.gradient or self.vignette:
            # Light falls off along the image's diagonal; the scene is lit so, the shaft with it.
            light = 1.0 - self.gradient * (grid @ [1.0 / width, 1.0 / height] / 2.0)
            middle = np.array([0.5 * width, 0.5 * height])
            from_middle = np.hypot(*(grid - middle).T) / np.hypot(*middle)
            colour *= (light * (1.0 - self.vignette * from_middle**2))[:, None]
        return colour.reshape(len(rows), parts, width, parts, 3).mean((1, 3))

    def _cylinder(
        self,
        rays: Array,
        colour: Array,
        depth: Array,
        radius_m: float,
        span_m: tuple[float, float],
        bgr: tuple[float, float, float],
        stripe: bool,
    ) -> None:
        d, h = self.direction, self.hinge_m
        to = h - (h @ d) * d
        # Across the axis: the rays' squared lengths, and their products with what leads to the axis.
        along, b, c = rays @ d, rays @ to, to @ to - radius_m**2
        a = np.einsum("ij,ij->i", rays, rays) - along**2
        hit = np.flatnonzero(b * b > a * c)
        a, b, along = a[hit], b[hit], along[hit]
        z = (b - np.sqrt(b * b - a * c)) / a
        place_m = z * along - h @ d
        seen = (place_m >= span_m[0]) & (place_m <= span_m[1]) & (z > 0.005) & (z < depth[hit])
        hit, z, along = hit[seen], z[seen], along[seen]
        normal = (z[:, None] * (rays[hit] - along[:, None] * d) - to) / radius_m
        side = np.cross(d, to / np.linalg.norm(to))
        light = np.abs(normal @ side - 0.25)
        shade = np.array(bgr) * (0.75 + 0.35 * np.abs(normal @ (to / np.linalg.norm(to))))[:, None]
        if stripe:
            shade = np.where(light[:, None] < 0.06, np.array([225.0, 230.0, 235.0]), shade)
        colour[hit] = shade
        depth[hit] = z

    def _glinting(self, image: Array, seed: int) -> Array:
        """White ellipses along the visible shaft, as wet steel and lacquer have them, some of them over its sides."""
        rng = np.random.default_rng([seed, 1])
        for _ in range(self.glints):
            point_m = self.hinge_m - rng.uniform(0.01, 0.03) * self.direction
            pixel = self.camera.project(point_m)[0]
            radius_px = self.camera.K[0, 0] * RADIUS_M / point_m[2]
            shift_px = rng.uniform(-1.0, 1.0, 2) * radius_px
            axes = (float(rng.uniform(0.2, 0.9) * radius_px), float(rng.uniform(0.1, 0.25) * radius_px))
            place = (float(pixel[0] + shift_px[0]), float(pixel[1] + shift_px[1]))
            cv2.ellipse(image, (place, axes, float(rng.uniform(0, 180))), (245.0, 245.0, 245.0), -1)
        return image

    def _sphere(self, rays: Array, colour: Array, depth: Array) -> None:
        a, b = np.einsum("ij,ij->i", rays, rays), rays @ self.tool_m
        c = self.tool_m @ self.tool_m - KNUCKLE_RADIUS_M**2
        hit = np.flatnonzero(b * b > a * c)
        z = (b[hit] - np.sqrt(b[hit] ** 2 - a[hit] * c)) / a[hit]
        hit = hit[z < depth[hit]]
        colour[hit] = KNUCKLE_BGR

    def _border(self) -> Array:
        """1 where the endoscope shows something, 0 in its black frame."""
        width, height = self.camera.width_px, self.camera.height_px
        mask = np.zeros((height, width), np.uint8)
        if self.border == "pillars":
            side = (width - round(1.25 * height)) // 2
            mask[:, side : width - side] = 255
        elif self.border == "disc":
            cv2.circle(mask, (width // 2, height // 2), round(0.52 * height), 255, -1, cv2.LINE_AA)
        else:
            mask[:] = 255
        return np.asarray(cv2.GaussianBlur(mask, (0, 0), 1.5) / 255.0)


def entering_from(
    angle_rad: float, camera: Camera, depth_m: float = 0.09, tilt_rad: float = 0.5
) -> tuple[Array, Array]:
    """Hinge and direction of a shaft that comes in from a side of the image, seen from its middle at `angle_rad`.

    Angles run clockwise from the right; the tip points away from the camera by `tilt_rad`.
    """
    outward = np.array([np.cos(angle_rad), np.sin(angle_rad), 0.0])
    direction = -np.cos(tilt_rad) * outward + np.array([0.0, 0.0, np.sin(tilt_rad)])
    reach_m = 0.12 * min(camera.width_px, camera.height_px) / camera.K[0, 0] * depth_m
    return np.array([0.0, 0.0, depth_m]) + reach_m * outward, direction
