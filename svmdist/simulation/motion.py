"""What the instruments do: scenarios as smooth paths, and the joint trajectories that follow them.

A path is a function of progress, 0 at the start of a recording and 1 at its end, so that every figure is complete
whatever the duration. The seed varies phases, positions and frequencies; all curves are twice continuously
differentiable. A second arm crosses the first one in the image and stays above it, so that the bodies keep apart.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from svmdist.errors import KinematicsError, SimulationError, UsageError
from svmdist.kinematics import forward_kinematics, solve_position
from svmdist.perturbations.chosen import UNPERTURBED
from svmdist.profile import Profile
from svmdist.simulation.clearance import InstrumentClearance, TissueClearance
from svmdist.simulation.scene import Options, Scene, make_scene
from svmdist.transforms import Array, inverse, make_transform, rotation_z, transform_points


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


RETRACTOR_HEIGHT_M = 0.06
CLEARANCE_TOLERANCE_M = 1e-6

APART_M = 0.003
"""The bodies of two instruments keep this far apart."""
LIFTS_M = np.arange(0.010, 0.0361, 0.002)
"""Heights above the first instrument's working height: the lowest that keeps the bodies apart is taken."""
CHECKED_COUNT = 120
CROSSING_FIELD_M = (0.040, 0.029)
"""Half of where the distal marker may be, seen in the first instrument's working plane: inside of the image."""
CROSSING_PERIOD_S = 2.7
"""Between two crossings, on average: an 8 s recording has three of them."""
_PATH_STREAM = 16


def make_trajectory(
    scene: Scene, scenario: Scenario, working_height_m: float, progress: Array
) -> tuple[Array, Array | None]:
    """Plan a scenario in a scene at values of progress, shape (n,); raises SimulationError out of reach.

    Gives exact joints, shape (n, n_joints), and the retractor's poses (n, 4, 4), or None without one. Where tissue
    moves, paths that end at a clearance move with it as they come near, as a surgeon's hand does.
    """
    stage = Stage(scene.T_world_tissue[:2, 3], scene.organ.height_m, working_height_m, scenario.duration_s)
    motion = plan_motion(scenario, progress, stage)
    motion.wrist_rad[:, 3] += scene.jaw_opening_rad(progress * scenario.duration_s)
    try:
        if motion.clearance_m is not None:
            lowering_m = _lowering_m(scene, scenario, stage, motion.lowest_at)
            if motion.clearance_m < 0.0:  # soft tissue gives way to a path that touches it
                lowering_m += 1e-3 * scene.perturbations["dent"]
            motion = _lowered(motion, lowering_m)
            if scene.moves_tissue:
                motion = _lowered(motion, -scene.tissue_offset_m(progress * scenario.duration_s))
        q = _joints(scene, motion)
    except KinematicsError as problem:
        raise SimulationError(f"scenario {scenario.name}: {problem}") from None
    T_world_retractor = None
    if motion.retractor_xy_m is not None:
        count = len(motion.retractor_xy_m)
        xyz_m = np.column_stack([motion.retractor_xy_m, np.full(count, RETRACTOR_HEIGHT_M)])
        # The blade's tip points to -y: it comes in from the top of the image.
        T_world_retractor = make_transform(rotation_z(np.pi / 2), xyz_m)
    return q, T_world_retractor


def _joints(scene: Scene, motion: Motion) -> Array:
    names = scene.chain.joint_names
    q = np.tile(scene.posture, (len(motion.p_world_tool_m), 1))
    q[:, -4:] += motion.wrist_rad
    targets_m = transform_points(inverse(scene.T_world_base), motion.p_world_tool_m)
    # Seven distal joints, as in every PSM: yaw, pitch and insertion place the wrist.
    return solve_position(scene.chain, q, targets_m, names[-7:-4])


def _lowering_m(scene: Scene, scenario: Scenario, stage: Stage, lowest_at: float) -> float:
    """Find by bisection how far to lower the path for the wanted clearance at its lowest point."""
    at = np.array([lowest_at])
    lowest = plan_motion(scenario, at, stage)
    lowest.wrist_rad[:, 3] += scene.jaw_opening_rad(at * scenario.duration_s)
    assert lowest.clearance_m is not None
    tissue = TissueClearance([replace(scene, perturbations=UNPERTURBED)])  # which does not give way
    low, high = -0.01, 0.03
    while high - low > CLEARANCE_TOLERANCE_M:
        middle = 0.5 * (low + high)
        (clearance_m,) = tissue.clearances_m([_joints(scene, _lowered(lowest, middle))[0]])
        low, high = (middle, high) if clearance_m > lowest.clearance_m else (low, middle)
    return 0.5 * (low + high)


def _lowered(motion: Motion, by_m: float | Array) -> Motion:
    """The motion with its path lowered by a length, or by one at each time, shape (n,)."""
    assert motion.lowering is not None
    p_m = motion.p_world_tool_m.copy()
    p_m[:, 2] -= by_m * motion.lowering
    return replace(motion, p_world_tool_m=p_m)


