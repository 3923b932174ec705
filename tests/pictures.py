"""Pictures that the simulator never drew: painted surgery with masks, and a shaft ray by ray from exact geometry."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.camera import Camera
from svmdist.samples import Image
from svmdist.transforms import Array

Canvas = NDArray[np.float32]
Colour = tuple[float, float, float]
Span = tuple[float, float]
RADIUS_M, KNUCKLE_RADIUS_M, END_M, WRIST_M = 0.004, 0.00175, 0.00627, 0.0091
PALE_BGR, RED_BGR = (170.0, 185.0, 205.0), (70.0, 60.0, 190.0)
KNUCKLE_BGR = (178.0, 158.0, 0.0)
STRIP_PX = 16
"""Rows that are drawn at once: the rays of a whole picture would be moved through memory with every step."""
BORDERS = ("none", "rectangle", "circle", "octagon")


@dataclass(frozen=True)
class SurgeryImage:
    """A painted picture, shape (h, w, 3) in BGR, and the masks (h, w) of instruments and picture."""

    bgr: Image
    instruments: Image
    picture: Image


def surgery_image(seed: int, *, count: int | None = None, border: str | None = None) -> SurgeryImage:
    """Paint one. Without `count`, one or two instruments come in from different sides."""
    rng = np.random.default_rng(seed)
    size = (480, 640)
    picture = _border(size, border or BORDERS[seed % len(BORDERS)])
    scene = _tissue(rng, size)
    count = int(rng.integers(1, 3)) if count is None else count
    inside = np.zeros(size, np.uint8)
    for side in rng.permutation(3)[:count]:  # left, right, above: trocars are not below the picture
        inside |= _instrument(rng, scene, *_course(rng, int(side), size))
    scene *= _light(rng, size)[..., None]
    scene = _highlights(rng, scene)
    scene = cv2.GaussianBlur(scene, (0, 0), float(rng.uniform(0.7, 1.3)))
    scene[picture == 0] = rng.uniform(0.0, 8.0)
    noisy = scene + rng.normal(0.0, rng.uniform(0.5, 3.0), scene.shape)
    bgr = np.clip(noisy, 0, 255).astype(np.uint8)
    return SurgeryImage(bgr, np.asarray(inside & picture, np.uint8), picture)


def _border(size: tuple[int, int], border: str) -> Image:
    """255 where the endoscope shows something, 0 in its black frame."""
    height, width = size
    mask = np.zeros(size, np.uint8)
    if border == "none":
        mask[:] = 255
    elif border == "rectangle":
        mask[:, width // 8 : -width // 8] = 255
    elif border == "circle":
        cv2.circle(mask, (width // 2, height // 2), int(0.52 * height), 255, cv2.FILLED)
    else:
        cut = height // 6
        right, bottom = width - width // 10, height - 6
        left, top = width // 10, 6
        corners = [
            (left + cut, top), (right - cut, top), (right, top + cut), (right, bottom - cut),
            (right - cut, bottom), (left + cut, bottom), (left, bottom - cut), (left, top + cut),
        ]  # fmt: skip
        cv2.fillConvexPoly(mask, np.array(corners, np.int32), 255)
    return mask


def _noise(rng: np.random.Generator, size: tuple[int, int], cells: int) -> Canvas:
    """Smooth noise from -1 to 1, shape (h, w)."""
    coarse = rng.uniform(-1.0, 1.0, (max(2, cells * size[0] // size[1]), cells)).astype(np.float32)
    return np.asarray(cv2.resize(coarse, (size[1], size[0]), interpolation=cv2.INTER_CUBIC), np.float32)


def _tissue(rng: np.random.Generator, size: tuple[int, int]) -> Canvas:
    """Red to pink with patches of fat and vessels."""
    base = np.array([rng.uniform(55, 110), rng.uniform(60, 120), rng.uniform(150, 215)], np.float32)
    texture = 0.16 * _noise(rng, size, 5) + 0.1 * _noise(rng, size, 17) + 0.05 * _noise(rng, size, 60)
    scene = base[None, None] * (1.0 + texture[..., None])
    fat = np.clip(3.0 * (_noise(rng, size, 6) - rng.uniform(0.4, 0.9)), 0.0, 1.0)[..., None]
    scene = (1.0 - fat) * scene + fat * np.array([70.0, 160.0, 215.0], np.float32)
    for _ in range(int(rng.integers(2, 7))):
        points = np.cumsum(rng.normal(0.0, 28.0, (12, 2)), axis=0) + rng.uniform(0.0, 1.0, 2) * size[::-1]
        overlay = scene.copy()
        cv2.polylines(overlay, [points.astype(np.int32)], False, (40.0, 35.0, 120.0), int(rng.integers(1, 4)))
        scene = 0.5 * scene + 0.5 * overlay
    return np.ascontiguousarray(scene, np.float32)


def _course(rng: np.random.Generator, side: int, size: tuple[int, int]) -> tuple[Array, Array]:
    """Where an instrument's axis leaves the image, and its tip inside of the picture, shape (2,) each."""
    height, width = size
    tip = np.array([rng.uniform(0.35, 0.65) * width, rng.uniform(0.4, 0.65) * height])
    outside = {
        0: np.array([-0.15 * width, rng.uniform(0.05, 0.8) * height]),
        1: np.array([1.15 * width, rng.uniform(0.05, 0.8) * height]),
        2: np.array([rng.uniform(0.15, 0.85) * width, -0.2 * height]),
    }[side]
    tip[0] += {0: -0.12, 1: 0.12, 2: 0.0}[side] * width
    return outside, tip


