"""What is drawn: tissue, phantoms and cloth behind, and before them instruments with exact labels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Size = tuple[int, int]
"""(h, w) in px. Fields have this shape and are float32; pictures have a third axis, BGR, with levels from 0 to 255."""
# Weight, red level, and green and blue over red, as (least, most) of each: what tissue looks like in a white light.
TISSUES = (
    (0.22, (75, 185), (0.20, 0.45), (0.20, 0.50)),  # liver, muscle
    (0.28, (130, 235), (0.35, 0.60), (0.35, 0.65)),  # red and pink organs
    (0.16, (170, 245), (0.55, 0.80), (0.50, 0.85)),  # pale serosa
    (0.14, (180, 245), (0.62, 0.90), (0.28, 0.65)),  # fat
    (0.06, (170, 240), (0.75, 0.95), (0.70, 0.98)),  # fascia, nearly white
    (0.08, (70, 165), (0.35, 0.80), (0.45, 1.10)),  # gall bladder, spleen, veins: brown to violet
    (0.06, (45, 110), (0.08, 0.30), (0.08, 0.35)),  # blood
)


def fractal(rng: np.random.Generator, size: Size, cells: float, octaves: int = 4, gain: float = 0.5) -> Array:
    """Noise of unit variance: `cells` bumps over the width, then twice as many with `gain` times the amplitude."""
    field = np.zeros(size, np.float32)
    amplitudes = gain ** np.arange(octaves)
    for octave, amplitude in enumerate(amplitudes):
        columns = max(2.0, min(cells * 2.0**octave, size[1] / 2))
        rows = max(2, round(columns * size[0] / size[1]))
        coarse = rng.standard_normal((rows + 1, round(columns) + 1)).astype(np.float32)
        field += amplitude * cv2.resize(coarse, size[::-1], interpolation=cv2.INTER_CUBIC)
    return np.asarray(field / np.sqrt(np.sum(amplitudes**2)), np.float32)


def _shading(rng: np.random.Generator, height: Array, steepness: float) -> tuple[Array, Array]:
    """Cosines to a lamp near the camera and to its mirror image, in [0, 1], of a relief seen from above.

    `height` has unit variance, `steepness` is the relief's amplitude in px.
    """
    light = np.array([*rng.normal(0.0, 0.35, 2), 1.0])
    light /= np.linalg.norm(light)
    half = light + np.array([0.0, 0.0, 1.0])
    half /= np.linalg.norm(half)
    slopes = (cv2.Sobel(height, cv2.CV_32F, x, 1 - x, ksize=3, scale=1 / 8) for x in (1, 0))
    slope_x, slope_y = (steepness * slope for slope in slopes)
    norm = np.sqrt(1.0 + slope_x**2 + slope_y**2)
    cosines = ((to[2] - to[0] * slope_x - to[1] * slope_y) / norm for to in (light, half))
    diffuse, mirror = (np.clip(cosine, 0.0, 1.0).astype(np.float32) for cosine in cosines)
    return diffuse, mirror


def background(rng: np.random.Generator, size: Size) -> tuple[Array, Array]:
    """A picture without instruments, and which of its pixels are tissue: tissue mostly, else what other rooms have."""
    kind = rng.choice(["tissue", "phantom", "cloth"], p=[0.74, 0.1, 0.16])
    if kind == "phantom":
        return _phantom(rng, size), np.ones(size, bool)
    of, other, seldom = (_tissue, _cloth, 0.1) if kind == "tissue" else (_cloth, _tissue, 0.3)
    scene, is_tissue = of(rng, size), np.full(size, kind == "tissue")
    if rng.random() < seldom:  # gauze on tissue, or tissue on a drape
        patch = fractal(rng, size, rng.uniform(1.2, 3.0), 3, 0.3) > rng.uniform(0.2, 1.2)
        scene[patch] = other(rng, size)[patch]
        is_tissue ^= patch
    return scene, is_tissue


def tissue_colour(rng: np.random.Generator) -> Array:
    """A colour of one kind of tissue in BGR, shape (3,)."""
    _, red, green, blue = TISSUES[rng.choice(len(TISSUES), p=[weight for weight, *_ in TISSUES])]
    level = rng.uniform(*red)
    return np.array([level * rng.uniform(*blue), level * rng.uniform(*green), level], np.float32)


def _tissue(rng: np.random.Generator, size: Size) -> Array:
    """Organs side by side, each with its colour and texture; folds, vessels, wet highlights, dark cavities."""
    height = fractal(rng, size, rng.uniform(1.5, 5.0), int(rng.integers(2, 6)), rng.uniform(0.3, 0.6))
    scene = np.empty((*size, 3), np.float32)
    scene[:] = tissue_colour(rng)
    for _ in range(int(rng.integers(0, 5))):
        edge = fractal(rng, size, rng.uniform(1.2, 4.0), 3, rng.uniform(0.2, 0.5)) - rng.normal(0.5, 0.5)
        scene += _soft(edge, np.exp(rng.uniform(0.5, 3.5))) * (tissue_colour(rng) - scene)
    scene *= 1.0 + rng.uniform(0.02, 0.16) * fractal(rng, size, rng.uniform(8, 50), 3)[..., None]
    if rng.random() < 0.6:  # vessels, darker and redder or bluer than what they run over
        lines = np.zeros(size, np.uint8)
        for _ in range(int(rng.integers(2, 14))):
            level, width = int(rng.integers(90, 255)), int(rng.integers(1, 4))
            cv2.polylines(lines, [wandering(rng, size, 0.25)], False, level, width, cv2.LINE_AA)
        share = cv2.GaussianBlur(lines, (0, 0), rng.uniform(0.5, 1.5)).astype(np.float32)[..., None] / 255.0
        colour = np.array([rng.uniform(0.3, 0.9), rng.uniform(0.25, 0.6), rng.uniform(0.5, 0.95)], np.float32)
        scene *= 1.0 - rng.uniform(0.2, 0.8) * share * (1.0 - colour)
    diffuse, mirror = _shading(rng, height, rng.uniform(2.0, 30.0) * size[1] / 350)
    scene *= (rng.uniform(0.15, 0.6) + diffuse)[..., None] * rng.uniform(0.7, 1.0)
    if rng.random() < 0.8:  # it is wet
        wet = mirror ** rng.uniform(40, 400) * np.clip(0.5 + fractal(rng, size, 12.0, 1), 0.0, 1.5)
        scene += (rng.uniform(60, 500) * wet * rng.uniform(0.2, 1.0))[..., None]
    if rng.random() < 0.35:
        deep = fractal(rng, size, rng.uniform(1.5, 4.0), 1) - rng.uniform(0.3, 1.2)
        scene *= 1.0 - rng.uniform(0.4, 0.95) * _soft(deep, rng.uniform(2.0, 8.0))
    return np.clip(scene, 0.0, 255.0)


def _soft(field: Array, sharpness: float) -> Array:
    """0 to 1 over the field's change of sign, shape (h, w, 1)."""
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(sharpness * field, -30.0, 30.0))), np.float32)[..., None]


