"""Derivatives against central differences: measurements, corrected links, residuals of the shaft."""

from dataclasses import replace

import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.estimation.instrument.error_model import CorrectedLink, CorrectedLinks, Correction, ErrorModel
from svmdist.estimation.instrument.measurement import Deviations, LinkMeasurement
from svmdist.estimation.instrument.measurement_kinds import (
    END_BIAS,
    JAWS,
    ContourMeasurement,
    DisparityMeasurement,
    EndMeasurement,
    PointError,
    PointMeasurement,
    PoseMeasurement,
    SizeMeasurement,
)
from svmdist.estimation.instrument.state import linearise
from svmdist.kinematics import DHChain, forward_kinematics, frame_transforms, row_index
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile.robot import CameraError, Joint, KinematicError
from svmdist.tracks import JointTrack
from svmdist.transforms import Array, make_transform, rotation_of, rotation_vector, rotation_x
from tests.jacobian import check_jacobian, nudged
from tests.shipped import CHAIN, POSTURE, PROFILE

IDEAL = Camera.from_horizontal_fov(640, 480, np.pi / 3)
LENS = replace(IDEAL, D=np.array([-0.3, 0.12, 2e-3, -1e-3, -0.02]))
T_LINK = make_transform(rotation_of([0.4, -0.7, 0.2]), [0.01, -0.02, 0.09])
T_RIGHT_LEFT = make_transform(rotation_of([0.0, 0.01, 0.002]), [-0.005, 0.0, 0.0])


def shaded(place_std_m: float, shading_px: float = 0.0) -> PointError:
    return PointError("point", place_std_m, 0.0, shading_px)


PAIR = DisparityMeasurement(
    name="ideal",
    link=None,
    left=IDEAL,
    right=IDEAL,
    T_right_left=T_RIGHT_LEFT,
    disparity_px=30.0,
    covariance=np.eye(1),
    correlation_time_s=30.0,
    error=shaded(1e-4, 0.5),
)


def measurements() -> list[LinkMeasurement]:
    """All kinds, also off the link's origin, through a lens, and with large residuals."""
    rng = np.random.default_rng(0)
    across = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    axis = across[2]
    root = rng.normal(size=(6, 6))
    T_frame = make_transform(rotation_of([0.1, 0.3, -0.2]), [0.002, 0.004, -0.003])
    near, far = (
        make_transform(rotation_of(turn * rng.normal(size=3)) @ T_LINK[:3, :3], [0.012, -0.02, 0.088])
        for turn in (1e-9, 0.9)
    )
    p_m, pixels = rng.normal(0.0, 0.003, (4, 3)), rng.uniform(0.0, 400.0, (4, 2))
    p_axis_m = np.array([0.001, -0.002, 0.003])
    edge = ContourMeasurement(
        name="edge 1",
        link="shaft",
        normal=across[0],
        across=across[:2],
        covariance=np.diag([1e-4, 1e-6]),
        p_axis_m=p_axis_m,
        axis=axis,
        radius_m=0.004,
        side=1,
        by_bias=np.diag(np.sqrt([2e-4, 1e-6])),
        correlation_time_s=30.0,
    )
    sides = [edge, replace(edge, name="edge -1", side=-1)]
    end = EndMeasurement(
        name="dark end",
        link="shaft",
        camera=IDEAL,
        pixel=pixels[2],
        towards_tip=np.array([0.6, 0.8]),
        covariance=np.eye(1),
        p_hinge_m=np.array([0.001, 0.002, 0.004]),
        axis=axis,
        ahead_m=-0.006,
        radius_m=0.004,
        model_std_m=2e-4,
        correlation_time_s=30.0,
    )
    ends = [end, replace(end, name="outline's end", ahead_m=0.003, radius_m=0.0)]
    origin = PointMeasurement(
        name="origin",
        link=None,
        camera=IDEAL,
        pixel=pixels[0],
        covariance=np.diag([0.2, 0.3]),
        error=shaded(1e-4, 0.7),
        correlation_time_s=30.0,
    )
    corner = {"camera": LENS, "p_link_m": p_m[0], "pixel": pixels[1], "covariance": np.eye(2)}
    size = {"camera": IDEAL, "radius_m": 0.00175, "radius_px": 12.0, "covariance": np.eye(1)}
    pose = PoseMeasurement(
        name="near",
        link="tag",
        T_link_frame=T_frame,
        T_camera_frame=near @ T_frame,
        covariance=np.eye(6),
        by_bias=root,
    )
    return [
        origin,
        replace(origin, name="corner", link="tag", error=shaded(2e-4), **corner),
        *ends,
        *(replace(one, name=f"right {one.name}", T_view_left=T_RIGHT_LEFT) for one in (sides[0], ends[0])),
        PAIR,
        replace(PAIR, name="lens", left=LENS, error=shaded(1e-4)),
        SizeMeasurement(name="size", link=None, bias_std_px=0.2, hidden_std_px=0.5, correlation_time_s=30.0, **size),
        *sides,
        pose,
        replace(pose, name="far", T_camera_frame=far, by_bias=np.eye(6)),
    ]


