"""The wrist moves rigidly with its frame, and its unit vectors stay what they are at any joints."""

from __future__ import annotations

import numpy as np

from svmdist.estimation.instrument.model import Rods, Wrist, WristKinematics, joints_of, wrist_in_tool
from svmdist.kinematics.dh import chain_of, frame_transforms
from svmdist.profile import load_profile
from svmdist.samples import JointSample
from svmdist.transforms import make_transform, rotation_x, rotation_z

PROFILE = load_profile()
assert PROFILE.robot is not None
assert PROFILE.instrument is not None
CHAIN = chain_of(PROFILE.robot)
EXACT = 1e-14
"""Sums and products of a few numbers of at most 0.3 m."""


def test_vectors_are_of_length_one_and_across_one_another() -> None:
    rng = np.random.default_rng(1)
    for q in rng.uniform(-0.8, 0.8, (20, len(CHAIN.joint_names))):
        wrist = wrist_in_tool(CHAIN, q)
        np.testing.assert_allclose(np.linalg.norm(wrist.vectors()[2:], axis=1), 1.0, atol=EXACT)
        np.testing.assert_allclose(wrist.tool_m, 0.0, atol=0)
        for jaw in wrist.jaws:
            axes = np.stack([jaw.along, jaw.outward, jaw.beside])
            np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=EXACT)


def test_straight_the_hinge_is_a_wrist_behind_the_tool() -> None:
    kinematics = WristKinematics.of(CHAIN)
    assert kinematics is not None
    q = np.zeros(len(CHAIN.joint_names))
    wrist = kinematics.wrist_in_tool(frame_transforms(CHAIN, q), q)
    np.testing.assert_allclose(wrist.jaws[0].along, wrist.shaft, atol=EXACT)
    assert abs(np.linalg.norm(wrist.hinge_m) - kinematics.length_m) < EXACT


def test_capsules_move_with_the_wrist() -> None:
    """Rods about a moved wrist are the moved rods: their ends are linear in the wrist's points and vectors."""
    assert PROFILE.instrument is not None
    wrist = wrist_in_tool(CHAIN, np.linspace(-0.5, 0.5, len(CHAIN.joint_names)))
    T = make_transform(rotation_x(0.7) @ rotation_z(-0.4), [0.02, -0.01, 0.12])
    vectors = wrist.vectors() @ T[:3, :3].T
    vectors[:2] += T[:3, 3]
    there = Rods.of(PROFILE.instrument).about(Wrist.of(vectors))
    moved = Rods.of(PROFILE.instrument).about(wrist).transformed(T)
    np.testing.assert_allclose(there.start_m, moved.start_m, atol=EXACT)
    np.testing.assert_allclose(there.end_m, moved.end_m, atol=EXACT)


def test_joints_are_those_of_the_chain_or_none() -> None:
    names = CHAIN.joint_names
    sample = JointSample(0, names[::-1], np.arange(len(names), dtype=np.float64))
    q = joints_of(CHAIN, sample)
    assert q is not None
    assert q.tolist() == list(range(len(names)))[::-1]
    assert joints_of(CHAIN, JointSample(0, names[1:], np.zeros(len(names) - 1))) is None
    assert joints_of(None, sample) is None
    assert joints_of(CHAIN, None) is None
