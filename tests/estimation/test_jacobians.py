"""Derivatives against central differences: measurements, corrected links, residuals of the shaft."""

from dataclasses import replace

import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.estimation.instrument import measurement as kinds
from svmdist.estimation.instrument.error_model import CorrectedLink, CorrectedLinks, Correction, ErrorModel
from svmdist.estimation.instrument.measurement import END_BIAS, EXACT, JAWS, LinkMeasurement, PointError
from svmdist.estimation.instrument.state import linearise
from svmdist.kinematics import DHChain, ShaftAxis, forward_kinematics, frame_transforms, row_index
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile.robot import CameraError, Joint, KinematicError
from svmdist.tracks import JointTrack
from svmdist.transforms import Array, make_transform, rotation_of, rotation_vector, rotation_x
from svmdist.vision.lines import TangentPlane
from svmdist.vision.silhouette import Rim
from tests.jacobian import check_jacobian, nudged
from tests.shipped import CHAIN, POSTURE, PROFILE

IDEAL = Camera.from_horizontal_fov(640, 480, np.pi / 3)
LENS = replace(IDEAL, D=np.array([-0.3, 0.12, 2e-3, -1e-3, -0.02]))
T_LINK = make_transform(rotation_of([0.4, -0.7, 0.2]), [0.01, -0.02, 0.09])
T_RIGHT_LEFT = make_transform(rotation_of([0.0, 0.01, 0.002]), [-0.005, 0.0, 0.0])


def shaded(place_std_m: float, shading_px: float = 0.0) -> PointError:
    return PointError("point", place_std_m, 0.0, shading_px)


rng = np.random.default_rng(0)
ACROSS = np.linalg.qr(rng.normal(size=(3, 3)))[0]
AXIS, ROOT = ACROSS[2], rng.normal(size=(6, 6))
NEAR, FAR = (
    make_transform(rotation_of(turn * rng.normal(size=3)) @ T_LINK[:3, :3], [0.012, -0.02, 0.088])
    for turn in (1e-9, 0.9)
)
P_M, PIXELS = rng.normal(0.0, 0.003, (4, 3)), rng.uniform(0.0, 400.0, (4, 2))


def made(name: str, in_view: kinds.InView, covariance: Array, link: str | None = None) -> LinkMeasurement:
    return LinkMeasurement(name=name, in_view=in_view, covariance=covariance, link=link, correlation_time_s=30.0)


def origin(error: PointError) -> LinkMeasurement:
    return made("origin", kinds.point(IDEAL, PIXELS[0], np.zeros(3), error), np.diag([0.2, 0.3]))


def pair(
    error: PointError, left: Camera = IDEAL, right: Camera = IDEAL, disparity_px: float = 30.0, name: str = "ideal"
) -> LinkMeasurement:
    return made(name, kinds.disparity((left, right), T_RIGHT_LEFT, disparity_px, np.zeros(3), error), np.eye(1))


def end(
    name: str, ahead_m: float = 0.003, radius_m: float = 0.0, std_m: float = 2e-4, std_px: float = 0.0
) -> LinkMeasurement:
    rim, hinge_m = Rim(PIXELS[2], np.array([0.6, 0.8]), 1.0), np.array([0.001, 0.002, 0.004])
    place = AXIS, hinge_m, ahead_m, radius_m
    return made(name, kinds.shaft_end(IDEAL, rim, *place, std_m, std_px, EXACT), np.eye(1), "shaft")


def edge(side: int) -> LinkMeasurement:
    contour, shaft = (
        TangentPlane(ACROSS[0], np.zeros((3, 3)), side),
        ShaftAxis("shaft", np.array([0.001, -0.002, 0.003]), AXIS),
    )
    by_bias = np.diag(np.sqrt([2e-4, 1e-6]))
    in_view = kinds.edge(contour, ACROSS[:2], by_bias, shaft, 0.004, 0.0, np.ones(2), EXACT)
    return made(f"edge {side}", in_view, np.diag([1e-4, 1e-6]), "shaft")


