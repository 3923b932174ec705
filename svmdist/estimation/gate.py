"""The gate for residuals: what a normal distribution lets pass, and what became of a measurement there."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

from svmdist.profile.settings import FilterSettings

GATE_Z = FilterSettings().gate_z


@dataclass(frozen=True, slots=True)
class GatingResult:
    """A measurement at the gate: its normalised innovation squared, of so many degrees of freedom.

    `source` is the detection that it was made of: what misleads one measurement of a source misleads the others too.
    """

    name: str
    nis: float
    degrees_of_freedom: int
    is_accepted: bool
    source: str = ""


@lru_cache(maxsize=256)
def chi_square_bound(degrees_of_freedom: int, z: float = GATE_Z) -> float:
    """Quantile of the chi-square distribution at the normal quantile z (Wilson and Hilferty 1931)."""
    c = 2.0 / (9.0 * degrees_of_freedom)
    return degrees_of_freedom * (1.0 - c + z * math.sqrt(c)) ** 3
