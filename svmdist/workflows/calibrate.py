"""Calibrations fitted to logs: of the paper's plane, and of the camera to a robot's base; and a robot's tool poses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import Literal

import numpy as np

from svmdist.camera import Camera
from svmdist.errors import CalibrationError, KinematicsError, RecordingError
from svmdist.estimation import plane_mapping
from svmdist.estimation.alignment import HandEyeFit, ToolPlaces, fit_hand_eye
from svmdist.estimation.instrument.error_model import ErrorModel
from svmdist.kinematics import forward_kinematics, select_joints, shaft_of
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile import Profile
from svmdist.profile import hand_eye as hand_eye_file
from svmdist.recording.log import Recording
from svmdist.results import Failure, FrameResult
from svmdist.samples import JointSample
from svmdist.tracks import JointTrack, Mask
from svmdist.transforms import Array, Stamps, inverse, rotation_angle, skew
from svmdist.workflows.estimate import estimate
from svmdist.workflows.replay import replay
from svmdist.workflows.request import Request, Setup


@dataclass(frozen=True)
class CalibrationPart:
    """What one recording contributes to a calibration: pixels of the tool and its true places, as they are fitted."""

    name: str
    source: plane_mapping.SourceFile
    camera: Camera
    tool_px: Array
    tool_m: Array


def collect_part(recording: Recording, request: Request, jobs: int | None = None) -> CalibrationPart:
    """Pairs of tool pixel and true position in the camera's plane; RecordingError where the log has no true pose."""
    setup = replace(request.setup, mapping=plane_mapping.PUBLISHED_MAPPING)
    frames, first = setup.profile.frames, replace(recording, wanted=recording.instruments[:1])
    results = [result for result in estimate(first, setup, jobs) if result.measured]
    stamps_ns = np.array([result.stamp_ns for result in results], np.int64)
    tool_px = np.array([result.image.tool_px for result in results], np.float64).reshape(-1, 2)
    camera = recording.camera
    if changes := recording.camera_changes:
        raise CalibrationError(f"{recording.name}: one camera is calibrated: {changes[0]}")
    if camera.has_distortion and len(tool_px):
        # Planar methods measure as if the lens were ideal; results have pixels of the recorded image.
        tool_px = camera.pinhole.project(camera.rays(tool_px))
    tool = recording.transform_track(frames.camera, frames.tool, ground_truth=True).at(stamps_ns)
    source = plane_mapping.SourceFile(name=recording.path.name, sha256=recording.sha256())
    return CalibrationPart(recording.name, source, camera, tool_px[tool.valid], tool.values[tool.valid, :2, 3])


def fit_parts(parts: Sequence[CalibrationPart], method: str) -> plane_mapping.Calibration:
    """Fit a calibration; CalibrationError for different cameras, too few frames or too little of the image covered."""
    first = parts[0]
    if others := [part.name for part in parts if not first.camera.same_optics(part.camera)]:
        differ = f"{first.name} and {others[0]} differ"
        raise CalibrationError(f"recordings of different cameras cannot be calibrated together: {differ}")
    return plane_mapping.fit_calibration(
        np.concatenate([part.tool_px for part in parts]),
        np.concatenate([part.tool_m for part in parts]),
        first.camera,
        method,
        created_by=f"svmdist {version('svmdist')}",
        sources=tuple(part.source for part in parts),
    )


Against = Literal["kinematics", "pose"]
SEEN_SIZES = {"fiducial": hand_eye_file.TAG_SIZE, "stereo": hand_eye_file.BASELINE, "shaft": hand_eye_file.SHAFT_RADIUS}
"""Methods that find the tool by images alone, the most accurate first, and the size that determines their depth."""
SEEING_METHODS = tuple(SEEN_SIZES)
NEAR_NS = 200_000_000  # joint rates come from the joint states within this of an image


@dataclass(frozen=True)
class HandEyeResult:
    """The transform of an instrument's base, and how it was found."""

    hand_eye: hand_eye_file.HandEye
    fit: HandEyeFit
    tool_std_m: float  # of the tool at its mean position, in the worst direction
    from_log: tuple[float, float] | None  # how far the log's own is: rotation in rad and translation of the tool in m


