"""The state that measurements make the most probable: Gauss–Newton on prior and residuals (Bell and Cathey 1993).

A camera is far from linear where a state is centimetres off, so that one step of a Kalman filter does not get there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from svmdist.estimation.filter.linearisation import Linearised, block_diagonal
from svmdist.estimation.filter.measurement import LinkMeasurement
from svmdist.estimation.filter.state import ErrorState
from svmdist.estimation.gate import chi_square_bound
from svmdist.profile.settings import FilterSettings
from svmdist.transforms import Array

SETTLED, NEARLY_SETTLED = 1e-3, 0.1
"""Of its standard deviation: an element of the state that moves by less has come to rest, or will with a next step."""


@dataclass(frozen=True, slots=True)
class MostProbable:
    """The most probable change x of the state, with derivatives, noise and gain there, and its squared deviation.

    `nis` is xᵀ P⁻¹ x + rᵀ R⁻¹ r at its minimum: what prior and measurements have to give way, together.
    """

    x: Array
    H: Array
    R: Array
    K: Array
    nis: float
    is_settled: bool


def most_probable(
    state: ErrorState,
    measurements: Sequence[LinkMeasurement],
    parts: Sequence[Linearised],
    settings: FilterSettings,
) -> MostProbable | None:
    """The state that measurements make the most probable; None where no start leads to one that shows them all.

    `parts` are the measurements about the present state.
    """
    size = sum(len(part.residual) for part in parts)
    bound = chi_square_bound(size, settings.gate_z)
    best = _descend(state, measurements, np.zeros(len(state.P)), settings, parts)
    if best is not None and best.nis <= bound:
        return best
    for start in _other_depths(state, settings):
        found = _descend(state, measurements, start, settings)
        if found is not None and (best is None or found.nis < best.nis):
            best = found
        if best is not None and best.nis <= bound:
            break
    return best


def _other_depths(state: ErrorState, settings: FilterSettings) -> Iterator[Array]:
    """While depth is as good as unknown, the most probable states at other depths.

    Of robots that err by centimetres some report their tool behind the camera, where nothing can be seen.
    """
    tool = state.link(None)
    along = state.P[:, : state.model.size] @ tool.derivative[2]
    variance_m2 = float(tool.derivative[2] @ along[: state.model.size])
    if variance_m2 > settings.depth_unknown_std_m**2:
        for depth_m in settings.depth_candidates_m:
            yield along * (depth_m - tool.T_camera_link[2, 3]) / variance_m2


def _descend(
    state: ErrorState,
    measurements: Sequence[LinkMeasurement],
    x: Array,
    settings: FilterSettings,
    parts: Sequence[Linearised] | None = None,
) -> MostProbable | None:
    """x ← K (r + H x) until x rests; None where a measurement's link leaves the view.

    In this form neither P nor the information has to be inverted: P is nearly singular where a joint's error is
    as good as known. `parts` are the measurements about the state after x, where they are known.
    """
    P, size = state.P, state.model.size
    R = block_diagonal([measurement.covariance for measurement in measurements])
    deviations = np.sqrt(np.diag(P) + 1e-18)
    there, moved = state, np.inf
    for _ in range(settings.max_iterations):
        if parts is None:
            there = state.retracted(x)
            parts = there.linearise(measurements)
        if not all(part.is_finite for part in parts):
            return None
        H = state.full_jacobian(parts)
        residual = np.concatenate([part.residual for part in parts]) - H[:, size:] @ there.bias_mean
        innovation = residual + H @ x
        # Solved with a unit-free H P: the units of the state differ by orders of magnitude.
        HP = H @ P
        solved = np.linalg.solve(HP @ H.T + R, np.column_stack([HP, innovation]))
        K = np.asarray(solved[:, :-1].T, np.float64)
        step = K @ innovation - x
        longer = float(np.max(np.abs(step) / deviations))
        if longer > moved:  # it swings: half of the way
            step, longer = 0.5 * step, 0.5 * longer
        x, parts, moved = x + step, None, longer
        if moved < SETTLED:
            break
    return MostProbable(x, H, R, K, float(innovation @ solved[:, -1]), moved < NEARLY_SETTLED)
