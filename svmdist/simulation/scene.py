"""Where everything stands for one seed: pure geometry, without PyBullet.

World: z up, floor at z = 0, the camera on the z axis looking straight down.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from svmdist.camera import Camera
from svmdist.errors import SimulationError
from svmdist.kinematics.dh import DHChain, chain_of, frame_transforms
from svmdist.perturbations.calibration import right_turn, zoomed_camera
from svmdist.perturbations.shape import plane_tilt
from svmdist.profile import Profile
from svmdist.samples import Image
from svmdist.simulation.bodies.instrument import Paint, Part, make_parts
from svmdist.simulation.bodies.meshes import DrawnMesh, loft, smooth_normals
from svmdist.simulation.bodies.organ import SEMI_AXES_M, Organ, make_organ
from svmdist.simulation.bodies.plate import Plate, make_plate
from svmdist.simulation.bodies.relief import make_relief
from svmdist.simulation.bodies.textures import fine_tissue_texture, floor_texture, tissue_texture
from svmdist.simulation.bodies.tissue_shape import TissueShape, make_tissue_shape
from svmdist.simulation.extras import Extras
from svmdist.simulation.room.lens import Lens, coefficients
from svmdist.simulation.room.settings import IDEAL, Room
from svmdist.transforms import Array, inverse, make_transform, rotation_z

FLOOR_HALF_M = 0.16
TISSUE_SHIFT_M = 0.0015
"""By seed, the organ stands this far from the camera's axis at most, along x and along y."""

RELIEF_STREAMS = (18, 19)
"""Of the surface and of its texture, apart from all others, so that relief moves nothing else."""
SHAPE_STREAM = 102

R_WORLD_CAMERA: Array = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class Scene:
    """The world of one seed: the chain and where its base, the camera and the tissue stand.

    `camera` is what the calibration tells. The lens has the `distortion`, OpenCV's coefficients, shape (5,).
    """

    chain: DHChain
    posture: Array
    camera: Camera
    T_world_base: Array
    T_world_camera: Array
    T_world_tissue: Array
    organ: Organ
    parts: tuple[Part, ...]
    retractor: DrawnMesh
    tissue_texture: Image
    floor_texture: Image
    baseline_m: float
    R_camera_right: Array
    plate: Plate | None = None
    room: Room = IDEAL
    distortion: Array = field(default_factory=lambda: np.zeros(5))

    @cached_property
    def lens(self) -> Lens | None:
        """What both cameras look through; None for a pinhole."""
        return Lens.of(self.camera, self.distortion) if self.distortion.any() else None

    @property
    def drawn_camera(self) -> Camera:
        """The pinhole camera whose images are drawn: wider than the real one where the lens needs it."""
        return self.camera if self.lens is None else self.lens.wide

    @property
    def right_camera(self) -> Camera:
        """The right camera of a rectified pair, as it is meant: the left one's intrinsics, and the baseline in P."""
        P = np.hstack([self.camera.K, np.zeros((3, 1))])
        P[0, 3] = -self.camera.K[0, 0] * self.baseline_m
        return replace(self.camera, P=P, frame_id=f"{self.camera.frame_id}_right")

    @property
    def T_camera_right(self) -> Array:
        """Where the right camera stands for the left one, shape (4, 4)."""
        return make_transform(self.R_camera_right, [self.baseline_m, 0.0, 0.0])

    @property
    def T_camera_base(self) -> Array:
        """Where the base stands for the camera, shape (4, 4)."""
        return inverse(self.T_world_camera) @ self.T_world_base

    @property
    def T_camera_tissue(self) -> Array:
        """Where the tissue stands for the camera, shape (4, 4)."""
        return inverse(self.T_world_camera) @ self.T_world_tissue

    def T_camera_risen_tissue(self, rise_m: float) -> Array:
        """Where the tissue stands for the camera, shape (4, 4), after it and the floor have risen."""
        return inverse(self.T_world_camera) @ risen(rise_m) @ self.T_world_tissue

    def link_poses(self, q: Array) -> dict[str, Array]:
        """Poses `T_world_link`, shape (..., 4, 4), of all rows by name, for joints (..., n_joints)."""
        frames = self.T_world_base @ frame_transforms(self.chain, q)
        return {row.name: frames[..., index, :, :] for index, row in enumerate(self.chain.rows)}


