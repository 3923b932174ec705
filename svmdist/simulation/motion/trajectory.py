"""From a motion of the tool to joint trajectories, by inverse kinematics, with clearances met exactly."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass, replace

import numpy as np

from svmdist.errors import KinematicsError, SimulationError
from svmdist.kinematics.inverse import solve_position
from svmdist.simulation.clearance.meters import ClearanceMeter
from svmdist.simulation.motion.scenarios import Motion, Scenario, Stage, plan_motion
from svmdist.simulation.room.jaw import untold_opening_rad
from svmdist.simulation.room.tissue_motion import tissue_rise_m
from svmdist.simulation.scene import Scene
from svmdist.transforms import Array, inverse, make_transform, rotation_z, transform_points

RETRACTOR_HEIGHT_M = 0.06
CLEARANCE_TOLERANCE_M = 1e-6


@dataclass(frozen=True)
class Trajectory:
    """Exact joints, shape (n, n_joints), and the retractor's poses (n, 4, 4), or None where there is none."""

    q: Array
    T_world_retractor: Array | None


def make_trajectory(
    scene: Scene,
    scenario: Scenario,
    working_height_m: float,
    progress: Array,
    meter: ClearanceMeter | None = None,
) -> Trajectory:
    """Plan a scenario in a scene at values of progress, shape (n,); raises SimulationError out of reach.

    Paths that end at a clearance are measured with the meter, or with one of their own. Where tissue moves, they go
    with it as they come near, and end at about that clearance whenever they do.
    """
    stage = Stage(scene.T_world_tissue[:2, 3], scene.organ.height_m, working_height_m, scenario.duration_s)
    motion = _with_jaw(scene, scenario, progress, plan_motion(scenario, progress, stage))
    try:
        if motion.clearance_m is not None:
            at = np.array([motion.lowest_at])
            lowest = _with_jaw(scene, scenario, at, plan_motion(scenario, at, stage))
            with nullcontext(meter) if meter is not None else ClearanceMeter(scene) as its_meter:
                motion = _lowered(motion, _lowering_m(scene, lowest, its_meter) + _pressed_m(scene, motion))
            if scene.room.moves_tissue:
                motion = _carried(scene, motion, scenario, progress)
        q = _joints(scene, motion)
    except KinematicsError as problem:
        raise SimulationError(f"scenario {scenario.name}: {problem}") from None
    return Trajectory(q, _retractor_poses(motion))


def _with_jaw(scene: Scene, scenario: Scenario, progress: Array, motion: Motion) -> Motion:
    """The motion with what the jaws open beyond it."""
    if not scene.room.jaw:
        return motion
    wrist_rad = motion.wrist_rad.copy()
    wrist_rad[:, 3] += untold_opening_rad(scene.room, scenario.seed, progress * scenario.duration_s)
    return replace(motion, wrist_rad=wrist_rad)


def _carried(scene: Scene, motion: Motion, scenario: Scenario, progress: Array) -> Motion:
    """The motion, carried by the tissue as far as it is lowered to it: a surgeon's hand follows what it works on."""
    assert motion.lowering is not None
    rise_m = tissue_rise_m(scene.room, scenario.seed, progress * scenario.duration_s)
    p_m = motion.p_world_tool_m.copy()
    p_m[:, 2] += rise_m * motion.lowering
    return replace(motion, p_world_tool_m=p_m)


def _joints(scene: Scene, motion: Motion) -> Array:
    names = scene.chain.joint_names
    q = np.tile(scene.posture, (len(motion.p_world_tool_m), 1))
    q[:, -4:] += motion.wrist_rad
    targets_m = transform_points(inverse(scene.T_world_base), motion.p_world_tool_m)
    # Seven distal joints, as in every PSM: yaw, pitch and insertion place the wrist.
    return solve_position(scene.chain, q, targets_m, names[-7:-4])


def _lowering_m(scene: Scene, lowest: Motion, meter: ClearanceMeter) -> float:
    """Find by bisection how far to lower the path for the wanted clearance at its lowest point."""
    assert lowest.clearance_m is not None
    low, high = -0.01, 0.03
    while high - low > CLEARANCE_TOLERANCE_M:
        middle = 0.5 * (low + high)
        clearance_m = meter.clearance_m(_joints(scene, _lowered(lowest, middle))[0])
        low, high = (middle, high) if clearance_m > lowest.clearance_m else (low, middle)
    return 0.5 * (low + high)


def _pressed_m(scene: Scene, motion: Motion) -> float:
    """How much deeper a path goes that touches the tissue, where this gives way."""
    assert motion.clearance_m is not None
    return 1e-3 * scene.room.dent if motion.clearance_m < 0.0 else 0.0


def _lowered(motion: Motion, by_m: float) -> Motion:
    assert motion.lowering is not None
    p_m = motion.p_world_tool_m.copy()
    p_m[:, 2] -= by_m * motion.lowering
    return Motion(p_m, motion.wrist_rad, motion.retractor_xy_m, motion.clearance_m, motion.lowering)


def _retractor_poses(motion: Motion) -> Array | None:
    if motion.retractor_xy_m is None:
        return None
    count = len(motion.retractor_xy_m)
    xyz_m = np.column_stack([motion.retractor_xy_m, np.full(count, RETRACTOR_HEIGHT_M)])
    # The blade's tip points to -y: it comes in from the top of the image.
    return make_transform(rotation_z(np.pi / 2), xyz_m)