def measurements() -> list[LinkMeasurement]:
    """All kinds, also off the link's origin, through a lens, and with large residuals."""
    T_frame = make_transform(rotation_of([0.1, 0.3, -0.2]), [0.002, 0.004, -0.003])
    ends = [end("dark end", -0.006, 0.004), end("outline's end")]
    sides = [edge(1), edge(-1)]
    return [
        origin(shaded(1e-4, 0.7)),
        made("corner", kinds.point(LENS, PIXELS[1], P_M[0], shaded(2e-4)), np.eye(2), "tag"),
        *ends,
        *(replace(one, name=f"right {one.name}", T_view_left=T_RIGHT_LEFT) for one in (sides[0], ends[0])),
        pair(shaded(1e-4, 0.5)),
        pair(shaded(1e-4), left=LENS, name="lens"),
        made("size", kinds.sphere_size(IDEAL, 0.00175, 0.0, 12.0, 0.2, 0.5), np.eye(1)),
        *sides,
        made("near", kinds.pose(T_frame, NEAR @ T_frame, ROOT), np.eye(6), "tag"),
        made("far", kinds.pose(T_frame, FAR, np.eye(6)), np.eye(6), "tag"),
    ]


def test_what_looks_like_the_shafts_end_does_so_in_the_next_frame():
    """Its deviation in the image is no noise that many frames take away: it lasts as that of the model does."""
    by_model = end("end", std_m=1e-3).linearise(T_LINK).biases[0].jacobian
    both = end("end", std_m=1e-3, std_px=20.0).linearise(T_LINK).biases[0].jacobian
    assert both == pytest.approx(np.copysign(np.hypot(by_model, 20.0), by_model))


def test_what_is_found_between_end_and_tips_is_off_with_both():
    """In the image and in disparity, to the same side, under one name: one error does not look like two."""
    ahead_m = 1e-3 * T_LINK[:3, :3] @ AXIS
    moved = nudged(T_LINK, np.concatenate([ahead_m, np.zeros(3)]))
    for kind in (origin, pair):
        one = kind(shaded(1e-4, 0.5))
        own = {bias.name for bias in one.linearise(T_LINK).biases[1:]}
        assert END_BIAS not in own
        off = {bias.name: bias for bias in kind(PointError(with_end_m=ahead_m)).linearise(T_LINK).biases[1:]}
        # As if the tool were nearer by as much: what is measured would be what is predicted there.
        expected = one.linearise(T_LINK).residual - one.linearise(moved).residual
        assert off[END_BIAS].jacobian[:, 0] == pytest.approx(expected, rel=0.05)
        assert off[END_BIAS].correlation_time_s == one.correlation_time_s
        # Jaws that are longer by a deviation put it as much farther along them: the tool's x.
        longer = np.concatenate([5e-4 * T_LINK[:3, 0], np.zeros(3)])
        expected = one.linearise(T_LINK).residual - one.linearise(nudged(T_LINK, longer)).residual
        error = PointError(with_end_m=ahead_m, with_jaws_m=5e-4)
        both = kind(error).linearise(T_LINK).biases[1:]
        by_jaws = next(bias.jacobian for bias in both if bias.name == JAWS)
        assert by_jaws == pytest.approx(np.column_stack([expected, np.zeros((len(expected), 6))]), rel=0.05)
    found, there = (end("end", std_m=1e-3).linearise(T) for T in (T_LINK, moved))
    assert found.biases[0].jacobian[0] == pytest.approx(found.residual - there.residual, rel=0.05)


def test_where_the_right_picture_is_cut_does_not_matter_for_disparity():
    """Principal points that stand 60 px apart change what is measured by as much, and no deviation of it."""
    K = IDEAL.K + np.array([[0.0, 0.0, 60.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    whole, cut = (
        pair(shaded(1e-4, 0.5), right=replace(IDEAL, K=at), disparity_px=30.0 - at[0, 2] + IDEAL.K[0, 2])
        for at in (IDEAL.K, K)
    )
    unsure = CameraError(focal_std_fraction=0.01)
    found, other = (replace(one, camera_error=unsure).linearise(T_LINK) for one in (whole, cut))
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
