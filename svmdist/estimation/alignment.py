"""How a robot and its camera belong together, by what a log shows: the camera-to-base transform, and the lag of stamps.

The transform is found from places of the tool in the camera's frame and in the base's:

    a_i = R b_i + t + noise + H_i c

a_i is what a method saw, with its covariance, b_i what the robot reports. c are errors that frames share: offsets of
joints, lengths, a size, the focal length, the principal point. They are not estimated, for the transform is to be used
with nominal kinematics, but the covariance includes what they do (consider parameters; Schmidt 1966). The shaft's
direction is a second measurement where both sides know it.

The lag between image and kinematic stamps is found by moving one against the other until they agree: the tool's track
in the image against the one that kinematics predict for it, shifted by a candidate lag. They differ by more than time:
a wrong camera-to-base transform turns, scales and shifts the prediction. A 2x3 affine map, held near the identity by a
prior, takes that up, so that only what moves in step decides. For each lag the best map is a linear least-squares fit
(a profile likelihood).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from svmdist.least_squares import huber_weights
from svmdist.profile.settings import HandEyeSettings
from svmdist.results import Failure
from svmdist.tracks import LagEstimate, Mask
from svmdist.transforms import Array, Stamps, make_transform, rotation_of, skew

MIN_FRACTION = 0.5  # inliers among the frames; with less, what is seen is not what the robot moves
GATE = 16.3  # largest squared normalised residual of an inlier: chi square of 3 degrees of freedom, 99.9 %
HUBER = 2.0  # normalised residual from which on a frame counts less
TRIALS = 400  # samples of three frames that the fit starts from
AXIS_FLOOR_RAD = 0.01  # of a shaft's direction in the image: what its outline does not show, 0.6°
AXIS_TILT_FLOOR_RAD = 0.17  # towards the camera: edges in shadows tilted it by 10° in simulated rooms
POSITION_FLOOR_M = 2e-4  # standard deviation added to that of a place, along each axis
CORRELATION_TIME_S = 0.5  # how long errors of a detection and backlash of joints last: between two reversals of a joint
CLOUD_STD_M = 1e-3  # places within this of a line or a point determine no rotation

MAX_LAG_S, STEP_S = 3.0, 0.01  # a hand-held tool hardly turns within 10 ms: no minimum is stepped over
MIN_PAIRS = 12
MIN_MOTION_PX = 4.0  # deviation of the predicted track below which noise could pass for motion
MAP_STD = 0.2  # prior of the affine map's factors about the identity: a turn or scale of some 10°, or 20 %
PIXEL_STD = 1.0  # what segmentation leaves of noise in a position; weighs the prior
MAX_STD_S = 0.02  # of a lag that is accepted
RIVAL_DISTANCE_S = 0.15  # minima further away than this are other answers, not the same one

Predict = Callable[[Stamps], tuple[Array, Mask]]
"""Stamps, shape (n,), to the tool's predicted pixels, shape (n, 2), and which of them are known, (n,)."""


@dataclass(frozen=True)
class ToolPlaces:
    """The tool at n instants, in time order: what was seen in the camera's frame, what the robot reports in the base's.

    Shared errors are those of all frames, of standard deviation 1 each: what they do to place and direction.
    """

    stamps_ns: Stamps
    seen_m: Array  # (n, 3)
    covariance: Array  # (n, 3, 3)
    nominal_m: Array  # (n, 3)
    nominal_covariance: Array  # (n, 3, 3), of what differs from frame to frame
    axes: Array  # the shaft's directions, (n, 3)
    axis_std_rad: Array  # (n,), NaN where one of both directions is not known
    nominal_axes: Array  # (n, 3)
    robot_shared: Array  # (n, 6, m)
    camera_shared: Array  # (n, 6, k)


@dataclass(frozen=True)
class HandEyeFit:
    """The transform, and how well it fits."""

    T_camera_base: Array
    covariance: Array  # of (δt, δφ), (6, 6)
    inliers: Mask  # (n,)
    residuals_m: Array  # of all frames, (n,)
    effects: Array  # (6, m + k): what shared errors, those of the robot first, do to (δt, δφ) for one deviation each
    ratio: float  # the mean squared residual over what is expected: above 1 the covariance has been enlarged by it


