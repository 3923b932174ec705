"""Instruments, drawn in two dimensions with exact labels and keypoints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from training.backgrounds import Array, Size, fractal

OTHER, TISSUE, DISTAL, SHAFT = range(4)
"""Classes of the network: border, paper and cloth; tissue; wrists and jaws; shafts."""
NO_INSTRUMENT, INSTRUMENT, UNKNOWN = range(4, 7)
"""Labels of real pictures, and of tags, beside these: a class below `DISTAL`, one from it on, and any."""
KEYPOINTS = ("entry", "end", "hinge", "tip")
"""Where a shaft's mid-line enters the view, where the shaft ends, the jaws' hinge, and their tips (both)."""
NOWHERE = (np.nan, np.nan)
# Level, and contrast of what is reflected, as (least, most) of each: dark, grey, steel, white, coloured
LEVELS = ((8, 75), (60, 170), (80, 235), (170, 250), (70, 220))
CONTRASTS = ((0.05, 0.5), (0.05, 0.3), (0.2, 0.7), (0.02, 0.15), (0.05, 0.3))
GREY, STEEL, COLOURED = 1, 2, 4
SHAFT_WEIGHTS, DISTAL_WEIGHTS = (0.40, 0.22, 0.24, 0.05, 0.09), (0.12, 0.2, 0.62, 0.03, 0.03)
KINDS = {"robotic": 0.42, "rigid": 0.36, "tube": 0.1, "hook": 0.12}
Parts = tuple[list["Part"], Array]
Surface = Callable[[Array, Array], Array]
"""Levels of BGR, shape (n, 3), at places across a part, from -1 to 1, and along it, from 0 to 1, shape (n,) each."""


def material(rng: np.random.Generator, weights: tuple[float, ...], surroundings: Array) -> Surface:
    """Draw a surface in an endoscope's light; `surroundings` is the colour in BGR, (3,), that steel reflects."""
    kind = int(rng.choice(len(LEVELS), p=weights))
    level, contrast, ambient = (rng.uniform(*span) for span in (LEVELS[kind], CONTRASTS[kind], (0.2, 0.9)))
    contrast *= float(rng.random() < 0.8)  # else plain
    # Insulation and marks are green, blue or yellow, not red as tissue is
    bgr = level * rng.uniform([0.3, 0.7, 0.3] if kind == COLOURED else 0.9, [1.0, 1.0, 1.0])
    # All of them reflect what is around them: dark and white ones, too, look warm over tissue
    share = rng.uniform(0.0, 0.5) * float(kind in (GREY, STEEL) or rng.random() < 0.6)
    bgr += share * (surroundings * level / max(float(surroundings.max()), 1.0) - bgr)
    reflection = np.clip(1.0 + contrast * rng.standard_normal(int(rng.integers(4, 14))), 0.1, 2.5)
    steps = np.clip(1.0 + 0.5 * contrast * rng.standard_normal(int(rng.integers(2, 9))), 0.3, 2.0)
    steps *= np.linspace(1.0 + rng.exponential(0.5), 1.0, len(steps))  # nearer to the lamp at its beginning
    at, width, bright = rng.uniform([-0.75, 0.03, 0.0], [0.75, 0.25, 150.0])

    def colour(across: Array, along: Array) -> Array:
        shade = ambient + (1.0 - ambient) * np.sqrt(np.clip(1.0 - across**2, 0.0, 1.0))
        shade = shade * np.interp(across, np.linspace(-1.0, 1.0, len(reflection)), reflection)
        shade = shade * np.interp(along, np.linspace(0.0, 1.0, len(steps)), steps)
        glare = bright * np.exp(-(((across - at) / width) ** 2))
        return np.asarray(np.clip(bgr * shade[:, None] + glare[:, None], 0.0, 400.0), np.float32)

    return colour


@dataclass(frozen=True)
class Part:
    """A straight piece between two points in px, (2,), each with its half-width; round or hollow at its end.

    Without a surface it is a window, through which one sees what is behind.
    """

    begin: Array
    end: Array
    begin_half: float
    end_half: float
    label: int
    surface: Surface | None
    round_end: float = 0.0

    @property
    def back(self) -> Array:
        """Unit vector from the end to the beginning, shape (2,)."""
        return np.asarray((self.begin - self.end) / np.linalg.norm(self.begin - self.end))


def _towards(heading: float) -> Array:
    return np.array([np.cos(heading), np.sin(heading)])


def _chain(at: Array, turns: Array, lengths: Array, halves: Array, surface: Surface) -> Parts:
    """Distal parts one behind the other, each heads for the sum of `turns` so far in rad; and where the last ends."""
    parts: list[Part] = []
    for heading, length, half, after in zip(np.cumsum(turns), lengths, halves, halves[1:], strict=False):
        begin, at = at - 0.3 * _towards(heading), at + length * _towards(heading)
        parts.append(Part(begin, at, half, after, DISTAL, surface, 0.8))
    return parts, at


