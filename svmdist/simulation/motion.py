"""What the instruments do: scenarios as smooth paths, and the joint trajectories that follow them.

A path is a function of progress, 0 at the start of a recording and 1 at its end, so that every figure is complete
whatever the duration; all curves are twice continuously differentiable. A second arm crosses the first one in the
image and stays above it, so that the bodies keep apart.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from svmdist.errors import KinematicsError, SimulationError, UsageError
from svmdist.kinematics import forward_kinematics, solve_position
from svmdist.perturbations import UNPERTURBED
from svmdist.profile import Profile
from svmdist.simulation.clearance import InstrumentClearance, TissueClearance
from svmdist.simulation.scene import Options, Scene, make_scene
from svmdist.transforms import Array, inverse, make_transform, rotation_z, transform_points

FIELD_M = (0.0455, 0.0335)  # half of what the camera sees in the working plane, less a margin for both markers
APART_M = 0.003  # the bodies of two instruments keep this far apart
LIFTS_M = np.arange(0.010, 0.0361, 0.002)  # above the first one's height: the lowest that keeps them apart is taken
CROSSING_FIELD_M = np.array([0.040, 0.029])
"""Half of where the distal marker may be, seen in the first instrument's working plane: inside of the image."""
CROSSING_PERIOD_S = 2.7  # between two crossings, on average: an 8 s recording has three of them
_PATH_STREAM = 16
Curve = Callable[[Array], Array]  # over progress


def smooth_step(s: Array, start: float = 0.0, end: float = 1.0) -> Array:
    """Rise from 0 to 1 between `start` and `end` with zero velocity and acceleration at both (quintic)."""
    x = np.clip((s - start) / (end - start), 0.0, 1.0)
    return np.asarray(x**3 * (10.0 - 15.0 * x + 6.0 * x * x))


def smooth_pulse(s: Array, rise: tuple[float, float], fall: tuple[float, float]) -> Array:
    """Rise from 0 to 1 over one span of progress, and fall back over another."""
    return smooth_step(s, *rise) - smooth_step(s, *fall)


def cubic_spline(knots: Array, s: Array) -> Array:
    """Natural cubic spline through knots, shape (k, d), evenly spaced over 0 to 1, at s, shape (n,)."""
    count = len(knots)
    h = 1.0 / (count - 1)
    # Second derivatives m solve m[i-1] + 4 m[i] + m[i+1] = 6 (k[i-1] - 2 k[i] + k[i+1]) / h², zero at ends.
    A, right = np.eye(count), np.zeros_like(knots)
    A[1:-1] = (np.eye(count, k=-1) + 4.0 * A + np.eye(count, k=1))[1:-1]
    right[1:-1] = 6.0 * (knots[:-2] - 2.0 * knots[1:-1] + knots[2:]) / h**2
    m = np.linalg.solve(A, right)
    left = np.clip((s / h).astype(int), 0, count - 2)
    b = (s / h - left)[:, None]
    a = 1.0 - b
    bent = (a**3 - a) * m[left] + (b**3 - b) * m[left + 1]
    return np.asarray(a * knots[left] + b * knots[left + 1] + bent * h**2 / 6.0)


def wander(rng: np.random.Generator, s: Array, cycles: float = 1.5) -> Array:
    """A gentle wave between -1 and 1 with a random phase and frequencies about `cycles`, shape (n,)."""
    phases = rng.uniform(0.0, 2.0 * np.pi, 2)
    first = cycles * rng.uniform(0.85, 1.15)
    slow, fast = 2 * np.pi * first * s + phases[0], 2 * np.pi * 2.3 * first * s + phases[1]
    return np.asarray(0.65 * np.sin(slow) + 0.35 * np.sin(fast))


def gentle_wrist(rng: np.random.Generator, s: Array) -> Array:
    """Gentle motion of roll, wrist pitch, wrist yaw and jaw about the posture, shape (n, 4) in rad."""
    return np.stack([amplitude * wander(rng, s) for amplitude in (0.15, 0.12, 0.08, 0.12)], -1)


