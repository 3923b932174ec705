"""What a robot reports of its tool: the chain's pose at the stamps, or the poses of the log, and their errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from svmdist.errors import RecordingError
from svmdist.profile import load_profile
from svmdist.recording.log import open_recording
from svmdist.workflows.calibrate import default_reference, reported_tool
from svmdist.workflows.fk import fk_blocks

PROFILE = load_profile()


def test_joints_and_poses_of_a_log_without_errors_are_the_same(golden: Path) -> None:
    """The pose topic is forward kinematics of the joints; beyond the log, neither is known."""
    recording = open_recording(golden / "3d" / "contact.mcap", PROFILE)
    assert default_reference(recording, PROFILE) == "kinematics"
    known = next(fk_blocks(recording, PROFILE))
    stamps_ns = np.append(known.stamps_ns[[10, 400]], known.stamps_ns[-1] + 10**10)
    by_joints, by_poses = (
        reported_tool(recording, PROFILE, kind, stamps_ns) for kind in ("kinematics", "pose")
    )
    assert by_joints.valid.tolist() == by_poses.valid.tolist() == [True, True, False]
    np.testing.assert_allclose(by_joints.T_base_tool[:2], known.poses[[10, 400]], atol=1e-9)
    np.testing.assert_allclose(by_poses.T_base_tool[:2], known.poses[[10, 400]], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(by_joints.axes[:2], axis=1), 1.0)
    assert np.isnan(by_poses.axes).all()
    assert by_joints.shared.shape[2] > by_poses.shared.shape[2] == 0
    # A degree of each joint moves the tool by centimetres, in every frame alike.
    assert np.linalg.norm(by_joints.shared[0, :3], axis=0).max() > 1e-3
    np.testing.assert_allclose(by_poses.noise[0], PROFILE.settings.hand_eye.pose_std_m**2 * np.eye(3))


def test_a_log_without_joints_and_poses_is_told(golden: Path) -> None:
    recording = open_recording(golden / "sweep.mcap", load_profile("dvrk-psm"))
    with pytest.raises(RecordingError, match=r"has no \[robot\]"):
        reported_tool(
            recording,
            load_profile("dvrk-psm").model_copy(update={"robot": None}),
            "kinematics",
            np.zeros(1, np.int64),
        )
