"""Joint trajectories of a recording's arms, by inverse kinematics.

The first arm follows its scenario, with clearances met exactly. A second one crosses it in the image, and stays above
it, so that the bodies keep apart while their pictures cross.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from svmdist.errors import KinematicsError, SimulationError
from svmdist.kinematics import forward_kinematics, solve_position
from svmdist.perturbations.chosen import UNPERTURBED
from svmdist.profile import Profile
from svmdist.simulation.clearance import InstrumentClearance, TissueClearance
from svmdist.simulation.scenarios import (
    Motion,
    Scenario,
    Stage,
    cubic_spline,
    gentle_wrist,
    plan_motion,
    wander,
)
from svmdist.simulation.scene import Options, Scene, make_scene
from svmdist.transforms import Array, inverse, make_transform, rotation_z, transform_points

RETRACTOR_HEIGHT_M = 0.06
CLEARANCE_TOLERANCE_M = 1e-6

APART_M = 0.003
"""The bodies of two instruments keep this far apart."""
LIFTS_M = np.arange(0.010, 0.0361, 0.002)
"""Heights above the first instrument's working height: the lowest that keeps the bodies apart is taken."""
CHECKED_COUNT = 120
FIELD_M = (0.040, 0.029)
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
    wanted_m = np.stack([_kept_within(seen_m[:, k] + offset_m[:, k], FIELD_M[k]) for k in range(2)], -1)
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