def wandering(rng: np.random.Generator, size: Size, bend: float) -> Array:
    """Points, shape (24, 2) of int32, of a line that turns by about `bend` rad a step."""
    headings = rng.uniform(0, 2 * np.pi) + np.cumsum(rng.normal(0.0, bend, 24))
    steps = np.stack([np.cos(headings), np.sin(headings)], -1) * size[1] * rng.uniform(0.005, 0.03)
    return np.asarray(np.rint(rng.uniform(0.0, 1.0, 2) * size[::-1] + np.cumsum(steps, axis=0)), np.int32)


def _phantom(rng: np.random.Generator, size: Size) -> Array:
    """Silicone: one colour with grooves, dull."""
    level = rng.uniform(90, 225)
    colour = level * np.array([rng.uniform(0.35, 0.85), rng.uniform(0.4, 0.85), 1.0], np.float32)
    creased = np.abs(fractal(rng, size, rng.uniform(1.5, 4.0), 2, 0.4)) ** rng.uniform(0.6, 1.5)
    diffuse, mirror = _shading(rng, creased.astype(np.float32), rng.uniform(2, 25))
    shade = rng.uniform(0.2, 0.6) + diffuse + rng.uniform(0.0, 0.5) * mirror**60
    return np.asarray(np.clip(colour * shade[..., None] * 0.8, 0.0, 255.0), np.float32)


