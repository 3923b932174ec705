"""A recording's summary and a fitted camera-to-base transform: lines for a person, rows and JSON."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from operator import attrgetter, itemgetter
from typing import Any

import numpy as np

from svmdist.camera import Camera
from svmdist.errors import printable
from svmdist.metrics import COUNT, LENGTH, RADIANS, RATIO, SECONDS, TEXT, Unit
from svmdist.profile import Profile
from svmdist.profile.hand_eye import FORMAT, HandEyeFile, Source
from svmdist.recording.log import Recording
from svmdist.recording.summary import RecordingSummary
from svmdist.report.tables import Column, Table, render, row_of
from svmdist.report.writers import Results
from svmdist.transforms import quaternion_xyzw_from_rotation
from svmdist.workflows.calibrate import HandEyeResult
from svmdist.workflows.capabilities import (
    Capability,
    TagCheck,
    capabilities,
    instruments_in,
    method_capabilities,
)

SCHEMA = "svmdist.info/1"

TOPIC_COLUMNS = (
    Column("topic", TEXT, "topic"),
    Column("schema", TEXT, "schema"),
    Column("message_encoding", TEXT, "encoding"),
    Column("kind", TEXT),
    Column("message_count", COUNT, "messages"),
    Column("rate_hz", Unit("Hz", "Hz", digits=1), "rate [Hz]"),
    Column("start_ns", Unit("ns")),
    Column("end_ns", Unit("ns")),
    Column("largest_gap_s", Unit("s", "s", digits=3), "largest gap [s]"),
    Column("gap_count", COUNT, "gaps"),
    Column("out_of_order_count", COUNT, "out of order"),
    Column("undecodable_count", COUNT, "unreadable"),
)


def _image_count(log: dict[str, Any]) -> int:
    image = log["roles"].get("image")
    return next((int(topic["message_count"]) for topic in log["topics"] if topic["topic"] == image), 0)


LOG_COLUMNS = (
    Column("recording", TEXT, "recording", itemgetter("recording")),
    Column("duration_s", SECONDS, "duration [s]", itemgetter("duration_s")),
    Column("size_bytes", Unit("B", "MB", 1e-6, 2), "size [MB]", itemgetter("size_bytes")),
    Column("images", COUNT, "images", _image_count),
    Column("messages", COUNT, "messages", lambda log: sum(topic["message_count"] for topic in log["topics"])),
    Column("methods", TEXT, "methods",
           lambda log: ", ".join(name for name, of in log["methods"].items() if of["served"]) or "none"),
    Column("loss_count", COUNT, "losses", lambda log: len(log["losses"])),
)  # fmt: skip


def info_results(summary: RecordingSummary, profile: Profile, tags: TagCheck | None = None) -> Results:
    """A recording: its topics as rows, what can be done with it in lines for a person, and all as a JSON document."""
    rows = [row_of(TOPIC_COLUMNS, topic) for topic in summary.topics]
    found = info_document(summary, profile, tags)
    return Results(TOPIC_COLUMNS, rows, lambda width: _info_lines(summary, found, width), document=found)


def logs_results(documents: Sequence[tuple[str, dict[str, Any]]]) -> Results:
    """Several recordings by names and documents: a table of one line each, the topics of all as rows."""
    topics = [topic | {"recording": name} for name, document in documents for topic in document["topics"]]
    logs = [row_of(LOG_COLUMNS, document | {"recording": name}) for name, document in documents]
    columns, tables = (*TOPIC_COLUMNS, Column("recording", TEXT)), [Table.of("", LOG_COLUMNS, logs)]
    return Results(columns, topics, tables=tables, document=[document for _, document in documents])


def info_document(
    summary: RecordingSummary, profile: Profile, tags: TagCheck | None = None
) -> dict[str, Any]:
    """The JSON document `svmdist.info/1`."""
    return {
        "schema": SCHEMA,
        "path": str(summary.path),
        "size_bytes": summary.size_bytes,
        "duration_s": summary.duration_s,
        "metadata": summary.metadata,
        "topics": [row_of(TOPIC_COLUMNS, topic) for topic in summary.topics],
        "roles": summary.roles,
        "instruments": list(instruments_in(summary, profile)),
        "cameras": {topic: _camera_document(camera) for topic, camera in summary.cameras.items()},
        "frames": list(summary.frames),
        "joint_names": {topic: list(names) for topic, names in summary.joint_names.items()},
        "is_clean": summary.health.is_clean,
        "losses": [str(loss) for loss in summary.health.losses],
        "commands": _capability_documents(capabilities(summary, profile, tags)),
        "methods": _capability_documents(method_capabilities(summary, profile, tags)),
    }


def _capability_documents(found: Iterable[Capability]) -> dict[str, dict[str, Any]]:
    return {
        one.name: {
            "served": one.served,
            "missing": [*one.missing],
            **({"note": one.note} if one.note else {}),
        }
        for one in found
    }


def _camera_document(camera: Camera) -> dict[str, Any]:
    size = {"width_px": camera.width_px, "height_px": camera.height_px}
    return size | {"K": camera.K.tolist(), "D": camera.D.tolist(), "frame_id": camera.frame_id}


def _info_lines(summary: RecordingSummary, document: dict[str, Any], width: int | None) -> Iterator[str]:

    def line(name: str, text: str) -> str:
        return f"{name:<11} {printable(text)}\n"

    yield f"{printable(document['path'])}: {summary.size_bytes / 1e6:.2f} MB, {summary.duration_s:.2f} s\n"
    if summary.metadata:
        yield line("made with", ", ".join(f"{key} {value}" for key, value in summary.metadata.items()))
    shown = [column for column in TOPIC_COLUMNS if column.heading]
    yield render(Table.of("", shown, document["topics"]), width=width)
    for topic, camera in summary.cameras.items():
        yield line("camera", f"{topic}: {_camera_in_words(camera)}")
    if summary.frames:
        yield line("frames", ", ".join(summary.frames))
    for topic, names in summary.joint_names.items():
        yield line("joints", f"{topic}: {', '.join(names)}")
    roles = ", ".join(f"{role} {topic}" for role, topic in summary.roles.items())
    yield line("roles", roles or "none of the topics is one that svmdist reads")
    yield line("instruments", ", ".join(document["instruments"]))
    for name, found in document["commands"].items():
        served = ", ".join(filter(None, ("yes", found.get("note"))))
        yield line(name, served if found["served"] else _missing(found))
    methods = document["methods"]
    yield line("methods", ", ".join(name for name, found in methods.items() if found["served"]) or "none")
    for name, found in methods.items():
        if not found["served"]:
            yield f"  {name:<9} {_missing(found)}\n"
    yield line("health", "clean" if summary.health.is_clean else f"{len(summary.health.losses)} losses")


def _missing(found: dict[str, Any]) -> str:
    return printable(f"no: it lacks {'; '.join(found['missing'])}")


def _camera_in_words(camera: Camera) -> str:
    K, D = camera.K, camera.D
    distortion = f"distortion {' '.join(f'{d:.4g}' for d in D)}" if D.any() else "no distortion"
    return (
        f"{camera.width_px}x{camera.height_px}, fx {K[0, 0]:.2f}, fy {K[1, 1]:.2f}, cx {K[0, 2]:.2f},"
        f" cy {K[1, 2]:.2f} px, {distortion}, frame {camera.frame_id}"
    )


def _deviation(at: int) -> Callable[[HandEyeResult], float]:
    return lambda result: float(np.sqrt(max(result.hand_eye.covariance[at][at], 0.0)))


def _pose_column(key: str, unit: Unit, at: int) -> Column:

    def read(result: HandEyeResult) -> float:
        T = result.hand_eye.T_camera_base
        return float(T[at, 3] if at < 3 else quaternion_xyzw_from_rotation(T[:3, :3])[at - 3])

    return Column(key, unit, of=read)


def _found(key: str, unit: Unit) -> Column:
    return Column(key, unit, of=attrgetter(f"hand_eye.{key}"))


HAND_EYE_COLUMNS = (
    *(_found(key, TEXT) for key in ("instrument", "camera", "base")),
    *(_pose_column(f"{axis}_m", LENGTH, at) for at, axis in enumerate("xyz")),
    *(_pose_column(f"q{axis}", RATIO, at) for at, axis in enumerate("xyzw", 3)),
    *(Column(f"{axis}_std_m", LENGTH, of=_deviation(at)) for at, axis in enumerate("xyz")),
    *(Column(f"turn_{axis}_std_rad", RADIANS, of=_deviation(at)) for at, axis in enumerate("xyz", 3)),
    Column("tool_std_m", LENGTH),
    *(_found(key, TEXT) for key in ("method", "reference")),
    *(_found(key, COUNT) for key in ("frame_count", "inlier_count")),
    _found("residual_rms_m", LENGTH),
    Column("log_turn_rad", RADIANS, of=lambda result: result.from_log[0] if result.from_log else None),
    Column("log_shift_m", LENGTH, of=lambda result: result.from_log[1] if result.from_log else None),
)


def hand_eye_results(results: Sequence[HandEyeResult]) -> Results:
    """A row per instrument, and for a person the transforms with what they rest on."""
    rows = [row_of(HAND_EYE_COLUMNS, result) for result in results]
    lines = [line for result in results for line in _hand_eye_lines(result, row_of(HAND_EYE_COLUMNS, result))]
    return Results(HAND_EYE_COLUMNS, rows, lambda _: lines, document=rows)


def _hand_eye_lines(result: HandEyeResult, row: dict[str, Any]) -> Iterator[str]:
    found = result.hand_eye
    place = (f"{axis} {row[f'{axis}_m'] * 1e3:.1f} ± {row[f'{axis}_std_m'] * 1e3:.1f}" for axis in "xyz")
    turn = (f"{axis} ± {np.degrees(row[f'turn_{axis}_std_rad']):.2f}" for axis in "xyz")
    yield f"{found.instrument}: {found.base} in {found.camera}, by {found.method} against {found.reference}\n"
    yield f"  translation [mm]     {', '.join(place)}\n"
    yield f"  rotation (xyzw)      {', '.join(f'{row[key]:.5f}' for key in ('qx', 'qy', 'qz', 'qw'))}\n"
    yield f"  about the axes [°]   {', '.join(turn)}\n"
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
    found = tuple(result.hand_eye for result in results)
    return HandEyeFile(format=FORMAT, sources=(source,), transforms=found)