def _instrument(rng: np.random.Generator, scene: Canvas, entry: Array, tip: Array) -> Image:
    """Paint shaft, wrist and two jaws; gives the mask, shape (h, w)."""
    height, width = scene.shape[:2]
    length = float(np.linalg.norm(tip - entry))
    along = (tip - entry) / length
    normal = np.array([-along[1], along[0]])
    half = width * rng.uniform(0.025, 0.06)
    end = tip - along * half * rng.uniform(3.0, 4.5)
    wrist = end + along * half * 2.0
    taper = rng.uniform(0.8, 1.0)
    across_px = normal * half
    shaft = np.array([entry + across_px, end + taper * across_px, end - taper * across_px, entry - across_px])
    upper, lower = 0.7 * across_px, 0.5 * across_px
    neck = np.array([end + upper, wrist + lower, wrist - lower, end - upper])
    opening = rng.uniform(0.1, 0.5)
    jaws = [
        np.array([wrist + 0.45 * side, tip + opening * side, wrist - 0.05 * side]) for side in (across_px, -across_px)
    ]
    y, x = np.mgrid[:height, :width].astype(np.float32)
    across = ((x - entry[0]) * normal[0] + (y - entry[1]) * normal[1]) / half
    round_light = np.sqrt(np.clip(1.0 - 0.85 * (across - rng.uniform(-0.3, 0.3)) ** 2, 0.05, 1.0))
    cast = np.array([rng.uniform(0.95, 1.06), 1.0, rng.uniform(0.96, 1.1)], np.float32)
    shaft_level, steel_level = rng.choice([32.0, 60.0, 120.0, 165.0]), rng.uniform(120.0, 190.0)
    mask = np.zeros((height, width), np.uint8)
    for part, level in ((shaft, shaft_level), (neck, steel_level), *((jaw, steel_level) for jaw in jaws)):
        own = np.zeros((height, width), np.uint8)
        cv2.fillPoly(own, [np.rint(part).astype(np.int32)], 255)
        shade = (0.45 + 0.55 * round_light) * (1.0 + 0.06 * _noise(rng, (height, width), 40))
        scene[own > 0] = (level * shade[..., None] * cast)[own > 0]
        mask |= own
    if rng.random() < 0.6:  # glare along the shaft
        glare = np.zeros((height, width), np.uint8)
        at = rng.uniform(-0.5, 0.5) * half * normal
        cv2.line(glare, *(tuple(int(v) for v in p + at) for p in (entry, end)), 255, max(1, int(0.18 * half)))
        soft = cv2.GaussianBlur(glare, (0, 0), 2.0) / 255.0 * (mask > 0)
        scene += (1.0 - scene / 255.0).clip(0.0) * 200.0 * soft[..., None]
    if rng.random() < 0.6:  # blood on it
        for _ in range(int(rng.integers(1, 6))):
            at = entry + along * rng.uniform(0.3, 1.0) * length + normal * rng.uniform(-1.0, 1.0) * half
            blot = np.zeros((height, width), np.uint8)
            axes = (int(rng.uniform(0.1, 0.5) * half) + 1, int(rng.uniform(0.1, 0.35) * half) + 1)
            cv2.ellipse(blot, at.astype(int).tolist(), axes, rng.uniform(0, 180), 0, 360, 255, cv2.FILLED)
            scene[(blot > 0) & (mask > 0)] = (25.0, 22.0, 110.0)
    return mask


