"""A recording's summary, its comparison with a profile, and a fitted camera-to-base transform: lines, rows, JSON."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from svmdist.camera import Camera
from svmdist.errors import printable
from svmdist.estimation.comparison import Checks, readable
from svmdist.metrics import COUNT, LENGTH, RADIANS, RATIO, SECONDS, TEXT, Column, Unit, row_of
from svmdist.profile.hand_eye import FORMAT, HandEyeFile, Source
from svmdist.recording.log import Recording
from svmdist.recording.messages import Kind
from svmdist.recording.source import sanitize_list
from svmdist.recording.summary import RecordingSummary
from svmdist.report.tables import Row, Table, counted, keys_of, render
from svmdist.report.writers import Results
from svmdist.transforms import quaternion_xyzw_from_rotation
from svmdist.workflows import capabilities
from svmdist.workflows.calibrate import HandEyeResult
from svmdist.workflows.check import warning

SCHEMA = "svmdist.info/1"
MAX_CHANGES = 4  # of cameras' calibrations that are listed

TOPIC_COLUMNS = (
    Column("topic", TEXT, "topic"),
    Column("schema", TEXT, "schema"),
    Column("message_encoding", TEXT, "encoding"),
    Column("kind", TEXT),
    Column("message_count", COUNT, "messages"),
    Column("rate_hz", Unit("Hz", digits=1), "rate [Hz]"),
    Column("start_ns", Unit("ns")),
    Column("end_ns", Unit("ns")),
    Column("largest_gap_s", Unit("s", digits=3), "largest gap [s]"),
    Column("gap_count", COUNT, "gaps"),
    Column("out_of_order_count", COUNT, "out of order"),
    Column("undecodable_count", COUNT, "unreadable"),
)


LOG_COLUMNS = (
    Column("recording", TEXT, "recording"),
    Column("duration_s", SECONDS, "duration [s]"),
    Column("size_bytes", Unit("B", 1e-6, 2), "size [MB]"),
    Column("images", COUNT, "images"),
    Column("messages", COUNT, "messages"),
    Column("methods", TEXT, "methods"),
    Column("loss_count", COUNT, "losses"),
)


def info_results(found: dict[str, Any]) -> Results:
    """A recording by its document: its topics as rows, and readable lines on what can be done with it."""
    return Results(TOPIC_COLUMNS, found["topics"], lambda width: _info_lines(found, width), document=found)


def logs_results(documents: Sequence[tuple[str, dict[str, Any]]]) -> Results:
    """Several recordings by names and documents: a table of one line each, the topics of all as rows."""
    topics, logs, notes = [], [], []
    for name, log in documents:
        topics += [topic | {"recording": name} for topic in log["topics"]]
        images = {one["topic"]: one["message_count"] for one in log["topics"] if one["kind"] == Kind.IMAGE}
        if (chosen := log["roles"].get("image")) is not None:
            images = {chosen: images[chosen]}
        if len(images) > 1:
            listed = sanitize_list(f"{topic} ({count} images)" for topic, count in images.items())
            notes.append(f"{name}: choose one with --topic image=TOPIC of {listed}")
        row = {"recording": name, "methods": _served_methods(log), "loss_count": len(log["losses"])}
        row["images"] = sum(images.values()) if len(images) < 2 else None
        row["messages"] = sum(topic["message_count"] for topic in log["topics"])
        logs.append(log | row)
    columns, tables = (*TOPIC_COLUMNS, Column("recording", TEXT)), [Table.of("", LOG_COLUMNS, logs)]
    return Results(columns, topics, None, tables, notes, [document for _, document in documents])


def _served_methods(log: dict[str, Any]) -> str:
    return ", ".join(name for name, found in log["methods"].items() if found["served"]) or "none"


def info_document(summary: RecordingSummary, checks: Mapping[str, Checks], no_tag: str = "") -> dict[str, Any]:
    """The JSON document `svmdist.info/1`; of comparisons it has how many there are, and what contradicts most."""
    methods = _served(capabilities.method_capabilities(summary, no_tag))
    commands = _served(capabilities.capabilities(summary, no_tag))
    if commands["estimate"]["served"]:
        best = next(name for name in capabilities.PREFERRED if methods[name]["served"])
        commands["estimate"]["note"] = f"by {best}"
    recording = summary.recording
    return {
        "schema": SCHEMA,
        "path": str(recording.path),
        "profile": recording.profile.name,
        "size_bytes": recording.size_bytes(),
        "duration_s": summary.duration_s,
        "metadata": recording.metadata,
        "topics": [row_of(TOPIC_COLUMNS, topic) for topic in summary.topics],
        "roles": summary.roles,
        "instruments": list(recording.instruments),
        "cameras": {topic: _camera_document(track.runs[0].camera) for topic, track in summary.cameras.items()},
        "camera_changes": [str(one) for topic, track in summary.cameras.items() for one in track.changes(topic)],
        "frames": list(summary.frames),
        "joint_names": {topic: list(names) for topic, names in summary.joint_names.items()},
        "is_clean": recording.health.is_clean,
        "losses": [str(loss) for loss in recording.health.losses],
        "commands": commands,
        "methods": methods,
        "checks": {"count": sum(len(one.comparisons) for one in checks.values()), "contradiction": warning(checks)},
    }


def _served(lacks: Mapping[str, tuple[str, ...]]) -> dict[str, dict[str, Any]]:
    return {name: {"served": not missing, "missing": [*missing]} for name, missing in lacks.items()}


def _camera_document(camera: Camera) -> dict[str, Any]:
    size = {"width_px": camera.width_px, "height_px": camera.height_px}
    lens = {"distortion_model": camera.distortion_model, "D": camera.D.tolist()}
    return size | {"K": camera.K.tolist(), **lens, "frame_id": camera.frame_id}


def _info_lines(log: dict[str, Any], width: int | None) -> Iterator[str]:
    def line(name: str, text: str) -> str:
        return f"{name:<11} {printable(text)}\n"

    def missing(found: dict[str, Any]) -> str:
        return f"no: it lacks {'; '.join(found['missing'])}"

    yield f"{printable(log['path'])}: {log['size_bytes'] / 1e6:.2f} MB, {log['duration_s']:.2f} s\n"
    if log["metadata"]:
        yield line("made with", ", ".join(f"{key} {value}" for key, value in log["metadata"].items()))
    yield render(Table.of("", [one for one in TOPIC_COLUMNS if one.heading], log["topics"]), width=width)
    for topic, camera in log["cameras"].items():
        yield line("camera", f"{topic}: {_camera_in_words(camera)}")
    changes = log["camera_changes"]
    for at, change in enumerate(changes[:MAX_CHANGES], 1):
        hidden = f", and {len(changes) - at} more changes" if at == MAX_CHANGES < len(changes) else ""
        yield line("changes", f"{change}{hidden}")
    if log["frames"]:
        yield line("frames", ", ".join(log["frames"]))
    for topic, names in log["joint_names"].items():
        yield line("joints", f"{topic}: {', '.join(names)}")
    roles = ", ".join(f"{role} {topic}" for role, topic in log["roles"].items())
    yield line("roles", roles or "none of the topics is one that svmdist reads")
    yield line("instruments", ", ".join(log["instruments"]))
    for name, found in log["commands"].items():
        yield line(name, ", ".join(filter(None, ("yes", found.get("note")))) if found["served"] else missing(found))
    yield line("methods", _served_methods(log))
    for name, found in log["methods"].items():
        if not found["served"]:
            yield f"  {name:<9} {printable(missing(found))}\n"
    if (checks := log["checks"])["count"]:
        agree = f"{counted(checks['count'], 'comparison')} with profile {log['profile']}: nothing contradicts"
        yield line("checks", checks["contradiction"] or agree)
    yield line("health", "clean" if log["is_clean"] else f"{len(log['losses'])} losses")


def _camera_in_words(camera: dict[str, Any]) -> str:
    (fx, _, cx), (_, fy, cy), _ = camera["K"]
    is_fisheye = camera["distortion_model"] == "fisheye"  # which bends by zeros, too
    bends = " ".join(f"{value:.4g}" for value in camera["D"]) if any(camera["D"]) or is_fisheye else ""
    lens = f"{'fisheye' if is_fisheye else 'distortion'} {bends}" if bends else "no distortion"
    pinhole = f"{camera['width_px']}x{camera['height_px']}, fx {fx:.2f}, fy {fy:.2f}, cx {cx:.2f}, cy {cy:.2f} px"
    return f"{pinhole}, {lens}, frame {camera['frame_id']}"


HAND_EYE_COLUMNS = (
    *(Column(key, TEXT, of=f"0.hand_eye.{key}") for key in ("instrument", "camera", "base")),
    *(Column(f"{axis}_m", LENGTH, of=f"0.hand_eye.translation_m.{at}") for at, axis in enumerate("xyz")),
    *(Column(f"q{axis}", RATIO, of=f"1.{at}") for at, axis in enumerate("xyzw")),
    *(Column(f"{axis}_std_m", LENGTH, of=f"2.{at}") for at, axis in enumerate("xyz")),
    *(Column(f"turn_{axis}_std_rad", RADIANS, of=f"2.{at}") for at, axis in enumerate("xyz", 3)),
    Column("tool_std_m", LENGTH, of="0.tool_std_m"),
    *(Column(key, TEXT, of=f"0.hand_eye.{key}") for key in ("method", "reference")),
    *(Column(key, COUNT, of=f"0.hand_eye.{key}") for key in ("frame_count", "inlier_count")),
    Column("residual_rms_m", LENGTH, of="0.hand_eye.residual_rms_m"),
    Column("log_turn_rad", RADIANS, of="0.from_log.0"),
    Column("log_shift_m", LENGTH, of="0.from_log.1"),
)
"""Of a result, its quaternion, and the standard deviations of its transform."""


def hand_eye_results(results: Sequence[HandEyeResult]) -> Results:
    """A row per instrument; as text, the transforms with what they rest on."""
    rows = []
    for one in results:
        quaternion = quaternion_xyzw_from_rotation(one.hand_eye.T_camera_base[:3, :3])
        std = np.sqrt(np.maximum(np.diag(one.hand_eye.covariance), 0.0))
        rows.append(row_of(HAND_EYE_COLUMNS, (one, quaternion, std)))
    lines = [line for found in zip(results, rows, strict=True) for line in _hand_eye_lines(*found)]
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
    residuals = f"{found.residual_rms_m * 1e3:.2f} mm rms; squared residuals over expected {result.fit.ratio:.2f}"
    yield f"  frames               {found.inlier_count} of {found.frame_count} agree, within {residuals}\n"
    if result.from_log is not None:
        turn_rad, shift_m = result.from_log
        yield f"  the log's transform  {np.degrees(turn_rad):.2f}° and, at the tool, {shift_m * 1e3:.1f} mm off it\n"


def hand_eye_file(results: Sequence[HandEyeResult], recording: Recording) -> HandEyeFile:
    """What a profile names."""
    source = Source(name=recording.path.name, sha256=recording.sha256())
    return HandEyeFile(format=FORMAT, sources=(source,), transforms=tuple(result.hand_eye for result in results))


COLUMNS = (
    Column("recording", TEXT, of="0"),
    Column("instrument", TEXT, "instrument", of="1"),
    Column("what", TEXT, "what", of="2.usual.what"),
    Column("against", TEXT, "compared", of="2.against"),
    Column("difference", RATIO, of="2.usual.value"),
    Column("unit", TEXT, of="2.usual.unit"),
    Column("std", RATIO, of="2.usual.std"),
    Column("shown", TEXT, "difference", of=lambda one: readable(one[2].usual), stored=False),
    Column("deviations", Unit(digits=1), "deviations", of="2.usual.deviations"),
    Column("frames", COUNT, of="2.frames"),
    Column("contradicting", COUNT, of="2.contradicting"),
    Column("beyond", TEXT, "frames", of=lambda one: f"{one[2].contradicting} of {one[2].frames}", stored=False),
    Column("verdict", TEXT, "verdict", of="2.verdict"),
    Column("could_be", TEXT, of=lambda one: "; ".join(one[2].could_be)),
)


def check_rows(recording: str, found: Mapping[str, Checks]) -> Iterator[Row]:
    """A row for each comparison of each instrument of a recording."""
    for instrument, checks in found.items():
        for one in checks.comparisons:
            yield row_of(COLUMNS, (recording, instrument, one))


def check_results(rows: Sequence[Row]) -> Results:
    """The rows; as text a table for each log, and below it what could be wrong where something contradicts."""
    document = [{key: row[key] for key in keys_of(COLUMNS)} for row in rows]
    return Results(COLUMNS, rows, lambda width: _lines(rows, width), document=document)


def _lines(rows: Sequence[Row], width: int | None) -> Iterator[str]:
    for recording in dict.fromkeys(row["recording"] for row in rows):
        ours = [row for row in rows if row["recording"] == recording]
        wrong = [row for row in ours if row["verdict"] == "contradicts"]
        several = len({row["instrument"] for row in ours}) > 1
        shown = [one for one in COLUMNS if one.heading and (several or one.key != "instrument")]
        yield render(Table.of(str(recording), shown, ours), width=width)
        for row in wrong:
            yield printable(f"{row['what']} contradicts; it could be: {row['could_be']}") + "\n"
        if not wrong:
            yield f"{counted(len(ours), 'comparison')}: nothing contradicts\n"