def test_what_looks_like_the_shafts_end_does_so_in_the_next_frame():
    """Its deviation in the image is no noise that many frames take away: it lasts as that of the model does."""
    _, _, _, end, *_ = measurements()
    by_model = replace(end, model_std_m=1e-3).linearise(T_LINK).biases[0].jacobian
    both = replace(end, model_std_m=1e-3, bias_std_px=20.0).linearise(T_LINK).biases[0].jacobian
    assert both == pytest.approx(np.copysign(np.hypot(by_model, 20.0), by_model))


def test_what_is_found_between_end_and_tips_is_off_with_both():
    """In the image and in disparity, to the same side, under one name: one error does not look like two."""
    origin, _, _, end, *_ = measurements()
    ahead_m = 1e-3 * T_LINK[:3, :3] @ end.axis
    moved = nudged(T_LINK, np.concatenate([ahead_m, np.zeros(3)]))
    for one in (origin, PAIR):
        own = {bias.name for bias in one.linearise(T_LINK).biases[1:]}
        assert END_BIAS not in own
        off = {
            bias.name: bias for bias in replace(one, error=PointError(with_end_m=ahead_m)).linearise(T_LINK).biases[1:]
        }
        # As if the tool were nearer by as much: what is measured would be what is predicted there.
        expected = one.linearise(T_LINK).residual - one.linearise(moved).residual
        assert off[END_BIAS].jacobian[:, 0] == pytest.approx(expected, rel=0.05)
        assert off[END_BIAS].correlation_time_s == end.correlation_time_s
        # Jaws that are longer by a deviation put it as much farther along them: the tool's x.
        longer = np.concatenate([5e-4 * T_LINK[:3, 0], np.zeros(3)])
        expected = one.linearise(T_LINK).residual - one.linearise(nudged(T_LINK, longer)).residual
        error = PointError(with_end_m=ahead_m, with_jaws_m=5e-4)
        both = replace(one, error=error).linearise(T_LINK).biases[1:]
        by_jaws = next(bias.jacobian for bias in both if bias.name == JAWS)
        assert by_jaws == pytest.approx(np.column_stack([expected, np.zeros((len(expected), 6))]), rel=0.05)
    by_end = replace(end, model_std_m=1e-3).linearise(T_LINK).biases[0].jacobian
    assert by_end[0] == pytest.approx(end.linearise(T_LINK).residual - end.linearise(moved).residual, rel=0.05)