def _cloth(rng: np.random.Generator, size: Size) -> Array:
    """Drapes, foam, gauze and paper: any colour, often blue, green or white, woven or plain."""
    hue = rng.choice([rng.uniform(90, 125), rng.uniform(60, 95), rng.uniform(0, 180)])
    saturation = rng.uniform(0, 60) if rng.random() < 0.6 else rng.uniform(60, 220)
    pixel = np.array([[[hue, saturation, rng.uniform(70, 245)]]]).astype(np.uint8)
    colour = cv2.cvtColor(pixel, cv2.COLOR_HSV2BGR)[0, 0].astype(np.float32)
    height = fractal(rng, size, rng.uniform(2.0, 6.0), 3, 0.5)
    shade = 0.3 + 0.75 * _shading(rng, height, rng.uniform(0, 25))[0]
    if rng.random() < 0.5:
        y, x = np.mgrid[: size[0], : size[1]].astype(np.float32)
        angle, period = rng.uniform(0, np.pi), rng.uniform(3.0, 9.0)
        one, two = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
        weave = np.sin(2 * np.pi * one / period) * np.sin(2 * np.pi * two / period)
        shade = shade * (1.0 + rng.uniform(0.03, 0.2) * weave)
    return np.asarray(np.clip(colour * shade[..., None], 0.0, 255.0), np.float32)


OTHER, TISSUE, DISTAL, SHAFT = range(4)
"""Classes of the network: border, paper and cloth; tissue; wrists and jaws; shafts."""
# Level, contrast of what is reflected, most bright lines, and their level, as (least, most) of each.
SURFACES = {
    "dark": ((8, 75), (0.05, 0.5), 2, (10, 150)),
    "grey": ((60, 170), (0.05, 0.3), 1, (10, 100)),
    "steel": ((80, 235), (0.2, 0.7), 3, (20, 180)),
    "white": ((170, 250), (0.02, 0.15), 1, (5, 60)),
    "coloured": ((70, 220), (0.05, 0.3), 2, (10, 120)),
}
TINTS = ((0.5, 1.0, 0.5), (1.0, 0.7, 0.4), (0.3, 1.0, 1.0))
SHAFT_WEIGHTS = (0.42, 0.18, 0.22, 0.06, 0.12)
DISTAL_WEIGHTS = (0.12, 0.2, 0.62, 0.03, 0.03)


@dataclass(frozen=True)
class Material:
    """A surface lit by an endoscope's lamp and by what is around it.

    `reflection` and `along` are brightness over the position across (from -1 to 1) and along (from 0 to 1) at equal
    steps; `glare` are bright lines along it: position across, width, level.
    """

    bgr: Array
    reflection: Array
    along: Array
    ambient: float
    glare: tuple[tuple[float, float, float], ...]

    def colour(self, across: Array, along: Array) -> Array:
        """Levels of BGR, shape (n, 3), where `across` from -1 to 1 and `along` from 0 to 1, shape (n,), are."""
        shade = self.ambient + np.sqrt(np.clip(1.0 - across**2, 0.0, 1.0)) * (1.0 - self.ambient)
        shade = shade * np.interp(across, np.linspace(-1.0, 1.0, len(self.reflection)), self.reflection)
        shade = shade * np.interp(along, np.linspace(0.0, 1.0, len(self.along)), self.along)
        shine = np.zeros_like(across)
        for at, width, level in self.glare:
            shine = shine + level * np.exp(-(((across - at) / width) ** 2))
        levels = self.bgr * shade[..., None].astype(np.float32) + shine[..., None].astype(np.float32)
        return np.asarray(np.clip(levels, 0.0, 255.0), np.float32)


def material(rng: np.random.Generator, weights: tuple[float, ...], surroundings: Array) -> Material:
    """Draw a surface; `surroundings` is the colour in BGR, shape (3,), that steel reflects in part."""
    kind = str(rng.choice([*SURFACES], p=weights))
    levels, contrasts, most_glares, gloss = SURFACES[kind]
    level, contrast = rng.uniform(*levels), rng.uniform(*contrasts)
    if kind == "coloured":  # insulation and marks: green, blue or yellow; no red, as tissue is
        bgr = level * rng.choice(TINTS) * rng.uniform(0.7, 1.0, 3)
    else:
        bgr = level * np.array([rng.uniform(0.92, 1.08), 1.0, rng.uniform(0.92, 1.08)])
    if kind in ("steel", "grey"):
        share = rng.uniform(0.0, 0.4)
        bgr = (1.0 - share) * bgr + share * surroundings * level / max(float(surroundings.max()), 1.0)
    reflection = np.clip(1.0 + contrast * rng.standard_normal(int(rng.integers(4, 14))), 0.1, 2.5)
    along = np.clip(1.0 + 0.5 * contrast * rng.standard_normal(int(rng.integers(2, 9))), 0.3, 2.0)
    count = int(rng.integers(0, most_glares + 1))
    glare = [(rng.uniform(-0.75, 0.75), rng.uniform(0.03, 0.25), rng.uniform(*gloss)) for _ in range(count)]
    return Material(bgr.astype(np.float32), reflection, along, rng.uniform(0.2, 0.9), tuple(glare))


