"""The clock of the joints against that of the images: late by a constant, and by more and more."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from svmdist.perturbations.chosen import Perturbations
from svmdist.transforms import Array

MAX_STAMP_NS = (1 << 63) - 1


def later_ns(stamp_ns: int, lag_ns: int) -> int:
    """A stamp that is later by a lag, within 64 bits."""
    return min(stamp_ns + lag_ns, MAX_STAMP_NS)


def late_stamps_ns(stamps_ns: ArrayLike, perturbations: Perturbations, start_ns: int) -> NDArray[np.int64]:
    """The stamps that joints get which were true at `stamps_ns`, any shape; the lag drifts from `start_ns` on."""
    stamps = np.asarray(stamps_ns, np.int64)
    late_ns = 1e6 * perturbations["lag"] + 1e-3 * perturbations["lag_drift"] * (stamps - start_ns)
    return np.asarray(stamps + np.rint(late_ns).astype(np.int64))


def reported_late(values: Array, stamps_ns: NDArray[np.int64], perturbations: Perturbations) -> Array:
    """What is reported at the stamps, shape (n,), of values over the same stamps, shape (n, k).

    Values lie on straight lines between stamps. So they do before the first and after the last one: the robot moved
    before the recording, too.
    """
    if len(stamps_ns) < 2 or not perturbations.has("lag", "lag_drift"):
        return values
    start_ns = int(stamps_ns[0])
    true_at = late_stamps_ns(stamps_ns, perturbations, start_ns) - start_ns
    at = stamps_ns - start_ns
    right = np.clip(np.searchsorted(true_at, at, side="left"), 1, len(at) - 1)
    left = right - 1
    weight = (at - true_at[left]) / (true_at[right] - true_at[left])
    return np.asarray(values[left] + weight[:, None] * (values[right] - values[left]))
