"""What a step of a method gives in place of a result where there is none."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Failure:
    """Why something could not be found or computed, in words for a person."""

    reason: str
