"""Perturbations applied: to what a robot reports of its joints, to cameras and images, and to nominal parameters.

The reported joints are perturbed, not the true ones: images and truth stay, as an existing log demands. With backlash
the motor is ahead of the joint, to where it moves, and the reported joint is the true one plus that lead. It is a play
operator (Krasnosel'skii & Pokrovskii, Systems with Hysteresis, 1989): the lead changes over a travel of twice the
backlash, as in a cable that gives way, so that noise in a logged joint makes no jumps. Nominal parameters, the cameras'
in a log and the instrument's, tag's and plane's in a profile, are the true ones, times or plus the strength.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from svmdist.camera import Camera
from svmdist.errors import ProfileError, UsageError
from svmdist.kinematics import chain_of
from svmdist.perturbations import PATH_STREAM, Perturbations, Place, direction, random_stream
from svmdist.profile import Profile
from svmdist.profile.robot import OtherInstrument
from svmdist.profile.toml import StrictModel
from svmdist.samples import Image, RightView
from svmdist.transforms import Array, Stamps, rotation_of
from svmdist.vision.degradations import dimmed, subsampled

METRES_PER_DEG = 1e-4  # of a joint that slides: a cable drum of 12 mm across moves so far in a degree
PROXIMAL_SHARE = 0.5  # backlash of yaw, pitch, insertion and roll, which have shorter cables, over that of the wrist
DRIFT_S = 8.0  # the strength is the deviation of how far a joint drifts in so long
DRIFT_PERIODS_S = np.array([16.0, 24.0, 36.0, 54.0])  # slower than a task, and too many to look like a sine
TURN_DEG_PER_MM = 4.0  # rotation of a tag that is glued on a millimetre off: a plate of 9 mm that lies on one edge

Model = TypeVar("Model", bound=StrictModel)


def late_stamps_ns(stamps_ns: ArrayLike, perturbations: Perturbations, start_ns: int) -> NDArray[np.int64]:
    """The stamps that joints get which were true at `stamps_ns`, any shape; the lag drifts from `start_ns` on."""
    stamps = np.asarray(stamps_ns, np.int64)
    late_ns = 1e6 * perturbations["lag"] + 1e-3 * perturbations["lag_drift"] * (stamps - start_ns)
    return np.asarray(stamps + np.rint(late_ns).astype(np.int64))


def reported_late(values: Array, stamps_ns: Stamps, perturbations: Perturbations) -> Array:
    """Values, (n, k), as reported at their stamps, (n,): interpolated, and extrapolated before the first."""
    if len(stamps_ns) < 2 or not perturbations.has("lag", "lag_drift"):
        return values
    start_ns = int(stamps_ns[0])
    true_at = late_stamps_ns(stamps_ns, perturbations, start_ns) - start_ns
    at = stamps_ns - start_ns
    right = np.clip(np.searchsorted(true_at, at, side="left"), 1, len(at) - 1)
    left = right - 1
    weight = (at - true_at[left]) / (true_at[right] - true_at[left])
    return np.asarray(values[left] + weight[:, None] * (values[right] - values[left]))


@dataclass(frozen=True)
class JointUnits:
    """Of the joints of a robot, base first; nothing perturbs the set-up joints, which hold still behind brakes."""

    places: dict[str, int]  # the index of each by its name, and by its aliases
    per_deg: Array  # a degree in a joint's unit, shape (n,)
    backlash_share: Array  # shape (n,)

    @classmethod
    def of(cls, profile: Profile) -> JointUnits:
        """The joints of a profile; raises ProfileError where it has no robot."""
        if profile.robot is None:
            raise ProfileError(f"profile {profile.name} has no [robot]: joints cannot be perturbed")
        chain, first = chain_of(profile.robot), profile.kinematic_error.first_moving_joint
        places = {name: at for at, joint in enumerate(chain.moving_joints) for name in (joint.name, *joint.aliases)}
        per_deg = np.where(chain.is_revolute, np.pi / 180.0, METRES_PER_DEG)
        per_deg[: 0 if first is None else chain.joint_names.index(first)] = 0.0
        # Behind the insertion comes the roll, then the wrist.
        wrist = max(np.flatnonzero(~chain.is_revolute), default=-1) + 2
        return cls(places, per_deg, np.where(np.arange(len(per_deg)) < wrist, PROXIMAL_SHARE, 1.0))


def reported_joints(
    q: Array, stamps_ns: Stamps, units: JointUnits, perturbations: Perturbations, seed: int, arm: int = 0
) -> Array:
    """What an arm reports of joints `q`, shape (n, n_joints) in the order of the robot's, at its stamps, shape (n,)."""
    band = perturbations["backlash"] * units.backlash_share * units.per_deg
    trailing, behind = np.empty_like(q), q[:1]
    for at, row in enumerate(q):
        trailing[at] = behind = np.clip(behind, row - band, row + band)
    reported = q + (q - trailing)
    # A smooth normal process of each joint: 0 at the start, a standard deviation of 1 after 8 s.
    seconds, turns = 1e-9 * (stamps_ns - stamps_ns[:1]), 2.0 * np.pi / DRIFT_PERIODS_S
    waves = random_stream(seed, PATH_STREAM, "joint_drift", arm).normal(0.0, 1.0, (2, q.shape[1], len(turns)))
    drift = sum(
        cosine * (np.cos(turn * seconds) - 1.0)[:, None] + sine * np.sin(turn * seconds)[:, None]
        for turn, (cosine, sine) in zip(turns, waves.transpose(2, 0, 1), strict=True)
    ) / np.sqrt(2.0 * (1.0 - np.cos(turns * DRIFT_S)).sum())
    reported += perturbations["joint_drift"] * units.per_deg * drift
    noise = random_stream(seed, PATH_STREAM, "joint_noise", arm).standard_normal(q.shape)
    reported += perturbations["joint_noise"] * units.per_deg * noise
    step = perturbations["quantisation"] * units.per_deg
    steps = np.divide(reported, step, out=np.zeros_like(q), where=step > 0.0)
    return np.where(step > 0.0, np.rint(steps) * step, reported)