def draw(canvas: Array, labels: Array, parts: list[Part]) -> None:
    """Draw parts over what is there; a pixel is a part's where that covers half of it or more."""
    limits, behind = np.array(labels.shape[::-1]), canvas.copy()
    for part in parts:
        reach = max(part.begin_half, part.end_half) * (1.0 + abs(part.round_end)) + 2.0
        low = np.clip(np.floor(np.minimum(part.begin, part.end) - reach), 0, limits).astype(int)
        high = np.clip(np.ceil(np.maximum(part.begin, part.end) + reach) + 1, 0, limits).astype(int)
        if (low >= high).any():
            continue
        y, x = np.mgrid[low[1] : high[1], low[0] : high[0]].astype(np.float32)
        length = float(np.linalg.norm(part.end - part.begin))
        axis, x, y = (part.end - part.begin) / length, x - part.begin[0], y - part.begin[1]
        along = (x * axis[0] + y * axis[1]) / length
        half = part.begin_half + (part.end_half - part.begin_half) * np.clip(along, 0.0, 1.0)
        across = (y * axis[0] - x * axis[1]) / half
        bulge = part.round_end * half * np.sqrt(np.clip(1.0 - across**2, 0.0, 1.0))
        # The part of the pixel that is covered: one px wide ramps over the sides and over both ends.
        covered = np.clip((1.0 - np.abs(across)) * half + 0.5, 0.0, 1.0)
        covered *= np.clip(np.minimum(along * length, (1.0 - along) * length + bulge) + 0.5, 0.0, 1.0)
        inside = covered > 0.0
        region = (slice(low[1], high[1]), slice(low[0], high[0]))
        at = np.clip(across[inside], -1.0, 1.0), along[inside]
        colours = part.surface(*at) if part.surface else behind[region][inside]
        canvas[region][inside] += covered[inside][:, None] * (colours - canvas[region][inside])
        labels[region][covered >= 0.5] = part.label


def instrument(rng: np.random.Generator, size: Size, surroundings: Array) -> Parts:
    """Parts of one at random, the nearest to the border first, and its keypoints in px, (5, 2), NaN where none."""
    near = rng.random() < 0.25  # fills a good part of the picture
    half = size[1] * float(np.exp(rng.uniform(*np.log([0.06, 0.18] if near else [0.009, 0.075]))))
    within = (-0.3, 1.3) if near and rng.random() < 0.5 else (0.03, 0.97)  # the picture, or also beside it
    tip = rng.uniform(*within, 2) * size[::-1]
    away = _towards(rng.uniform(0.0, 2 * np.pi)) * rng.uniform(0.75, 0.9)  # it comes from any side or corner
    span = tip - (0.5 + away + rng.normal(0.0, 0.15, 2)) * size[::-1]
    heading, least = float(np.arctan2(span[1], span[0])), rng.uniform(4.0, 9.0) * half
    along = _towards(heading)
    entry = tip - along * (max(float(np.linalg.norm(span)), least) + 2.0 * half + 0.1 * size[1])
    shaft = material(rng, SHAFT_WEIGHTS, surroundings)
    steel = shaft if rng.random() < 0.15 else material(rng, DISTAL_WEIGHTS, surroundings)
    entry_half = half * float(np.exp(abs(rng.normal(0.05, 0.2)) + rng.exponential(0.12)))
    kind = str(rng.choice([*KINDS], p=[*KINDS.values()]))
    if kind == "tube":  # suction, irrigation, a stapler's barrel: a shaft that ends
        tube = Part(entry, tip, entry_half, half, SHAFT, shaft, rng.uniform(-0.4, 0.6))
        return [tube], np.array([entry, tip, NOWHERE, tip, NOWHERE])
    if kind == "hook":
        return _hook(rng, Part(entry, tip, entry_half, half, SHAFT, shaft), heading, surroundings)
    end = tip - along * half * rng.uniform(2.0, 7.0)
    parts, length = [Part(entry, end, entry_half, half, SHAFT, shaft)], float(np.linalg.norm(tip - end))
    # A wrist of one or two links that bends, or a neck; then one or two curved jaws that narrow
    bends, links = (0.4, int(rng.integers(1, 3))) if kind == "robotic" else (0.05, int(rng.integers(0, 2)))
    turns = np.array([heading, *rng.normal(0.0, bends, links + 1)])
    halves = half * rng.uniform(0.6, 1.0, links + 1)
    wrist, hinge = _chain(end, turns[:-1], half * rng.uniform(0.5, 2.6, links), halves, steel)
    length = half * rng.uniform(1.2, 4.5) if kind == "robotic" else max(1.5 * half, length)
    opening = 0.0 if rng.random() < 0.25 else abs(rng.normal(0.0, 0.35))
    halves = np.maximum(half * np.linspace(rng.uniform(0.25, 0.7), rng.uniform(0.08, 0.5), 5), 0.8)
    tips, ahead, has_windows = list[Array](), float(turns.sum()), rng.random() < 0.2
    for to in (-1, 1) if rng.random() < 0.85 else (1,):
        begin = hinge + to * _towards(ahead + np.pi / 2) * halves[0] * 0.5
        bent = np.array([ahead + to * opening, *[-to * opening * rng.uniform(0.05, 0.2)] * 3])
        jaw, at = _chain(begin, bent, np.full(4, length / 4), halves, steel)
        wrist, tips = wrist + jaw, [*tips, at]
        if has_windows:  # fenestrated jaws
            wide = float(halves[1] * rng.uniform(0.4, 0.75))
            wrist.append(Part(jaw[0].end, 0.3 * jaw[2].begin + 0.7 * jaw[3].end, wide, wide, DISTAL, None, 0.8))
    return parts + wrist, np.array([entry, end, hinge, tips[0], tips[-1]])


