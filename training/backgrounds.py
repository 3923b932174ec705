"""What is behind the instruments, drawn: organs, drapes, training boxes, and what may be taken for instruments."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Size = tuple[int, int]
"""(h, w) in px. Fields have this shape and are float32; pictures have a third axis, BGR, with levels from 0 to 255."""
# Weight, red level, and green and blue over red, as (least, most) of each: what tissue looks like in a white light.
TISSUES = (
    (0.42, (75, 235), (0.20, 0.60), (0.20, 0.65)),  # liver, muscle, red and pink organs
    (0.10, (170, 245), (0.55, 0.80), (0.50, 0.85)),  # pale serosa
    (0.20, (170, 245), (0.62, 0.95), (0.28, 0.98)),  # fat; fascia, nearly white
    (0.16, (70, 200), (0.35, 1.05), (0.45, 1.10)),  # gall bladder, spleen, veins: brown to violet and grey
    (0.12, (45, 150), (0.05, 0.25), (0.06, 0.30)),  # blood
)


def fractal(rng: np.random.Generator, size: Size, cells: float, octaves: int = 4, gain: float = 0.5) -> Array:
    """Noise of unit variance: `cells` bumps over the width, then twice as many with `gain` times the amplitude."""
    field = np.zeros(size, np.float32)
    for octave in range(octaves):
        columns = max(2.0, min(cells * 2.0**octave, size[1] / 2))
        shape = max(2, round(columns * size[0] / size[1])) + 1, round(columns) + 1
        coarse = rng.standard_normal(shape).astype(np.float32)
        field += gain**octave * cv2.resize(coarse, size[::-1], interpolation=cv2.INTER_CUBIC)
    return np.asarray(field / np.sqrt(sum(gain ** (2 * octave) for octave in range(octaves))), np.float32)


def background(rng: np.random.Generator, size: Size) -> tuple[Array, Array]:
    """A picture without instruments, and which of its pixels are tissue: tissue mostly, else what other rooms have."""
    make, colour = ((_tissue, colour_of_tissue), (_room, _any_colour))[rng.choice(2, p=[0.66, 0.34])]
    scene = np.tile(colour(rng), (*size, 1)) if rng.random() < 0.2 else make(rng, size)  # a plain one, too
    if make is _tissue and rng.random() < 0.25:
        return _pad(rng, scene)
    return scene, np.full(size, make is _tissue)


def _pad(rng: np.random.Generator, tissue: Array) -> tuple[Array, Array]:
    """Tissue or silicone as a pad with straight sides that lies on a drape or a table, and what of it is tissue."""
    height, width = size = tissue.shape[:2]
    around, pad = _room(rng, size), np.zeros(size, np.uint8)
    middle, sides = rng.uniform(0.35, 0.65, 2) * (width, height), rng.uniform(0.5, 1.15, 2) * (width, height)
    corners = cv2.boxPoints((middle.tolist(), sides.tolist(), float(rng.normal(0.0, 20.0))))
    corners = np.rint(corners + rng.normal(0.0, 0.04, (4, 2)) * width).astype(np.int32)
    cv2.fillConvexPoly(pad, corners, 1)
    blur = cv2.GaussianBlur(pad.astype(np.float32), (0, 0), rng.uniform(0.02, 0.08) * width)[..., None]
    edge = cv2.GaussianBlur(pad.astype(np.float32), (0, 0), rng.uniform(0.5, 2.0))[..., None]
    around *= rng.uniform(0.15, 1.0) * (1.0 - rng.uniform(0.0, 0.8) * blur)
    own = tissue * (1.0 - rng.uniform(0.0, 0.6) * (1.0 - np.clip(2.0 * blur - 1.0, 0.0, 1.0)))
    return np.asarray(around + edge * (own - around), np.float32), pad > 0


def colour_of_tissue(rng: np.random.Generator) -> Array:
    """A tissue's colour at random, in BGR, shape (3,)."""
    _, red, green, blue = TISSUES[rng.choice(len(TISSUES), p=[weight for weight, *_ in TISSUES])]
    return rng.uniform(*red) * np.array([rng.uniform(*blue), rng.uniform(*green), 1.0], np.float32)


