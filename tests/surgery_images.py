"""Random pictures as endoscopes show them, drawn with their masks: tissue, instruments, light, blood, border, blur."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.samples import Image
from svmdist.transforms import Array

Canvas = NDArray[np.float32]
BORDERS = ("none", "rectangle", "circle", "octagon")


@dataclass(frozen=True)
class SurgeryImage:
    """A picture, shape (h, w, 3) in BGR, the masks (h, w) of instruments and picture, and each axis (2, 2)."""

    bgr: Image
    instruments: Image
    picture: Image
    axes: tuple[Array, ...]
    tips: tuple[Array, ...]


def surgery_image(
    seed: int,
    *,
    count: int | None = None,
    size: tuple[int, int] = (480, 640),
    border: str | None = None,
    background: str = "tissue",
) -> SurgeryImage:
    """Draw one. Without `count`, one or two instruments come in from different sides; `size` is (h, w)."""
    rng = np.random.default_rng(seed)
    border = BORDERS[seed % len(BORDERS)] if border is None else border
    picture = _picture(size, border)
    scene = _paper(rng, size) if background == "paper" else _tissue(rng, size)
    count = int(rng.integers(1, 3)) if count is None else count
    inside = np.zeros(size, np.uint8)
    axes, tips = [], []
    sides = rng.permutation(3)[:count]  # left, right, above: trocars are not below the picture
    for side in sides:
        entry, tip = _course(rng, int(side), picture)
        drawn, axis = _instrument(rng, scene, entry, tip)
        inside |= drawn
        axes.append(axis)
        tips.append(tip)
    scene *= _light(rng, size)[..., None]
    scene = _highlights(rng, scene)
    scene = cv2.GaussianBlur(scene, (0, 0), float(rng.uniform(0.7, 1.3)))
    scene[picture == 0] = rng.uniform(0.0, 8.0)
    noisy = scene + rng.normal(0.0, rng.uniform(0.5, 3.0), scene.shape)
    bgr = np.clip(noisy, 0, 255).astype(np.uint8)
    return SurgeryImage(bgr, np.asarray(inside & picture, np.uint8), picture, tuple(axes), tuple(tips))


def _picture(size: tuple[int, int], border: str) -> Image:
    height, width = size
    mask = np.zeros(size, np.uint8)
    centre = (width // 2, height // 2)
    if border == "none":
        mask[:] = 255
    elif border == "rectangle":
        mask[:, width // 8 : -width // 8] = 255
    elif border == "circle":
        cv2.circle(mask, centre, int(0.52 * height), 255, cv2.FILLED)
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


def _paper(rng: np.random.Generator, size: tuple[int, int]) -> Canvas:
    """Pale and hardly coloured, with a cast of the light's."""
    base = rng.uniform(130, 190) * np.array([rng.uniform(0.7, 1.0), 1.0, rng.uniform(0.95, 1.05)], np.float32)
    texture = 0.05 * _noise(rng, size, 4) + 0.03 * _noise(rng, size, 90)
    return np.ascontiguousarray(base[None, None] * (1.0 + texture[..., None]), np.float32)


def _course(rng: np.random.Generator, side: int, picture: Image) -> tuple[Array, Array]:
    """Where an instrument's axis leaves the image, and its tip inside of the picture, shape (2,) each."""
    height, width = picture.shape
    tip = np.array([rng.uniform(0.35, 0.65) * width, rng.uniform(0.4, 0.65) * height])
    outside = {
        0: np.array([-0.15 * width, rng.uniform(0.05, 0.8) * height]),
        1: np.array([1.15 * width, rng.uniform(0.05, 0.8) * height]),
        2: np.array([rng.uniform(0.15, 0.85) * width, -0.2 * height]),
    }[side]
    tip[0] += {0: -0.12, 1: 0.12, 2: 0.0}[side] * width
    return outside, tip


def _instrument(rng: np.random.Generator, scene: Canvas, entry: Array, tip: Array) -> tuple[Image, Array]:
    """Draw shaft, wrist and two jaws; gives the mask, shape (h, w), and the shaft's axis, shape (2, 2)."""
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
    neck = np.array(
        [end + 0.7 * across_px, wrist + 0.5 * across_px, wrist - 0.5 * across_px, end - 0.7 * across_px]
    )
    opening = rng.uniform(0.1, 0.5)
    jaws = [
        np.array([wrist + 0.45 * side, tip + opening * side, wrist - 0.05 * side])
        for side in (across_px, -across_px)
    ]
    y, x = np.mgrid[:height, :width].astype(np.float32)
    across = ((x - entry[0]) * normal[0] + (y - entry[1]) * normal[1]) / half
    round_light = np.sqrt(np.clip(1.0 - 0.85 * (across - rng.uniform(-0.3, 0.3)) ** 2, 0.05, 1.0)).astype(
        np.float32
    )
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
        soft = (
            cv2.GaussianBlur(glare, (0, 0), 2.0).astype(np.float32)[..., None] / 255.0 * (mask > 0)[..., None]
        )
        scene += (1.0 - scene / 255.0).clip(0.0) * 200.0 * soft
    if rng.random() < 0.6:  # blood on it
        for _ in range(int(rng.integers(1, 6))):
            at = entry + along * rng.uniform(0.3, 1.0) * length + normal * rng.uniform(-1.0, 1.0) * half
            blot = np.zeros((height, width), np.uint8)
            axes = (int(rng.uniform(0.1, 0.5) * half) + 1, int(rng.uniform(0.1, 0.35) * half) + 1)
            cv2.ellipse(
                blot, (int(at[0]), int(at[1])), axes, float(rng.uniform(0, 180)), 0, 360, 255, cv2.FILLED
            )
            scene[(blot > 0) & (mask > 0)] = (25.0, 22.0, 110.0)
    return mask, np.stack([entry, end])


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
