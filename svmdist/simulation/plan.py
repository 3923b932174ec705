"""The plan of a recording: all that is fixed before the first image, for each arm and for the stamps of the log.

A plan holds no physics world and can be sent to another process. A block is one image with all samples up to the
next; each can be made by itself, so that the content does not depend on who makes it, or in which order.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.kinematics import DHChain, chain_of, forward_kinematics, link_transforms
from svmdist.perturbations import Place
from svmdist.perturbations.apply import JointUnits, built_profile, reported_joints, reported_late
from svmdist.profile import Profile
from svmdist.samples import JointSample, PoseSample, Sample, TransformSample
from svmdist.simulation.motion import Scenario, make_other_arms, make_trajectory
from svmdist.simulation.scene import PLAIN, Options, Scene, make_scene
from svmdist.transforms import Array, make_transform

START_NS = 1_700_000_000_000_000_000  # no clock is read, so that a rerun gives the same log
TOPICS = {
    "image": "/ECM/left/image",
    "camera_info": "/ECM/left/camera_info",
    "right_image": "/ECM/right/image",
    "right_camera_info": "/ECM/right/camera_info",
    "tf": "/tf",
    "ground_truth_tf": "/ground_truth/tf",
}
"""Topics by role as a dVRK has them, where the profile leaves one open; those of an arm have its name."""
_ENCODER_STREAM, _JOINT_STREAM, _CAMERA_BASE_STREAM = 10, 12, 13


def draw_nominal_kinematics(
    chain: DHChain, T_camera_base: Array, profile: Profile, seed: int, scale: float = 0.0, arm: int = 0
) -> tuple[Array, Array]:
    """What an arm of a seed adds to true joints, (n_joints,), rad or m, and its nominal `T_camera_base`, (4, 4).

    `scale` multiplies the profile's kinematic error. That of `T_camera_base` is a rotation about the base's origin and
    a shift, both in the camera's axes. All are constant in a recording: a da Vinci research kit, whose cables stretch
    and whose set-up joints are read by potentiometers, places its tool centimetres off in the camera's frame, with
    motion repeatable to fractions of a millimetre.
    """
    further = [arm] if arm else []

    def sampled(stream: int, std_rad: float, std_m: float) -> Array:
        unit = np.random.default_rng([seed, stream, *further]).normal(0.0, 1.0, len(chain.joint_names))
        return np.asarray(unit * np.where(chain.is_revolute, std_rad, std_m))

    settings, error = profile.simulation, profile.kinematic_error
    assert settings is not None  # the scene has checked it
    offsets = sampled(_ENCODER_STREAM, settings.encoder_std_rad, settings.encoder_std_m)
    rng = np.random.default_rng([seed, _CAMERA_BASE_STREAM, *further])
    R = cv2.Rodrigues(scale * rng.normal(0.0, error.camera_base_std_rad, 3))[0] @ T_camera_base[:3, :3]
    shift_m = scale * rng.normal(0.0, error.camera_base_std_m, 3)
    joint_offsets = scale * sampled(_JOINT_STREAM, error.joint_std_rad, error.joint_std_m)
    if error.first_moving_joint is not None:  # what joints that hold still are off is a part of T_camera_base's
        joint_offsets[: chain.joint_names.index(error.first_moving_joint)] = 0.0
    return offsets + joint_offsets, make_transform(R, T_camera_base[:3, 3] + shift_m)


@dataclass(frozen=True)
class Arm:
    """An arm of a scene: profile and scene as it sees them."""

    profile: Profile
    scene: Scene
    topics: dict[str, str]
    q: Array  # exact joints at all stamps, shape (n, n_joints)
    nominal_chain: DHChain  # the profile's
    nominal_T_camera_base: Array
    reported: Array  # joints that it reports at the same stamps, shape (n, n_joints)
    prefix: str  # of the names of its links in transforms; the first arm's have none

    def reports(self, stamp_ns: int, index: int) -> Iterator[tuple[str, Sample]]:
        """Yield joints and pose as the encoders have them at the stamp number `index`."""
        q = self.reported[index]
        yield self.topics["joints"], JointSample(stamp_ns, self.scene.chain.joint_names, q)
        T_base_tool = forward_kinematics(self.nominal_chain, q)
        yield self.topics["pose"], PoseSample(stamp_ns, self.profile.frames.base, T_base_tool)

    def nominal_transforms(self, stamp_ns: int, index: int) -> tuple[TransformSample, ...]:
        """The nominal camera-to-base transform, then the whole chain as the reported joints place it."""
        frames, chain = self.profile.frames, self.nominal_chain
        links = link_transforms(chain, self.reported[index])
        links[-1] = links[-1] @ chain.T_last_tool
        names = (frames.camera, frames.base, *(self.prefix + row.name for row in chain.rows[:-1]), frames.tool)
        transforms = zip(pairwise(names), (self.nominal_T_camera_base, *links), strict=True)
        return tuple(TransformSample(stamp_ns, *frame_ids, T) for frame_ids, T in transforms)


@dataclass(frozen=True)
class SceneState:
    """Joints of each arm, (n_joints,), the retractor's pose, (4, 4), and the tissue's offset from rest in m."""

    q: tuple[Array, ...]
    T_world_retractor: Array | None
    offset_m: float


@dataclass(frozen=True)
class Plan:
    """A recording before it is made; the first arm's scene is the world's. Arrays have one entry for each stamp."""

    scene: Scene
    arms: tuple[Arm, ...]
    topics: dict[str, str]
    options: Options
    stamps_ns: NDArray[np.int64]
    with_image: NDArray[np.bool_]
    with_joints: NDArray[np.bool_]
    with_camera_info: NDArray[np.bool_]
    T_world_retractor: Array | None  # (n, 4, 4)
    tissue_offset_m: Array

    @property
    def blocks(self) -> list[range]:
        """The numbers of the stamps of each block, in the order of time; the first image has the first stamp."""
        begins = np.nonzero(self.with_image)[0].tolist()
        return list(map(range, begins, [*begins[1:], len(self.stamps_ns)]))

    def state(self, index: int, after_ns: float = 0.0) -> SceneState:
        """The state at the stamp number `index`, or later: interpolated between stamps, still after the last one."""
        below, above, share = index, index, 0.0
        if after_ns:
            since_ns = self.stamps_ns - self.stamps_ns[index]  # stamps are too large for a float
            above = int(np.clip(np.searchsorted(since_ns, after_ns), 1, len(since_ns) - 1))
            below = above - 1
            share = min((after_ns - since_ns[below]) / (since_ns[above] - since_ns[below]), 1.0)

        def at(values: Array) -> Array:
            return np.asarray(values[below] + share * (values[above] - values[below]))

        # The retractor's blade slides, and never turns.
        blade = None if self.T_world_retractor is None else at(self.T_world_retractor)
        return SceneState(tuple(at(arm.q) for arm in self.arms), blade, float(at(self.tissue_offset_m)))


def make_plan(scenario: Scenario, profile: Profile, options: Options = PLAIN) -> Plan:
    """Plan a recording: joints and poses at the profile's joint rate, transforms and truth at every image's stamp.

    Raises SimulationError where PyBullet is missing and needed, or the profile cannot be simulated.
    """
    perturbations, seed = options.perturbations, scenario.seed
    built = built_profile(profile, perturbations, seed)
    scene = make_scene(built, seed, options)
    settings = built.simulation
    assert settings is not None  # make_scene has checked it
    images = _stamps(scenario.frame_count, scenario.rate_hz)
    # Joints up to the end of the recording, so that every image lies between two of them.
    joints = _stamps(int(np.ceil(scenario.duration_s * settings.joint_rate_hz)) + 1, settings.joint_rate_hz)
    stamps = np.union1d(images, joints)
    with_image, with_joints = np.isin(stamps, images), np.isin(stamps, joints)
    with_camera_info = np.zeros(len(stamps), np.bool_)
    with_camera_info[np.searchsorted(stamps, np.arange(START_NS, stamps[-1] + 1, 10**9))] = True  # every second
    progress = np.clip((stamps - START_NS) / (scenario.duration_s * 1e9), 0.0, 1.0)
    path, T_world_retractor = make_trajectory(scene, scenario, progress)
    others = make_other_arms(built, scene, options, path, progress, scenario.duration_s)
    arms = []
    for number, (name, its, q) in enumerate([(profile.instrument_name, scene, path), *others]):
        view = profile.for_instrument(name) if number else profile
        assert view.robot is not None  # the scene has checked it
        chain, scale = chain_of(view.robot), options.kinematic_error  # an arm takes itself for the profile's
        offsets, T_nominal = draw_nominal_kinematics(chain, its.T_camera_base, view, seed, scale, number)
        exact = q + offsets
        exact[:, -1] -= its.jaw_opening_rad(progress * scenario.duration_s, number)
        reported = exact
        if perturbations.changes(Place.JOINTS, Place.CLOCK):
            late = reported_late(exact[with_joints], joints, perturbations)
            samples = reported_joints(late, joints, JointUnits.of(view), perturbations, seed, number)
            # Interpolated between samples, where only transforms are written.
            seconds, at_s = 1e-9 * (stamps - joints[0]), 1e-9 * (joints - joints[0])
            reported = np.column_stack([np.interp(seconds, at_s, joint) for joint in samples.T])
        defaults = TOPICS | {"joints": f"/{name}/measured_js", "pose": f"/{name}/measured_cp"}
        defaults["ground_truth_distance"] = f"/ground_truth/{name}/distance" if number else "/ground_truth/distance"
        topics = {role: getattr(view.topics, role) or topic for role, topic in defaults.items()}
        arms.append(Arm(view, its, topics, q, chain, T_nominal, reported, f"{name}_" if number else ""))
    tissue_offset_m = scene.tissue_offset_m(np.asarray((stamps - START_NS) * 1e-9, np.float64))
    due = stamps, with_image, with_joints, with_camera_info
    return Plan(scene, tuple(arms), arms[0].topics, options, *due, T_world_retractor, tissue_offset_m)


def _stamps(count: int, rate_hz: float) -> NDArray[np.int64]:
    return np.asarray(START_NS + np.rint(np.arange(count) * (1e9 / rate_hz)).astype(np.int64))
