"""One perturbation: its name and unit, what its strength means, and how strong it is in the real world."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from svmdist.perturbations.laws import Law


class Place(StrEnum):
    """What a perturbation changes."""

    JOINTS = "joints"
    CLOCK = "clock"
    CALIBRATION = "calibration"
    IMAGES = "images"


@dataclass(frozen=True, slots=True)
class Perturbation:
    """A declared way in which the world is not what log or profile say.

    `real` is its strength under `--world real`, with `source`, where that is from; None leaves it out there.
    A strength of `neutral` changes nothing; one that is given lies in `low` to `high`. What cannot be done to a log
    that is recorded already is not `at_replay`.
    """

    name: str
    unit: str
    place: Place
    meaning: str
    low: float
    high: float
    real: Law | None = None
    source: str = ""
    neutral: float = 0.0
    at_record: bool = True
    at_replay: bool = True
