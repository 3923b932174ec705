"""The scenarios: what the instrument does, as a smooth path of the tool's origin and of the wrist.

A path is a function of progress, 0 at the start of a recording and 1 at its end, so that every figure is complete
whatever the duration. The seed varies phases, positions and frequencies. All curves are twice continuously
differentiable.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from svmdist.errors import UsageError
from svmdist.transforms import Array


def smooth_step(s: Array, start: float = 0.0, end: float = 1.0) -> Array:
    """Rise from 0 to 1 between `start` and `end` with zero velocity and acceleration at both (quintic)."""
    x = np.clip((s - start) / (end - start), 0.0, 1.0)
    return np.asarray(x**3 * (10.0 - 15.0 * x + 6.0 * x * x))


def smooth_pulse(s: Array, rise: tuple[float, float], fall: tuple[float, float]) -> Array:
    """Rise from 0 to 1 over one span of progress, and fall back over another."""
    return smooth_step(s, *rise) - smooth_step(s, *fall)


def cubic_spline(knots: Array, s: Array) -> Array:
    """Natural cubic spline through knots, shape (k, ...), evenly spaced over 0 to 1, at s, shape (n,)."""
    count = len(knots)
    h = 1.0 / (count - 1)
    # Second derivatives m solve m[i-1] + 4 m[i] + m[i+1] = 6 (k[i-1] - 2 k[i] + k[i+1]) / h², zero at ends.
    A = np.eye(count)
    right = np.zeros_like(knots)
    for index in range(1, count - 1):
        A[index, index - 1 : index + 2] = 1.0, 4.0, 1.0
        right[index] = 6.0 * (knots[index - 1] - 2.0 * knots[index] + knots[index + 1]) / h**2
    m = np.linalg.solve(A, right.reshape(count, -1)).reshape(knots.shape)
    left = np.clip((s / h).astype(int), 0, count - 2)
    shape = (-1, *([1] * (knots.ndim - 1)))
    b = (s / h - left).reshape(shape)
    a = 1.0 - b
    return np.asarray(
        a * knots[left] + b * knots[left + 1] + ((a**3 - a) * m[left] + (b**3 - b) * m[left + 1]) * h**2 / 6.0
    )


def wander(rng: np.random.Generator, s: Array, cycles: float = 1.5) -> Array:
    """A gentle wave between -1 and 1 with a random phase and frequencies about `cycles`, shape (n,)."""
    phases = rng.uniform(0.0, 2.0 * np.pi, 2)
    first = cycles * rng.uniform(0.85, 1.15)
    slow, fast = 2 * np.pi * first * s + phases[0], 2 * np.pi * 2.3 * first * s + phases[1]
    return np.asarray(0.65 * np.sin(slow) + 0.35 * np.sin(fast))


Progress = Array


@dataclass(frozen=True)
class Scenario:
    """What to record: a named motion, the seed of everything random, and how long and how often."""

    name: str
    seed: int = 0
    duration_s: float = 8.0
    rate_hz: float = 10.0

    def __post_init__(self) -> None:
        if self.frame_count < 1:
            raise UsageError(
                f"{self.duration_s:g} s at {self.rate_hz:g} Hz hold no frame: give a longer duration or a higher rate"
            )

    @property
    def frame_count(self) -> int:
        """Number of images."""
        return round(self.duration_s * self.rate_hz)


@dataclass(frozen=True)
class Stage:
    """Where a motion takes place, in m: the tissue's origin on the floor, (2,), and the working height."""

    tissue_xy_m: Array
    tissue_height_m: float
    working_height_m: float
    duration_s: float


@dataclass(frozen=True)
class Motion:
    """A motion sampled over progress.

    `p_world_tool_m` (n, 3); `wrist_rad` (n, 4) holds roll, wrist pitch, wrist yaw and jaw as differences
    from the posture. Where `clearance_m` is given, the path is lowered by `lowering`, (n,), times the one
    length at which the clearance at progress `lowest_at` is just that.
    """

    p_world_tool_m: Array
    wrist_rad: Array
    retractor_xy_m: Array | None = None
    clearance_m: float | None = None
    lowering: Array | None = None
    lowest_at: float = 1.0


FIELD_M = (0.0455, 0.0335)
"""Half of what the camera sees in the working plane, less a margin for the distal marker and its virtual marker."""


def plan_motion(scenario: Scenario, progress: Progress, stage: Stage) -> Motion:
    """Sample a scenario's motion at values of progress, shape (n,)."""
    rng = np.random.default_rng([scenario.seed, zlib.crc32(scenario.name.encode())])
    return SCENARIOS[scenario.name](rng, progress, stage)


def _calibration(rng: np.random.Generator, s: Progress, stage: Stage) -> Motion:
    """A closed figure that crosses the whole field nine times each way.

    Heights run on their own frequency, so that they do not go with the position.
    """
    phases = rng.uniform(0.0, 2.0 * np.pi, 3)
    return Motion(_waves(s, stage, phases, (*FIELD_M, 0.002), (5, 4, 7.3)), gentle_wrist(rng, s))


def _sweep(rng: np.random.Generator, s: Progress, stage: Stage) -> Motion:
    phases = rng.uniform(0.0, 2.0 * np.pi, 3)
    cycles = ((3, 2), (2, 3), (3, 4))[rng.integers(3)]
    return Motion(_waves(s, stage, phases, (0.034, 0.024, 0.0015), (*cycles, 4.4)), gentle_wrist(rng, s))


