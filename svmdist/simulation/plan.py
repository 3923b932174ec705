"""The plan of a recording: all that is settled before the first image, for each arm and for the stamps of the log."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.kinematics import DHChain, chain_of, forward_kinematics, link_transforms
from svmdist.perturbations.calibration import built_profile
from svmdist.perturbations.chosen import Perturbations
from svmdist.perturbations.joints import JointPerturber, JointUnits, reported_late
from svmdist.perturbations.table import Place
from svmdist.profile import Profile
from svmdist.samples import DistanceSample, JointSample, PoseSample, Sample, TransformSample
from svmdist.simulation.motion import Scenario, make_other_arms, make_trajectory
from svmdist.simulation.scene import Options, Scene, make_scene
from svmdist.transforms import Array, make_transform

_ENCODER_STREAM, _JOINT_STREAM, _CAMERA_BASE_STREAM = 10, 12, 13


@dataclass(frozen=True)
class NominalKinematics:
    """What is added to the true joints, in rad or m, shape (n_joints,), and the nominal `T_camera_base`, (4, 4).

    `chain` is the robot as its profile describes it.
    """

    joint_offsets: Array
    T_camera_base: Array
    chain: DHChain


def draw_nominal_kinematics(
    chain: DHChain, T_camera_base: Array, profile: Profile, seed: int, scale: float = 0.0, arm: int = 0
) -> NominalKinematics:
    """Draw the nominal kinematics of a seed for one of the arms; `scale` multiplies the profile's kinematic error.

    The same seed draws the same directions at every scale. The error of `T_camera_base` is a rotation about the
    base's origin and a shift, both in the camera's axes. Joints that hold still while the robot works have no error:
    theirs is a part of the error of `T_camera_base`.
    """
    further = [arm] if arm else []
    kinds = [row.type for row in chain.rows if row.type != "fixed"]

    def drawn(stream: int, std_rad: float, std_m: float, first: int = 0) -> Array:
        std = np.array([std_m if kind == "prismatic" else std_rad for kind in kinds])
        std[:first] = 0.0
        return np.asarray(np.random.default_rng([seed, stream, *further]).normal(0.0, 1.0, len(std)) * std)

    offsets, settings = np.zeros(len(kinds)), profile.simulation
    if settings is not None:
        offsets = drawn(_ENCODER_STREAM, settings.encoder_std_rad, settings.encoder_std_m)
    if scale == 0.0:
        return NominalKinematics(offsets, T_camera_base, chain)
    error = profile.kinematic_error
    rng = np.random.default_rng([seed, _CAMERA_BASE_STREAM, *further])
    rotation_rad = scale * rng.normal(0.0, error.camera_base_std_rad, 3)
    shift_m = scale * rng.normal(0.0, error.camera_base_std_m, 3)
    T_nominal = make_transform(
        cv2.Rodrigues(rotation_rad)[0] @ T_camera_base[:3, :3], T_camera_base[:3, 3] + shift_m
    )
    first = error.first_moving_joint
    begin = 0 if first is None else chain.joint_names.index(first)
    joint_offsets = scale * drawn(_JOINT_STREAM, error.joint_std_rad, error.joint_std_m, begin)
    return NominalKinematics(offsets + joint_offsets, T_nominal, chain)


def reported_joints(
    q: Array,
    stamps_ns: NDArray[np.int64],
    is_sample: NDArray[np.bool_],
    profile: Profile,
    perturbations: Perturbations,
    seed: int,
    arm: int,
) -> Array:
    """What is reported of joints `q`, shape (n, n_joints), at stamps (n,), of which `is_sample` (n,) are the encoders'.

    Reports are interpolated between samples, where only transforms are written. Without perturbations it is `q`.
    """
    if not (perturbations.changes(Place.JOINTS) or perturbations.changes(Place.CLOCK)):
        return q
    at_ns = stamps_ns[is_sample]
    late = reported_late(q[is_sample], at_ns, perturbations)
    perturber = JointPerturber(JointUnits.of(profile), perturbations, seed, arm)
    samples = np.array(
        [perturber.perturbed(row, stamp) for row, stamp in zip(late, at_ns.tolist(), strict=True)]
    )
    seconds, at_s = 1e-9 * (stamps_ns - at_ns[0]), 1e-9 * (at_ns - at_ns[0])
    return np.column_stack([np.interp(seconds, at_s, joint) for joint in samples.T])


@dataclass(frozen=True)
class Arm:
    """An arm of a scene: profile and scene as it sees them, its topics, its exact joints (n, n_joints) at all stamps.

    `reported` are the joints that it reports at the same stamps, (n, n_joints). `prefix` stands before the names of its
    links in transforms; the first arm's have none.
    """

    profile: Profile
    scene: Scene
    topics: dict[str, str]
    q: Array
    nominal: NominalKinematics
    reported: Array
    prefix: str = ""

    def reports(self, stamp_ns: int, index: int) -> Iterator[tuple[str, Sample]]:
        """Yield joints and pose as the encoders have them at the stamp number `index`."""
        names, frames, q = self.scene.chain.joint_names, self.profile.frames, self.reported[index]
        yield self.topics["joints"], JointSample(stamp_ns, names, q)
        T_base_tool = forward_kinematics(self.nominal.chain, q)
        yield self.topics["pose"], PoseSample(stamp_ns, frames.base, T_base_tool)

    def true_tool(self, stamp_ns: int, index: int) -> TransformSample:
        """The true pose of the tool at the stamp number `index`."""
        frames = self.profile.frames
        T_camera_tool = self.scene.T_camera_base @ forward_kinematics(self.scene.chain, self.q[index])
        return TransformSample(stamp_ns, frames.camera, frames.tool, T_camera_tool)

    def nominal_transforms(self, stamp_ns: int, index: int) -> tuple[TransformSample, ...]:
        """The nominal camera-to-base transform, then the whole chain as the reported joints place it."""
        frames, chain = self.profile.frames, self.nominal.chain
        names = [self.prefix + row.name for row in chain.rows]
        links = link_transforms(chain, self.reported[index])
        children, parents = [*names[:-1], frames.tool], [frames.base, *names[:-1]]
        links[-1] = links[-1] @ chain.T_last_tool
        return (
            TransformSample(stamp_ns, frames.camera, frames.base, self.nominal.T_camera_base),
            *(
                TransformSample(stamp_ns, parent, child, T)
                for parent, child, T in zip(parents, children, links, strict=True)
            ),
        )


def distances(stamp_ns: int, between_m: Array, clearance_m: float) -> DistanceSample:
    """The three distances of two things, by the vector between their origins in the camera frame, shape (3,)."""
    return DistanceSample(
        stamp_ns,
        planar_m=float(np.linalg.norm(between_m[:2])),  # eq. (35): in the camera's xy plane
        spatial_m=float(np.linalg.norm(between_m)),
        clearance_m=clearance_m,
    )


START_NS = 1_700_000_000_000_000_000
"""The stamp of the first sample. No clock is read, so that a rerun gives the same log."""
CAMERA_INFO_PERIOD_NS = 1_000_000_000


@dataclass(frozen=True)
class Block:
    """The stamps from number `begin` to before `end`; the first of them is that of image number `frame`."""

    frame: int
    begin: int
    end: int


@dataclass(frozen=True)
class SceneState:
    """Joints of each arm, (n_joints,), the retractor's pose, (4, 4), and the tissue's offset from rest in m."""

    q: tuple[Array, ...]
    T_world_retractor: Array | None
    offset_m: float


@dataclass(frozen=True)
class Plan:
    """A recording before it is made; the first arm's scene is the world's.

    All arrays have one entry for each stamp: `stamps_ns` (n,), whether an image, joints or the cameras' calibration
    come with it (n,), the retractor's poses (n, 4, 4), or None where there is none, and the tissue's offset (n,).
    """

    profile: Profile
    scene: Scene
    arms: tuple[Arm, ...]
    topics: dict[str, str]
    noise: float
    options: Options
    stamps_ns: NDArray[np.int64]
    with_image: NDArray[np.bool_]
    with_joints: NDArray[np.bool_]
    with_camera_info: NDArray[np.bool_]
    T_world_retractor: Array | None
    tissue_offset_m: Array

    @property
    def blocks(self) -> list[Block]:
        """All blocks in the order of time; the first image has the first stamp."""
        begins = np.nonzero(self.with_image)[0].tolist()
        ends = [*begins[1:], len(self.stamps_ns)]
        return [Block(frame, *span) for frame, span in enumerate(zip(begins, ends, strict=True))]

    def state(self, index: int, after_ns: float = 0.0) -> SceneState:
        """The state at the stamp number `index`, or later: interpolated between stamps, still after the last one."""
        if not after_ns:
            return self._state(lambda values: values[index])
        since_ns = self.stamps_ns - self.stamps_ns[index]  # stamps are too large for a float
        above = int(np.clip(np.searchsorted(since_ns, after_ns), 1, len(since_ns) - 1))
        below = above - 1
        share = min((after_ns - since_ns[below]) / (since_ns[above] - since_ns[below]), 1.0)
        return self._state(lambda values: values[below] + share * (values[above] - values[below]))

    def _state(self, at: Callable[[Array], Array]) -> SceneState:
        return SceneState(
            tuple(at(arm.q) for arm in self.arms),
            # The retractor's blade slides, and never turns.
            None if self.T_world_retractor is None else at(self.T_world_retractor),
            float(at(self.tissue_offset_m)),
        )


def make_plan(
    scenario: Scenario, profile: Profile, *, noise: float = 0.0, options: Options | None = None
) -> Plan:
    """Plan a recording; `noise` is a standard deviation in 8-bit levels.

    Joints and poses come at the profile's joint rate, transforms and truth at every image's stamp. Raises
    SimulationError where PyBullet is missing and needed, or the profile cannot be simulated.
    """
    options = options or Options()
    built = built_profile(profile, options.perturbations, scenario.seed)
    scene = make_scene(built, scenario.seed, options)
    settings = built.simulation
    assert settings is not None  # make_scene has checked it
    images = _stamps(scenario.frame_count, scenario.rate_hz)
    # Joints up to the end of the recording, so that every image lies between two of them.
    joint_count = int(np.ceil(scenario.duration_s * settings.joint_rate_hz)) + 1
    joints = _stamps(joint_count, settings.joint_rate_hz)
    stamps = np.union1d(images, joints)
    with_joints = np.isin(stamps, joints)
    with_camera_info = np.zeros(len(stamps), np.bool_)
    with_camera_info[np.searchsorted(stamps, np.arange(START_NS, stamps[-1] + 1, CAMERA_INFO_PERIOD_NS))] = (
        True
    )
    progress = np.clip((stamps - START_NS) / (scenario.duration_s * 1e9), 0.0, 1.0)
    path_s = progress * scenario.duration_s
    path, T_world_retractor = make_trajectory(scene, scenario, settings.working_height_m, progress)

    def arm(number: int, view: Profile, its: Scene, q: Array, distance: str, prefix: str = "") -> Arm:
        """An arm that takes itself for the profile's."""
        assert view.robot is not None  # the scene has checked it
        nominal = draw_nominal_kinematics(
            chain_of(view.robot), its.T_camera_base, view, scenario.seed, options.kinematic_error, number
        )
        exact = q + nominal.joint_offsets
        exact[:, -1] -= its.jaw_opening_rad(path_s, number)
        reported = reported_joints(
            exact, stamps, with_joints, view, options.perturbations, scenario.seed, number
        )
        return Arm(view, its, complete_topics(view, distance), q, nominal, reported, prefix)

    arms = [arm(0, profile, scene, path, "/ground_truth/distance")]
    others = make_other_arms(built, scene, options, path, progress, scenario.duration_s)
    for number, (name, its, q) in enumerate(others, start=1):
        view, distance = profile.for_instrument(name), f"/ground_truth/{name}/distance"
        arms.append(arm(number, view, its, q, distance, prefix=f"{name}_"))
    return Plan(
        profile=profile,
        scene=scene,
        arms=tuple(arms),
        topics=complete_topics(profile),
        noise=noise,
        options=options,
        stamps_ns=stamps,
        with_image=np.isin(stamps, images),
        with_joints=with_joints,
        with_camera_info=with_camera_info,
        T_world_retractor=T_world_retractor,
        tissue_offset_m=scene.tissue_offset_m(np.asarray((stamps - START_NS) * 1e-9, np.float64)),
    )


def complete_topics(profile: Profile, distance: str = "/ground_truth/distance") -> dict[str, str]:
    """Topics by role: the profile's, or those of a dVRK where it leaves one open."""
    name = profile.instrument_name
    defaults = {
        "image": "/ECM/left/image",
        "camera_info": "/ECM/left/camera_info",
        "right_image": "/ECM/right/image",
        "right_camera_info": "/ECM/right/camera_info",
        "joints": f"/{name}/measured_js",
        "pose": f"/{name}/measured_cp",
        "tf": "/tf",
        "ground_truth_tf": "/ground_truth/tf",
        "ground_truth_distance": distance,
    }
    return {role: getattr(profile.topics, role) or topic for role, topic in defaults.items()}


def between_topic(first: str, second: str) -> str:
    """The topic of the true distances between two instruments."""
    return f"/ground_truth/{first}/{second}/distance"


def _stamps(count: int, rate_hz: float) -> NDArray[np.int64]:
    return np.asarray(START_NS + np.rint(np.arange(count) * (1e9 / rate_hz)).astype(np.int64))