def fit_hand_eye(places: ToolPlaces, settings: HandEyeSettings) -> HandEyeFit | Failure:
    """Fit the transform robustly; a Failure says why it cannot be found."""
    count = len(places.seen_m)
    if count < settings.min_count:
        return Failure(f"the tool was seen and known in {count} frames; {settings.min_count} are needed")
    spread_m = np.linalg.svd(places.nominal_m - places.nominal_m.mean(0), compute_uv=False) / np.sqrt(count)
    if spread_m[0] < CLOUD_STD_M:
        return Failure(f"the tool moved by {spread_m[0] * 1e3:.1f} mm only: move it through the view")
    T = _start(places)
    if T is None:
        return Failure("the tool moved along a line only: move it in all directions")
    inliers = _normalised(places, T) <= GATE
    for _ in range(10):
        T = _refined(places, T, inliers)
        now = _normalised(places, T) <= GATE
        if (now == inliers).all():
            break
        inliers = now
    number = int(inliers.sum())
    if number < max(settings.min_count, MIN_FRACTION * count):
        said = f"{number} of {count} places of the tool agree with the robot's motion"
        return Failure(f"{said}: is it the same instrument, at the same time (--lag)?")
    covariance, effects, ratio = _covariance(places, T, inliers)
    turn_std_rad = float(np.sqrt(np.linalg.eigvalsh(covariance[3:, 3:])[-1]))
    if not turn_std_rad <= settings.max_turn_std_rad:
        said = f"the rotation is uncertain by {np.degrees(turn_std_rad):.0f}°"
        return Failure(f"{said}: move the tool further, in all directions")
    return HandEyeFit(T, covariance, inliers, np.linalg.norm(_residuals(places, T)[0], axis=1), effects, ratio)


def rigid_fit(seen_m: Array, nominal_m: Array, weights: Array | None = None) -> Array:
    """The transform T with seen = T nominal in least squares, of points (n, 3) each (Kabsch 1976)."""
    w = np.ones(len(seen_m)) if weights is None else weights
    w = w / w.sum()
    a0, b0 = w @ seen_m, w @ nominal_m
    u, _, vt = np.linalg.svd(((seen_m - a0) * w[:, None]).T @ (nominal_m - b0))
    R = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return make_transform(R, a0 - R @ b0)


def _start(places: ToolPlaces) -> Array | None:
    """The best of transforms by three frames each (RANSAC): the one with the least truncated residuals."""
    rng, starts = np.random.default_rng(0), list[Array]()
    for _ in range(TRIALS):
        three = rng.choice(len(places.seen_m), 3, replace=False)
        corner = places.nominal_m[three]
        area_m2 = np.linalg.norm(np.cross(corner[1] - corner[0], corner[2] - corner[0]))
        if area_m2 >= CLOUD_STD_M**2:
            starts.append(rigid_fit(places.seen_m[three], corner))
    return min(starts, key=lambda T: float(np.minimum(_normalised(places, T), GATE).sum()), default=None)


def _residuals(places: ToolPlaces, T: Array) -> tuple[Array, Array, Array]:
    """Residuals of places, (n, 3); their covariance by what differs from frame to frame; shared errors, (n, 6, m)."""
    R = T[:3, :3]
    r = places.seen_m - (places.nominal_m @ R.T + T[:3, 3])
    covariance = places.covariance + R @ places.nominal_covariance @ R.T + POSITION_FLOOR_M**2 * np.eye(3)
    # What shared errors do to place and direction in the camera's frame.
    turned = np.concatenate([R @ places.robot_shared[:, :3], R @ places.robot_shared[:, 3:]], axis=1)
    return r, covariance, np.concatenate([turned, places.camera_shared], axis=2)


def _normalised(places: ToolPlaces, T: Array) -> Array:
    """Squared residuals of places over their covariance, shared errors included, (n,)."""
    r, S, shared = _residuals(places, T)
    S = S + shared[:, :3] @ shared[:, :3].swapaxes(1, 2)
    return np.asarray(np.einsum("ni,ni->n", r, np.linalg.solve(S, r[..., None])[..., 0]))