def _waves(
    s: Progress, stage: Stage, phases: Array, amplitudes_m: Sequence[float], cycles: Sequence[float]
) -> Array:
    p_m = amplitudes_m * np.sin(2 * np.pi * np.array(cycles) * s[:, None] + phases)
    p_m[:, 2] += stage.working_height_m
    return np.asarray(p_m)


def _approach(rng: np.random.Generator, s: Progress, stage: Stage) -> Motion:
    return _descent(rng, s, stage, there=smooth_step(s, 0.04, 0.9), clearance_m=0.002, lowest_at=1.0)


def _contact(rng: np.random.Generator, s: Progress, stage: Stage) -> Motion:
    there = smooth_pulse(s, (0.04, 0.46), (0.56, 0.96))
    return _descent(rng, s, stage, there=there, clearance_m=-0.0002, lowest_at=0.51)


def _descent(
    rng: np.random.Generator, s: Progress, stage: Stage, there: Array, clearance_m: float, lowest_at: float
) -> Motion:
    """Go from the image's border to a place over the organ and down to a clearance."""
    bearing = rng.uniform(-0.9, 0.9)
    start = np.array([0.045, 0.031 * np.sin(bearing) / np.sin(0.9), stage.working_height_m + 0.003])
    radius_m, angle = rng.uniform(0.002, 0.007), rng.uniform(0.0, 2.0 * np.pi)
    # Jaws point to -x: this far to the right of the place that their tips are to reach.
    offset_m = np.array([0.006 + radius_m * np.cos(angle), radius_m * np.sin(angle)])
    target = np.array([*(stage.tissue_xy_m + offset_m), stage.tissue_height_m + 0.014])
    sag = 0.004 * np.sin(np.pi * there) ** 2 * rng.uniform(-1.0, 1.0)
    p_m = start + there[:, None] * (target - start)
    p_m[:, 1] += sag
    # The wrist is still at the lowest point, so that it is the lowest.
    wrist = gentle_wrist(rng, s) * (1.0 - there[:, None])
    wrist[:, 2] -= 0.25 * there  # the jaws bend down to the tissue
    # The last millimetres come last: `there` cubed is still smooth, and late.
    return Motion(p_m, wrist, clearance_m=clearance_m, lowering=there**3, lowest_at=lowest_at)


def _occlusion(rng: np.random.Generator, s: Progress, stage: Stage) -> Motion:
    parked = np.array([0.040, rng.uniform(0.006, 0.014)])
    far_left = np.array([rng.uniform(-0.034, -0.026), rng.uniform(-0.012, 0.012)])
    outside = np.array([0.062, rng.uniform(-0.02, 0.0)])
    # Parked under the retractor, across the tissue and back, out of the image, and back in.
    across = smooth_pulse(s, (0.20, 0.42), (0.46, 0.68))[:, None]
    away = smooth_pulse(s, (0.68, 0.82), (0.86, 1.0))[:, None]
    xy_m = parked + across * (far_left - parked) + away * (outside - parked)
    xy_m[:, 1] += 0.004 * wander(rng, s)
    z_m = stage.working_height_m + 0.001 * wander(rng, s, 2.0)
    over = smooth_pulse(s, (0.02, 0.10), (0.13, 0.22))
    # The blade hangs at half the camera's distance: seen from there, it stands over the parked tool.
    tip_y_m = 0.032 - 0.029 * over
    retractor = np.stack([np.full_like(s, rng.uniform(0.0235, 0.0245)), tip_y_m], -1)
    return Motion(np.column_stack([xy_m, z_m]), gentle_wrist(rng, s), retractor_xy_m=retractor)


def _random(rng: np.random.Generator, s: Progress, stage: Stage) -> Motion:
    half_m = np.array([0.020, 0.015, 0.010])
    centre_m = np.array([stage.tissue_xy_m[0] + 0.012, stage.tissue_xy_m[1], stage.working_height_m])
    count = max(12, round(2.5 * stage.duration_s))
    # Latin hypercube: every slice of the box is visited once along each axis, whatever the seed.
    slices = np.stack([rng.permutation(count) for _ in range(3)], -1)
    waypoints = (slices + rng.uniform(0.0, 1.0, slices.shape)) / count * 2.0 - 1.0
    # A spline overshoots its waypoints: scale the whole curve, not the samples asked for, to the box.
    whole = cubic_spline(waypoints, np.linspace(0.0, 1.0, 2001))
    low, high = whole.min(axis=0), whole.max(axis=0)
    unit = (cubic_spline(waypoints, s) - low) / (high - low) * 2.0 - 1.0
    wrist = gentle_wrist(rng, s)
    wrist[:, 2] += 0.1  # near the tissue at the bottom of the box: jaws up a little
    return Motion(centre_m + unit * half_m, wrist)


def gentle_wrist(rng: np.random.Generator, s: Progress) -> Array:
    """Gentle motion of roll, wrist pitch, wrist yaw and jaw about the posture, shape (n, 4) in rad."""
    amplitudes = (0.15, 0.12, 0.08, 0.12)
    return np.stack([amplitude * wander(rng, s) for amplitude in amplitudes], -1)


SCENARIOS: dict[str, Callable[[np.random.Generator, Progress, Stage], Motion]] = {
    "calibration": _calibration,
    "sweep": _sweep,
    "approach": _approach,
    "contact": _contact,
    "occlusion": _occlusion,
    "random": _random,
}
