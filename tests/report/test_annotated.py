"""Annotated recordings hold what was copied and measured, and open in viewers; videos show each image at its time."""

import json
import os
import re
import subprocess
import sys
from collections import Counter, defaultdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from svmdist.camera import Camera
from svmdist.drawing import Part
from svmdist.recording.log import TRUE_SUFFIX, Recording, open_recording
from svmdist.recording.own_messages_pb2 import DistanceEstimate
from svmdist.report.annotated import write_annotated, write_rrd, write_video
from svmdist.report.on_image import draw_on
from svmdist.results import FrameResult
from svmdist.workflows.frame_drawing import DrawnFrame, drawn_frames
from svmdist.workflows.request import Setup, prepare
from tests.conftest import REPOSITORY

Annotated = tuple[Recording, list[DrawnFrame], Setup]
DUO = REPOSITORY / "recordings" / "3d" / "duo.mcap"
COUNT = 21  # of its 80 images
ANNOTATION_TOPICS = {
    "/ECM/left/image/annotations",
    "/svmdist/PSM1/distance",
    "/svmdist/PSM2/distance",
    "/svmdist/tf",
    "/svmdist/scene",
    "/svmdist/surface",
    "/svmdist/log",
}


@pytest.fixture(scope="module")
def annotated(tmp_path_factory: pytest.TempPathFactory) -> Annotated:
    """The golden log of two instruments with annotations of the first images, and what they were made of."""
    setup = prepare(method="fused")
    path = tmp_path_factory.mktemp("annotated") / "duo.mcap"
    frames: list[DrawnFrame] = []

    def kept() -> Any:
        for frame in drawn_frames(recording, setup, numbers=range(COUNT)):
            frames.append(frame)
            yield frame

    recording = open_recording(DUO, setup.profile)
    write_annotated(kept(), path, recording, setup)
    assert len(frames) == COUNT
    return open_recording(path, setup.profile), frames, setup


def messages_of(recording: Recording, topic: str, kind: Any) -> list[Any]:
    messages = recording.file.source.messages()
    return [kind.FromString(bytes(raw.data)) for raw in messages if raw.topic == topic]


def stamp_ns(message: Any) -> int:
    return int(message.timestamp.seconds * 1_000_000_000 + message.timestamp.nanos)


def test_every_message_of_the_log_is_copied_and_the_images_bit_for_bit(annotated):
    copy, _, setup = annotated
    original = open_recording(DUO, setup.profile)
    counts = Counter(raw.topic for raw in copy.file.source.messages())
    assert set(counts) - {raw.topic for raw in original.file.source.messages()} == ANNOTATION_TOPICS
    before, after = defaultdict(list), defaultdict(list)
    for log, messages in ((original, before), (copy, after)):
        for raw in log.file.source.messages():
            messages[raw.topic].append(bytes(raw.data))
    for topic, messages in before.items():
        assert len(after[topic]) == len(messages), topic
        if topic != "/ground_truth/tf":
            assert after[topic] == messages, topic


def test_a_copy_has_the_truth_of_its_log(annotated):
    """Under the names that the profile has, whatever the copy calls them."""
    copy, _, setup = annotated
    for frame in ("tool", "tissue"):
        tracks = (
            log.transform_track("camera", frame, ground_truth=True)
            for log in (copy, open_recording(DUO, setup.profile))
        )
        ours, expected = (track.T_parent_child for track in tracks)
        np.testing.assert_allclose(ours, expected, atol=1e-12)


def test_the_surface_of_each_image_is_a_cloud(annotated):
    """As many points as its data hold, on the tissue: 0.1 m before the camera, within the organ's centimetres."""
    for cloud in messages_of(annotated[0], "/svmdist/surface", PointCloud)[::20]:
        kinds = {PackedElementField.FLOAT32: "<f4", PackedElementField.UINT8: "u1"}
        points = np.frombuffer(cloud.data, [(field.name, kinds[field.type]) for field in cloud.fields])
        assert points.itemsize == cloud.point_stride
        assert len(points) > 250  # the organ is a sixth of 30,000 px, in cells of 16
        assert np.percentile(points["z"], (1, 99)) == pytest.approx([0.104, 0.104], abs=0.008)
        assert np.median(points["red"]) > np.median(points["green"]) + 40