def _any_colour(rng: np.random.Generator) -> Array:
    """A colour of plastic, paper and cloth, often blue, green or white, in BGR, shape (3,)."""
    hue = rng.choice([rng.uniform(90, 125), rng.uniform(60, 95), rng.uniform(0, 180)])
    saturation = rng.uniform(0, 60) if rng.random() < 0.6 else rng.uniform(60, 220)
    pixel = np.array([[[hue, saturation, rng.uniform(40, 250)]]]).astype(np.uint8)
    return np.asarray(cv2.cvtColor(pixel, cv2.COLOR_HSV2BGR)[0, 0], np.float32)


def _shading(rng: np.random.Generator, height: Array, steepness: float) -> tuple[Array, Array]:
    """Cosines to a lamp near the camera and to its mirror image, in [0, 1], of a relief of some px seen from above."""
    slopes = [steepness * cv2.Sobel(height, cv2.CV_32F, x, 1 - x, ksize=3, scale=1 / 8) for x in (1, 0)]
    normal = np.stack([-slopes[0], -slopes[1], np.ones_like(height)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    light = np.array([*rng.normal(0.0, 0.35, 2), 1.0])
    light /= np.linalg.norm(light)
    half = light + np.array([0.0, 0.0, 1.0])
    half /= np.linalg.norm(half)
    return np.clip(normal @ light, 0.0, 1.0), np.clip(normal @ half, 0.0, 1.0)


def _tissue(rng: np.random.Generator, size: Size) -> Array:
    """Organs side by side, or silicone, each with its colour and texture; vessels, highlights, cavities."""
    bare = rng.random() < 0.3  # nearly without texture, as silicone and near or blurred tissue are
    octaves = 1 if bare else int(rng.integers(2, 6))
    height = fractal(rng, size, rng.uniform(1.5, 5.0), octaves, rng.uniform(0.3, 0.6))
    scene = np.tile(colour_of_tissue(rng), (*size, 1))
    for _ in range(int(rng.integers(0, 6))):  # an organ lies over what was there, and shades it
        edge = fractal(rng, size, rng.uniform(1.2, 4.0), 3, rng.uniform(0.1, 0.5)) - rng.normal(0.5, 0.5)
        covered, shade = _soft(edge, np.exp(rng.uniform(0.5, 4.0))), _soft(edge + rng.uniform(0.1, 0.4), 6.0)
        scene *= 1.0 - rng.uniform(0.0, 0.7) * (1.0 - covered) * shade
        scene += covered * (colour_of_tissue(rng) - scene)
        height = height + covered[..., 0] * rng.uniform(0.0, 3.0) * np.sqrt(np.clip(edge, 0.0, None))
    for _ in range(int(rng.integers(1, 4)) if rng.random() < 0.35 else 0):
        scene = _bar(rng, scene, is_tissue=True)
    if not bare:
        scene *= (1.0 + rng.uniform(0.02, 0.16) * fractal(rng, size, rng.uniform(8, 50), 3))[..., None]
        vessels = np.exp(-((fractal(rng, size, rng.uniform(2, 8), 3) / rng.uniform(0.01, 0.08)) ** 2))
        darker = 1.0 - rng.uniform([0.3, 0.25, 0.5], [0.9, 0.6, 0.95]).astype(np.float32)
        scene *= 1.0 - rng.uniform(0.0, 0.8) * darker * vessels[..., None]
    diffuse, mirror = _shading(rng, height.astype(np.float32), rng.uniform(2.0, 30.0) * size[1] / 350)
    scene *= (rng.uniform(0.15, 0.6) + diffuse)[..., None] * rng.uniform(0.7, 1.0)
    if rng.random() < 0.8:  # it is wet
        wet = mirror ** rng.uniform(40, 400) * np.clip(0.5 + fractal(rng, size, 12.0, 1), 0.0, 1.5)
        scene += (rng.uniform(30, 400) * wet)[..., None]
    return np.asarray(np.clip(scene, 0.0, 255.0), np.float32)


def _soft(field: Array, sharpness: float) -> Array:
    """0 to 1 over the field's change of sign, shape (h, w, 1)."""
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(sharpness * field, -30.0, 30.0))), np.float32)[..., None]


