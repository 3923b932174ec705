"""Hand-eye: where a robot's base stands for the camera, from the tool that a method sees and the robot reports."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from svmdist.errors import KinematicsError, RecordingError, UsageError
from svmdist.estimation.filter.error_model import ErrorModel
from svmdist.estimation.hand_eye import HandEyeFit, ToolPlaces, fit_hand_eye
from svmdist.kinematics.chain import chain_of
from svmdist.kinematics.dh import DHChain
from svmdist.kinematics.robot_state import RobotState
from svmdist.kinematics.shaft_axis import shaft_of
from svmdist.profile import Profile
from svmdist.profile_hand_eye import ConstantEffect, HandEye
from svmdist.recording.arms import FixedTransform
from svmdist.recording.reader import Recording
from svmdist.results import Failure, FrameResult, ToolPose
from svmdist.samples import JointSample
from svmdist.stated_deviations import (
    BASELINE,
    FOCAL_LENGTH,
    PRINCIPAL_POINT,
    SHAFT_RADIUS,
    TAG_SIZE,
    stated_deviations,
)
from svmdist.tracks import JointTrack
from svmdist.transforms import Array, inverse, rotation_angle, skew
from svmdist.workflows.replay import replay
from svmdist.workflows.setup import Setup

SEEING_METHODS = ("fiducial", "stereo", "shaft")
"""Methods whose tool is from the images alone, the surest first."""
Against = Literal["kinematics", "pose"]
NEAR_NS = 200_000_000
"""Joints within this of an image tell their rates."""


@dataclass(frozen=True)
class HandEyeResult:
    """The transform of an instrument's base, and how it was found.

    `tool_std_m` is how certain the transform places the tool, at the middle of the places that were seen, in the worst
    direction; `from_log` how far the log's own transform is from it: turn in rad and shift of the tool in m.
    """

    hand_eye: HandEye
    fit: HandEyeFit
    stamps_ns: NDArray[np.int64]
    tool_std_m: float
    from_log: tuple[float, float] | None


@dataclass(frozen=True)
class _Reported:
    """What the robot reports at stamps: poses in the base's frame (n, 4, 4), which are known, and their errors.

    `axes` (n, 3) are the shaft's directions, NaN where not known; `noise` (n, 3, 3) what differs from frame to frame;
    `shared` (n, 6, m) what errors of all frames do to place and direction, of the constants `names`.
    """

    T_base_tool: Array
    valid: NDArray[np.bool_]
    axes: Array
    noise: Array
    shared: Array
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Fitted:
    """The fit, or why there is none, the places that it is of, and what constants did to it."""

    fit: HandEyeFit | Failure
    places: ToolPlaces
    effects: tuple[ConstantEffect, ...]


def hand_eye(
    recording: Recording,
    setup: Setup,
    instrument: str,
    against: Against | None = None,
    jobs: int | None = None,
) -> HandEyeResult | Failure:
    """Fit the camera-to-base transform of an instrument; a Failure says why it cannot be told.

    The method of the setup sees the tool, without any transform of the log. `against` is what the robot reports:
    kinematics of its joints, or poses; None takes the joints where log and profile have them. With joints, a second
    pass lets the method know how the wrist is bent in the camera's frame, by the transform of the first pass.
    Raises UsageError for a method that does not see the tool, RecordingError where the log lacks joints and poses.
    """
    if setup.method not in SEEING_METHODS:
        raise UsageError(
            f"--method {setup.method}: hand-eye needs the tool as images show it: {', '.join(SEEING_METHODS)}"
        )
    profile = replace_profile(setup.profile, instrument)
    own = recording.for_instrument(instrument)
    against = against or _default(own, profile)
    blind = recording.with_bases({name: FixedTransform(None) for name in recording.instruments})
    focal_px = float(recording.camera.K[0, 0])
    rows = _seen(blind, setup, instrument, jobs)
    reported = _reported(own, profile, against, _stamps(rows))
    fitted = _fit(rows, reported, setup, profile, focal_px)
    if isinstance(fitted.fit, HandEyeFit) and against == "kinematics" and setup.method != "fiducial":
        knowing = blind.with_bases({instrument: FixedTransform(fitted.fit.T_camera_base)})
        again = _seen(knowing, setup, instrument, jobs)
        reported_again = _reported(own, profile, against, _stamps(again))
        second = _fit(again, reported_again, setup, profile, focal_px)
        if isinstance(second.fit, HandEyeFit):
            rows, fitted = again, second
    if isinstance(fitted.fit, Failure):
        return fitted.fit
    return _result(fitted.fit, fitted, _stamps(rows), own, setup, profile, against)


def replace_profile(profile: Profile, instrument: str) -> Profile:
    """The profile as one of its instruments sees it, without an earlier hand-eye file."""
    return profile.model_copy(update={"hand_eye": None}).for_instrument(instrument)


def _default(recording: Recording, profile: Profile) -> Against:
    if profile.robot is not None and recording.topic_of("joints") is not None:
        names = recording.joint_track().names
        there = set(names)
        if all(
            there & {joint.name, *joint.aliases} for joint in profile.robot.joints if joint.type != "fixed"
        ):
            return "kinematics"
    if recording.topic_of("pose") is not None:
        return "pose"
    raise RecordingError(
        f"{recording.path.name}: no joint states of profile {profile.name}'s chain and no poses of"
        f" {profile.instrument_name}: hand-eye needs the one or the other"
    )


def _seen(recording: Recording, setup: Setup, instrument: str, jobs: int | None) -> list[FrameResult]:
    """The rows in which the method saw the tool."""
    bare = replace(setup, profile=setup.profile.model_copy(update={"hand_eye": None}))
    rows = [replayed.results[0] for (replayed,) in replay(recording, [bare], wanted=[instrument], jobs=jobs)]
    return [row for row in rows if row.measured and row.tool is not None]


def _stamps(rows: Sequence[FrameResult]) -> NDArray[np.int64]:
    return np.array([row.stamp_ns for row in rows], np.int64)


def _reported(
    recording: Recording, profile: Profile, against: Against, stamps_ns: NDArray[np.int64]
) -> _Reported:
    if against == "pose":
        poses = recording.pose_track().at(stamps_ns)
        count = len(stamps_ns)
        noise = profile.settings.hand_eye.pose_std_m**2 * np.eye(3)
        return _Reported(
            poses.values,
            poses.valid,
            np.full((count, 3), np.nan),
            np.repeat(noise[None], count, 0),
            np.zeros((count, 6, 0)),
        )
    return _by_joints(recording, profile, stamps_ns)


def _by_joints(recording: Recording, profile: Profile, stamps_ns: NDArray[np.int64]) -> _Reported:
    """Forward kinematics with the deviations that the profile states: play differs, all else is shared."""
    if profile.robot is None:
        raise RecordingError(f"profile {profile.name} has no [robot]: kinematics need its chain")
    chain = chain_of(profile.robot)
    model = ErrorModel(chain, profile.kinematic_error)
    shaft, joints = shaft_of(chain), recording.joint_track()
    names, shared_columns = tuple(model.constant_columns), list(model.constant_columns.values())
    poses, axes, noise, shared = [], [], [], []
    sampled = joints.at(stamps_ns)
    for stamp_ns, positions, valid in zip(stamps_ns, sampled.values, sampled.valid, strict=True):
        state = _state(chain, joints, int(stamp_ns), positions) if valid else None
        if state is None:
            poses.append(np.full((4, 4), np.nan))
            axes.append(np.full(3, np.nan))
            noise.append(np.zeros((3, 3)))
            shared.append(np.zeros((6, len(shared_columns))))
            continue
        links = model.links(model.nominal(state), model.no_correction(), model.anchor_m(state))
        tool = links.link(None)
        std = np.sqrt(np.diag(model.prior(state)))[shared_columns]
        play = tool.derivative[:3] @ model.play_covariance @ tool.derivative[:3].T
        axis, turned = np.full(3, np.nan), np.zeros((3, len(shared_columns)))
        if shaft is not None:
            link = links.link(shaft.link)
            axis = link.T_camera_link[:3, :3] @ shaft.axis
            turned = -skew(axis) @ link.derivative[3:][:, shared_columns]
        poses.append(tool.T_camera_link)
        axes.append(axis)
        noise.append(play)
        shared.append(np.vstack([tool.derivative[:3][:, shared_columns], turned]) * std)
    return _Reported(
        np.reshape(poses, (-1, 4, 4)),
        np.asarray(sampled.valid),
        np.reshape(axes, (-1, 3)),
        np.reshape(noise, (-1, 3, 3)),
        np.reshape(shared, (-1, 6, len(shared_columns))),
        names,
    )


def _state(chain: DHChain, joints: JointTrack, stamp_ns: int, positions: Array) -> RobotState:
    """The robot with its base at the camera: what follows is in the base's frame."""
    near = np.abs(joints.stamps_ns - stamp_ns) <= NEAR_NS
    track = JointTrack(joints.stamps_ns[near], joints.names, joints.positions[near]) if near.any() else None
    sample = JointSample(stamp_ns, joints.names, positions)
    state = RobotState.of(chain, sample, np.eye(4), stamp_ns, track)
    if isinstance(state, Failure):
        raise KinematicsError(state.reason)
    return state