def make_scene(profile: Profile, seed: int, extras: Extras | None = None) -> Scene:
    """Set up the world of a seed; raises SimulationError for a profile that describes no such simulation."""
    extras = extras or Extras()
    if profile.robot is None or profile.instrument is None or profile.simulation is None:
        raise SimulationError(
            f"profile {profile.name} cannot be simulated: it needs [robot], [instrument] and [simulation]"
        )
    chain, settings = chain_of(profile.robot), profile.simulation
    missing = [name for name in chain.joint_names if name not in settings.posture]
    if missing or len(chain.rows) < 4:
        raise SimulationError(
            f"profile {profile.name} cannot be simulated: simulation.posture lacks {', '.join(missing)}"
            if missing
            else f"profile {profile.name} cannot be simulated: an instrument needs four joints or more"
        )
    if extras.tag and profile.fiducial is None:
        raise SimulationError(f"profile {profile.name} has no tag to mount: it needs [fiducial]")
    # One stream for each thing, so that one of them can change without moving the others.
    place, shape, red, dull = (np.random.default_rng([seed, stream]) for stream in range(4))
    bumps, speckle = (np.random.default_rng([seed, stream]) for stream in RELIEF_STREAMS)
    relief = make_relief(bumps, extras.relief_m, min(SEMI_AXES_M)) if extras.relief_m > 0.0 else None
    colour = tissue_texture(red)
    room = extras.room
    T_world_tissue = make_transform(
        rotation_z(place.uniform(-np.pi, np.pi)),
        [*place.uniform(-TISSUE_SHIFT_M, TISSUE_SHIFT_M, 2), 0.0],
    )
    camera = Camera.from_horizontal_fov(
        settings.width_px, settings.height_px, settings.horizontal_fov_rad, profile.frames.camera
    )
    if (zoom := extras.perturbations["zoom"]) != 1.0:
        camera = zoomed_camera(camera, zoom)
    if room.lens:
        camera = replace(camera, D=coefficients(room.lens))
    return Scene(
        chain=chain,
        posture=np.array([settings.posture[name] for name in chain.joint_names]),
        camera=camera,
        T_world_base=make_transform(rotation_z(settings.base_yaw_rad), settings.base_position_m),
        T_world_camera=_camera_pose(settings.camera_height_m, extras, seed),
        T_world_tissue=T_world_tissue,
        organ=make_organ(shape, relief, _tissue_shape(room, seed), is_soft=room.dent > 0.0),
        parts=make_parts(
            profile.instrument,
            tuple(row.name for row in chain.rows),
            profile.robot.joints[-3].a_m,
            Paint(room.tip, room.shaft_grey, room.shaft_blue, 1e-3 * room.ring),
        ),
        retractor=make_retractor(),
        tissue_texture=colour if relief is None else fine_tissue_texture(speckle, colour, relief),
        floor_texture=floor_texture(dull),
        baseline_m=settings.stereo_baseline_m,
        R_camera_right=right_turn(extras.perturbations),
        plate=make_plate(profile.fiducial) if extras.tag and profile.fiducial is not None else None,
        room=room,
        distortion=coefficients(room.lens + room.lens_untold),
    )


def _camera_pose(height_m: float, extras: Extras, seed: int) -> Array:
    """Where the camera stands, shape (4, 4): so high above the floor, whose origin is on its optical axis."""
    if not extras.perturbations.has("plane_tilt"):
        return make_transform(R_WORLD_CAMERA, [0.0, 0.0, height_m])
    # In these axes the floor's normal is the stated one, turned back.
    R = R_WORLD_CAMERA @ plane_tilt(extras.perturbations, seed)
    return make_transform(R, height_m / R[2, 2] * R[:, 2])


def _tissue_shape(room: Room, seed: int) -> TissueShape | None:
    if not (room.tissue_shape or room.tissue_ellipsoid):
        return None
    rng = np.random.default_rng([seed, SHAPE_STREAM])
    return make_tissue_shape(rng, room.tissue_shape, room.tissue_ellipsoid)


def risen(rise_m: float) -> Array:
    """A rise along the floor's normal as a transform of the world, shape (4, 4)."""
    return make_transform(np.eye(3), [0.0, 0.0, rise_m])


def make_floor() -> DrawnMesh:
    """A flat sheet in the world's frame at z = 0, finely divided for even shading."""
    count = 33
    axis = np.linspace(-FLOOR_HALF_M, FLOOR_HALF_M, count)
    x, y = np.meshgrid(axis, axis)
    vertices_m = np.stack([x.ravel(), y.ravel(), np.zeros(count * count)], -1)
    row, column = np.meshgrid(np.arange(count - 1), np.arange(count - 1), indexing="ij")
    a = (row * count + column).ravel()
    faces = np.concatenate(
        [np.stack([a, a + 1, a + count + 1], -1), np.stack([a, a + count + 1, a + count], -1)]
    )
    uv = 0.5 + vertices_m[:, :2] / (2.0 * FLOOR_HALF_M)
    return DrawnMesh(vertices_m, faces, smooth_normals(vertices_m, faces), uv)


def make_retractor() -> DrawnMesh:
    """A flat steel blade along +x from its tip at the origin; `occlusion` swings it over the instrument."""
    x_m = np.array([0.0, 0.0008, 0.002, 0.004, 0.008, 0.09])
    return loft(
        x_m,
        np.array([0.0035, 0.0052, 0.0062, 0.0068, 0.007, 0.007]),
        np.array([0.0006, 0.0007, 0.0008, 0.0008, 0.0008, 0.0008]),
        roundness=3.0,
    )
