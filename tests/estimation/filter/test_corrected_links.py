"""Corrected links against the formula of the correction and central differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from svmdist.estimation.instrument.corrected_links import Correction
from svmdist.estimation.instrument.error_model import ErrorModel
from svmdist.kinematics.dh import DHChain, DHRow, forward_kinematics, frame_transforms, row_index
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile import KinematicError
from svmdist.tracks import JointTrack
from svmdist.transforms import Array, make_transform, rotation_of, rotation_vector, rotation_x
from tests.shipped import CHAIN, POSTURE, PROFILE

T_CAMERA_BASE = make_transform(rotation_of([2.0, 0.4, -0.3]), [0.1, -0.2, 0.9])
rng = np.random.default_rng(11)
ROWS = tuple(
    DHRow(f"j{index}", kind, *rng.uniform(-1.0, 1.0, 4))  # type: ignore[arg-type]
    for index, kind in enumerate(("prismatic", "revolute", "fixed", "revolute", "prismatic", "revolute"))
)
SHORT = DHChain(ROWS, "modified", make_transform(rotation_x(0.7), [0.1, -0.2, 0.05]))
CASES = [
    (CHAIN, PROFILE.kinematic_error, POSTURE, (None, "yaw", CHAIN.rows[0].name, CHAIN.rows[-2].name)),
    (
        SHORT,
        KinematicError(first_moving_joint="j1"),
        np.array([0.1, 0.2, -0.4, 0.3, 1.0]),
        (None, "j0", "j2", "j4"),
    ),
    (SHORT, KinematicError(), np.array([0.1, 0.2, -0.4, 0.3, 1.0]), (None, "j0", "j3")),
]


def moving_robot(chain: DHChain, q: Array) -> RobotState:
    """The robot at rates of up to 0.5 in each joint, which its track tells."""
    rates = np.random.default_rng(4).uniform(-0.5, 0.5, len(q))
    stamps_ns = np.arange(-50, 51, 10) * 1_000_000
    track = JointTrack(stamps_ns, chain.joint_names, q + rates * stamps_ns[:, None] / 1e9)
    return RobotState(chain, 0, q, T_CAMERA_BASE, track)


def by_definition(
    model: ErrorModel, robot: RobotState, at: Correction, anchor_m: Array, link: str | None
) -> Array:
    """The corrected pose as the head of `correction` writes it, by a chain with other lengths."""
    q, moving = robot.q.copy(), slice(-model.columns.joint_count, None)
    q[moving] += robot.rates[moving] * at.time_offset_s + at.q_offset + at.play
    rows, lengths = list(model.chain.rows), iter(at.length_m)
    is_modified = model.chain.convention == "modified"
    first = int(model.chain.moving_rows[len(q) - model.columns.joint_count])
    for index in range(first + is_modified, len(rows)):
        row = rows[index]
        if row.a_m != 0.0:
            rows[index] = replace(rows[index], a_m=row.a_m + next(lengths))
        if row.d_m != 0.0 and row.joint != "prismatic" and (is_modified or index > first):
            rows[index] = replace(rows[index], d_m=row.d_m + next(lengths))
    assert next(lengths, None) is None
    chain = DHChain(tuple(rows), model.chain.convention, model.chain.T_last_tool)
    last = forward_kinematics(chain, q)
    if link is not None:
        last = frame_transforms(chain, q)[row_index(chain, link)]
    T = T_CAMERA_BASE @ last
    return make_transform(at.turn @ T[:3, :3], anchor_m + at.shift_m + at.turn @ (T[:3, 3] - anchor_m))


@pytest.mark.parametrize(("chain", "error", "q", "links"), CASES)
def test_links_are_moved_and_turned_about_the_anchor(
    chain: DHChain, error: KinematicError, q: Array, links: tuple[str | None, ...]
) -> None:
    """Poses equal the definition within 1e-13, derivatives central differences of it to 1e-8."""
    model, robot = ErrorModel(chain, error), moving_robot(chain, q)
    anchor_m = model.anchor_m(robot)
    at = model.no_correction().retract(0.05 * np.random.default_rng(1).normal(size=model.size))
    found = model.links(model.nominal(robot), at, anchor_m)
    for name in links:
        link, T = found.link(name), by_definition(model, robot, at, anchor_m, name)
        assert found.link(name) is link
        np.testing.assert_allclose(link.T_camera_link, T, atol=1e-13)
        for column in range(model.size):
            step = 1e-6 * np.eye(model.size)[column]
            ahead, back = (
                by_definition(model, robot, at.retract(sign * step), anchor_m, name) for sign in (1.0, -1.0)
            )
            slope = np.concatenate(
                [ahead[:3, 3] - back[:3, 3], rotation_vector(ahead[:3, :3] @ back[:3, :3].T)]
            )
            np.testing.assert_allclose(link.derivative[:, column], slope / 2e-6, atol=1e-8)


def test_a_stack_of_states_equals_each() -> None:
    """Links of several states under one correction, within 1e-13."""
    model = ErrorModel(CHAIN, PROFILE.kinematic_error)
    robots = [RobotState(CHAIN, k, POSTURE + 0.02 * k, T_CAMERA_BASE) for k in range(4)]
    anchor_m = model.anchor_m(robots[0])
    at = model.no_correction().retract(0.05 * np.random.default_rng(1).normal(size=model.size))
    together = model.links(model.nominal_of_many(robots), at, anchor_m)
    for k, robot in enumerate(robots):
        alone = model.links(model.nominal(robot), at, anchor_m)
        for name in (None, "yaw", CHAIN.rows[0].name):
            np.testing.assert_allclose(
                together.link(name).T_camera_link[k], alone.link(name).T_camera_link, atol=1e-13
            )
            np.testing.assert_allclose(
                together.link(name).derivative[k], alone.link(name).derivative, atol=1e-13
            )


def test_a_row_that_the_chain_lacks_is_an_error() -> None:
    """Its name and those of the rows that there are."""
    model, robot = ErrorModel(CHAIN, PROFILE.kinematic_error), RobotState(CHAIN, 0, POSTURE, T_CAMERA_BASE)
    links = model.links(model.nominal(robot), model.no_correction(), model.anchor_m(robot))
    with pytest.raises(ValueError, match="no row elbow; it has"):
        links.link("elbow")