def _hook(rng: np.random.Generator, shaft: Part, heading: float, surroundings: Array) -> Parts:
    """A monopolar hook or spatula, which burns: its insulation narrows, often white, to a bent wire."""
    along, half = _towards(heading), shaft.end_half
    tip, thin = shaft.end + along * half * rng.uniform(1.5, 6.0), half * rng.uniform(0.1, 0.4)
    weights = (0.1, 0.1, 0.1, 0.65, 0.05)
    sleeve = Part(shaft.end, tip, half * rng.uniform(0.8, 1.0), thin, DISTAL, material(rng, weights, surroundings))
    turns = np.array([heading, *rng.choice([-1, 1]) * rng.uniform([0.0, 0.3], [0.4, 1.2])])
    halves = np.maximum(np.full(4, thin * rng.uniform(0.3, 0.9)), 0.8)
    lengths = half * rng.uniform([0.2, 0.2, 0.2], [1.5, 0.6, 0.8])
    wire, at = _chain(tip, turns, lengths, halves, material(rng, DISTAL_WEIGHTS, surroundings))
    return [shaft, sleeve, *wire], np.array([shaft.begin, shaft.end, NOWHERE, at, NOWHERE])


def _letter(rng: np.random.Generator, scene: Array, own: Array, shaft: Part) -> None:
    """Print on a shaft what makers do: a word, and bars as of a sign or a band."""
    word = "".join(rng.choice(list("ABCDEGILMNOPRSTUVXZ 0135"), int(rng.integers(2, 12))))
    text, weight = np.zeros((80, 60 * len(word)), np.uint8), int(rng.integers(3, 20))
    cv2.putText(text, word, (4, 62), cv2.FONT_HERSHEY_SIMPLEX, 2.2, 255, weight, cv2.LINE_AA)
    for at in rng.integers(text.shape[1], size=int(rng.integers(0, 3))).tolist():
        cv2.rectangle(text, (at, 0), (at + int(rng.integers(10, 80)), 80), 255, cv2.FILLED)
    back = shaft.back
    along = back * rng.choice([-1, 1])
    across, half = np.array([-along[1], along[0]]), shaft.end_half
    turn = half * rng.uniform(0.5, 2.2) / 80 * np.column_stack([along, across])
    middle = shaft.end + half * (rng.uniform(0.0, 14.0) * back + rng.uniform(-0.6, 0.6) * across)
    share = _laid(text, turn, middle, own.shape, cv2.INTER_LINEAR).astype(np.float32) / 255.0
    share *= (own == SHAFT) * rng.uniform(0.4, 1.0)
    is_dark = scene[own == SHAFT].mean() < 110 or rng.random() < 0.3
    level = rng.uniform(150, 300) if is_dark else rng.uniform(0, 50)
    scene += share[..., None] * (level - scene)


def _laid(texture: Array, turn: Array, middle: Array, shape: Size, how: int) -> Array:
    """A texture over a picture of that shape, with its middle at a place; `turn`, (2, 2): its pixels' sides."""
    shift = middle - turn @ [0.5 * (n - 1) for n in texture.shape[::-1]]
    return np.asarray(cv2.warpAffine(texture, np.column_stack([turn, shift]), shape[::-1], flags=how))