@dataclass(frozen=True)
class Scenario:
    """What to record: a named motion, the seed of everything random, and how long and how often."""

    name: str
    seed: int = 0
    duration_s: float = 8.0
    rate_hz: float = 10.0

    def __post_init__(self) -> None:
        if self.frame_count < 1:
            found = f"{self.duration_s:g} s at {self.rate_hz:g} Hz hold no frame"
            raise UsageError(f"{found}: give a longer duration or a higher rate")

    @property
    def frame_count(self) -> int:
        """Number of images."""
        return round(self.duration_s * self.rate_hz)


@dataclass(frozen=True)
class Motion:
    """A motion sampled over progress."""

    p_world_tool_m: Array  # (n, 3)
    wrist_rad: Array  # (n, 4): roll, wrist pitch, wrist yaw and jaw as differences from the posture
    retractor_xy_m: Array | None = None
    # The path is lowered by `lowering`, (n,), times the length that brings it to a clearance at progress `lowest_at`.
    lowering: Array | None = None
    clearance_m: float = 0.0
    lowest_at: float = 1.0


def plan_motion(scenario: Scenario, progress: Array, scene: Scene) -> Motion:
    """Sample a scenario's motion in a scene at values of progress, shape (n,)."""
    rng = np.random.default_rng([scenario.seed, zlib.crc32(scenario.name.encode())])
    motion = SCENARIOS[scenario.name](rng, progress, scene, scenario.duration_s)
    motion.wrist_rad[:, 3] += scene.jaw_opening_rad(progress * scenario.duration_s)
    return motion


def _waves(rng: np.random.Generator, s: Array, scene: Scene, _: float, *, crosses_field: bool) -> Motion:
    """A closed figure, whose height has its own frequency; `calibration` crosses the field nine times each way."""
    phases = rng.uniform(0.0, 2.0 * np.pi, 3)
    if crosses_field:
        amplitudes_m, cycles = (*FIELD_M, 0.002), (5, 4, 7.3)
    else:
        amplitudes_m, cycles = (0.034, 0.024, 0.0015), (*((3, 2), (2, 3), (3, 4))[rng.integers(3)], 4.4)
    p_m = np.array(amplitudes_m) * np.sin(2 * np.pi * np.array(cycles) * s[:, None] + phases)
    p_m[:, 2] += scene.working_height_m
    return Motion(p_m, gentle_wrist(rng, s))


def _descent(
    rng: np.random.Generator, s: Array, scene: Scene, _: float, *, path: Curve, clearance_m: float, lowest_at: float
) -> Motion:
    """Go from the image's border, where `path` is 0, to a place over the organ, where it is 1, at a clearance."""
    there = path(s)
    start = np.array([0.045, 0.031 * np.sin(rng.uniform(-0.9, 0.9)) / np.sin(0.9), scene.working_height_m + 0.003])
    radius_m, angle = rng.uniform(0.002, 0.007), rng.uniform(0.0, 2.0 * np.pi)
    # Jaws point to -x: this far to the right of the place that their tips are to reach.
    offset_m = np.array([0.006 + radius_m * np.cos(angle), radius_m * np.sin(angle)])
    target = np.array([*(scene.T_world_tissue[:2, 3] + offset_m), scene.organ.height_m + 0.014])
    p_m = start + there[:, None] * (target - start)
    p_m[:, 1] += 0.004 * np.sin(np.pi * there) ** 2 * rng.uniform(-1.0, 1.0)
    # The wrist is still at the lowest point, so that it is the lowest.
    wrist = gentle_wrist(rng, s) * (1.0 - there[:, None])
    wrist[:, 2] -= 0.25 * there  # the jaws bend down to the tissue
    # The last millimetres come last: `there` cubed is still smooth, and late.
    return Motion(p_m, wrist, clearance_m=clearance_m, lowering=there**3, lowest_at=lowest_at)


