"""A recording's summary and a fitted camera-to-base transform: lines for a person, rows and JSON."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from svmdist.camera import Camera
from svmdist.profile import Profile
from svmdist.profile.hand_eye import FORMAT, HandEyeFile, Source
from svmdist.recording.log import Recording
from svmdist.recording.summary import RecordingSummary, TopicSummary
from svmdist.report.tables import Cell, Column, number, printable, render, rich_table
from svmdist.transforms import quaternion_xyzw_from_rotation
from svmdist.workflows.capabilities import (
    Capability,
    TagCheck,
    capabilities,
    instruments_in,
    method_capabilities,
)
from svmdist.workflows.hand_eye import HandEyeResult

SCHEMA = "svmdist.info/1"

TOPIC_KEYS = (
    "topic",
    "schema",
    "message_encoding",
    "kind",
    "message_count",
    "rate_hz",
    "start_ns",
    "end_ns",
    "largest_gap_s",
    "gap_count",
    "out_of_order_count",
    "undecodable_count",
)

TOPIC_COLUMNS = (
    Column("topic", "topic", is_text=True),
    Column("schema", "schema", is_text=True),
    Column("message_encoding", "encoding", is_text=True),
    Column("message_count", "messages"),
    Column("rate_hz", "rate [Hz]", number(1)),
    Column("gap_count", "gaps"),
    Column("largest_gap_s", "largest gap [s]", number(3)),
    Column("out_of_order_count", "out of order"),
    Column("undecodable_count", "unreadable"),
)


LOG_KEYS = ("recording", "duration_s", "size_bytes", "images", "messages", "methods", "loss_count")
LOG_COLUMNS = (
    Column("recording", "recording", is_text=True),
    Column("duration_s", "duration [s]", number(2)),
    Column("size_bytes", "size [MB]", number(2, 1e-6)),
    Column("images", "images"),
    Column("messages", "messages"),
    Column("methods", "methods", is_text=True),
    Column("loss_count", "losses"),
)


def log_row(name: str, document: dict[str, Any]) -> dict[str, Cell]:
    """One of several recordings, by its document, with the keys of `LOG_KEYS`."""
    counts = {topic["topic"]: int(topic["message_count"]) for topic in document["topics"]}
    return {
        "recording": name,
        "duration_s": document["duration_s"],
        "size_bytes": document["size_bytes"],
        "images": counts.get(document["roles"].get("image", ""), 0),
        "messages": sum(counts.values()),
        "methods": ", ".join(method for method, of in document["methods"].items() if of["served"]) or "none",
        "loss_count": len(document["losses"]),
    }


def topic_row(topic: TopicSummary) -> dict[str, Cell]:
    """One topic, flat, with the keys of `TOPIC_KEYS`."""
    return {key: getattr(topic, key) for key in TOPIC_KEYS}


def info_document(
    summary: RecordingSummary, profile: Profile, tags: TagCheck | None = None
) -> dict[str, Any]:
    """The JSON document."""
    return {
        "schema": SCHEMA,
        "path": str(summary.path),
        "size_bytes": summary.size_bytes,
        "duration_s": summary.duration_s,
        "metadata": summary.metadata,
        "topics": [topic_row(topic) for topic in summary.topics],
        "roles": summary.roles,
        "instruments": list(instruments_in(summary, profile)),
        "cameras": {topic: _camera_document(camera) for topic, camera in summary.cameras.items()},
        "frames": list(summary.frames),
        "joint_names": {topic: list(names) for topic, names in summary.joint_names.items()},
        "is_clean": summary.health.is_clean,
        "losses": [str(loss) for loss in summary.health.losses],
        "commands": {
            capability.name: _capability_document(capability)
            for capability in capabilities(summary, profile, tags)
        },
        "methods": {
            capability.name: _capability_document(capability)
            for capability in method_capabilities(summary, profile, tags)
        },
    }


def info_lines(
    summary: RecordingSummary, profile: Profile, width: int | None = None, tags: TagCheck | None = None
) -> Iterator[str]:
    """The summary for a person."""
    yield f"{printable(str(summary.path))}: {summary.size_bytes / 1e6:.2f} MB, {summary.duration_s:.2f} s\n"
    if summary.metadata:
        pairs = ", ".join(f"{key} {value}" for key, value in summary.metadata.items())
        yield f"made with   {printable(pairs)}\n"
    yield render(rich_table("", TOPIC_COLUMNS, [topic_row(topic) for topic in summary.topics]), width=width)
    for topic, camera in summary.cameras.items():
        yield f"camera      {printable(topic)}: {_camera_line(camera)}\n"
    if summary.frames:
        yield f"frames      {printable(', '.join(summary.frames))}\n"
    for topic, names in summary.joint_names.items():
        yield f"joints      {printable(topic)}: {printable(', '.join(names))}\n"
    roles = ", ".join(f"{role} {topic}" for role, topic in summary.roles.items())
    yield f"roles       {printable(roles) or 'none of the topics is one that svmdist reads'}\n"
    yield f"instruments {printable(', '.join(instruments_in(summary, profile)))}\n"
    for capability in capabilities(summary, profile, tags):
        note = f", {capability.note}" if capability.note else ""
        answer = f"yes{note}" if capability.served else f"no: it lacks {'; '.join(capability.missing)}"
        yield f"{capability.name:<11} {printable(answer)}\n"
    methods = method_capabilities(summary, profile, tags)
    yield f"methods     {', '.join(each.name for each in methods if each.served) or 'none'}\n"
    for each in methods:
        if not each.served:
            yield f"  {each.name:<9} no: it lacks {printable('; '.join(each.missing))}\n"
    losses = len(summary.health.losses)
    yield f"health      {'clean' if summary.health.is_clean else f'{losses} losses'}\n"


def _capability_document(capability: Capability) -> dict[str, Any]:
    note = {"note": capability.note} if capability.note else {}
    return {"served": capability.served, "missing": list(capability.missing), **note}


def _camera_line(camera: Camera) -> str:
    K = camera.K
    distortion = (
        "no distortion" if not camera.D.any() else f"distortion {' '.join(f'{d:.4g}' for d in camera.D)}"
    )
    return (
        f"{camera.width_px}x{camera.height_px}, fx {K[0, 0]:.2f}, fy {K[1, 1]:.2f}, cx {K[0, 2]:.2f},"
        f" cy {K[1, 2]:.2f} px, {distortion}, frame {camera.frame_id}"
    )


def _camera_document(camera: Camera) -> dict[str, Any]:
    return {
        "width_px": camera.width_px,
        "height_px": camera.height_px,
        "K": camera.K.tolist(),
        "D": camera.D.tolist(),
        "frame_id": camera.frame_id,
    }


HAND_EYE_KEYS = (
    "instrument",
    "camera",
    "base",
    "x_m",
    "y_m",
    "z_m",
    "qx",
    "qy",
    "qz",
    "qw",
    "x_std_m",
    "y_std_m",
    "z_std_m",
    "turn_x_std_rad",
    "turn_y_std_rad",
    "turn_z_std_rad",
    "tool_std_m",
    "method",
    "reference",
    "frame_count",
    "inlier_count",
    "residual_rms_m",
    "log_turn_rad",
    "log_shift_m",
)


def hand_eye_row(result: HandEyeResult) -> dict[str, Cell]:
    """One instrument, flat, with the keys of `HAND_EYE_KEYS`."""
    found = result.hand_eye
    T = found.T_camera_base
    std = np.sqrt(np.maximum(np.diag(np.array(found.covariance)), 0.0))
    turn_rad, shift_m = result.from_log if result.from_log is not None else (None, None)
    values: tuple[Cell, ...] = (
        found.instrument,
        found.camera,
        found.base,
        *(float(value) for value in T[:3, 3]),
        *(float(value) for value in quaternion_xyzw_from_rotation(T[:3, :3])),
        *(float(value) for value in std),
        result.tool_std_m,
        found.method,
        found.reference,
        found.frame_count,
        found.inlier_count,
        found.residual_rms_m,
        turn_rad,
        shift_m,
    )
    return dict(zip(HAND_EYE_KEYS, values, strict=True))


def hand_eye_lines(result: HandEyeResult) -> Iterator[str]:
    """For a person: the transform with its deviations, and what it rests on."""
    found, row = result.hand_eye, hand_eye_row(result)
    std = np.sqrt(np.maximum(np.diag(np.array(found.covariance)), 0.0))
    yield f"{found.instrument}: {found.base} in {found.camera}, by {found.method} against {found.reference}\n"
    place = ", ".join(
        f"{axis} {value * 1e3:.1f} ± {deviation * 1e3:.1f}"
        for axis, value, deviation in zip("xyz", found.translation_m, std[:3], strict=True)
    )
    yield f"  translation [mm]     {place}\n"
    quaternion = ", ".join(f"{row[key]:.5f}" for key in ("qx", "qy", "qz", "qw"))
    yield f"  rotation (xyzw)      {quaternion}\n"
    turn = ", ".join(f"{axis} ± {np.degrees(value):.2f}" for axis, value in zip("xyz", std[3:], strict=True))
    yield f"  about the axes [°]   {turn}\n"
    yield f"  at the tool [mm]     ± {result.tool_std_m * 1e3:.2f} in the worst direction\n"
    yield (
        f"  frames               {found.inlier_count} of {found.frame_count} agree, within"
        f" {found.residual_rms_m * 1e3:.2f} mm rms; squared residuals over expected {result.fit.ratio:.2f}\n"
    )
    if result.from_log is not None:
        turn_rad, shift_m = result.from_log
        yield f"  the log's transform  {np.degrees(turn_rad):.2f}° and, at the tool, {shift_m * 1e3:.1f} mm off it\n"


def hand_eye_file(results: Sequence[HandEyeResult], recording: Recording) -> HandEyeFile:
    """What a profile names."""
    source = Source(name=recording.path.name, sha256=recording.sha256())
    return HandEyeFile(
        format=FORMAT, sources=(source,), transforms=tuple(result.hand_eye for result in results)
    )
