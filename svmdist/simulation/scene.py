"""The world of one seed and its options: pure geometry, without PyBullet.

World: z up, floor at z = 0, the camera on the z axis looking straight down.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from svmdist.camera import Camera
from svmdist.errors import SimulationError
from svmdist.kinematics import DHChain, chain_of, frame_transforms, row_index
from svmdist.perturbations import UNPERTURBED, Perturbations, World
from svmdist.perturbations.apply import plane_tilt, right_turn, zoomed_camera
from svmdist.profile import Profile
from svmdist.simulation.effects import DISTORTION
from svmdist.simulation.meshes import Part, make_parts, make_plate
from svmdist.simulation.organ import Organ, make_organ
from svmdist.transforms import Array, inverse, make_transform, rotation_z
from svmdist.vision.degradations import require_degradation

TISSUE_SHIFT_M = 0.0015  # by seed, the organ stands this far from the camera's axis at most, along x and along y
BREATHING_HZ, PULSE_HZ, JAW_HZ = 0.25, 1.2, 0.3  # 15 breaths a minute, as a ventilator is set; 72 beats a minute
_MOTION_STREAM, _JAW_STREAM = 101, 104


@dataclass(frozen=True)
class Options:
    """Options of a simulation; the defaults are the plain one."""

    stereo: bool = False  # adds the right camera
    tag: bool = False  # mounts the profile's fiducial plate
    kinematic_error: float = 0.0  # scales the error of the nominal kinematics: 0 none, 1 as the profile states
    degradations: tuple[tuple[str, int], ...] = ()  # (name, severity), in order, behind the sensor's noise
    arms: int = 1
    perturbations: Perturbations = UNPERTURBED  # sampled for the world
    world: World = World.IDEAL
    noise: float = 0.0  # the sensor's, a standard deviation in 8-bit levels

    def __post_init__(self) -> None:
        for name, severity in self.degradations:
            require_degradation(name, severity)

    def metadata(self) -> dict[str, str]:
        """What is set beside noise, for a recording's metadata; empty for a plain recording."""
        named = {
            "stereo": "yes" if self.stereo else "",
            "tag": "yes" if self.tag else "",
            "kinematic_error": f"{self.kinematic_error:g}" if self.kinematic_error else "",
            "arms": str(self.arms) if self.arms > 1 else "",
            "degrade": ",".join(f"{name}={severity}" for name, severity in self.degradations),
            "world": "" if self.world is World.IDEAL else self.world.value,
            "perturb": str(self.perturbations),
        }
        return {name: value for name, value in named.items() if value}


PLAIN = Options()


@dataclass(frozen=True, eq=False)
class Scene:
    """The world of one seed: the chain and where its base, the camera and the tissue stand."""

    chain: DHChain
    posture: Array
    camera: Camera  # as the calibration states it
    T_world_base: Array
    T_world_camera: Array
    T_world_tissue: Array
    organ: Organ
    parts: tuple[Part, ...]
    baseline_m: float
    working_height_m: float  # of the tool's origin above the floor
    perturbations: Perturbations
    seed: int

    @property
    def right_camera(self) -> Camera:
        """The right camera of a rectified pair as intended: the left one's intrinsics, and the baseline in P."""
        P = np.hstack([self.camera.K, np.zeros((3, 1))])
        P[0, 3] = -self.camera.K[0, 0] * self.baseline_m
        return replace(self.camera, P=P, frame_id=f"{self.camera.frame_id}_right")

    @property
    def T_camera_right(self) -> Array:
        """The true pose of the right camera, shape (4, 4)."""
        return make_transform(right_turn(self.perturbations), [self.baseline_m, 0.0, 0.0])

    @property
    def T_camera_base(self) -> Array:
        """The true pose of the base, shape (4, 4)."""
        return inverse(self.T_world_camera) @ self.T_world_base

    def T_camera_tissue(self, offset_m: float = 0.0) -> Array:
        """The pose of the tissue, raised by an offset from rest, shape (4, 4)."""
        return inverse(self.T_world_camera) @ raised(offset_m) @ self.T_world_tissue

    def part_poses(self, q: Array) -> Array:
        """Poses `T_world_part`, shape (n_parts, 4, 4), for joints (n_joints,)."""
        T_world_link = self.T_world_base @ frame_transforms(self.chain, q)
        return np.stack([T_world_link[row_index(self.chain, part.link)] @ part.T_link_part for part in self.parts])

    def tissue_offset_m(self, t_s: Array) -> Array:
        """How far tissue and floor stand above their place at rest, shape (n,), at times since the start, (n,)."""
        phases = np.random.default_rng([self.seed, _MOTION_STREAM]).uniform(0.0, 2.0 * np.pi, 2)
        breath_mm = self.perturbations["breathing"] * np.sin(2.0 * np.pi * BREATHING_HZ * t_s + phases[0])
        pulse_mm = self.perturbations["pulse"] * np.sin(2.0 * np.pi * PULSE_HZ * t_s + phases[1])
        return np.asarray(1e-3 * (breath_mm + pulse_mm), np.float64)

    def jaw_opening_rad(self, t_s: Array, arm: int = 0) -> Array:
        """Unreported opening of an arm's jaws, as cables stretch, shape (n,), at times since the start, shape (n,)."""
        phase = np.random.default_rng([self.seed, _JAW_STREAM, arm]).uniform(0.0, 2.0 * np.pi)
        wave = 0.5 - 0.5 * np.cos(2.0 * np.pi * JAW_HZ * t_s + phase)
        return np.asarray(np.deg2rad(self.perturbations["jaw"]) * wave * wave)


