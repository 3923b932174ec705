"""The lag between image and kinematic stamps: found by moving one against the other until they agree.

The tool's track in the image is compared with the one that kinematics predict for it, shifted by a candidate lag. They
differ by more than time: a wrong camera-to-base transform turns, scales and shifts the prediction. A 2x3 affine map,
held near the identity by a prior, takes that up, so that only what moves in step decides. For each lag the best map is
a linear least-squares fit (a profile likelihood).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from svmdist.tracks import LagEstimate, Mask
from svmdist.transforms import Array, Stamps

Predict = Callable[[Stamps], tuple[Array, Mask]]
"""Stamps, shape (n,), to the tool's predicted pixels, shape (n, 2), and which of them are known, (n,)."""

MAX_LAG_S, STEP_S = 3.0, 0.01  # a hand-held tool hardly turns within 10 ms: no minimum is stepped over
MIN_PAIRS = 12
MIN_MOTION_PX = 4.0  # deviation of the predicted track below which noise could pass for motion
MAP_STD = 0.2  # prior of the affine map's factors about the identity: a turn or scale of some 10°, or 20 %
PIXEL_STD = 1.0  # what segmentation leaves of noise in a position; weighs the prior
MAX_STD_S = 0.02  # of a lag that is accepted
RIVAL_DISTANCE_S = 0.15  # minima further away than this are other answers, not the same one


def estimate_lag(stamps_ns: Stamps, seen_px: Array, predict: Predict) -> LagEstimate:
    """Estimate the lag from where the tool was seen, shape (n, 2) in px, at image stamps, shape (n,)."""
    if len(stamps_ns) < MIN_PAIRS:
        return _unknown(f"{len(stamps_ns)} measured frames; {MIN_PAIRS} are needed")
    motion_px = float(np.sqrt(np.mean(np.var(seen_px, axis=0))))
    if motion_px < MIN_MOTION_PX:
        return _unknown(f"the tool moves by {motion_px:.1f} px in the image; {MIN_MOTION_PX:g} px are needed")
    error_at = partial(_error_at, stamps_ns, seen_px, predict)
    lags_s = np.arange(-MAX_LAG_S, MAX_LAG_S + STEP_S / 2, STEP_S)
    costs = np.array([error_at(lag_s)[0] for lag_s in lags_s])
    if not np.isfinite(costs).any():
        return _unknown("images and kinematics do not overlap in time")
    # Golden-section search between the neighbours of the coarse minimum, down to 0.05 ms.
    ratio, coarse_s = (np.sqrt(5.0) - 1.0) / 2.0, float(lags_s[np.argmin(costs)])
    low, high = coarse_s - STEP_S, coarse_s + STEP_S
    while high - low > 5e-5:
        left, right = high - ratio * (high - low), low + ratio * (high - low)
        low, high = (low, right) if error_at(left)[0] <= error_at(right)[0] else (left, high)
    lag_s = float((low + high) / 2.0)
    rival = float(np.min(costs[np.abs(lags_s - lag_s) > RIVAL_DISTANCE_S], initial=np.inf))
    # As in any least-squares fit of a shift, noise over speed: J(τ + h) ≈ J + v² h² with v the mean speed that the map
    # cannot take up. Infinite at rest.
    (here, count), ahead, behind = error_at(lag_s), error_at(lag_s + STEP_S)[0], error_at(lag_s - STEP_S)[0]
    curvature = (ahead + behind - 2.0 * here) / STEP_S**2 / 2.0
    std_s = float(np.sqrt(here / (curvature * 2 * count))) if 0.0 < curvature < np.inf else np.inf
    confidence = 1.0 - here / rival if np.isfinite(rival) and rival > 0 else 0.0
    if std_s > MAX_STD_S:
        return _unknown("the motion is too slow to estimate the lag")
    if confidence < 0.5:
        return _unknown(f"another lag explains the images nearly as well (confidence {confidence:.2f})")
    return LagEstimate(lag_s, std_s, confidence)


def _error_at(stamps_ns: Stamps, seen_px: Array, predict: Predict, lag_s: float) -> tuple[float, int]:
    """The best map's mean squared error in px² per coordinate, with its prior, inf of too few frames; their number."""
    predicted, known = predict(stamps_ns - round(lag_s * 1e9))
    count = int(np.count_nonzero(known))
    if count < max(MIN_PAIRS, len(stamps_ns) // 4):
        return np.inf, count
    p, s = predicted[known], seen_px[known]
    p, s = p - p.mean(0), s - s.mean(0)
    if np.sqrt(np.mean(p**2)) < MIN_MOTION_PX:
        return np.inf, count
    weight = (PIXEL_STD / MAP_STD) ** 2
    change = np.linalg.solve(p.T @ p + weight * np.eye(2), p.T @ (s - p))
    residual = s - p - p @ change
    cost = float(np.sum(residual**2) + weight * np.sum(change**2)) / (2 * count)
    # Frames drop out at the ends of the search; less motion left must not pass for a better fit.
    return cost * float(np.mean(seen_px.var(0))) / float(np.mean(s**2)), count


def _unknown(reason: str) -> LagEstimate:
    return LagEstimate(0.0, None, 0.0, reason)