def _mark(rng: np.random.Generator, scene: Array, own: Array, parts: list[Part]) -> None:
    """Put on an instrument what laboratories do: tape, a plate with a tag, a bead at a joint."""
    shaft, colour = parts[0], rng.uniform(0, 255, 3).tolist()
    back = shaft.back
    half, at = shaft.end_half, shaft.end + back * shaft.end_half * rng.uniform(-0.5, 9.0)
    kind = ("tape", "tag", "bead")[rng.choice(3)]
    if kind == "tape":
        end, shade = at + back * half * rng.uniform(0.5, 4.0), rng.uniform(0.3, 1.2)

        def surface(across: Array, _: Array) -> Array:
            return np.outer(shade * (1.0 - 0.5 * across**2), colour)

        draw(scene, own, [Part(at, end, 1.05 * half, 1.1 * half, SHAFT, surface)])
    elif kind == "tag":
        cells = int(rng.integers(4, 9))
        tag = np.pad(rng.integers(1, 3, (cells - 2, cells - 2), np.uint8), 1, constant_values=1)
        tag = np.pad(tag, 1, constant_values=2)  # 1 is black, 2 white
        sides = 2.0 * half * rng.uniform(0.9, 2.2) * rng.uniform(0.5, 1.0, (1, 2))
        turn = sides / (cells + 2) * np.column_stack([back, back[::-1] * (-1, 1)])
        shown = _laid(tag, turn, at, own.shape, cv2.INTER_NEAREST)
        levels = np.sort(rng.uniform([0, 90], [70, 330]))
        scene[shown > 0] = levels[shown[shown > 0] - 1, None]
        own[shown > 0] = INSTRUMENT
    else:
        at = parts[min(int(rng.integers(1, 3)), len(parts) - 1)].begin
        radius = half * rng.uniform(0.5, 1.3)
        x, y = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in own.shape[::-1]))
        height = 1.0 - ((x - at[0]) ** 2 + (y - at[1]) ** 2) / radius**2
        bead = height > 0.0
        scene[bead] = np.outer(0.3 + 0.7 * np.sqrt(height[bead]), colour) * rng.uniform(0.5, 1.3)
        own[bead] = DISTAL


def place(rng: np.random.Generator, scene: Array, labels: Array, parts: list[Part]) -> None:
    """Draw an instrument over the scene: its shadow, its parts, what is on them, and blood."""
    size, half, own = labels.shape, parts[0].end_half, np.zeros(labels.shape, np.uint8)
    behind = scene.copy()
    draw(scene, own, parts)
    mask = own > 0
    if not mask.any():
        return
    if half > 0.05 * size[1] and rng.random() < 0.5:  # so near that it is out of focus
        blur_px = rng.uniform(0.5, 4.0)
        share = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), blur_px)[..., None]
        behind += share * (cv2.GaussianBlur(scene, (0, 0), blur_px) - behind)
        scene[:] = behind
    if rng.random() < 0.6:  # its shadow on what is behind it, beside it, soft or hard
        shift = np.array([[1.0, 0.0, rng.normal(0.0, 1.2) * half], [0.0, 1.0, rng.normal(0.3, 1.2) * half]])
        soft = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), rng.uniform(0.5, 1.0 + 0.6 * half))
        moved = cv2.warpAffine(soft, shift, size[::-1])[~mask]
        scene[~mask] *= 1.0 - rng.uniform(0.1, 0.75) * moved[:, None]
    for _ in range(int(rng.integers(1, 3)) if rng.random() < 0.42 and (own == SHAFT).any() else 0):
        _letter(rng, scene, own, parts[0])
    if rng.random() < 0.2:
        _mark(rng, scene, own, parts)
        mask = own > 0
    if len(distal := np.argwhere(own == DISTAL)) > 30:  # slots, screws, cables, edges that shine
        details = scene.copy()
        for y, x in distal[rng.integers(len(distal), size=int(rng.integers(0, 16)))].tolist():
            level = rng.uniform(0, 60) if rng.random() < 0.6 else rng.uniform(150, 400)
            axes = np.maximum(1, half * rng.uniform([0.05, 0.03], [0.9, 0.22])).astype(int).tolist()
            cv2.ellipse(details, (x, y), axes, rng.uniform(0, 180), 0, 360, [level] * 3, cv2.FILLED)
        scene[own == DISTAL] = details[own == DISTAL]
    if rng.random() < 0.45:  # blood, or what is like it, on it: it stays what it is
        spots = fractal(rng, size, rng.uniform(6.0, 25.0), 3)[mask][:, None] - rng.uniform(0.3, 1.8)
        blood = rng.uniform(35, 170) * np.array([rng.uniform(0.05, 0.4), rng.uniform(0.05, 0.35), 1.0])
        scene[mask] += np.clip(4.0 * spots, 0.0, 1.0) * rng.uniform(0.4, 1.0) * (blood - scene[mask])
    labels[mask] = own[mask]