def _occlusion(rng: np.random.Generator, s: Array, scene: Scene, _: float) -> Motion:
    parked = np.array([0.040, rng.uniform(0.006, 0.014)])
    far_left = np.array([rng.uniform(-0.034, -0.026), rng.uniform(-0.012, 0.012)])
    outside = np.array([0.062, rng.uniform(-0.02, 0.0)])
    # Parked under the retractor, across the tissue and back, out of the image, and back in.
    across = smooth_pulse(s, (0.20, 0.42), (0.46, 0.68))[:, None]
    away = smooth_pulse(s, (0.68, 0.82), (0.86, 1.0))[:, None]
    xy_m = parked + across * (far_left - parked) + away * (outside - parked)
    xy_m[:, 1] += 0.004 * wander(rng, s)
    z_m = scene.working_height_m + 0.001 * wander(rng, s, 2.0)
    over = smooth_pulse(s, (0.02, 0.10), (0.13, 0.22))
    # The blade hangs at half the camera's distance: seen from there, it stands over the parked tool.
    retractor = np.stack([np.full_like(s, rng.uniform(0.0235, 0.0245)), 0.032 - 0.029 * over], -1)
    return Motion(np.column_stack([xy_m, z_m]), gentle_wrist(rng, s), retractor_xy_m=retractor)


def _random(rng: np.random.Generator, s: Array, scene: Scene, duration_s: float) -> Motion:
    half_m = np.array([0.020, 0.015, 0.010])
    centre_m = np.array([*(scene.T_world_tissue[:2, 3] + [0.012, 0.0]), scene.working_height_m])
    count = max(12, round(2.5 * duration_s))
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


SCENARIOS: dict[str, Callable[[np.random.Generator, Array, Scene, float], Motion]] = {
    "calibration": partial(_waves, crosses_field=True),
    "sweep": partial(_waves, crosses_field=False),
    "approach": partial(_descent, path=partial(smooth_step, start=0.04, end=0.9), clearance_m=0.002, lowest_at=1.0),
    "contact": partial(
        _descent, path=partial(smooth_pulse, rise=(0.04, 0.46), fall=(0.56, 0.96)), clearance_m=-0.0002, lowest_at=0.51
    ),
    "occlusion": _occlusion,
    "random": _random,
}


def make_trajectory(scene: Scene, scenario: Scenario, progress: Array) -> tuple[Array, Array | None]:
    """Exact joints of a scenario, (n, n_joints), at values of progress, (n,), and poses of a retractor, (n, 4, 4).

    Raises SimulationError out of reach.
    """
    motion = plan_motion(scenario, progress, scene)
    p_m, xy_m = motion.p_world_tool_m, motion.retractor_xy_m
    try:
        if motion.lowering is not None:
            lowering_m = _lowering_m(scene, plan_motion(scenario, np.array([motion.lowest_at]), scene))
            p_m[:, 2] -= lowering_m * motion.lowering
            # The path moves with the tissue as it comes near, as a surgeon's hand does.
            p_m[:, 2] += scene.tissue_offset_m(progress * scenario.duration_s) * motion.lowering
        q = _joints(scene, p_m, motion.wrist_rad)
    except KinematicsError as problem:
        raise SimulationError(f"scenario {scenario.name}: {problem}") from None
    if xy_m is None:
        return q, None
    # The blade hangs 60 mm high. Its tip points to -y: it comes in from the top of the image.
    return q, make_transform(rotation_z(np.pi / 2), np.column_stack([xy_m, np.full(len(xy_m), 0.06)]))


def _joints(scene: Scene, p_world_tool_m: Array, wrist_rad: Array) -> Array:
    q = np.tile(scene.posture, (len(p_world_tool_m), 1))
    q[:, -4:] += wrist_rad
    targets_m = transform_points(inverse(scene.T_world_base), p_world_tool_m)
    # Seven distal joints, as in every PSM: yaw, pitch and insertion place the wrist.
    return solve_position(scene.chain, q, targets_m, scene.chain.joint_names[-7:-4])


def _lowering_m(scene: Scene, lowest: Motion) -> float:
    """Find by bisection how far to lower the path for the wanted clearance at its lowest point."""
    assert lowest.lowering is not None
    tissue = TissueClearance([replace(scene, perturbations=UNPERTURBED)])  # which does not give way
    low, high = -0.01, 0.03
    while high - low > 1e-6:
        middle = 0.5 * (low + high)
        p_m = lowest.p_world_tool_m - middle * lowest.lowering[:, None] * [0.0, 0.0, 1.0]
        (clearance_m,) = tissue.clearances_m([_joints(scene, p_m, lowest.wrist_rad)[0]])
        low, high = (middle, high) if clearance_m > lowest.clearance_m else (low, middle)
    # Soft tissue gives way to a path that touches it.
    return 0.5 * (low + high) + 1e-3 * scene.perturbations["dent"] * (lowest.clearance_m < 0.0)


