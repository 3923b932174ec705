"""The references that estimates are held against: kinematics as in the paper, and the simulator's truth."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from svmdist.errors import RecordingError
from svmdist.estimation.equations import Equations
from svmdist.kinematics import paper
from svmdist.kinematics.chain import chain_of
from svmdist.kinematics.dh import forward_kinematics, select_joints
from svmdist.profile import Profile
from svmdist.recording.reader import Recording
from svmdist.transforms import Array

KINEMATICS_PRINTED_NOTE = (
    "eq. (28) as printed is the zero matrix, which makes (31) zero everywhere: the identity stands in for it;"
    " eq. (30) as printed is a reflection; eqs. (33), (34) as printed divide metres by 100 and are 10^4 too small"
)


class Reference(StrEnum):
    """What is taken for the truth."""

    GROUND_TRUTH = "ground_truth"
    KINEMATICS = "kinematics"


@dataclass(frozen=True, slots=True)
class PlanarTruth:
    """True planar distances at asked stamps, shape (n,) in m, and which of them the log can tell."""

    planar_m: Array
    valid: NDArray[np.bool_]


def planar_truth(
    recording: Recording,
    profile: Profile,
    reference: Reference,
    stamps_ns: NDArray[np.int64],
    equations: Equations = "corrected",
) -> PlanarTruth:
    """Planar distances between tool and tissue by a reference, interpolated to stamps, never extrapolated.

    Raises RecordingError or KinematicsError where the log has no such reference.
    """
    if reference is Reference.GROUND_TRUTH:
        return _from_simulator(recording, stamps_ns)
    return _from_kinematics(recording, profile, stamps_ns, equations)


def _from_simulator(recording: Recording, stamps_ns: NDArray[np.int64]) -> PlanarTruth:
    truth = recording.distance_track().at(stamps_ns)
    return PlanarTruth(truth.planar_m, truth.valid)


def _from_kinematics(
    recording: Recording, profile: Profile, stamps_ns: NDArray[np.int64], equations: Equations
) -> PlanarTruth:
    """eqs. (31)–(35): the chain from camera to tool, and its distance from the tissue in the camera's plane."""
    if profile.robot is None:
        raise RecordingError(f"profile {profile.name} has no [robot]: kinematics need its chain")
    chain = chain_of(profile.robot)
    joints = recording.joint_track()
    q = joints.at(stamps_ns)
    T_base_tool = forward_kinematics(chain, select_joints(chain, joints.names, q.values))
    if equations == "printed":
        # The translation of the last row is zero, so that (30)'s reflection leaves the position as it is.
        displacement_cm = paper.displacement_cm_printed(T_base_tool[:, :3, 3])
        return PlanarTruth(paper.planar_distance_cm(displacement_cm) / 100.0, q.valid)
    frames = profile.frames
    camera_base = recording.transform_track(frames.camera, frames.base).at(stamps_ns)
    tissue = recording.transform_track(frames.camera, frames.tissue, ground_truth=True).at(stamps_ns)
    T_camera_tool = camera_base.values @ T_base_tool
    displacement_cm = paper.displacement_cm_corrected(T_camera_tool[:, :3, 3], tissue.values[:, :3, 3])
    return PlanarTruth(
        paper.planar_distance_cm(displacement_cm) / 100.0, q.valid & camera_base.valid & tissue.valid
    )
