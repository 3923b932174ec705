"""Which perturbations a run has, and how strong they are: given one by one, or drawn for a whole world by seed."""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from svmdist.errors import UsageError
from svmdist.perturbations.perturbation import Place
from svmdist.perturbations.table import TABLE, find_perturbation, require_strength
from svmdist.transforms import Array

_STRENGTH_STREAM, _DIRECTION_STREAM, _PATH_STREAM = 40, 41, 42


class World(StrEnum):
    """`--world`: what log and profile say, exactly; or as far from it as real ones are."""

    IDEAL = "ideal"
    REAL = "real"


@dataclass(frozen=True, slots=True)
class Perturbations:
    """Names of the table and strengths in their units, each name once; those that are left out change nothing.

    Raises UsageError for a name or a strength that the table does not have.
    """

    strengths: tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        for name, strength in self.strengths:
            require_strength(name, strength)
        names = [name for name, _ in self.strengths]
        doubles = sorted({name for name in names if names.count(name) > 1})
        if doubles:
            raise UsageError(f"perturbation {doubles[0]} is given twice")

    def __bool__(self) -> bool:
        return bool(self.strengths)

    def __str__(self) -> str:
        return ",".join(f"{name}={_number(strength)}" for name, strength in self.strengths)

    def __getitem__(self, name: str) -> float:
        """The strength of one of the table, in its unit; neutral where it is not chosen."""
        neutral = find_perturbation(name).neutral
        return dict(self.strengths).get(name, neutral)

    def has(self, *names: str) -> bool:
        """Whether one of these is chosen, with a strength that changes something."""
        return any(self[name] != find_perturbation(name).neutral for name in names)

    def changes(self, place: Place) -> bool:
        """Whether one is chosen that changes this."""
        return any(self.has(name) for name, _ in self.strengths if TABLE[name].place is place)


UNPERTURBED = Perturbations()


def draw_world(world: World, seed: int, given: Perturbations = UNPERTURBED) -> Perturbations:
    """The perturbations of a recording: in a real world all of the table that are real, then those that are given.

    A given strength takes the place of a drawn one. Each name has a random stream of its own, so that a further entry
    of the table changes no other one. Six digits of a drawn strength count, so that metadata stay readable.
    """
    if world is World.IDEAL:
        return given
    drawn = {
        name: float(f"{entry.real.draw(_stream(seed, _STRENGTH_STREAM, name)):.6g}")
        for name, entry in TABLE.items()
        if entry.real is not None and entry.at_record
    }
    return Perturbations(tuple((drawn | dict(given.strengths)).items()))


def parse_perturbations(text: str) -> Perturbations:
    """Read NAME=STRENGTH, or several of them separated by commas; raises UsageError."""
    return Perturbations(tuple(_parse_one(part) for part in text.split(",")))


def direction(seed: int, name: str, axes: int) -> Array:
    """The direction in which a perturbation goes in the world of a seed: a unit vector, shape (axes,)."""
    drawn = _stream(seed, _DIRECTION_STREAM, name).normal(0.0, 1.0, axes)
    return np.asarray(drawn / np.linalg.norm(drawn))


def path_stream(seed: int, name: str, arm: int = 0) -> np.random.Generator:
    """The random stream of what a perturbation does over time, for one of the arms."""
    return _stream(seed, _PATH_STREAM, name, arm)


def require_at_replay(perturbations: Perturbations) -> None:
    """Raise UsageError for one that cannot be done to a log that is recorded already."""
    _require(perturbations, [name for name, entry in TABLE.items() if entry.at_replay], "at replay")


def require_at_record(perturbations: Perturbations) -> None:
    """Raise UsageError for one that `record` does not do."""
    _require(perturbations, [name for name, entry in TABLE.items() if entry.at_record], "when recording")


def merged(several: Iterable[Perturbations]) -> Perturbations:
    """Several together; raises UsageError for a name in two of them."""
    return Perturbations(tuple(pair for one in several for pair in one.strengths))


def _require(perturbations: Perturbations, possible: list[str], when: str) -> None:
    for name, _ in perturbations.strengths:
        if name not in possible:
            raise UsageError(
                f"perturbation {name} cannot be applied {when}: the choices are {', '.join(possible)}"
            )


def _parse_one(text: str) -> tuple[str, float]:
    name, _, number = text.strip().partition("=")
    try:
        return find_perturbation(name).name, float(number)
    except ValueError:
        raise UsageError(f"{text.strip()}: expected NAME=STRENGTH, as in focal=1") from None


def _number(strength: float) -> str:
    """The shortest text that reads as the same number."""
    short = f"{strength:g}"
    return short if float(short) == strength else repr(strength)


def _stream(seed: int, stream: int, name: str, *further: int) -> np.random.Generator:
    return np.random.default_rng([seed, stream, zlib.crc32(name.encode()), *further])
