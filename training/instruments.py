"""Instruments that come in from the border: shaft, wrist and jaws as shaded parts, with exact labels."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from training.backgrounds import tissue_colour
from training.materials import DISTAL_WEIGHTS, SHAFT_WEIGHTS, Material, material
from training.noise import Canvas, Size

OTHER, TISSUE, DISTAL, SHAFT = range(4)
"""Classes of the network: border, paper and cloth; tissue; wrists and jaws; shafts."""
Labels = NDArray[np.uint8]
Point = NDArray[np.float64]


@dataclass(frozen=True)
class Part:
    """A straight piece between two points in px, shape (2,), of which each has its half-width in px."""

    begin: Point
    end: Point
    begin_half: float
    end_half: float
    label: int
    surface: Material


def instrument(rng: np.random.Generator, size: Size, surroundings: NDArray[np.float32]) -> list[Part]:
    """The parts of a random instrument, those nearest to the border first; `size` is the picture's (h, w)."""
    half = size[1] * float(np.exp(rng.uniform(np.log(0.011), np.log(0.085))))
    tip = rng.uniform(0.08, 0.92, 2) * size[::-1]
    entry = _entry(rng, size, tip, half)
    along = (tip - entry) / np.linalg.norm(tip - entry)
    shaft = material(rng, SHAFT_WEIGHTS, surroundings)
    steel = material(rng, DISTAL_WEIGHTS, surroundings)
    nearer = float(np.exp(rng.normal(0.12, 0.22)))  # its border end is nearer to the camera as a rule
    make = [_robotic, _rigid, _tube, _hook][int(rng.choice(4, p=[0.48, 0.34, 0.1, 0.08]))]
    return make(rng, entry, tip, along, half, half * nearer, shaft, steel)


def cords(rng: np.random.Generator, size: Size) -> list[Part]:
    """Ducts, ligaments and folds: as round and nearly as straight as shafts, and tissue all the same."""
    parts: list[Part] = []
    for _ in range(int(rng.integers(1, 4))):
        plain = np.clip(1.0 + 0.15 * rng.standard_normal(6), 0.4, 1.6)
        wet = (rng.uniform(-0.5, 0.5), rng.uniform(0.05, 0.2), rng.uniform(0.0, 90.0))
        surface = Material(
            tissue_colour(rng), plain, plain[:3], rng.uniform(0.3, 0.8), (wet,), (1.0, 0.5, 0.0)
        )
        at, heading = rng.uniform(-0.1, 1.1, 2) * size[::-1], rng.uniform(0.0, 2 * np.pi)
        half = size[1] * float(np.exp(rng.uniform(np.log(0.006), np.log(0.06))))
        for _ in range(int(rng.integers(2, 7))):
            heading += rng.normal(0.0, 0.3)
            after = at + np.array([np.cos(heading), np.sin(heading)]) * size[1] * rng.uniform(0.05, 0.25)
            wider = half * float(np.exp(rng.normal(0.0, 0.2)))
            parts.append(Part(at, after, half, wider, TISSUE, surface))
            at, half = after, wider
    return parts


def draw(canvas: Canvas, labels: Labels, parts: list[Part]) -> None:
    """Draw parts over what is there; a pixel is a part's where that covers half of it or more."""
    for part in parts:
        _draw(canvas, labels, part)


def silhouette(size: Size, parts: list[Part]) -> NDArray[np.uint8]:
    """Their outline filled with 255, shape (h, w); for shadows, in whole pixels."""
    mask = np.zeros(size, np.uint8)
    for part in parts:
        normal = _normal(part)
        corners = [
            part.begin + normal * part.begin_half,
            part.end + normal * part.end_half,
            part.end - normal * part.end_half,
            part.begin - normal * part.begin_half,
        ]
        cv2.fillConvexPoly(mask, np.rint(corners).astype(np.int32), 255)
    return mask


def _draw(canvas: Canvas, labels: Labels, part: Part) -> None:
    height, width = labels.shape
    reach = max(part.begin_half, part.end_half) + 2.0
    low = np.maximum(np.floor(np.minimum(part.begin, part.end) - reach), 0).astype(int)
    high = np.minimum(np.ceil(np.maximum(part.begin, part.end) + reach) + 1, (width, height)).astype(int)
    if (low >= high).any():
        return
    y, x = np.mgrid[low[1] : high[1], low[0] : high[0]].astype(np.float32)
    length = float(np.linalg.norm(part.end - part.begin))
    axis, normal = (part.end - part.begin) / length, _normal(part)
    x, y = x - part.begin[0], y - part.begin[1]
    along = (x * axis[0] + y * axis[1]) / length
    half = part.begin_half + (part.end_half - part.begin_half) * np.clip(along, 0.0, 1.0)
    across = (x * normal[0] + y * normal[1]) / half
    # The part of the pixel that is covered: one px wide ramps over the sides and over both ends.
    covered = np.clip((1.0 - np.abs(across)) * half + 0.5, 0.0, 1.0)
    covered *= np.clip(np.minimum(along, 1.0 - along) * length + 0.5, 0.0, 1.0)
    inside = covered > 0.0
    if not inside.any():
        return
    colours = part.surface.colour(
        np.clip(across[inside], -1.0, 1.0), along[inside], length / max(part.begin_half, 1.0)
    )
    region = (slice(low[1], high[1]), slice(low[0], high[0]))
    share = covered[inside][:, None]
    canvas[region][inside] = share * colours + (1.0 - share) * canvas[region][inside]
    labels[region][covered >= 0.5] = part.label