def hand_eye(
    recording: Recording, setup: Setup, instrument: str, against: Against | None = None, jobs: int | None = None
) -> HandEyeResult | Failure:
    """Fit the camera-to-base transform of an instrument; a Failure says why that is impossible.

    The method of the setup sees the tool, without any transform of the log. `against` is what the robot reports, joints
    or poses; None takes joints where log and profile have them. Raises RecordingError without joints and poses.
    """
    setup = replace(setup, profile=setup.profile.model_copy(update={"hand_eye": None}))
    profile = setup.profile.for_instrument(instrument)
    own = recording.for_instrument(instrument)
    if against is None:
        robot, has_joints = profile.robot, own.topic_of("joints") is not None
        if robot is not None and has_joints and not robot.missing_joints(own.joint_track().names):
            against = "kinematics"
        elif own.topic_of("pose") is not None:
            against = "pose"
        else:
            none = f"no joint states of profile {profile.name}'s chain and no poses of {profile.instrument_name}"
            raise RecordingError(f"{own.path.name}: {none}: hand-eye needs the one or the other")

    def fit_to(log: Recording) -> HandEyeResult | Failure:
        rows = [replayed.results[0] for (replayed,) in replay(log, [setup], jobs=jobs)]
        seen = [row for row in rows if row.measured and row.tool is not None]
        found = _fit(seen, own, setup.method, profile, against)
        if isinstance(found, Failure) and len(seen) < profile.settings.hand_eye.min_count:
            said = Counter(row.detail or row.status for row in rows if not row.measured).most_common(1)
            return Failure(found.reason + "".join(f"; {count} frames say: {why}" for why, count in said))
        return found

    without = replace(recording, bases=dict.fromkeys(recording.instruments), wanted=(instrument,))
    found = fit_to(without)
    if isinstance(found, HandEyeResult) and against == "kinematics" and setup.method != "fiducial":
        # Measured with the wrist's orientation by the first fit.
        second = fit_to(replace(without, bases={**without.bases, instrument: found.fit.T_camera_base}))
        found = second if isinstance(second, HandEyeResult) else found
    return found


def _reported_tool(
    log: Recording, profile: Profile, against: Against, stamps_ns: Stamps
) -> tuple[Mask, Sequence[str], list[Array]]:
    """Where the robot reports its tool, the names of errors that all frames share, and its columns of `ToolPlaces`."""
    count = len(stamps_ns)
    nominal_m, axes = np.full((2, count, 3), np.nan)
    if against == "pose":
        poses = log.pose_track().at(stamps_ns)
        noise = np.repeat(profile.settings.hand_eye.pose_std_m**2 * np.eye(3)[None], count, 0)
        return poses.valid, (), [poses.values[:, :3, 3], noise, axes, np.zeros((count, 6, 0))]
    # Backlash is noise of each frame, and the other errors of the profile are shared by all frames.
    chain = log.chain
    model = ErrorModel(chain, profile.kinematic_error)
    shaft, joints = shaft_of(chain), log.joint_track()
    columns = list(model.parameter_columns.values())
    noise, shared = np.zeros((count, 3, 3)), np.zeros((count, 6, len(columns)))
    sampled = joints.at(stamps_ns)
    for at in np.flatnonzero(sampled.valid):
        near = np.abs(joints.stamps_ns - stamps_ns[at]) <= NEAR_NS
        around = JointTrack(joints.stamps_ns[near], joints.names, joints.positions[near])
        sample = JointSample(int(stamps_ns[at]), joints.names, sampled.values[at])
        # With the base at the camera: all that follows is in the base's frame.
        state = RobotState.of(chain, sample, np.eye(4), sample.stamp_ns, around)
        if isinstance(state, Failure):
            raise KinematicsError(state.reason)
        links = model.nominal_links(state)
        tool = links.link(None)
        nominal_m[at] = tool.T_camera_link[:3, 3]
        noise[at] = tool.derivative[:3] @ model.backlash_covariance @ tool.derivative[:3].T
        shared[at, :3] = tool.derivative[:3][:, columns]
        if shaft is not None:
            link = links.link(shaft.link)
            axes[at] = link.T_camera_link[:3, :3] @ shaft.axis
            shared[at, 3:] = -skew(axes[at]) @ link.derivative[3:][:, columns]
        shared[at] *= np.sqrt(np.diag(model.prior(state)))[columns]
    return sampled.valid, tuple(model.parameter_columns), [nominal_m, noise, axes, shared]