def test_no_frame_of_the_copy_has_two_parents(annotated):
    parents = defaultdict(set)
    for topic in ("/tf", "/ground_truth/tf", "/svmdist/tf"):
        for message in messages_of(annotated[0], topic, FrameTransforms):
            for transform in message.transforms:
                parents[transform.child_frame_id].add(transform.parent_frame_id)
    assert {child for child, found in parents.items() if len(found) > 1} == set()
    assert {"tool", f"tool{TRUE_SUFFIX}", "PSM1_tool_estimate", "PSM2_tool_estimate"} <= set(parents)


def test_the_numbers_are_those_of_estimate(annotated, golden_rows):
    copy = annotated[0]
    for name in ("PSM1", "PSM2"):
        own: list[FrameResult] = golden_rows("3d/duo", "fused").of(name).rows[:COUNT]
        messages = messages_of(copy, f"/svmdist/{name}/distance", DistanceEstimate)
        assert [stamp_ns(message) for message in messages] == [row.stamp_ns for row in own]
        for message, row in zip(messages, own, strict=True):
            assert (message.status, message.method, message.instrument) == (str(row.status), "fused", name)
            clearance = row.distances.clearance
            assert (message.clearance_m, message.clearance_std_m) == (clearance.value_m, clearance.std_m)
            half_m = 1.959964 * clearance.std_m
            assert message.clearance_high_m - message.clearance_low_m == pytest.approx(2 * half_m, rel=1e-6)
            assert not message.HasField("alarm")  # none was asked for


def test_annotations_transforms_and_scene_say_the_same_as_the_results(annotated):
    copy, frames, _ = annotated
    camera = copy.camera
    drawings = messages_of(copy, "/ECM/left/image/annotations", ImageAnnotations)
    transforms = messages_of(copy, "/svmdist/tf", FrameTransforms)
    scenes = messages_of(copy, "/svmdist/scene", SceneUpdate)
    for frame, drawing, poses, scene in zip(frames, drawings, transforms, scenes, strict=True):
        texts = " ".join(text.text for text in drawing.texts)
        entities = {entity.id: entity for entity in scene.entities}
        for result, pose in zip(frame.replayed.results, poses.transforms, strict=True):
            clearance, tool = result.distances.clearance, result.tool
            assert f"{result.instrument} fused: clearance {clearance.value_m * 1e3:.2f} mm" in texts
            assert pose.child_frame_id == f"{result.instrument}_tool_estimate"
            place = np.array([pose.translation.x, pose.translation.y, pose.translation.z])
            np.testing.assert_allclose(place, tool.pose.position_m)
            start, end = entities[f"{result.instrument} distance"].lines[0].points
            length_m = np.linalg.norm([end.x - start.x, end.y - start.y, end.z - start.z])
            assert length_m == pytest.approx(abs(clearance.value_m), abs=1e-9)
            assert len(entities[f"{result.instrument} instrument"].cylinders) > 5
        assert stamp_ns(drawing) == frame.drawing.stamp_ns
        places = [(point.x, point.y) for shape in drawing.points for point in shape.points]
        inside = [-50 < x < camera.width_px + 50 and -50 < y < camera.height_px + 50 for x, y in places]
        assert np.mean(inside) > 0.9


def test_the_log_says_why_a_frame_was_not_measured(tmp_path):
    """The golden log in which the tissue or the instrument is hidden for a while."""
    setup = prepare()
    recording = open_recording(REPOSITORY / "recordings" / "occlusion.mcap", setup.profile)
    frames = list(drawn_frames(recording, setup))
    write_annotated(iter(frames), tmp_path / "out.mcap", recording, setup)
    lines = messages_of(open_recording(tmp_path / "out.mcap", setup.profile), "/svmdist/log", Log)
    assert lines[0].level == Log.INFO
    assert "method overlay" in lines[0].message
    rejected = [result for frame in frames for result in frame.replayed.results if not result.measured]
    assert rejected
    assert [(stamp_ns(line), line.level) for line in lines[1:]] == [
        (result.stamp_ns, Log.WARNING) for result in rejected
    ]
    for line, result in zip(lines[1:], rejected, strict=True):
        assert str(result.status) in line.message