def test_where_the_right_picture_is_cut_does_not_matter_for_disparity():
    """Principal points that stand 60 px apart change what is measured by as much, and no deviation of it."""
    K = IDEAL.K + np.array([[0.0, 0.0, 60.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    cut = replace(PAIR, right=replace(IDEAL, K=K), disparity_px=PAIR.disparity_px - 60.0)
    unsure = Deviations(CameraError(focal_std_fraction=0.01))
    found, other = (replace(one, deviations=unsure).linearise(T_LINK) for one in (PAIR, cut))
    assert found.residual == pytest.approx(other.residual)
    assert any(np.abs(bias.jacobian).max() > 0.1 for bias in found.biases)
    for one, same in zip(found.biases, other.biases, strict=True):
        assert one.jacobian == pytest.approx(same.jacobian), one.name


def test_what_is_seen_later_is_compared_with_where_the_link_has_gone():
    """By the joints' rates, and uncertain by a tenth of that; by a speed that is stated where no joints tell it."""
    delay_s, velocity = 0.009, np.array([0.03, -0.02, 0.04, 0.5, -0.3, 0.2])
    link = CorrectedLink(T_LINK, np.zeros((6, 3)), velocity)
    for one in measurements():
        late = linearise(replace(one, delay_s=delay_s), link)
        there = one.linearise(nudged(T_LINK, velocity * delay_s)).residual
        np.testing.assert_allclose(late.residual, there, rtol=1e-2, atol=1e-3 * np.abs(there).max())
        *_, motion = late.biases
        by_m = one.linearise(T_LINK).H[:, :3]
        std_m = 0.1 * np.linalg.norm(velocity[:3]) * delay_s
        np.testing.assert_allclose(motion.jacobian @ motion.jacobian.T, std_m**2 * by_m @ by_m.T)
        still = linearise(replace(one, delay_s=delay_s), replace(link, velocity=np.zeros(6)))
        np.testing.assert_array_equal(still.residual, one.linearise(T_LINK).residual)
        assert np.abs(still.biases[-1].jacobian).max() > np.abs(motion.jacobian).max()


@pytest.mark.parametrize("measurement", measurements(), ids=lambda measurement: measurement.name)
def test_derivatives_are_those_of_the_residual(measurement):
    """To 1e-7 of the largest element; rounding over the step leaves 1e-9 px/m of some 1e4."""
    found = measurement.linearise(T_LINK)
    assert found.H.shape == (len(measurement.covariance), 6)
    check_jacobian(lambda step: measurement.linearise(nudged(T_LINK, step)).residual, -found.H, relative=1e-7)


T_CAMERA_BASE = make_transform(rotation_of([2.0, 0.4, -0.3]), [0.1, -0.2, 0.9])
rng = np.random.default_rng(11)
LENGTHS = ("a_m", "alpha_rad", "d_m", "theta_rad")
ROWS = tuple(
    Joint(name=f"j{index}", type=kind, **dict(zip(LENGTHS, rng.uniform(-1.0, 1.0, 4), strict=True)))
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


def by_definition(model: ErrorModel, robot: RobotState, at: Correction, link: str | None) -> Array:
    """The corrected pose as the head of `correction` writes it, by a chain with other lengths."""
    count = len(model.turns)
    shift_m, _, q_offset, play, (late_s,), length_m = np.split(at.x, np.cumsum([3, 3, count, count, 1]))
    q, moving = robot.q.copy(), slice(-count, None)
    q[moving] += robot.rates[moving] * late_s + q_offset + play
    rows, lengths = list(model.chain.rows), iter(length_m)
    is_modified = model.chain.convention == "modified"
    first = int(model.chain.moving_rows[len(q) - count])
    for index in range(first + is_modified, len(rows)):
        row = rows[index]
        if row.a_m != 0.0:
            rows[index] = rows[index].model_copy(update={"a_m": row.a_m + next(lengths)})
        if row.d_m != 0.0 and row.type != "prismatic" and (is_modified or index > first):
            rows[index] = rows[index].model_copy(update={"d_m": row.d_m + next(lengths)})
    assert next(lengths, None) is None
    chain = DHChain(tuple(rows), model.chain.convention, model.chain.T_last_tool)
    last = forward_kinematics(chain, q)
    if link is not None:
        last = frame_transforms(chain, q)[row_index(chain, link)]
    T = T_CAMERA_BASE @ last
    return make_transform(at.turn @ T[:3, :3], at.anchor_m + shift_m + at.turn @ (T[:3, 3] - at.anchor_m))


@pytest.mark.parametrize(("chain", "error", "q", "links"), CASES)
def test_links_are_moved_and_turned_about_the_anchor(chain, error, q, links):
    """Poses equal the definition within 1e-13, derivatives central differences of it to 1e-8."""
    model, robot = ErrorModel(chain, error), moving_robot(chain, q)
    at = model.no_correction(robot).retract(0.05 * np.random.default_rng(1).normal(size=model.size))
    found = CorrectedLinks(model, robot, at)
    for name in links:
        link, T = found.link(name), by_definition(model, robot, at, name)
        assert found.link(name) is link
        np.testing.assert_allclose(link.T_camera_link, T, atol=1e-13)

        def pose(step: Array, name: str | None = name, T: Array = T) -> Array:
            stepped = by_definition(model, robot, at.retract(step), name)
            return np.concatenate([stepped[:3, 3], rotation_vector(stepped[:3, :3] @ T[:3, :3].T)])

        check_jacobian(pose, link.derivative, absolute=1e-8)
