"""Instruments, drawn in two dimensions with exact labels and keypoints."""

from __future__ import annotations

import cv2
import numpy as np

from training.parts import ROWS, Array, Part, Size, fractal, lay, lettering, painted

OTHER, TISSUE, DISTAL, SHAFT = range(4)
"""Classes of the network: border, paper and cloth; tissue; wrists and jaws; shafts."""
NO_INSTRUMENT, INSTRUMENT, UNKNOWN = range(4, 7)
"""Labels of real pictures, and of tags, beside these: a class below `DISTAL`, one from it on, and any."""
NOWHERE = np.full(2, np.nan)
# Level, and contrast of what is reflected, as (least, most); weights on shafts, wrists and jaws, sleeves of hooks
MATERIALS = (
    ((8, 75), (0.05, 0.5), (0.40, 0.12, 0.10)),  # dark
    ((60, 170), (0.05, 0.3), (0.22, 0.20, 0.10)),  # grey
    ((80, 235), (0.2, 0.7), (0.24, 0.62, 0.10)),  # steel
    ((170, 250), (0.02, 0.15), (0.05, 0.03, 0.65)),  # white
    ((70, 220), (0.05, 0.3), (0.09, 0.03, 0.05)),  # green, blue or yellow insulation and marks: not red as tissue is
)
COLOURED, ON_SHAFTS, ON_JAWS, ON_SLEEVES = 4, 0, 1, 2


def _material(rng: np.random.Generator, where: int, around: Array, length: float = 2.0, gain: float = 1.0) -> Array:
    """A surface, `length` times as long as wide, that reflects something of what is `around` it, a colour (3,)."""
    kind = int(rng.choice(len(MATERIALS), p=[weights[where] for *_, weights in MATERIALS]))
    level, contrast = (rng.uniform(*span) for span in MATERIALS[kind][:2])
    bgr = level * rng.uniform([0.3, 0.7, 0.3] if kind == COLOURED else 0.9, [1.0, 1.0, 1.0])
    share = rng.uniform(0.0, 0.5) * float(rng.random() < 0.75)  # dark and white ones, too, look warm over tissue
    bgr += share * (around * level / max(float(around.max()), 1.0) - bgr)
    surface = painted(rng, gain * bgr, contrast * float(rng.random() < 0.8), length, 150.0)
    for _ in range(int(rng.integers(0, 8)) if where == ON_JAWS else 0):  # slots, screws, cables, edges that shine
        at = (rng.random(2) * surface.shape[1::-1]).astype(int).tolist()
        axes = (ROWS * rng.uniform(0.03, [0.6, 0.15])).astype(int).tolist()
        level = rng.uniform(0, 60) if rng.random() < 0.6 else rng.uniform(150, 400)
        cv2.ellipse(surface, at, axes, rng.uniform(0, 180), 0, 360, [level] * 3, cv2.FILLED, cv2.LINE_AA)
    if where == ON_SHAFTS and rng.random() < 0.45:
        _print(rng, surface[:, -10 * ROWS :])
    return surface


def _print(rng: np.random.Generator, surface: Array) -> None:
    """Print on a shaft what makers and laboratories do: a word, from one side or the other, and bands or tape."""
    surface = surface[::-1, ::-1] if rng.random() < 0.5 else surface
    ink = lettering(rng, surface.shape[:2], (0.15, 0.65))
    for begin in rng.integers(surface.shape[1], size=int(rng.integers(0, 3))).tolist():
        ink[:, begin : begin + int(ROWS * np.exp(rng.uniform(-2.0, 0.7)))] = 1.0
    bgr = rng.uniform(*(0, 60) if surface.mean() > 110 else (150, 300)) * rng.uniform(rng.choice([0.1, 1.0]), 1.0, 3)
    surface += ink * rng.uniform(0.4, 1.0) * (bgr - surface)


def _towards(heading: float) -> Array:
    return np.array([np.cos(heading), np.sin(heading)])


