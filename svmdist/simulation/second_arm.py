"""The further arms of a recording: their scenes, and a path each that crosses the first instrument in the image.

The other instrument stays above the first one, so that the bodies keep apart while their pictures cross.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from svmdist.errors import KinematicsError, SimulationError
from svmdist.kinematics.dh import forward_kinematics
from svmdist.kinematics.inverse import solve_position
from svmdist.profile import Profile
from svmdist.simulation.clearance.meters import BetweenMeter
from svmdist.simulation.extras import Extras
from svmdist.simulation.motion.paths import cubic_spline, wander
from svmdist.simulation.room.jaw import untold_opening_rad
from svmdist.simulation.scene import Scene, make_scene
from svmdist.transforms import Array, inverse, transform_points

CLEARANCE_M = 0.003
"""The bodies of two instruments keep this far apart."""
LIFTS_M = np.arange(0.010, 0.0361, 0.002)
"""How far above the first instrument's working height: the lowest that keeps the bodies apart is taken."""
CHECKED_COUNT = 120
FIELD_M = (0.040, 0.029)
"""Half of where the distal marker may be, seen in the first instrument's working plane: inside of the image."""
CROSSING_PERIOD_S = 2.7
"""Between two crossings, on average: an 8 s recording has three of them."""
_PATH_STREAM = 16


@dataclass(frozen=True)
class OtherArm:
    """One further arm: its name, the profile and the scene as it sees them, and its exact joints (n, n_joints)."""

    name: str
    profile: Profile
    scene: Scene
    q: Array


def make_other_arms(
    profile: Profile, scene: Scene, seed: int, extras: Extras, q: Array, progress: Array, duration_s: float
) -> tuple[OtherArm, ...]:
    """Set up the further arms of a recording in which the first one moves by `q`, shape (n, n_joints).

    Raises SimulationError where the profile places fewer arms, or the bodies cannot keep apart.
    """
    count = extras.arms - 1
    placed = [other.name for other in profile.other_instruments if other.simulation is not None]
    if count > len(placed):
        raise SimulationError(
            f"profile {profile.name} places {1 + len(placed)} of {extras.arms} arms: it needs"
            " [[other_instruments]] with [other_instruments.simulation] for each further one"
        )
    arms = []
    for index, name in enumerate(placed[:count], start=1):
        view = profile.for_instrument(name)
        other = replace(
            make_scene(view, seed, extras), organ=scene.organ, T_world_tissue=scene.T_world_tissue
        )
        settings = view.simulation
        assert settings is not None  # the scene has checked it
        rng = np.random.default_rng([seed, _PATH_STREAM, index])
        path = _Path(scene, other, settings.working_height_m, rng, progress, duration_s)
        if scene.room.jaw:
            path.open_jaws(untold_opening_rad(scene.room, seed, progress * duration_s, index))
        arms.append(OtherArm(name, view, other, path.joints(q)))
    return tuple(arms)


class _Path:
    """The path of one further instrument, relative to the first one in the image."""

    def __init__(
        self,
        scene: Scene,
        other: Scene,
        working_height_m: float,
        rng: np.random.Generator,
        progress: Array,
        duration_s: float,
    ) -> None:
        self._scene, self._other = scene, other
        self._height_m = working_height_m
        self._offset_m = _offsets(rng, progress, duration_s, _bearing(other))
        self._rise = 0.001 * wander(rng, progress, 2.0)
        amplitudes = (0.15, 0.12, 0.08, 0.12)
        self._wrist = np.stack([amplitude * wander(rng, progress) for amplitude in amplitudes], -1)

    def open_jaws(self, opening_rad: Array) -> None:
        """Open the jaws further, by shape (n,)."""
        self._wrist[:, 3] += opening_rad

    def joints(self, q: Array) -> Array:
        """Joints, shape (n, n_joints), on the lowest path that keeps away from the first instrument at `q`."""
        checked = np.unique(np.linspace(0, len(q) - 1, CHECKED_COUNT).astype(int))
        with BetweenMeter(self._scene, self._other) as meter:
            for lift_m in LIFTS_M:
                path = self._solve(q, float(lift_m))
                if (meter.clearances_m(q[checked], path[checked]) >= CLEARANCE_M).all():
                    return path
        raise SimulationError(
            f"a second instrument cannot keep {CLEARANCE_M * 1e3:g} mm away from the first one on this path"
        )

    def _solve(self, q: Array, lift_m: float) -> Array:
        camera_height_m = float(self._scene.T_world_camera[2, 3])
        T_base_tool = forward_kinematics(self._scene.chain, q)
        p_world_m = (self._scene.T_world_base @ T_base_tool)[:, :3, 3]
        # As seen through the working plane: where the first instrument is, and the other one beside it.
        depth_m = camera_height_m - self._height_m
        seen_m = p_world_m[:, :2] * (depth_m / (camera_height_m - p_world_m[:, 2:]))
        wanted_m = np.stack(
            [_kept_within(seen_m[:, k] + self._offset_m[:, k], FIELD_M[k]) for k in range(2)], -1
        )
        z_m = self._height_m + lift_m + self._rise
        target_m = np.column_stack([wanted_m * ((camera_height_m - z_m) / depth_m)[:, None], z_m])
        start = np.tile(self._other.posture, (len(q), 1))
        start[:, -4:] += self._wrist
        targets_m = transform_points(inverse(self._other.T_world_base), target_m)
        try:
            return solve_position(self._other.chain, start, targets_m, self._other.chain.joint_names[-7:-4])
        except KinematicsError as problem:
            raise SimulationError(f"the second instrument: {problem}") from None


def _bearing(scene: Scene) -> float:
    """From where the shaft comes in, as an angle in the world's xy plane, in rad."""
    base_m = scene.T_world_base[:2, 3]
    return float(np.arctan2(base_m[1], base_m[0]))


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
