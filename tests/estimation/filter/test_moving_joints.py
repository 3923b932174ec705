"""What of a chain may err, and where each error stands in the state."""

from __future__ import annotations

import numpy as np

from svmdist.estimation.instrument.corrected_links import ErrorColumns, MovingJoints
from svmdist.kinematics.dh import chain_of
from svmdist.profile import load_profile
from tests.shipped import CHAIN


def test_columns_follow_one_another_and_fill_the_state() -> None:
    at = ErrorColumns(joint_count=7, length_count=2)
    places = [*range(6), *range(22)[at.offsets], *range(22)[at.play], at.time_offset, *range(23)[at.lengths]]
    assert places == list(range(at.size))


def test_the_shipped_chain_has_one_length_behind_its_trocar() -> None:
    """The wrist's 9.1 mm along x of its own frame; the set-up joints' lengths are one with the base's place."""
    joints = MovingJoints.of(CHAIN, CHAIN.joint_names.index("yaw"))
    assert [(CHAIN.rows[length.row].name, length.column) for length in joints.lengths] == [("wrist_pitch", 0)]
    np.testing.assert_array_equal(joints.turns + joints.slides, 1.0)


def test_modified_rows_shift_along_the_frame_before() -> None:
    """A dVRK's: the shaft's length along its own z, the wrist's along x of the frame before it."""
    robot = load_profile("dvrk-psm").robot
    assert robot is not None
    chain = chain_of(robot)
    joints = MovingJoints.of(chain, 0)
    for length in joints.lengths:
        row = chain.rows[length.row]
        if length.column == 0:
            assert row.a_m != 0.0
            assert length.axis_row == length.row - (chain.convention == "modified")
        else:
            assert row.d_m != 0.0
            assert row.joint != "prismatic"
    assert joints.lengths