def _room(rng: np.random.Generator, size: Size) -> Array:
    """Drapes, foam, gauze and paper of any colour; on the board of a training box strips, discs and pegs, shadows."""
    height = fractal(rng, size, rng.uniform(2.0, 6.0), 3, 0.5)
    shade = 0.3 + 0.75 * _shading(rng, height, rng.uniform(0, 25) * float(rng.random() < 0.7))[0]
    scene = np.asarray(_any_colour(rng) * shade[..., None] * rng.uniform(0.2, 1.0), np.float32)
    for _ in range(int(rng.integers(2, 25)) if rng.random() < 0.45 else 0):
        at, reach = rng.uniform(0.0, 1.0, 2) * size[::-1], size[1] * np.exp(rng.uniform(-4.6, -1.9))
        corners = at + rng.standard_normal((int(rng.integers(3, 16)), 2)) * reach * rng.uniform(0.4, 1.0, 2)
        outline = cv2.convexHull(np.rint(corners).astype(np.int32))
        for shift, light in ((int(rng.integers(0, 6)), 0.15), (0, rng.uniform(0.4, 1.1))):
            cv2.fillPoly(scene, [outline + shift], (_any_colour(rng) * light).tolist(), cv2.LINE_AA)
    for _ in range(int(rng.integers(1, 5)) if rng.random() < 0.3 else 0):
        scene = _bar(rng, scene, is_tissue=False)
    grain = 1.0 + 0.12 * fractal(rng, size, rng.uniform(2.0, 60.0), 3)
    return np.asarray(np.clip(scene * grain[..., None], 0.0, 255.0), np.float32)


def _bar(rng: np.random.Generator, scene: Array, *, is_tissue: bool) -> Array:
    """With a bowel's loop, a vessel or a fold of fat over it, which is round as a shaft is, and tissue.

    Else with what stands behind instruments in a laboratory: links of robots, stands, cables, a table's edge.
    """
    size, blur = scene.shape[:2], rng.uniform(0.3, 4.0)
    widest, bend, taper = (0.14, 0.4, 0.5) if is_tissue else (0.3, 0.2 * float(rng.random() < 0.3), 0.3)
    half = size[1] * float(np.exp(rng.uniform(*np.log([0.011, widest]))))
    places = np.mgrid[: size[0], : size[1]][::-1].transpose(1, 2, 0) - rng.uniform(0.05, 0.95, 2) * size[::-1]
    cosine, sine = np.cos(heading := rng.uniform(0.0, 2.0 * np.pi)), np.sin(heading)
    along, across = np.moveaxis(places @ np.array([[cosine, -sine], [sine, cosine]]), 2, 0)
    across += rng.normal(0.0, bend) * along**2 / size[1]
    across += 0.3 * half * is_tissue * rng.exponential(0.5) * fractal(rng, size, 4.0, 2)
    across /= half * np.exp(rng.normal(0.0, taper) * along / size[1])
    roundness = rng.uniform(0.4, 1.0) if is_tissue else rng.uniform(0.2, 0.7) * float(rng.random() < 0.5)
    shade = rng.uniform(0.3, 0.9) + roundness * (np.sqrt(np.clip(1.0 - across**2, 0.0, 1.0)) - 0.4)
    shine = np.exp(-(((across - rng.uniform(-0.6, 0.6)) / rng.uniform(0.05, 0.3)) ** 2))
    shine *= is_tissue * rng.uniform(0.0, 200.0) * np.clip(0.5 + fractal(rng, size, 10.0, 2), 0.0, 1.0)
    colour = colour_of_tissue(rng) if is_tissue else _any_colour(rng) * rng.uniform(0.3, 1.0)
    begins = -np.inf if is_tissue or rng.random() < 0.4 else float(rng.uniform(-0.3, 0.3)) * size[1]
    inside = np.clip(np.minimum((1.0 - np.abs(across)) * half, along - begins) + 0.5, 0.0, 1.0)
    covered = cv2.GaussianBlur(inside.astype(np.float32), (0, 0), blur)[..., None]
    own = cv2.GaussianBlur((colour * shade[..., None] + shine[..., None]).astype(np.float32), (0, 0), blur)
    return np.asarray(scene + covered * (own - scene), np.float32)