def make_other_arms(
    profile: Profile, scene: Scene, options: Options, q: Array, progress: Array, duration_s: float
) -> list[tuple[str, Scene, Array]]:
    """The name, scene and exact joints, shape (n, n_joints), of the arms beside the first, which moves by `q`.

    Each takes the lowest path that keeps away from the first instrument. Raises SimulationError where the profile
    places fewer arms, or the bodies cannot keep apart.
    """
    placed = [other.name for other in profile.other_instruments if other.simulation is not None]
    if options.arms > 1 + len(placed):
        needed = "it needs [[other_instruments]] with [other_instruments.simulation] for each further one"
        raise SimulationError(f"profile {profile.name} places {1 + len(placed)} of {options.arms} arms: {needed}")
    checked = np.unique(np.linspace(0, len(q) - 1, 120).astype(int))
    p_world_m = (scene.T_world_base @ forward_kinematics(scene.chain, q))[:, :3, 3]
    camera_m = float(scene.T_world_camera[2, 3])
    arms = []
    for number, name in enumerate(placed[: options.arms - 1], start=1):
        other = make_scene(profile.for_instrument(name), scene.seed, options)
        rng = np.random.default_rng([scene.seed, _PATH_STREAM, number])
        # Seen through the working plane, the path is an offset from the first instrument's.
        depth_m = camera_m - other.working_height_m
        wanted_m = p_world_m[:, :2] * (depth_m / (camera_m - p_world_m[:, 2:]))
        wanted_m += _offsets(rng, progress, duration_s, other.T_world_base[:2, 3])
        # The same inside of 70 % of the field, bent smoothly to stay within it outside.
        free_m, rest_m = 0.7 * CROSSING_FIELD_M, CROSSING_FIELD_M - 0.7 * CROSSING_FIELD_M
        bent_m = rest_m * np.tanh(np.maximum(np.abs(wanted_m) - free_m, 0.0) / rest_m)
        wanted_m = np.sign(wanted_m) * (np.minimum(np.abs(wanted_m), free_m) + bent_m)
        rise_m = 0.001 * wander(rng, progress, 2.0)
        wrist_rad = gentle_wrist(rng, progress)
        wrist_rad[:, 3] += scene.jaw_opening_rad(progress * duration_s, number)
        with InstrumentClearance(scene, other) as between:
            for lift_m in LIFTS_M:
                z_m = other.working_height_m + float(lift_m) + rise_m
                target_m = np.column_stack([wanted_m * ((camera_m - z_m) / depth_m)[:, None], z_m])
                try:
                    path = _joints(other, target_m, wrist_rad)
                except KinematicsError as problem:
                    raise SimulationError(f"the second instrument: {problem}") from None
                if all(between.clearance_m(q[at], path[at]) >= APART_M for at in checked):
                    break
            else:
                apart = f"keep {APART_M * 1e3:g} mm away from the first one"
                raise SimulationError(f"a second instrument cannot {apart} on this path")
        arms.append((name, other, path))
    return arms


def _offsets(rng: np.random.Generator, progress: Array, duration_s: float, base_m: Array) -> Array:
    """From the first instrument to the one with its base at (2,), shape (n, 2) in m: to and fro, through zero."""
    # The turning points lie on the base's side, left and right of it by turns: its jaws stay off the first one's shaft.
    bearing, side = float(np.arctan2(base_m[1], base_m[0])), 1.0 if rng.integers(2) else -1.0
    knots: list[Array] = []
    for index in range(max(1, round(duration_s / CROSSING_PERIOD_S)) + 1):
        if knots:
            knots.append(rng.uniform(-0.0012, 0.0012, 2))  # within a marker's radius
        angle = bearing + side * (-1.0) ** index * rng.uniform(0.6, 1.25)
        knots.append(rng.uniform(0.018, 0.030) * np.array([np.cos(angle), np.sin(angle)]))
    return cubic_spline(np.array(knots), progress)
