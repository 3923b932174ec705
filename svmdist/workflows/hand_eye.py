"""Hand-eye: where a robot's base stands for the camera, from the tool that a method sees and the robot reports."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from svmdist.errors import RecordingError, UsageError
from svmdist.estimation.hand_eye import HandEyeFit, ToolPlaces, fit_hand_eye
from svmdist.profile import Profile, stated_deviations
from svmdist.profile.hand_eye import (
    BASELINE,
    FOCAL_LENGTH,
    PRINCIPAL_POINT,
    SHAFT_RADIUS,
    TAG_SIZE,
    ConstantEffect,
    HandEye,
)
from svmdist.recording.log import Recording
from svmdist.recording.topics import FixedTransform
from svmdist.results import Failure, FrameResult, ToolPose
from svmdist.transforms import Array, inverse, rotation_angle
from svmdist.workflows.parallel import Progress, Steps, image_total
from svmdist.workflows.replay import replay
from svmdist.workflows.reported_tool import Against, ReportedTool, default_reference, reported_tool
from svmdist.workflows.request import Setup

SEEING_METHODS = ("fiducial", "stereo", "shaft")
"""Methods whose tool is from the images alone, the surest first."""


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
    on_progress: Progress | None = None,
) -> HandEyeResult | Failure:
    """Fit the camera-to-base transform of an instrument; a Failure says why it cannot be told.

    The method of the setup sees the tool, without any transform of the log. `against` is what the robot reports:
    kinematics of its joints, or poses; None takes the joints where log and profile have them. With joints, a second
    pass lets the method know how the wrist is bent in the camera's frame, by the transform of the first pass.
    `on_progress` is told of the images of both.
    Raises UsageError for a method that does not see the tool, RecordingError where the log lacks joints and poses.
    """
    if setup.method not in SEEING_METHODS:
        raise UsageError(
            f"--method {setup.method}: hand-eye needs the tool as images show it: {', '.join(SEEING_METHODS)}"
        )
    profile = replace_profile(setup.profile, instrument)
    own = recording.for_instrument(instrument)
    against = against or default_reference(own, profile)
    blind = recording.with_bases({name: FixedTransform(None) for name in recording.instruments})
    focal_px = float(recording.camera.K[0, 0])
    twice = against == "kinematics" and setup.method != "fiducial"
    steps = Steps(on_progress, image_total([recording], lambda _: 2 if twice else 1))
    rows, missed = _seen(blind, setup, instrument, jobs, steps)
    reported = reported_tool(own, profile, against, _stamps(rows))
    fitted = _fit(rows, reported, setup, profile, focal_px)
    if isinstance(fitted.fit, HandEyeFit) and twice:
        knowing = blind.with_bases({instrument: FixedTransform(fitted.fit.T_camera_base)})
        again, _ = _seen(knowing, setup, instrument, jobs, steps)
        reported_again = reported_tool(own, profile, against, _stamps(again))
        second = _fit(again, reported_again, setup, profile, focal_px)
        if isinstance(second.fit, HandEyeFit):
            rows, fitted = again, second
    if isinstance(fitted.fit, Failure):
        is_for_want_of_rows = len(rows) < profile.settings.hand_eye.min_count
        return Failure(f"{fitted.fit.reason}{missed}") if is_for_want_of_rows else fitted.fit
    return _result(fitted.fit, fitted, _stamps(rows), own, setup, profile, against)


def replace_profile(profile: Profile, instrument: str) -> Profile:
    """The profile as one of its instruments sees it, without an earlier hand-eye file."""
    return profile.model_copy(update={"hand_eye": None}).for_instrument(instrument)


def _seen(
    recording: Recording, setup: Setup, instrument: str, jobs: int | None, steps: Steps
) -> tuple[list[FrameResult], str]:
    """The rows in which the method saw the tool, and what most of the others say, to be put behind a reason."""
    bare = replace(setup, profile=setup.profile.model_copy(update={"hand_eye": None}))
    lanes = steps.of(replay(recording, [bare], wanted=[instrument], jobs=jobs))
    rows = [replayed.results[0] for (replayed,) in lanes]
    seen = [row for row in rows if row.measured and row.tool is not None]
    said = Counter(row.detail or row.status for row in rows if not row.measured).most_common(1)
    return seen, "".join(f"; {count} frames say: {reason}" for reason, count in said)


def _stamps(rows: Sequence[FrameResult]) -> NDArray[np.int64]:
    return np.array([row.stamp_ns for row in rows], np.int64)


def _fit(
    rows: Sequence[FrameResult], reported: ReportedTool, setup: Setup, profile: Profile, focal_px: float
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
    fit: HandEyeFit, reported: ReportedTool, camera: Mapping[str, Array], profile: Profile
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