def _fit(
    rows: Sequence[FrameResult], reported: _Reported, setup: Setup, profile: Profile, focal_px: float
) -> _Fitted:
    known = np.flatnonzero(reported.valid)
    tools = [_pose(rows[int(place)]) for place in known]
    seen_m = np.reshape([tool.position_m for tool in tools], (-1, 3))
    camera = _camera_errors(seen_m, setup.method, profile, focal_px)
    places = ToolPlaces(
        _stamps(rows)[known],
        seen_m,
        np.reshape([tool.position_covariance for tool in tools], (-1, 3, 3)),
        reported.T_base_tool[known, :3, 3],
        reported.noise[known],
        np.reshape([tool.axis for tool in tools], (-1, 3)),
        np.where(np.isfinite(reported.axes[known]).all(1), [tool.shaft_std_rad for tool in tools], np.nan),
        reported.axes[known],
        reported.shared[known],
        np.concatenate(list(camera.values()), 2),
    )
    fit = fit_hand_eye(places, profile.settings.hand_eye)
    return _Fitted(
        fit, places, () if isinstance(fit, Failure) else tuple(_effects(fit, reported, camera, profile))
    )


def _pose(row: FrameResult) -> ToolPose:
    assert row.tool is not None
    return row.tool.pose


SEEN_SIZES = {"fiducial": TAG_SIZE, "shaft": SHAFT_RADIUS, "stereo": BASELINE}
"""The size that depth goes by, for each method that sees the tool."""