@dataclass(frozen=True)
class Part:
    """A straight piece between two points in px, shape (2,), of which each has its half-width in px."""

    begin: Array
    end: Array
    begin_half: float
    end_half: float
    label: int
    surface: Material

    @property
    def normal(self) -> Array:
        """The unit vector across it, shape (2,)."""
        axis = (self.end - self.begin) / np.linalg.norm(self.end - self.begin)
        return np.array([-axis[1], axis[0]])

    @property
    def corners(self) -> Array:
        """Its outline, shape (4, 2)."""
        first, last = self.normal * self.begin_half, self.normal * self.end_half
        return np.array([self.begin + first, self.end + last, self.end - last, self.begin - first])


def cords(rng: np.random.Generator, size: Size) -> list[Part]:
    """Ducts, ligaments and folds: as round and nearly as straight as shafts, and tissue all the same."""
    parts: list[Part] = []
    for _ in range(int(rng.integers(1, 4))):
        plain = np.clip(1.0 + 0.15 * rng.standard_normal(6), 0.4, 1.6)
        wet = (rng.uniform(-0.5, 0.5), rng.uniform(0.05, 0.2), rng.uniform(0.0, 90.0))
        bgr, ambient = tissue_colour(rng), rng.uniform(0.3, 0.8)
        surface = Material(bgr, plain, plain[:3], ambient, (wet,))
        at, heading = rng.uniform(-0.1, 1.1, 2) * size[::-1], rng.uniform(0.0, 2 * np.pi)
        half = size[1] * float(np.exp(rng.uniform(np.log(0.006), np.log(0.06))))
        for _ in range(int(rng.integers(2, 7))):
            heading += rng.normal(0.0, 0.3)
            after = at + np.array([np.cos(heading), np.sin(heading)]) * size[1] * rng.uniform(0.05, 0.25)
            wider = half * float(np.exp(rng.normal(0.0, 0.2)))
            parts.append(Part(at, after, half, wider, TISSUE, surface))
            at, half = after, wider
    return parts


def draw(canvas: Array, labels: Array, parts: list[Part]) -> None:
    """Draw parts over what is there; a pixel is a part's where that covers half of it or more."""
    height, width = labels.shape
    for part in parts:
        reach = max(part.begin_half, part.end_half) + 2.0
        low = np.maximum(np.floor(np.minimum(part.begin, part.end) - reach), 0).astype(int)
        high = np.minimum(np.ceil(np.maximum(part.begin, part.end) + reach) + 1, (width, height)).astype(int)
        if (low >= high).any():
            continue
        y, x = np.mgrid[low[1] : high[1], low[0] : high[0]].astype(np.float32)
        length = float(np.linalg.norm(part.end - part.begin))
        axis, normal = (part.end - part.begin) / length, part.normal
        x, y = x - part.begin[0], y - part.begin[1]
        along = (x * axis[0] + y * axis[1]) / length
        half = part.begin_half + (part.end_half - part.begin_half) * np.clip(along, 0.0, 1.0)
        across = (x * normal[0] + y * normal[1]) / half
        # The part of the pixel that is covered: one px wide ramps over the sides and over both ends.
        covered = np.clip((1.0 - np.abs(across)) * half + 0.5, 0.0, 1.0)
        covered *= np.clip(np.minimum(along, 1.0 - along) * length + 0.5, 0.0, 1.0)
        inside = covered > 0.0
        if not inside.any():
            continue
        colours = part.surface.colour(np.clip(across[inside], -1.0, 1.0), along[inside])
        region = (slice(low[1], high[1]), slice(low[0], high[0]))
        share = covered[inside][:, None]
        canvas[region][inside] = share * colours + (1.0 - share) * canvas[region][inside]
        labels[region][covered >= 0.5] = part.label