def _light(rng: np.random.Generator, size: tuple[int, int]) -> Canvas:
    """A lamp at the camera: bright in the middle."""
    height, width = size
    y, x = np.mgrid[:height, :width].astype(np.float32)
    r2 = ((x - width / 2) ** 2 + (y - height / 2) ** 2) / (width / 2) ** 2
    return np.asarray(rng.uniform(0.75, 1.15) / (1.0 + rng.uniform(0.1, 0.6) * r2), np.float32)


def _highlights(rng: np.random.Generator, scene: Canvas) -> Canvas:
    """Wet tissue and steel shine in small spots."""
    height, width = scene.shape[:2]
    spots = np.zeros((height, width), np.uint8)
    for _ in range(int(rng.integers(5, 60))):
        at = (int(rng.integers(0, width)), int(rng.integers(0, height)))
        axes = (int(rng.integers(1, 5)), int(rng.integers(1, 4)))
        cv2.ellipse(spots, at, axes, float(rng.uniform(0, 180)), 0, 360, 255, cv2.FILLED)
    soft = cv2.GaussianBlur(spots, (0, 0), 1.0).astype(np.float32)[..., None] / 255.0
    return np.asarray(scene + (250.0 - scene).clip(0.0) * soft, np.float32)


@dataclass(frozen=True)
class ShaftImage:
    """One picture to draw: the hinge (3,) and the shaft's direction to the tip (3,), the scene and its faults."""

    camera: Camera
    hinge_m: Array
    direction: Array
    background_bgr: Colour = PALE_BGR
    stripe: bool = False
    marker: bool = True
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
        image = cv2.GaussianBlur(image, (0, 0), self.blur_px)
        border = _border((height, self.camera.width_px), self.border)
        image *= (cv2.GaussianBlur(border, (0, 0), 1.5) / 255.0)[..., None]
        image += np.random.default_rng(seed).normal(0.0, self.noise, image.shape)
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)

    def _traced(self, rows: Array, parts: int) -> Array:
        """Rows of the sharp picture, shape (n, w, 3): what each pixel's rays meet first, and their mean."""
        width = self.camera.width_px
        offsets = (np.arange(parts) + 0.5) / parts - 0.5
        x = (np.arange(width)[:, None] + offsets).ravel()
        y = (rows[:, None] + offsets).ravel()
        grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
        rays = self.camera.rays(grid)
        colour = np.tile(np.array(self.background_bgr), (len(rays), 1))
        depth = np.full(len(rays), np.inf)
        self._cylinder(rays, colour, depth, RADIUS_M, (-0.3, -END_M), (32.0, 30.0, 30.0), self.stripe)
        self._cylinder(rays, colour, depth, 0.0027, (-END_M, 0.0), (150.0, 150.0, 148.0), False)
        if self.marker:
            self._sphere(rays, colour, depth)
        return colour.reshape(len(rows), parts, width, parts, 3).mean((1, 3))

    def _cylinder(
        self,
        rays: Array,
        colour: Array,
        depth: Array,
        radius_m: float,
        span_m: Span,
        bgr: Colour,
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
        ahead = to / np.linalg.norm(to)
        colour[hit] = np.array(bgr) * (0.75 + 0.35 * np.abs(normal @ ahead))[:, None]
        if stripe:
            colour[hit[np.abs(normal @ np.cross(d, ahead) - 0.25) < 0.06]] = (225.0, 230.0, 235.0)
        depth[hit] = z

    def _sphere(self, rays: Array, colour: Array, depth: Array) -> None:
        a, b = np.einsum("ij,ij->i", rays, rays), rays @ self.tool_m
        c = self.tool_m @ self.tool_m - KNUCKLE_RADIUS_M**2
        hit = np.flatnonzero(b * b > a * c)
        z = (b[hit] - np.sqrt(b[hit] ** 2 - a[hit] * c)) / a[hit]
        hit = hit[z < depth[hit]]
        colour[hit] = KNUCKLE_BGR


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