@dataclass(frozen=True)
class ReplayedWorld:
    """A log in a perturbed world; `profile` is the profile as it was read, `seed` that of what is sampled."""

    perturbations: Perturbations
    profile: Profile
    seed: int = 0

    def reported(
        self, instrument: str, names: Sequence[str], stamps_ns: Stamps, positions: Array
    ) -> tuple[Stamps, Array]:
        """The stamps, shape (n,), and joints, shape (n, n_logged), that would be reported for those of a log.

        Before the first one come as many, on the line through the first two, as the lag takes away: the robot moved.
        """
        perturbations = self.perturbations
        if len(stamps_ns) < 2 or not perturbations.changes(Place.JOINTS, Place.CLOCK):
            return stamps_ns, positions
        start_ns, step_ns = int(stamps_ns[0]), int(stamps_ns[1]) - int(stamps_ns[0])
        lag_ns = int(late_stamps_ns(start_ns, perturbations, start_ns)) - start_ns
        before = np.arange(-(-lag_ns // step_ns) if step_ns > 0 and lag_ns > 0 else 0, 0, -1)
        earlier = positions[0] - before[:, None] * (positions[1] - positions[0])
        reported = np.concatenate([earlier, positions])
        at_ns = np.concatenate([start_ns - before * step_ns, stamps_ns])
        late_ns = late_stamps_ns(at_ns, perturbations, start_ns)
        units = JointUnits.of(self.profile.for_instrument(instrument))
        places = np.array([units.places.get(name, -1) for name in names])
        known, q = places >= 0, np.zeros((len(at_ns), len(units.per_deg)))
        q[:, places[known]] = reported[:, known]
        arm = self.profile.instrument_names.index(instrument)
        perturbed = reported_joints(q, late_ns, units, perturbations, self.seed, arm)
        reported[:, known] = perturbed[:, places[known]]
        return late_ns, reported


def nominal_camera(camera: Camera, perturbations: Perturbations, *, right: bool = False) -> Camera:
    """A camera as a log has it: the right one of a pair with its baseline in P, which of others stays."""
    P = camera.P
    if perturbations.has("focal", "principal_point"):
        scale, shift_px = 1.0 + 1e-2 * perturbations["focal"], perturbations["principal_point"]
        P = None if P is None else _intrinsics(P, scale, shift_px)
        camera = replace(camera, K=_intrinsics(camera.K, scale, shift_px), P=P)
    if right and P is not None and P[0, 3] and perturbations.has("baseline"):  # a pair
        P = P.copy()
        P[0, 3] -= P[0, 0] * 1e-3 * perturbations["baseline"]
        camera = replace(camera, P=P)
    return camera


def right_turn(perturbations: Perturbations) -> Array:
    """The unmodelled rotation of the right camera in its own axes, shape (3, 3)."""
    # A log states that its pair is rectified: the pair is not, and no method would accept one that says so.
    axes = ("right_pitch", "right_yaw", "right_roll")  # about x, y and z
    return rotation_of(np.deg2rad([perturbations[name] for name in axes]))


def zoomed_camera(camera: Camera, zoom: float) -> Camera:
    """The camera that sees what another one sees, enlarged about the middle of the image."""
    enlarge = np.diag([zoom, zoom, 1.0])
    enlarge[:2, 2] = (1 - zoom) * (np.array([camera.width_px, camera.height_px]) - 1) / 2.0
    return replace(camera, K=enlarge @ camera.K, P=None if camera.P is None else enlarge @ camera.P)


def _intrinsics(matrix: Array, scale: float, shift_px: float) -> Array:
    """K, shape (3, 3), or P, shape (3, 4), with other focal lengths and another principal point."""
    changed = matrix.copy()
    changed[:2, :2] *= scale
    changed[:2, 3:] *= scale
    changed[:2, 2] += shift_px
    return changed


def perturbed_image(image_bgr: Image, perturbations: Perturbations) -> Image:
    """Apply to an image of either camera, shape (height, width, 3), what can be applied at replay."""
    zoom, chroma = perturbations["zoom"], perturbations["chroma"]
    if zoom != 1.0:  # about the image's middle; of a smaller one the border is black
        height, width = image_bgr.shape[:2]
        T = np.column_stack([zoom * np.eye(2), (1.0 - zoom) * 0.5 * np.array([width - 1, height - 1])])
        image_bgr = np.asarray(cv2.warpAffine(image_bgr, T, (width, height), flags=cv2.INTER_CUBIC), np.uint8)
    image_bgr = dimmed(image_bgr, perturbations["border"], perturbations["vignette"])
    return subsampled(image_bgr, chroma) if chroma else image_bgr


def perturbed_right_view(right: RightView, perturbations: Perturbations) -> RightView:
    """Apply the same to the right view, and what concerns the right camera alone; what comes into view is black."""
    image_bgr, camera = right.image_bgr, right.camera
    # Hartley & Zisserman, Multiple View Geometry, sec. 8.4; the lens' distortion is taken to turn along.
    if perturbations.has("right_yaw", "right_pitch", "right_roll"):
        H = camera.K @ right_turn(perturbations).T @ np.linalg.inv(camera.K)
        size = (camera.width_px, camera.height_px)
        image_bgr = np.asarray(cv2.warpPerspective(image_bgr, H, size, flags=cv2.INTER_CUBIC), np.uint8)
    return replace(right, image_bgr=perturbed_image(image_bgr, perturbations))


def built_profile(profile: Profile, perturbations: Perturbations, seed: int) -> Profile:
    """The world of which the profile is nominal: `nominal_profile` of it is the profile again."""
    built = nominal_profile(profile, perturbations, seed, -1)
    if built.simulation is None or not perturbations.has("plane"):
        return built
    height_m = built.simulation.camera_height_m - 1e-3 * perturbations["plane"]
    return _with(built, simulation=_with(built.simulation, camera_height_m=height_m))


def plane_tilt(perturbations: Perturbations, seed: int) -> Array:
    """The rotation from the true to the nominal normal of the plane, in the camera's axes, shape (3, 3)."""
    return rotation_of(np.array([*direction(seed, "plane_tilt", 2), 0.0]) * np.deg2rad(perturbations["plane_tilt"]))


def nominal_profile(profile: Profile, perturbations: Perturbations, seed: int, sign: int = 1) -> Profile:
    """The nominal profile of a world that is as this one has it; of `sign` -1 the world of a nominal profile."""

    def scaled(length_m: float, name: str) -> float:
        return float(length_m * (1.0 + 1e-2 * perturbations[name]) ** sign)

    def tool(part: Profile | OtherInstrument) -> dict[str, object]:
        robot, instrument = part.robot, part.instrument
        if robot is not None and perturbations.has("wrist_length"):
            joints = list(robot.joints)
            # The wrist's length is the last one along a link's x axis: from its pitch to its yaw.
            for index in [index for index, joint in enumerate(joints) if joint.a_m][-1:]:
                a_m = joints[index].a_m + sign * 1e-3 * perturbations["wrist_length"]
                joints[index] = _with(joints[index], a_m=a_m)
            robot = _with(robot, joints=tuple(joints))
        if instrument is not None and perturbations.has("shaft_radius", "knuckle_radius"):
            shaft_m = scaled(instrument.shaft_radius_m, "shaft_radius")
            knuckle_m = scaled(instrument.knuckle_radius_m, "knuckle_radius")
            instrument = _with(instrument, shaft_radius_m=shaft_m, knuckle_radius_m=knuckle_m)
        return {"robot": robot, "instrument": instrument}

    fiducial, tissue = profile.fiducial, profile.tissue
    if fiducial is not None and perturbations.has("tag_size", "tag_mount"):
        fiducial = _with(fiducial, size_m=scaled(fiducial.size_m, "tag_size"))
        if mount_mm := sign * perturbations["tag_mount"]:
            shift_m = 1e-3 * mount_mm * direction(seed, "tag_mount", 3)
            turn = rotation_of(np.deg2rad(TURN_DEG_PER_MM) * mount_mm * direction(seed, "tag_mount turn", 3))
            position_m = tuple((np.array(fiducial.position_m) + shift_m).tolist())
            R = tuple(tuple(row) for row in (np.array(fiducial.rotation) @ turn).tolist())
            fiducial = _with(fiducial, position_m=position_m, rotation=R)
    if tissue is not None and perturbations.has("plane", "plane_tilt"):
        distance_m = tissue.plane_distance_m + sign * 1e-3 * perturbations["plane"]
        if distance_m <= 0.0:
            raise UsageError(f"perturbation plane: the plane would be {-1e3 * distance_m:g} mm behind the camera")
        R_nominal = plane_tilt(perturbations, seed)
        normal = (R_nominal if sign > 0 else R_nominal.T) @ tissue.plane_normal
        plane_normal = tuple((normal / np.linalg.norm(normal)).tolist())
        tissue = _with(tissue, plane_distance_m=distance_m, plane_normal=plane_normal)
    others = tuple(_with(other, **tool(other)) for other in profile.other_instruments)
    return _with(profile, **tool(profile), fiducial=fiducial, tissue=tissue, other_instruments=others)


def _with(model: Model, **update: object) -> Model:
    """A copy of a part of a profile; the ranges of the table keep its values possible."""
    return model.model_copy(update=update)
