"""How strong a perturbation is in the real world: a law with one number to draw, and a standard deviation to state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np


class Law(Protocol):
    """Draws a strength, in the perturbation's unit."""

    def draw(self, rng: np.random.Generator, /) -> float:
        """The strength of one world."""


@dataclass(frozen=True, slots=True)
class Always:
    """The same strength in every world: what it does there differs by seed."""

    strength: float

    def draw(self, _rng: np.random.Generator) -> float:
        """The strength of one world."""
        return self.strength

    def __str__(self) -> str:
        return f"{self.strength:g}"


@dataclass(frozen=True, slots=True)
class Uniform:
    """Any strength from `low` to `high`."""

    low: float
    high: float

    def draw(self, rng: np.random.Generator) -> float:
        """The strength of one world."""
        return float(rng.uniform(self.low, self.high))

    def __str__(self) -> str:
        return f"{self.low:g} to {self.high:g}"


@dataclass(frozen=True, slots=True)
class Normal:
    """A normal with a mean of 0; `std` is the deviation that a profile may state.

    With several `axes`, the strength is the length of a vector that has `std` along each of them; its direction is
    drawn apart from it. Beyond `limit` it is drawn again.
    """

    std: float
    axes: int = 1
    limit: float = np.inf

    def draw(self, rng: np.random.Generator) -> float:
        """The strength of one world."""
        while True:
            drawn = rng.normal(0.0, self.std, self.axes)
            strength = float(drawn[0]) if self.axes == 1 else float(np.linalg.norm(drawn))
            if abs(strength) <= self.limit:
                return strength

    def __str__(self) -> str:
        along = f" along each of {self.axes} axes" if self.axes > 1 else ""
        within = f", at most {self.limit:g}" if np.isfinite(self.limit) else ""
        return f"std {self.std:g}{along}{within}"
