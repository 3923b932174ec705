"""metadata.yaml of rosbag2: what it declares is found however it is written, and no file of it can do harm."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest
import yaml
from rosbags.rosbag2 import StoragePlugin

from svmdist.profile import Profile
from svmdist.recording.log import open_recording
from svmdist.recording.rosbag import bag2_metadata
from svmdist.recording.rosbag.bag2_metadata import MAX_BYTES, MetadataError, parse_metadata, read_metadata
from svmdist.recording.source import LossKind

from .builders import Entry
from .other_recorders import ros_messages, write_rosbag2

DECLARED = {
    "rosbag2_bagfile_information": {
        "version": 9,
        "storage_identifier": "mcap",
        "relative_file_paths": ["a_0.mcap", "a_1.mcap"],
        "compression_mode": "message",
        "topics_with_message_count": [
            {
                "topic_metadata": {"name": "/image", "offered_qos_profiles": "- depth: 1\n  name: no"},
                "message_count": 12,
            },
            {"message_count": 0, "topic_metadata": {"name": "/2026-11-22"}},
            {"topic_metadata": {"name": "/odd"}, "message_count": "many"},
            {"topic_metadata": {"name": "/endless"}, "message_count": 10**30},
            "no topic",
        ],
    }
}


@pytest.mark.parametrize("flow", [False, True, None], ids=["block", "flow", "mixed"])
def test_the_same_is_read_in_every_style(flow: bool | None) -> None:
    found = parse_metadata(yaml.safe_dump(DECLARED, default_flow_style=flow).encode())
    assert found.files == ("a_0.mcap", "a_1.mcap")
    assert found.storage == "mcap"
    assert found.is_message_compressed
    assert found.counts == {"/image": 12, "/2026-11-22": 0}


def test_the_slow_parser_reads_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """PyYAML without libyaml, as it may be built from source."""
    data = yaml.safe_dump(DECLARED).encode()
    expected = parse_metadata(data)
    monkeypatch.setattr(bag2_metadata, "Loader", yaml.BaseLoader)
    assert parse_metadata(data) == expected


BILLION = "a: &a [x, x]\n" + "".join(f"{b}: &{b} [*{a}, *{a}]\n" for a, b in zip("abcdefg", "bcdefgh"))  # noqa: B905
HOSTILE = {
    "too large": b"# " + b"x" * MAX_BYTES,
    "deep in flow": b"[" * 100_000,
    "deep in blocks": b"- " * 100_000,
    "aliases": BILLION.encode(),
    "merged aliases": b"a: &a {x: 1}\nb: {<<: *a}",
    "many values": b"[" + b"[]," * 150_000 + b"]",
    "many documents": b"---\n" * 200_000,
    "no YAML": b"a: b: c",
    "not text": b"\xff\xfe\xfa\x80",
    "control characters": b"a: \x1b[31m",
    "an object": b"!!python/object/apply:os.system [exit 1]",
    "only newlines": b"\n" * MAX_BYTES,
    "nothing": b"",
    "another document": b"a: 1",
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files_are_refused_in_one_line_and_soon(name: str) -> None:
    """Each of them takes below 0.7 s; ten times that is for machines under load."""
    start_s = time.process_time()
    with pytest.raises(MetadataError) as caught:
        parse_metadata(HOSTILE[name])
    assert time.process_time() - start_s < 7.0
    assert str(caught.value).isprintable()
    assert "metadata.yaml" in str(caught.value)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes on this system")
def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "metadata.yaml")
    with pytest.raises(MetadataError, match="no regular file"):
        read_metadata(tmp_path)


@pytest.mark.parametrize("compressed", [False, True], ids=["plain", "compressed"])
def test_messages_are_read_beside_broken_metadata(
    tmp_path: Path, entries: list[Entry], profile: Profile, compressed: bool
) -> None:
    """The messages are not in it: it is one loss, and whether they are compressed shows in themselves."""
    folder = write_rosbag2(
        tmp_path / "a", ros_messages(entries), StoragePlugin.SQLITE3, compressed=compressed
    )
    whole = open_recording(folder, profile).joint_track()
    (folder / "metadata.yaml").write_text("a: b: c")
    recording = open_recording(folder, profile)
    assert recording.joint_track().stamps_ns.tolist() == whole.stamps_ns.tolist()
    assert [loss.kind for loss in recording.health.losses] == [LossKind.STRUCTURE]