def instrument(rng: np.random.Generator, size: Size, around: Array) -> tuple[list[Part], Array]:
    """Parts of one at random, and keypoints in px, (5, 2), or NOWHERE: the shaft's ends, the jaws' hinge, both tips."""
    near = rng.random() < 0.25  # fills a good part of the picture, often so near to the lamp that it is blown out
    half = size[1] * float(np.exp(rng.uniform(*np.log([0.06, 0.18] if near else [0.009, 0.075]))))
    gain = rng.uniform(1.0, 4.0) if near and rng.random() < 0.4 else 1.0
    within = (-0.3, 1.3) if near and rng.random() < 0.5 else (0.03, 0.97)  # the picture, or also beside it
    tip = rng.uniform(*within, 2) * size[::-1]
    side = _towards(rng.uniform(0.0, 2 * np.pi)) * rng.uniform(0.75, 0.9)  # it comes from any side or corner
    span = tip - (0.5 + side + rng.normal(0.0, 0.15, 2)) * size[::-1]
    heading, length = float(np.arctan2(span[1], span[0])), float(np.linalg.norm(span)) + 9.0 * half + 0.1 * size[1]
    kind = str(rng.choice(["robotic", "rigid", "tube", "hook"], p=[0.42, 0.36, 0.1, 0.12]))
    entry, end = (tip - far * _towards(heading) for far in (length, half * rng.uniform(2.0, 7.0) * (kind != "tube")))
    surface = _material(rng, ON_SHAFTS, around, length / (2.0 * half), gain)
    steel = surface if rng.random() < 0.1 else _material(rng, ON_JAWS, around, gain=gain)
    wider, round_end = abs(rng.normal(0.05, 0.2)) + rng.exponential(0.12), rng.uniform(-0.4, 0.6) * (kind == "tube")
    parts = [Part(entry, end, half * float(np.exp(wider)), half, SHAFT, surface, round_end)]
    # Distal links: of a wrist that bends, with a clevis that may be large; of a neck; of a tube none
    bend, links = {"robotic": (0.4, int(rng.integers(1, 3))), "rigid": (0.05, int(rng.integers(2)))}.get(kind, (0.0, 0))
    lengths, turns = rng.uniform(0.5, 2.6, links), rng.normal(0.0, bend, links)
    halves, surfaces = np.exp(rng.normal(-0.2, 0.2, links + 1)), [steel] * links
    if kind == "hook":  # or a spatula, which burns: its insulation narrows, often white, to a bent wire
        lengths, thin = rng.uniform([1.5, 0.2, 0.2, 0.2], [6.0, 1.5, 0.6, 0.8]), rng.uniform(0.1, 0.4)
        turns = rng.choice([-1, 1]) * rng.uniform([0.0, 0.0, 0.3, 0.0], [0.0, 0.4, 1.2, 0.0])
        halves, surfaces = np.array([0.9, *[thin] * 4]), [_material(rng, ON_SLEEVES, around), *[steel] * 3]
    at, halves = end, np.maximum(half * halves, 0.8).tolist()
    for long, turn, wide, narrow, surface in zip(half * lengths, turns, halves, halves[1:], surfaces, strict=False):
        begin, at = at - 0.3 * _towards(heading), at + long * _towards(heading)
        parts.append(Part(begin, at, wide, narrow, DISTAL, surface, 0.8))
        heading += turn
    hinge, tips = NOWHERE, [at, NOWHERE]
    if kind in ("robotic", "rigid"):
        jaws = _jaws(rng, at, heading, half, steel)
        hinge, tips, parts = at, [part.end for part in jaws if part.surface is not None], parts + jaws
    return parts + (_mark(rng, parts) if rng.random() < 0.2 else []), np.array([entry, end, hinge, tips[0], tips[-1]])


def _jaws(rng: np.random.Generator, hinge: Array, heading: float, half: float, steel: Array) -> list[Part]:
    """One or two curved jaws that narrow to tips, fenestrated or not; the windows come after them."""
    length, opening = half * rng.uniform(1.2, 6.0), abs(rng.normal(0.0, 0.3)) * (rng.random() < 0.75)
    wide, narrow = np.maximum(half * rng.uniform([0.25, 0.08], [0.7, 0.5]), 0.8).tolist()
    curved, hole = length * rng.normal(0.0, 0.04), wide * rng.uniform(0.3, 0.6)
    jaws, windows = list[Part](), list[Part]()
    for side in (-1, 1) if rng.random() < 0.85 else (1,):
        begin = hinge + 0.5 * side * wide * _towards(heading + np.pi / 2)
        span = length * _towards(heading + side * opening)
        bend = curved + side * opening * length * rng.uniform(0.0, 0.15)
        jaws.append(Part(begin, begin + span, wide, narrow, DISTAL, steel[::side], 0.8, bend))
        begin = begin + 0.75 * bend * np.array([-span[1], span[0]]) / length  # the middle half of the parabola
        windows.append(Part(begin + 0.25 * span, begin + 0.75 * span, hole, hole, DISTAL, None, 0.8, 0.25 * bend))
    return jaws + windows * (rng.random() < 0.2)


def _mark(rng: np.random.Generator, parts: list[Part]) -> list[Part]:
    """What laboratories put on an instrument: a plate with a tag, or a bead at a joint."""
    half, along = parts[0].end_half, (parts[0].end - parts[0].begin) / np.linalg.norm(parts[0].end - parts[0].begin)
    if rng.random() < 0.5:
        cells = np.pad(np.pad(rng.integers(0, 2, 2 * [int(rng.integers(2, 7))]), 1), 1, constant_values=1)
        levels = np.sort(rng.uniform([0, 90], [70, 330])).astype(np.float32)
        side, at = half * rng.uniform(0.9, 2.2), parts[0].end - half * rng.uniform(0.0, 9.0) * along
        end, tag = at - 2.0 * side * rng.uniform(0.5, 1.0) * along, np.kron(cells, np.ones((8, 8), int))
        return [Part(at, end, side, side, INSTRUMENT, np.repeat(levels[tag][..., None], 3, 2))]
    radius, at = half * rng.uniform(0.5, 1.3), parts[int(rng.integers(len(parts)))].end
    bead = painted(rng, rng.uniform(0, 255, 3), 0.1, 1.0, 100.0)
    return [Part(at, at + side * along, radius, radius, DISTAL, bead, 1.0) for side in (-1, 1)]


def place(rng: np.random.Generator, scene: Array, labels: Array, parts: list[Part]) -> None:
    """Draw an instrument over the scene, out of focus where it is near, and blood on it: it stays what it is."""
    is_near = parts[0].end_half > 0.05 * labels.shape[1]
    own = lay(rng, scene, parts, rng.uniform(0.5, 4.0) if is_near and rng.random() < 0.5 else 0.3)
    if rng.random() < 0.45:
        spots = fractal(rng, labels.shape, rng.uniform(6.0, 25.0), 3) - rng.uniform(0.3, 1.8)
        blood = rng.uniform(35, 170) * rng.uniform([0.05, 0.05, 1.0], [0.4, 0.35, 1.0])
        scene += ((own > 0) * np.clip(4.0 * spots, 0.0, rng.uniform(0.4, 1.0)))[..., None] * (blood - scene)
    labels[own > 0] = own[own > 0]