def make_other_arms(
    profile: Profile, scene: Scene, options: Options, q: Array, progress: Array, duration_s: float
) -> list[tuple[str, Scene, Array]]:
    """Set up the further arms of a recording in which the first one moves by `q`, shape (n, n_joints).

    Gives the name, the scene as it sees it and the exact joints, shape (n, n_joints), of each. Raises SimulationError
    where the profile places fewer arms, or the bodies cannot keep apart.
    """
    count = options.arms - 1
    placed = [other.name for other in profile.other_instruments if other.simulation is not None]
    if count > len(placed):
        raise SimulationError(
            f"profile {profile.name} places {1 + len(placed)} of {options.arms} arms: it needs"
            " [[other_instruments]] with [other_instruments.simulation] for each further one"
        )
    arms = []
    for index, name in enumerate(placed[:count], start=1):
        view = profile.for_instrument(name)
        other = make_scene(view, scene.seed, options)
        other = replace(other, organ=scene.organ, T_world_tissue=scene.T_world_tissue)
        settings = view.simulation
        assert settings is not None  # the scene has checked it
        rng = np.random.default_rng([scene.seed, _PATH_STREAM, index])
        # The shaft comes in from there, as an angle in the world's xy plane.
        bearing = float(np.arctan2(other.T_world_base[1, 3], other.T_world_base[0, 3]))
        offset_m = _offsets(rng, progress, duration_s, bearing)
        rise_m = 0.001 * wander(rng, progress, 2.0)
        wrist_rad = gentle_wrist(rng, progress)
        wrist_rad[:, 3] += scene.jaw_opening_rad(progress * duration_s, index)
        path = _crossing(scene, other, settings.working_height_m, q, offset_m, rise_m, wrist_rad)
        arms.append((name, other, path))
    return arms


def _crossing(
    scene: Scene, other: Scene, plane_m: float, q: Array, offset_m: Array, rise_m: Array, wrist_rad: Array
) -> Array:
    """Joints, shape (n, n_joints), on the lowest path that keeps away from the first instrument at `q`.

    Seen through the working plane at `plane_m`, the path is `offset_m`, shape (n, 2), from the first instrument;
    `rise_m`, shape (n,), varies its height.
    """
    camera_height_m = float(scene.T_world_camera[2, 3])
    p_world_m = (scene.T_world_base @ forward_kinematics(scene.chain, q))[:, :3, 3]
    depth_m = camera_height_m - plane_m
    seen_m = p_world_m[:, :2] * (depth_m / (camera_height_m - p_world_m[:, 2:]))
    wanted_m = np.stack(
        [_kept_within(seen_m[:, k] + offset_m[:, k], CROSSING_FIELD_M[k]) for k in range(2)], -1
    )
    checked = np.unique(np.linspace(0, len(q) - 1, CHECKED_COUNT).astype(int))
    with InstrumentClearance(scene, other) as between:
        for lift_m in LIFTS_M:
            z_m = plane_m + float(lift_m) + rise_m
            target_m = np.column_stack([wanted_m * ((camera_height_m - z_m) / depth_m)[:, None], z_m])
            try:
                path = _joints(other, Motion(target_m, wrist_rad))
            except KinematicsError as problem:
                raise SimulationError(f"the second instrument: {problem}") from None
            if all(between.clearance_m(q[at], path[at]) >= APART_M for at in checked):
                return path
    raise SimulationError(
        f"a second instrument cannot keep {APART_M * 1e3:g} mm away from the first one on this path"
    )


def _offsets(rng: np.random.Generator, progress: Array, duration_s: float, bearing: float) -> Array:
    """From the first instrument to the other one, shape (n, 2) in m: to and fro, through zero between.

    The turning points lie on the side that the other instrument comes from, some to the left of it and some to
    the right, so that its jaws stay off the first one's shaft.
    """
    crossing_count = max(1, round(duration_s / CROSSING_PERIOD_S))
    side = 1.0 if rng.integers(2) else -1.0
    knots = []
    for index in range(crossing_count + 1):
        turn = side * (-1.0) ** index * rng.uniform(0.6, 1.25)
        radius_m = rng.uniform(0.018, 0.030)
        knots.append(radius_m * np.array([np.cos(bearing + turn), np.sin(bearing + turn)]))
        if index < crossing_count:
            knots.append(rng.uniform(-0.0012, 0.0012, 2))  # within a marker's radius
    return cubic_spline(np.array(knots), progress)


def _kept_within(x_m: Array, half_m: float) -> Array:
    """The same inside of 70 % of a range, bent smoothly to stay within it outside."""
    free_m = 0.7 * half_m
    rest_m = half_m - free_m
    beyond_m = np.maximum(np.abs(x_m) - free_m, 0.0)
    return np.asarray(np.sign(x_m) * (np.minimum(np.abs(x_m), free_m) + rest_m * np.tanh(beyond_m / rest_m)))
