"""Instruments that come in from the border: shaft, wrist and jaws as shaded parts, with exact labels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from training.textures import Array, Size, tissue_colour

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
KINDS = tuple(SURFACES)
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
    kind = KINDS[int(rng.choice(len(KINDS), p=weights))]
    levels, contrasts, most_glares, gloss = SURFACES[kind]
    level, contrast = rng.uniform(*levels), rng.uniform(*contrasts)
    if kind == "coloured":  # insulation and marks: green, blue or yellow; no red, as tissue is
        bgr = level * np.array(TINTS[int(rng.choice(len(TINTS)))]) * rng.uniform(0.7, 1.0, 3)
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
    count = 4
    parts = []
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
