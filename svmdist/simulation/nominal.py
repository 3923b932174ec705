"""The nominal kinematics of a simulated robot: the joints that its encoders report, and where it takes its base to be.

Cables stretch and set-up joints are read by potentiometers: a da Vinci research kit places its tool
centimetres off in the camera's frame, while its motion is repeatable to fractions of a millimetre. Both
errors are therefore constants of a recording, drawn by seed.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from svmdist.kinematics.dh import DHChain
from svmdist.profile import KinematicError, Profile, Simulation
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
    chain: DHChain,
    T_camera_base: Array,
    profile: Profile,
    seed: int,
    scale: float = 0.0,
    arm: tuple[int, ...] = (),
) -> NominalKinematics:
    """Draw the nominal kinematics of a seed; `scale` multiplies the profile's kinematic error.

    The same seed draws the same directions at every scale. `arm` is empty for the first arm and holds the number
    of any further one, which has errors of its own. The rotation of `T_camera_base` is off by
    a turn about the base's origin, its translation by a shift, both in the camera's axes. Joints that hold
    still while the robot works have no error: theirs is a part of the error of `T_camera_base`.
    """
    offsets = _encoder_offsets(chain, profile.simulation, [seed, _ENCODER_STREAM, *arm])
    if scale == 0.0:
        return NominalKinematics(offsets, T_camera_base, chain)
    error = profile.kinematic_error
    rng = np.random.default_rng([seed, _CAMERA_BASE_STREAM, *arm])
    turn_rad = scale * rng.normal(0.0, error.camera_base_std_rad, 3)
    shift_m = scale * rng.normal(0.0, error.camera_base_std_m, 3)
    T_nominal = make_transform(
        cv2.Rodrigues(turn_rad)[0] @ T_camera_base[:3, :3], T_camera_base[:3, 3] + shift_m
    )
    joint_offsets = scale * _joint_offsets(chain, error, [seed, _JOINT_STREAM, *arm])
    return NominalKinematics(offsets + joint_offsets, T_nominal, chain)


def _encoder_offsets(chain: DHChain, settings: Simulation | None, seeds: list[int]) -> Array:
    if settings is None:
        return np.zeros(len(chain.joint_names))
    std = _by_joint(chain, settings.encoder_std_rad, settings.encoder_std_m)
    return np.asarray(np.random.default_rng(seeds).normal(0.0, 1.0, len(std)) * std)


def _joint_offsets(chain: DHChain, error: KinematicError, seeds: list[int]) -> Array:
    std = _by_joint(chain, error.joint_std_rad, error.joint_std_m)
    if error.first_moving_joint is not None:
        std[: chain.joint_names.index(error.first_moving_joint)] = 0.0
    return np.asarray(np.random.default_rng(seeds).normal(0.0, 1.0, len(std)) * std)


def _by_joint(chain: DHChain, revolute: float, prismatic: float) -> Array:
    kinds = [row.joint for row in chain.rows if row.joint != "fixed"]
    return np.array([prismatic if kind == "prismatic" else revolute for kind in kinds])
