"""One arm of a recording: what it does, and what it reports about that.

Cables stretch and set-up joints are read by potentiometers: a da Vinci research kit places its tool centimetres off in
the camera's frame, while its motion is repeatable to fractions of a millimetre. The errors of the nominal kinematics
are therefore constants of a recording, drawn by seed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.kinematics import DHChain, forward_kinematics, link_transforms
from svmdist.perturbations.chosen import Perturbations
from svmdist.perturbations.joints import JointPerturber, JointUnits, reported_late
from svmdist.perturbations.table import Place
from svmdist.profile import Profile
from svmdist.samples import DistanceSample, JointSample, PoseSample, Sample, TransformSample
from svmdist.simulation.scene import Scene
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
