"""The gate for residuals: what a normal distribution lets pass."""

from __future__ import annotations

import numpy as np

GATE_Z = 3.09
"""Normal quantile of the gate: an observation less likely than 1 in 1,000 is rejected."""


def chi_square_bound(freedom: int, z: float = GATE_Z) -> float:
    """Quantile of the chi-square distribution at the normal quantile z (Wilson and Hilferty 1931)."""
    c = 2.0 / (9.0 * freedom)
    return float(freedom * (1.0 - c + z * np.sqrt(c)) ** 3)
