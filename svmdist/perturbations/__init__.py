"""Ways in which the world is not what logs and profiles state, for `record` and replay: their table, and a choice."""

from __future__ import annotations

import tomllib
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from importlib.resources import files
from typing import Any

import numpy as np

from svmdist.errors import UsageError, did_you_mean
from svmdist.transforms import Array

Place = StrEnum("Place", ["JOINTS", "CLOCK", "CALIBRATION", "IMAGES"])
"""What a perturbation changes."""


@dataclass(frozen=True, slots=True)
class Size:
    """A strength in real worlds, in the perturbation's unit: `uniform` between two bounds, or a normal of mean 0."""

    uniform: tuple[float, float] | None = None  # the bounds are often the same
    std: float = 0.0  # along each axis
    axes: int = 1  # of several, it is the length of a vector, whose direction is sampled apart
    limit: float = np.inf  # beyond it, it is sampled again

    def draw(self, rng: np.random.Generator) -> float:
        """Sample the strength of one world."""
        if self.uniform is not None:
            return float(rng.uniform(*self.uniform))
        while True:
            sample = rng.normal(0.0, self.std, self.axes)
            strength = float(sample[0]) if self.axes == 1 else float(np.linalg.norm(sample))
            if abs(strength) <= self.limit:
                return strength


@dataclass(frozen=True, slots=True)
class Perturbation:
    """One perturbation: a strength in `unit`, from `low` to `high`; a strength of `neutral` changes nothing."""

    name: str
    unit: str
    place: Place
    meaning: str
    low: float
    high: float
    real: Size | None = None  # its size under `--world real`; None leaves it out there
    source: str = ""  # of that size
    neutral: float = 0.0
    at_replay: bool = True  # whether it can be applied to an existing log


def _read_table() -> Iterator[Perturbation]:
    rows: dict[str, dict[str, Any]] = tomllib.loads(files(__package__).joinpath("table.toml").read_text("utf-8"))
    for name, row in rows.items():
        low, high = map(float, row.pop("range"))
        place, real = Place(row.pop("changes")), Size(**row.pop("real")) if "real" in row else None
        row.setdefault("at_replay", place is not Place.IMAGES)
        yield Perturbation(name, place=place, low=low, high=high, real=real, **row)


TABLE: dict[str, Perturbation] = {entry.name: entry for entry in _read_table()}


def find_perturbation(name: str) -> Perturbation:
    """The entry of a name; raises UsageError that lists the names."""
    if name not in TABLE:
        raise UsageError(f"no perturbation {name}: {did_you_mean(name, TABLE)}")
    return TABLE[name]


_STRENGTH_STREAM, _DIRECTION_STREAM, PATH_STREAM = 40, 41, 42
World = StrEnum("World", ["IDEAL", "REAL"])
"""`--world`: exactly what log and profile state, or as far from it as real worlds are."""


@dataclass(frozen=True, slots=True)
class Perturbations:
    """Names of the table with strengths, each once; UsageError for an unknown name or a strength out of range."""

    strengths: tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        for name, strength in self.strengths:
            entry = find_perturbation(name)
            if not entry.low <= strength <= entry.high:  # NaN is in no range
                expected = f"from {entry.low:g} to {entry.high:g} {entry.unit}"
                raise UsageError(f"perturbation {name}: {expected}, found {strength:g}")
            if [other for other, _ in self.strengths].count(name) > 1:
                raise UsageError(f"perturbation {name} is given twice")

    def __bool__(self) -> bool:
        return bool(self.strengths)

    def __str__(self) -> str:
        # The shortest text that reads as the same number.
        return ",".join(f"{name}={float(strength)!r}".removesuffix(".0") for name, strength in self.strengths)

    def __getitem__(self, name: str) -> float:
        """The strength of an entry of the table, in its unit; neutral where it is not chosen."""
        return dict(self.strengths).get(name, find_perturbation(name).neutral)

    def has(self, *names: str) -> bool:
        """Whether one of these is chosen with a strength that changes something."""
        return any(self[name] != find_perturbation(name).neutral for name in names)

    def changes(self, *places: Place) -> bool:
        """Whether a chosen one changes one of these."""
        return any(self.has(name) for name, _ in self.strengths if TABLE[name].place in places)


UNPERTURBED = Perturbations()


def draw_world(world: World, seed: int, given: Perturbations = UNPERTURBED) -> Perturbations:
    """Sample the perturbations of a recording: in a real world all that have a size there; the given ones go before.

    Each name has a random stream of its own, so that a new entry of the table changes no other one. Sampled strengths
    have six digits, so that metadata stay readable.
    """
    sampled = {}
    for name, entry in TABLE.items() if world is World.REAL else ():
        if entry.real is not None:
            sampled[name] = float(f"{entry.real.draw(random_stream(seed, _STRENGTH_STREAM, name)):.6g}")
    return Perturbations(tuple((sampled | dict(given.strengths)).items()))


def parse_perturbations(text: str) -> Perturbations:
    """Read NAME=STRENGTH, or several of them separated by commas; raises UsageError."""
    strengths = []
    for part in text.split(","):
        name, _, number = part.strip().partition("=")
        try:
            strengths.append((find_perturbation(name).name, float(number)))
        except ValueError:
            raise UsageError(f"{part.strip()}: expected NAME=STRENGTH, as in focal=1") from None
    return Perturbations(tuple(strengths))


def direction(seed: int, name: str, axes: int) -> Array:
    """The direction of a perturbation in the world of a seed: a unit vector, shape (axes,)."""
    sample = random_stream(seed, _DIRECTION_STREAM, name).normal(0.0, 1.0, axes)
    return np.asarray(sample / np.linalg.norm(sample))


def require_at_replay(perturbations: Perturbations) -> None:
    """Raise UsageError for one that cannot be applied to an existing log."""
    possible = ", ".join(name for name, entry in TABLE.items() if entry.at_replay)
    for name, _ in perturbations.strengths:
        if not TABLE[name].at_replay:
            raise UsageError(f"perturbation {name} cannot be applied at replay: the choices are {possible}")


def random_stream(seed: int, stream: int, name: str, *further: int) -> np.random.Generator:
    """The random numbers of one thing about a perturbation in the world of a seed."""
    return np.random.default_rng([seed, stream, zlib.crc32(name.encode()), *further])