def _rows(places: ToolPlaces, T: Array, inliers: Mask, *, robust: bool = True) -> Array:
    """Whitened (k, 1 + 6 + m) of inlier frames: residual, derivative and shared errors, of places, then of axes."""
    R = T[:3, :3]
    r, S, shared = (of_all[inliers] for of_all in _residuals(places, T))
    whiten = np.linalg.inv(np.linalg.cholesky(S))
    by_shift, by_turn = np.broadcast_to(np.eye(3), (len(r), 3, 3)), -skew(places.nominal_m[inliers] @ R.T)
    blocks = [whiten @ np.concatenate([r[..., None], by_shift, by_turn, shared[:, :3]], 2)]
    known = np.isfinite(places.axis_std_rad[inliers])
    if known.any():
        predicted = places.nominal_axes[inliers][known] @ R.T
        # Unit vectors across each axis, as rows, (n, 2, 3): across the line of sight, and towards it.
        aside = np.cross(predicted, places.seen_m[inliers][known])
        aside /= np.maximum(np.linalg.norm(aside, axis=1, keepdims=True), 1e-12)
        across = np.stack([aside, np.cross(predicted, aside)], 1)
        std = np.hypot(places.axis_std_rad[inliers][known][:, None], [AXIS_FLOOR_RAD, AXIS_TILT_FLOOR_RAD])[..., None]
        off = (places.axes[inliers][known] - predicted)[..., None]
        by_shift, by_turn = np.zeros((len(off), 3, 3)), -skew(predicted)
        blocks.append(across @ np.concatenate([off, by_shift, by_turn, shared[known][:, 3:]], 2) / std)
    if robust:
        weights = [np.sqrt(huber_weights(np.linalg.norm(block[..., 0], axis=1), HUBER)) for block in blocks]
        blocks = [weight[:, None, None] * block for weight, block in zip(weights, blocks, strict=True)]
    return np.concatenate([block.reshape(-1, block.shape[2]) for block in blocks])


def _refined(places: ToolPlaces, T: Array, inliers: Mask) -> Array:
    if inliers.sum() < 3:
        return T
    for _ in range(50):
        rows = _rows(places, T, inliers)
        # Least norm where a direction is not observable.
        step = np.linalg.lstsq(rows[:, 1:7], rows[:, 0], rcond=1e-9)[0]
        T = make_transform(rotation_of(step[3:]) @ T[:3, :3], T[:3, 3] + step[:3])
        if np.abs(step).max() < 1e-10:
            break
    return T


def _covariance(places: ToolPlaces, T: Array, inliers: Mask) -> tuple[Array, Array, float]:
    """Covariance, effects and ratio as in `HandEyeFit`."""
    rows = _rows(places, T, inliers)
    J, H = rows[:, 1:7], rows[:, 7:]
    gain = np.linalg.pinv(J.T @ J, hermitian=True)
    plain = _rows(places, T, inliers, robust=False)[:, 0]
    # Noise counts as much more as residuals are larger than expected (Birge 1932), and as neighbours repeat each other,
    # by what the residuals show or the settings say: errors of detections and backlash last for some frames, where the
    # covariances of single frames hide them. What is shared is added whole.
    ratio = float(plain @ plain) / max(1, len(plain) - 6)
    series = plain[: 3 * np.count_nonzero(inliers)].reshape(-1, 3)
    power = float((series**2).sum())
    repeated = float((series[1:] * series[:-1]).sum()) / power if power > 0 else 0.0
    step_s = float(np.median(np.diff(places.stamps_ns[inliers]))) / 1e9
    repeated = min(max(repeated, float(np.exp(-step_s / CORRELATION_TIME_S))), 0.95)
    noise = max(1.0, ratio) * (1.0 + repeated) / (1.0 - repeated)
    # What was seen is off by H c, so the fit is off by as much, and its correction is the opposite.
    effects = -gain @ J.T @ H
    return noise * gain + effects @ effects.T, effects, ratio


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