def _normal(part: Part) -> Point:
    axis = (part.end - part.begin) / np.linalg.norm(part.end - part.begin)
    return np.array([-axis[1], axis[0]])


def _entry(rng: np.random.Generator, size: Size, tip: Point, half: float) -> Point:
    """A point outside of the picture that the shaft comes from: from any side, seldom from above."""
    height, width = size
    side = int(rng.choice(4, p=[0.33, 0.33, 0.22, 0.12]))
    beyond = 1.5 * half + 8.0
    at = rng.uniform(-0.2, 1.2)
    entry = [
        (-beyond, at * height),
        (width + beyond, at * height),
        (at * width, height + beyond),
        (at * width, -beyond),
    ][side]
    towards = np.array(entry)
    if np.linalg.norm(tip - towards) < 5.0 * half:
        towards = tip + (towards - tip) / np.linalg.norm(towards - tip) * 5.0 * half
    return towards


def _turned(direction: Point, angle: float) -> Point:
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array(
        [cosine * direction[0] - sine * direction[1], sine * direction[0] + cosine * direction[1]]
    )


def _robotic(
    rng: np.random.Generator,
    entry: Point,
    tip: Point,
    along: Point,
    half: float,
    entry_half: float,
    shaft: Material,
    steel: Material,
) -> list[Part]:
    """A shaft, a collar, a wrist that bends in two links, and jaws."""
    end = tip - along * half * rng.uniform(3.0, 6.0)
    parts = [Part(entry, end, entry_half, half, SHAFT, shaft)]
    at, heading = end, along
    if rng.random() < 0.6:
        collar = at + heading * half * rng.uniform(0.2, 0.8)
        parts.append(Part(at, collar, half, half * rng.uniform(0.85, 1.05), DISTAL, steel))
        at = collar
    link = steel
    for _ in range(int(rng.integers(1, 3))):
        heading = _turned(heading, rng.normal(0.0, 0.35))
        link = (
            material(rng, DISTAL_WEIGHTS, np.array([60, 60, 140], np.float32))
            if rng.random() < 0.4
            else steel
        )
        after = at + heading * half * rng.uniform(0.8, 2.4)
        parts.append(
            Part(
                at - heading * 0.3 * half,
                after,
                half * rng.uniform(0.65, 1.0),
                half * rng.uniform(0.5, 0.95),
                DISTAL,
                link,
            )
        )
        at = after
    return parts + _jaws(rng, at, heading, half, rng.uniform(1.5, 4.0), steel)


def _rigid(
    rng: np.random.Generator,
    entry: Point,
    tip: Point,
    along: Point,
    half: float,
    entry_half: float,
    shaft: Material,
    steel: Material,
) -> list[Part]:
    """A laparoscopic instrument: the shaft, a short neck, long jaws straight on."""
    end = tip - along * half * rng.uniform(2.0, 7.0)
    neck = end + along * half * rng.uniform(0.3, 2.0)
    parts = [Part(entry, end, entry_half, half, SHAFT, shaft)]
    parts.append(Part(end, neck, half * rng.uniform(0.6, 1.0), half * rng.uniform(0.5, 0.9), DISTAL, steel))
    length = max(1.5, float(np.linalg.norm(tip - neck)) / half)
    return parts + _jaws(rng, neck, along, half, length, steel)


def _tube(
    rng: np.random.Generator,
    entry: Point,
    tip: Point,
    along: Point,  # noqa: ARG001
    half: float,
    entry_half: float,
    shaft: Material,
    steel: Material,  # noqa: ARG001
) -> list[Part]:
    """Suction, irrigation, a stapler's barrel: a shaft that ends."""
    taper = rng.uniform(0.8, 1.0)
    return [Part(entry, tip, entry_half, half * taper, SHAFT, shaft)]


def _hook(
    rng: np.random.Generator,
    entry: Point,
    tip: Point,
    along: Point,
    half: float,
    entry_half: float,
    shaft: Material,
    steel: Material,
) -> list[Part]:
    """A hook or a spatula for cautery: a thin wire beyond the shaft, bent at its end."""
    end = tip - along * half * rng.uniform(2.0, 5.0)
    thin = max(1.0, half * rng.uniform(0.15, 0.4))
    parts = [Part(entry, end, entry_half, half, SHAFT, shaft)]
    parts.append(Part(end - along * half * 0.2, tip, thin, thin, DISTAL, steel))
    bent = tip + _turned(along, rng.choice([-1, 1]) * rng.uniform(0.8, 1.8)) * half * rng.uniform(0.5, 2.0)
    parts.append(Part(tip - along * thin * 0.5, bent, thin, 0.8 * thin, DISTAL, steel))
    return parts


def _jaws(
    rng: np.random.Generator, at: Point, heading: Point, half: float, length: float, steel: Material
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
            widths = [root + (point - root) * k / count for k in (number, number + 1)]
            parts.append(
                Part(
                    place - direction * 0.3,
                    after,
                    max(widths[0], 0.8),
                    max(widths[1], 0.8),
                    DISTAL,
                    steel,
                )
            )
            place = after
            direction = _turned(direction, (bend - side * opening * rng.uniform(0.2, 0.8)) / count)
    return parts