def test_the_layout_names_topics_that_are_written(annotated):
    layout = json.loads((REPOSITORY / "docs" / "foxglove-layout.json").read_text())
    topics = {info.topic for info in annotated[0].topics()}
    named = set(re.findall(r'"(/[\w/]+)', json.dumps(layout)))
    assert {"/ECM/left/image/annotations", "/svmdist/scene", "/svmdist/log"} <= named <= topics
    fields = {
        path["value"].partition(".")[2] for panel in layout["configById"].values() for path in panel.get("paths", [])
    }
    assert fields <= {field.name for field in DistanceEstimate.DESCRIPTOR.fields}


def rerun(folder: Path, *arguments: object) -> str:
    """What the `rerun` program prints, with a home of its own: it writes its settings there."""
    own = os.environ | {"HOME": str(folder), "XDG_CONFIG_HOME": str(folder)}
    command = [sys.executable, "-m", "rerun", *map(str, arguments)]
    done = subprocess.run(command, env=own, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def contents(path: Path) -> tuple[dict[str, set[str]], Counter[str]]:
    """The columns and rows of each entity of a recording of Rerun's."""
    columns, rows = defaultdict[str, set[str]](set), Counter[str]()
    printed = rerun(path.parent, "rrd", "print", path)
    for count, entity, found in re.findall(r"with (\d+) rows .* - (/\S.*) - data columns: \[(.*)\]", printed):
        if "McapChannel:id" not in found:
            columns[entity] |= set(found.split())
            rows[entity] += int(count)
    return columns, rows


def test_a_log_for_rerun_holds_all_that_is_drawn(annotated, tmp_path):
    """With every frame, and Rerun's own verification; in space, what Foxglove's scene has."""
    pytest.importorskip("rerun", reason="rerun-sdk has no wheel for this platform")
    copy, frames, setup = annotated
    write_rrd(iter(frames[:5]), tmp_path / "duo.rrd", copy, setup)
    rerun(tmp_path, "rrd", "verify", tmp_path / "duo.rrd")
    columns, rows = contents(tmp_path / "duo.rrd")
    assert {"EncodedImage:blob", "Pinhole:image_from_camera"} <= columns["/camera/image"]
    for name in ("tissue", "shaft", "pose", r"distal\ marker", "distance", "between"):
        assert "LineStrips2D:strips" in columns[f"/camera/image/drawn/{name}"], name
    assert "Points2D:labels" in columns["/camera/image/drawn/labels"]
    for name in ("PSM1", "PSM2"):
        assert rows[f"/distances/{name}/clearance"] == rows[f"/distances/{name}/clearance_high"] == 5
        assert "Transform3D:translation" in columns[f"/camera/scene/{name}_tool_estimate"]
        assert rows[rf"/camera/scene/{name}\ instrument"] == rows[rf"/camera/scene/{name}\ distance"] == 5
    assert "Mesh3D:vertex_positions" in columns["/camera/scene/tissue"]


def test_without_rerun_a_line_names_the_extra(golden, cli, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    refused = cli("estimate", golden / "sweep.mcap", "-o", tmp_path / "none.rrd", code=1)
    assert "svmdist[rerun]" in refused.line


def test_rerun_shows_image_camera_transforms_and_text(annotated, tmp_path):
    """Rerun's own importer, as `rerun FILE` runs it."""
    pytest.importorskip("rerun", reason="rerun-sdk has no wheel for this platform")
    rerun(tmp_path, "mcap", "convert", annotated[0].path, "-o", tmp_path / "duo.rrd")
    columns, rows = contents(tmp_path / "duo.rrd")
    assert columns["/ECM/left/image"] >= {"EncodedImage:blob", "EncodedImage:media_type"}
    assert "Pinhole:image_from_camera" in columns["/ECM/left/camera_info"]
    for topic in ("/tf", "/svmdist/tf", "/ground_truth/tf"):
        assert {"Transform3D:child_frame", "Transform3D:translation"} <= columns[topic]
    assert "TextLog:text" in columns["/svmdist/log"]
    # Every annotation topic is there with every message; a message of /svmdist/tf has a row for each instrument.
    assert set(columns) >= ANNOTATION_TOPICS
    written = {info.topic: info.message_count for info in annotated[0].topics()}
    assert all(rows[topic] == written[topic] for topic in ANNOTATION_TOPICS - {"/svmdist/tf"})
    topics = ("/svmdist/PSM2/distance", "/svmdist/scene")
    assert (rows["/ECM/left/image"], rows["/svmdist/tf"], *map(written.get, topics)) == (
        80,
        2 * COUNT,
        COUNT,
        COUNT,
    )
    # What Rerun has no archetype for arrives with its message, to be looked at as data.
    assert "svmdist.DistanceEstimate:message" in columns["/svmdist/PSM1/distance"]
    assert "foxglove.SceneUpdate:message" in columns["/svmdist/scene"]
    assert "foxglove.ImageAnnotations:message" in columns["/ECM/left/image/annotations"]


def decoded(path: Path) -> list[tuple[float, np.ndarray]]:
    av = pytest.importorskip("av", reason="PyAV has no wheel for this platform")
    with av.open(str(path)) as container:
        return [
            (float(frame.pts * frame.time_base), frame.to_ndarray(format="bgr24"))
            for frame in container.decode(video=0)
        ]


def test_every_image_is_shown_at_its_stamp_with_its_drawing(golden, tmp_path):
    setup = prepare()
    recording = open_recording(golden / "occlusion.mcap", setup.profile)
    frames = list(drawn_frames(recording, setup, numbers=range(12)))
    write_video(frames, tmp_path / "out.mp4", recording)
    shown = decoded(tmp_path / "out.mp4")
    begin_ns = frames[0].drawing.stamp_ns
    np.testing.assert_allclose(
        [seconds for seconds, _ in shown],
        [(frame.drawing.stamp_ns - begin_ns) / 1e9 for frame in frames],
        atol=2e-3,
    )
    for frame, (_, pixels) in zip(frames, shown, strict=True):
        expected = draw_on(frame.replayed.image_bgr, frame.drawing).astype(float)
        bare = frame.replayed.image_bgr.astype(float)
        assert np.abs(pixels - expected).mean() < 6.0
        assert np.abs(pixels - expected).mean() < np.abs(pixels - bare).mean()
    assert any(shape.part is Part.DISTANCE for frame in frames for shape in frame.drawing.shapes)


def test_an_odd_size_and_a_clock_that_is_set_back_give_a_video(golden, tmp_path):
    setup = prepare()
    recording = open_recording(golden / "sweep.mcap", setup.profile)
    frames = list(drawn_frames(recording, setup, numbers=range(3)))
    odd = SimpleNamespace(logged_camera=Camera.from_horizontal_fov(639, 479, 1.0))
    write_video([*frames, *frames], tmp_path / "out.mp4", odd)
    shown = decoded(tmp_path / "out.mp4")
    assert [pixels.shape for _, pixels in shown] == [(480, 640, 3)] * 6
    assert (np.diff([seconds for seconds, _ in shown]) > 0).all()


def test_estimate_writes_a_video_by_its_ending(golden, cli, tmp_path, monkeypatch):
    """And says without PyAV what to install."""
    few = ("--method", "centroid", "--every", 8)
    outcome = cli("estimate", golden / "sweep.mcap", *few, "-o", tmp_path / "out.mp4")
    assert "10 of 10 frames measured" in outcome.err
    assert len(decoded(tmp_path / "out.mp4")) == 10
    monkeypatch.setitem(sys.modules, "av", None)
    refused = cli("estimate", golden / "sweep.mcap", "-o", tmp_path / "none.mp4", code=1)
    assert "svmdist[video]" in refused.line
    assert not (tmp_path / "none.mp4").exists()
