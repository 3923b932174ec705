"""The one table of perturbations, by name. An entry here is an option of `record` and of `compare`."""

from __future__ import annotations

from svmdist.errors import UsageError, did_you_mean
from svmdist.perturbations.calibration_table import CALIBRATION
from svmdist.perturbations.image_table import IMAGES
from svmdist.perturbations.joint_table import CLOCK, JOINTS
from svmdist.perturbations.laws import Normal
from svmdist.perturbations.perturbation import Perturbation

TABLE: dict[str, Perturbation] = {entry.name: entry for entry in (*JOINTS, *CLOCK, *CALIBRATION, *IMAGES)}


def find_perturbation(name: str) -> Perturbation:
    """The entry of a name; raises UsageError that lists the names."""
    found = TABLE.get(name)
    if found is None:
        raise UsageError(f"no perturbation {name}: {did_you_mean(name, TABLE)}")
    return found


def real_std(name: str) -> float:
    """The standard deviation of a strength in the real world, in its unit, along each axis: what a profile may state.

    Raises ValueError for a strength that is not normal.
    """
    law = find_perturbation(name).real
    if not isinstance(law, Normal):
        raise ValueError(f"perturbation {name} has no standard deviation")
    return law.std


def require_strength(name: str, strength: float) -> None:
    """Raise UsageError for a name that is not in the table, or a strength out of its range."""
    entry = find_perturbation(name)
    if not entry.low <= strength <= entry.high:  # NaN is in no range
        raise UsageError(
            f"perturbation {name}: from {entry.low:g} to {entry.high:g} {entry.unit}, found {strength:g}"
        )