def _camera_errors(seen_m: Array, method: str, profile: Profile, focal_px: float) -> dict[str, Array]:
    """What constants of the camera, and of what is seen, that are larger than stated do to places, by their names.

    Each is (n, 6, k), for one deviation of each of its k numbers. By a size that is stated too small, or a baseline,
    a place is seen too near; by a focal length its depth is. A principal point turns places about the camera; what it
    does to directions is small beside their own deviation.
    """
    stated = stated_deviations(profile)
    depth_m, turn_rad = seen_m * [0.0, 0.0, 1.0], stated[PRINCIPAL_POINT] / focal_px
    turns = np.array([[0.0, turn_rad, 0.0], [-turn_rad, 0.0, 0.0]])
    return {
        SEEN_SIZES[method]: _alone(-stated.get(SEEN_SIZES[method], 0.0) * seen_m)[..., None],
        FOCAL_LENGTH: _alone(-stated[FOCAL_LENGTH] * depth_m)[..., None],
        PRINCIPAL_POINT: np.stack([_alone(np.cross(turn, seen_m)) for turn in turns], -1),
    }


def _effects(
    fit: HandEyeFit, reported: _Reported, camera: Mapping[str, Array], profile: Profile
) -> Iterator[ConstantEffect]:
    """What each constant did to a fit, for the estimators that use it; without those that are stated to be exact."""
    counts = dict.fromkeys(reported.names, 1) | {name: errors.shape[2] for name, errors in camera.items()}
    stated, at = stated_deviations(profile), 0
    for name, count in counts.items():
        rows, at = fit.effects[:, at : at + count].T, at + count
        if stated.get(name, 0.0) > 0.0:
            yield ConstantEffect(constant=name, deviation=stated[name], effects=rows.tolist())


def _alone(shift_m: Array) -> Array:
    """A shift that turns nothing."""
    return np.concatenate([shift_m, np.zeros_like(shift_m)], 1)


def _result(
    fit: HandEyeFit,
    fitted: _Fitted,
    stamps_ns: NDArray[np.int64],
    recording: Recording,
    setup: Setup,
    profile: Profile,
    against: Against,
) -> HandEyeResult:
    T, frames = fit.T_camera_base, profile.frames
    C = 0.5 * (fit.covariance + fit.covariance.T)
    stated = HandEye.model_validate(
        {
            "instrument": profile.instrument_name,
            "camera": frames.camera,
            "base": frames.base,
            "rotation": T[:3, :3].tolist(),
            "translation_m": T[:3, 3].tolist(),
            "covariance": C.tolist(),
            "method": setup.method,
            "reference": against,
            "frame_count": len(fit.agrees),
            "inlier_count": int(fit.agrees.sum()),
            "constants": fitted.effects,
            "residual_rms_m": float(np.sqrt(np.mean(fit.residuals_m[fit.agrees] ** 2))),
        }
    )
    middle_m = fitted.places.seen_m[fit.agrees].mean(0)
    tool_std_m = float(np.sqrt(np.linalg.eigvalsh(stated.covariance_at(middle_m)[:3, :3])[-1]))
    return HandEyeResult(stated, fit, stamps_ns, tool_std_m, _from_log(recording, profile, T, middle_m))


def _from_log(
    recording: Recording, profile: Profile, T_camera_base: Array, middle_m: Array
) -> tuple[float, float] | None:
    """How far the log's own transform is from a fitted one: turn in rad, and shift of the tool in m."""
    try:
        track = recording.transform_track(profile.frames.camera, profile.frames.base)
    except RecordingError:
        return None
    if len(track.stamps_ns) == 0:
        return None
    T_log = track.T_parent_child[0]
    nominal = inverse(T_camera_base) @ np.append(middle_m, 1.0)
    turn_rad = float(rotation_angle(T_log[:3, :3], T_camera_base[:3, :3]))
    return turn_rad, float(np.linalg.norm((T_log @ nominal)[:3] - middle_m))
