"""Perturbations on the command line: `NAME=STRENGTH`, or several together, separated by commas."""

from __future__ import annotations

from typing import TYPE_CHECKING

from svmdist.errors import UsageError

if TYPE_CHECKING:
    from svmdist.perturbations.chosen import Perturbations


def parse_perturb(option: str, values: list[str] | None) -> Perturbations:
    """Parse the values of an option as one choice; raises UsageError."""
    from svmdist.perturbations.chosen import merged

    groups = parse_perturb_groups(option, values)
    try:
        return merged(groups)
    except UsageError as problem:
        raise UsageError(f"{option}: {problem}") from None


def parse_perturb_groups(option: str, values: list[str] | None) -> tuple[Perturbations, ...]:
    """Parse the values of an option as a choice each; raises UsageError."""
    from svmdist.perturbations.chosen import parse_perturbations

    try:
        return tuple(parse_perturbations(value) for value in values or [])
    except UsageError as problem:
        raise UsageError(f"{option}: {problem}") from None