def instrument(rng: np.random.Generator, size: Size, surroundings: Array) -> list[Part]:
    """The parts of a random instrument, those nearest to the border first; `size` is the picture's (h, w)."""
    half = size[1] * float(np.exp(rng.uniform(np.log(0.011), np.log(0.085))))
    tip = rng.uniform(0.08, 0.92, 2) * size[::-1]
    side = int(rng.choice(4, p=[0.33, 0.33, 0.22, 0.12]))  # it comes from any side, seldom from above
    beyond, at, (height, width) = 1.5 * half + 8.0, rng.uniform(-0.2, 1.2), size
    x, y = ((-beyond, None), (width + beyond, None), (None, height + beyond), (None, -beyond))[side]
    entry = np.array([at * width if x is None else x, at * height if y is None else y])
    if np.linalg.norm(tip - entry) < 5.0 * half:
        entry = tip + (entry - tip) / np.linalg.norm(entry - tip) * 5.0 * half
    along = (tip - entry) / np.linalg.norm(tip - entry)
    shaft = material(rng, SHAFT_WEIGHTS, surroundings)
    steel = material(rng, DISTAL_WEIGHTS, surroundings)
    entry_half = half * float(np.exp(rng.normal(0.12, 0.22)))  # nearer to the camera as a rule
    kind = rng.choice(["robotic", "rigid", "tube", "hook"], p=[0.48, 0.34, 0.1, 0.08])
    if kind == "tube":  # suction, irrigation, a stapler's barrel: a shaft that ends
        return [Part(entry, tip, entry_half, half * rng.uniform(0.8, 1.0), SHAFT, shaft)]
    end = tip - along * half * rng.uniform(2.0, 7.0)
    parts = [Part(entry, end, entry_half, half, SHAFT, shaft)]
    if kind == "robotic":  # a wrist that bends in one or two links
        for _ in range(int(rng.integers(1, 3))):
            along = _turned(along, rng.normal(0.0, 0.35))
            after = end + along * half * rng.uniform(0.8, 2.4)
            halves = half * rng.uniform(0.65, 1.0), half * rng.uniform(0.5, 0.95)
            parts.append(Part(end - along * 0.3 * half, after, *halves, DISTAL, steel))
            end = after
        return parts + _jaws(rng, end, along, half, rng.uniform(1.5, 4.0), steel)
    if kind == "rigid":  # a laparoscopic instrument: long jaws straight on
        length = max(1.5, float(np.linalg.norm(tip - end)) / half)
        return parts + _jaws(rng, end, along, half, length, steel)
    thin = max(1.0, half * rng.uniform(0.15, 0.4))  # cautery: a thin wire, bent at its end
    parts.append(Part(end - along * half * 0.2, tip, thin, thin, DISTAL, steel))
    bent = tip + _turned(along, rng.choice([-1, 1]) * rng.uniform(0.8, 1.8)) * half * rng.uniform(0.5, 2.0)
    return [*parts, Part(tip - along * thin * 0.5, bent, thin, 0.8 * thin, DISTAL, steel)]


def _turned(direction: Array, angle: float) -> Array:
    x, y = direction
    return np.array([np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y])


def _jaws(
    rng: np.random.Generator, at: Array, heading: Array, half: float, length: float, steel: Material
) -> list[Part]:
    """One or two curved jaws that narrow; `length` in half-widths."""
    heading = _turned(heading, rng.normal(0.0, 0.3))
    opening = 0.0 if rng.random() < 0.25 else abs(rng.normal(0.0, 0.3))
    bend = rng.normal(0.0, 0.25)
    sides = (-1, 1) if rng.random() < 0.85 else (1,)
    root, point = half * rng.uniform(0.25, 0.6), half * rng.uniform(0.08, 0.4)
    count, parts = 4, []
    for side in sides:
        place = at + side * np.array([-heading[1], heading[0]]) * root * 0.5
        direction = _turned(heading, side * opening)
        for number in range(count):
            after = place + direction * half * length / count
            wide, narrow = (max(root + (point - root) * k / count, 0.8) for k in (number, number + 1))
            parts.append(Part(place - direction * 0.3, after, wide, narrow, DISTAL, steel))
            place = after
            direction = _turned(direction, (bend - side * opening * rng.uniform(0.2, 0.8)) / count)
    return parts
