"""The one table of perturbations: ways in which the world is not what a log or a profile states.

The entries are data, in `table.toml`; the modules beside this one apply them.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from importlib.resources import files
from typing import Any

import numpy as np

from svmdist.errors import UsageError, did_you_mean


class Place(StrEnum):
    """What a perturbation changes."""

    JOINTS = "joints"
    CLOCK = "clock"
    CALIBRATION = "calibration"
    IMAGES = "images"


@dataclass(frozen=True, slots=True)
class Uniform:
    """A strength from `low` to `high`, in the perturbation's unit; often a single value."""

    low: float
    high: float

    def draw(self, rng: np.random.Generator) -> float:
        """Draw the strength of one world; a law of a single value draws nothing."""
        return self.low if self.low == self.high else float(rng.uniform(self.low, self.high))

    def __str__(self) -> str:
        return f"{self.low:g}" if self.low == self.high else f"{self.low:g} to {self.high:g}"


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
        """Draw the strength of one world."""
        while True:
            drawn = rng.normal(0.0, self.std, self.axes)
            strength = float(drawn[0]) if self.axes == 1 else float(np.linalg.norm(drawn))
            if abs(strength) <= self.limit:
                return strength

    def __str__(self) -> str:
        along = f" along each of {self.axes} axes" if self.axes > 1 else ""
        within = f", at most {self.limit:g}" if np.isfinite(self.limit) else ""
        return f"std {self.std:g}{along}{within}"


@dataclass(frozen=True, slots=True)
class Perturbation:
    """One perturbation: a strength in `unit`, from `low` to `high`; a strength of `neutral` changes nothing.

    `real` is its size under `--world real`, with `source`, where that is from; None leaves it out there.
    What cannot be applied to an existing log is not `at_replay`.
    """

    name: str
    unit: str
    place: Place
    meaning: str
    low: float
    high: float
    real: Uniform | Normal | None = None
    source: str = ""
    neutral: float = 0.0
    at_replay: bool = True


def _read_table() -> Iterator[Perturbation]:
    rows: dict[str, dict[str, Any]] = tomllib.loads(
        files(__package__).joinpath("table.toml").read_text("utf-8")
    )
    for name, row in rows.items():
        low, high = map(float, row.pop("range"))
        size, place = row.pop("real", None), Place(row.pop("changes"))
        real = None if size is None else Uniform(*size["uniform"]) if "uniform" in size else Normal(**size)
        row.setdefault("at_replay", place is not Place.IMAGES)
        yield Perturbation(name, place=place, low=low, high=high, real=real, **row)


TABLE: dict[str, Perturbation] = {entry.name: entry for entry in _read_table()}


def find_perturbation(name: str) -> Perturbation:
    """The entry of a name; raises UsageError that lists the names."""
    if name not in TABLE:
        raise UsageError(f"no perturbation {name}: {did_you_mean(name, TABLE)}")
    return TABLE[name]