def make_scene(profile: Profile, seed: int, options: Options = PLAIN) -> Scene:
    """Set up the world of a seed; raises SimulationError for a profile that describes no such simulation."""
    perturbations, cannot = options.perturbations, f"profile {profile.name} cannot be simulated"
    if profile.robot is None or profile.instrument is None or profile.simulation is None:
        raise SimulationError(f"{cannot}: it needs [robot], [instrument] and [simulation]")
    chain, settings = chain_of(profile.robot), profile.simulation
    if missing := ", ".join(name for name in chain.joint_names if name not in settings.posture):
        raise SimulationError(f"{cannot}: simulation.posture lacks {missing}")
    if len(chain.rows) < 4:
        raise SimulationError(f"{cannot}: an instrument needs four joints")
    if options.tag and profile.fiducial is None:
        raise SimulationError(f"profile {profile.name} has no tag to mount: it needs [fiducial]")
    # One stream for each thing, so that one of them can change without moving the others.
    place, shape = (np.random.default_rng([seed, stream]) for stream in range(2))
    R_world_tissue = rotation_z(place.uniform(-np.pi, np.pi))
    tissue_m = [*place.uniform(-TISSUE_SHIFT_M, TISSUE_SHIFT_M, 2), 0.0]
    view = settings.width_px, settings.height_px, settings.horizontal_fov_rad, profile.frames.camera
    camera = zoomed_camera(Camera.from_horizontal_fov(*view), perturbations["zoom"])
    D = perturbations["lens"] * DISTORTION
    # In these axes the floor's normal is the nominal one, rotated back; the floor's origin is on the optical axis.
    R = np.diag([1.0, -1.0, -1.0]) @ plane_tilt(perturbations, seed)
    parts = make_parts(profile.instrument, chain, perturbations)
    return Scene(
        chain=chain,
        posture=np.array([settings.posture[name] for name in chain.joint_names]),
        camera=replace(camera, D=D) if D.any() else camera,
        T_world_base=make_transform(rotation_z(settings.base_yaw_rad), settings.base_position_m),
        T_world_camera=make_transform(R, settings.camera_height_m / R[2, 2] * R[:, 2]),
        T_world_tissue=make_transform(R_world_tissue, tissue_m),
        organ=make_organ(shape, seed, perturbations),
        parts=(*parts, make_plate(profile.fiducial)) if options.tag and profile.fiducial else parts,
        baseline_m=settings.stereo_baseline_m,
        working_height_m=settings.working_height_m,
        perturbations=perturbations,
        seed=seed,
    )


def raised(offset_m: float) -> Array:
    """A shift of the world along the floor's normal, shape (4, 4)."""
    return make_transform(np.eye(3), [0.0, 0.0, offset_m])