def _fit(
    rows: list[FrameResult], recording: Recording, method: str, profile: Profile, against: Against
) -> HandEyeResult | Failure:
    stamps_ns = np.array([row.stamp_ns for row in rows], np.int64)
    valid, shared_names, reported = _reported_tool(recording, profile, against, stamps_ns)
    known = np.flatnonzero(valid)
    nominal_m, noise, axes, shared = (column[known] for column in reported)
    tools = [rows[at].tool.pose for at in known]  # type: ignore[union-attr]  # rows of a seen tool
    seen_m = np.reshape([tool.position_m for tool in tools], (-1, 3))
    camera_names, camera_shared = _camera_errors(seen_m, method, profile, float(recording.camera.K[0, 0]))
    places = ToolPlaces(
        stamps_ns[known],
        seen_m,
        np.reshape([tool.position_covariance for tool in tools], (-1, 3, 3)),
        nominal_m,
        noise,
        np.reshape([tool.axis for tool in tools], (-1, 3)),
        np.where(np.isfinite(axes).all(1), [tool.shaft_std_rad for tool in tools], np.nan),
        axes,
        shared,
        camera_shared,
    )
    fit = fit_hand_eye(places, profile.settings.hand_eye)
    if isinstance(fit, Failure):
        return fit
    # The effect of each calibration parameter on the fit, for estimators that use it; without exact ones.
    names = np.array([*shared_names, *camera_names])
    std, effects = hand_eye_file.prior_deviations(profile), []
    for name in dict.fromkeys(names.tolist()):
        if std.get(name, 0.0) > 0.0:
            columns = fit.effects[:, names == name].T.tolist()
            effects.append(hand_eye_file.ConstantEffect(constant=name, deviation=std[name], effects=columns))
    hand_eye_of_fit = hand_eye_file.HandEye.model_validate(
        {
            "instrument": profile.instrument_name,
            "camera": profile.frames.camera,
            "base": profile.frames.base,
            "rotation": fit.T_camera_base[:3, :3].tolist(),
            "translation_m": fit.T_camera_base[:3, 3].tolist(),
            "covariance": (0.5 * (fit.covariance + fit.covariance.T)).tolist(),
            "method": method,
            "reference": against,
            "frame_count": len(fit.inliers),
            "inlier_count": int(fit.inliers.sum()),
            "constants": effects,
            "residual_rms_m": float(np.sqrt(np.mean(fit.residuals_m[fit.inliers] ** 2))),
        }
    )
    middle_m = seen_m[fit.inliers].mean(0)
    from_log = None
    with suppress(RecordingError, IndexError):  # the log has no such transform
        T_log = recording.transform_track(profile.frames.camera, profile.frames.base).T_parent_child[0]
        nominal = inverse(fit.T_camera_base) @ np.append(middle_m, 1.0)
        rotation_rad = float(rotation_angle(T_log[:3, :3], fit.T_camera_base[:3, :3]))
        from_log = rotation_rad, float(np.linalg.norm((T_log @ nominal)[:3] - middle_m))
    tool_std_m = float(np.sqrt(np.linalg.eigvalsh(hand_eye_of_fit.covariance_at(middle_m)[:3, :3])[-1]))
    return HandEyeResult(hand_eye_of_fit, fit, tool_std_m, from_log)


def _camera_errors(seen_m: Array, method: str, profile: Profile, focal_px: float) -> tuple[list[str], Array]:
    """Calibration parameters, and the effects of one standard deviation of each on seen positions, (n, 6, m).

    A size or baseline that is too small scales positions towards the camera, a focal length their depth. A principal
    point rotates positions about the camera; its effect on directions is negligible.
    """
    std, size = hand_eye_file.prior_deviations(profile), SEEN_SIZES[method]
    names = [size, hand_eye_file.FOCAL_LENGTH, *[hand_eye_file.PRINCIPAL_POINT] * 2]
    rotation_rad = std[hand_eye_file.PRINCIPAL_POINT] / focal_px
    effects = np.zeros((len(seen_m), 6, len(names)))
    effects[:, :3, 0] = -std.get(size, 0.0) * seen_m
    effects[:, 2, 1] = -std[hand_eye_file.FOCAL_LENGTH] * seen_m[:, 2]
    effects[:, :3, 2] = np.cross([0.0, rotation_rad, 0.0], seen_m)
    effects[:, :3, 3] = np.cross([-rotation_rad, 0.0, 0.0], seen_m)
    return names, effects


BLOCK = 1 << 14


def fk_blocks(recording: Recording, *, in_camera: bool = False) -> Generator[tuple[Stamps, Array, Array]]:
    """Yield the tool's pose for every joint state in a recording's window, by the profile's chain, in blocks.

    Each has stamps of joint states, (n,), the poses, (n, 4, 4), in the base's frame, and the errors of all its joint
    states against the log's pose topic, (m, 2): position in m and angle in rad, NaN without a pose, with a constant
    offset where its frame is not the chain's base. With `in_camera`, poses are in the camera's frame, by the transform
    of a hand-eye file or of the log; joint states without one at their stamp are left out.
    Raises, before the first block, RecordingError without joint states, transform or chain, and KinematicsError where
    the chain's joints are not in the log.
    """
    chain, frames = recording.chain, recording.profile.frames
    joints = recording.joint_track()
    inside = recording.window.places(joints.stamps_ns)
    if len(inside) == 0:
        raise RecordingError(f"{recording.path.name}: no joint state is between --start and --end")
    poses = recording.pose_track() if recording.topic_of("pose") is not None else None
    base = recording.transform_track(frames.camera, frames.base) if in_camera else None
    for start in range(0, len(inside), BLOCK):
        places = inside[start : start + BLOCK]
        at_ns = joints.stamps_ns[places]
        T = forward_kinematics(chain, select_joints(chain, joints.names, joints.positions[places]))
        errors = np.full((len(T), 2), np.nan)
        if poses is not None:
            measured = poses.at(at_ns)
            difference = inverse(T[measured.valid]) @ measured.values[measured.valid]
            errors[measured.valid, 0] = np.linalg.norm(difference[:, :3, 3], axis=-1)
            errors[measured.valid, 1] = rotation_angle(difference[:, :3, :3], np.eye(3))
        if base is not None:
            T_camera_base = base.at(at_ns)
            at_ns, T = at_ns[T_camera_base.valid], (T_camera_base.values @ T)[T_camera_base.valid]
        yield at_ns, T, errors
