"""What instruments' surfaces look like: colour over the position across and along a part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from training.noise import Field

KINDS = ("dark", "grey", "steel", "white", "coloured")
SHAFT_WEIGHTS = (0.42, 0.18, 0.22, 0.06, 0.12)
DISTAL_WEIGHTS = (0.12, 0.2, 0.62, 0.03, 0.03)


@dataclass(frozen=True)
class Material:
    """A surface lit by an endoscope's lamp and by what is around it.

    `reflection` and `along` are brightness over the position across (from -1 to 1) and along (from 0 to 1) at equal
    steps; polished steel mirrors its surroundings, and has much of both.
    """

    bgr: NDArray[np.float32]
    reflection: NDArray[np.float64]
    along: NDArray[np.float64]
    ambient: float
    glare: tuple[tuple[float, float, float], ...]
    """Bright lines along it: position across, width, level."""
    stripes: tuple[float, float, float]
    """Rings about it: their period over the half-width, the dark part of each, and how dark it is; 0 of it is none."""

    def colour(self, across: Field, along: Field, length_widths: float) -> NDArray[np.float32]:
        """Levels of BGR, shape (n, 3), where `across` from -1 to 1 and `along` from 0 to 1, shape (n,), are.

        `length_widths` is the part's length over its half-width.
        """
        steps = np.linspace(-1.0, 1.0, len(self.reflection))
        shade = self.ambient + np.sqrt(np.clip(1.0 - across**2, 0.0, 1.0)) * (1.0 - self.ambient)
        shade = shade * np.interp(across, steps, self.reflection)
        shade = shade * np.interp(along, np.linspace(0.0, 1.0, len(self.along)), self.along)
        period, part, depth = self.stripes
        if depth > 0.0:
            ring = np.mod(along * length_widths, period) < part * period
            shade = np.where(ring, shade * (1.0 - depth), shade)
        shine = np.zeros_like(across)
        for at, width, level in self.glare:
            shine = shine + level * np.exp(-(((across - at) / width) ** 2))
        levels = self.bgr * shade[..., None].astype(np.float32) + shine[..., None].astype(np.float32)
        return np.asarray(np.clip(levels, 0.0, 255.0), np.float32)


def material(
    rng: np.random.Generator, weights: tuple[float, ...], surroundings: NDArray[np.float32]
) -> Material:
    """Draw a surface; `surroundings` is the colour in BGR, shape (3,), that steel reflects in part."""
    kind = KINDS[int(rng.choice(len(KINDS), p=weights))]
    tint = np.array([rng.uniform(0.92, 1.08), 1.0, rng.uniform(0.92, 1.08)])
    level, contrast, glares, gloss = {
        "dark": (rng.uniform(8, 75), rng.uniform(0.05, 0.5), rng.integers(0, 3), rng.uniform(20, 200)),
        "grey": (rng.uniform(60, 170), rng.uniform(0.05, 0.3), rng.integers(0, 2), rng.uniform(20, 120)),
        "steel": (rng.uniform(80, 235), rng.uniform(0.2, 0.7), rng.integers(0, 4), rng.uniform(60, 220)),
        "white": (rng.uniform(170, 250), rng.uniform(0.02, 0.15), rng.integers(0, 2), rng.uniform(10, 80)),
        "coloured": (rng.uniform(70, 220), rng.uniform(0.05, 0.3), rng.integers(0, 3), rng.uniform(20, 150)),
    }[kind]
    if kind == "coloured":  # insulation and marks: green, blue, yellow, seldom violet; no red, as tissue is
        tint = np.array(
            [
                (rng.uniform(0.2, 0.7), 1.0, rng.uniform(0.1, 0.7)),
                (1.0, rng.uniform(0.3, 0.8), rng.uniform(0.05, 0.5)),
                (rng.uniform(0.1, 0.4), rng.uniform(0.8, 1.0), 1.0),
                (1.0, rng.uniform(0.2, 0.6), rng.uniform(0.4, 0.9)),
            ][int(rng.choice(4, p=[0.4, 0.35, 0.15, 0.1]))]
        )
    bgr = level * tint
    if kind in ("steel", "grey"):
        share = rng.uniform(0.0, 0.4)
        bgr = (1.0 - share) * bgr + share * surroundings * level / max(float(surroundings.max()), 1.0)
    reflection = np.clip(1.0 + contrast * rng.standard_normal(int(rng.integers(4, 14))), 0.1, 2.5)
    along = np.clip(1.0 + 0.5 * contrast * rng.standard_normal(int(rng.integers(2, 9))), 0.3, 2.0)
    lines = tuple(
        (rng.uniform(-0.75, 0.75), rng.uniform(0.03, 0.25), gloss * rng.uniform(0.3, 1.0))
        for _ in range(int(glares))
    )
    depth = rng.uniform(0.2, 0.8) if rng.random() < 0.1 else 0.0
    stripes = (rng.uniform(0.15, 1.5), rng.uniform(0.2, 0.6), depth)
    return Material(bgr.astype(np.float32), reflection, along, rng.uniform(0.2, 0.9), lines, stripes)
