"""Logs whose messages stand twice, or out of the order of time: images come by stamp, each once; losses are told."""

from __future__ import annotations

from pathlib import Path

import pytest

from svmdist.profile import Profile
from svmdist.recording.log import open_recording
from svmdist.recording.writer import RecordingWriter
from svmdist.samples import Observation

from .builders import Entry, scene, write_scene
from .faults import CHUNK_OPCODE, MAGIC_BYTES, join, split


def observed(path: Path, profile: Profile) -> tuple[list[int], int, bool]:
    """The stamps of the observations, how many have joints, and whether nothing was lost."""
    recording = open_recording(path, profile)
    found = [one for one in recording.observations() if isinstance(one, Observation)]
    return (
        [one.stamp_ns for one in found],
        sum(one.joints is not None for one in found),
        recording.health.is_clean,
    )


def test_a_log_that_was_appended_to_itself(tmp_path: Path, profile: Profile) -> None:
    """Every message stands there twice: the rows are those of the log, and the second images are told as lost."""
    entries = scene(20)
    once = observed(write_scene(tmp_path / "once.mcap", entries), profile)
    stamps_ns, with_joints, is_clean = observed(
        write_scene(tmp_path / "twice.mcap", entries + entries), profile
    )
    assert (stamps_ns, with_joints) == once[:2]
    assert once[2]
    assert not is_clean


def test_files_joined_byte_by_byte(tmp_path: Path, profile: Profile) -> None:
    """`cat a.mcap b.mcap`: what can be read of it comes once and in order, and the loss is told."""
    log = write_scene(tmp_path / "a.mcap", scene(20))
    both = tmp_path / "both.mcap"
    both.write_bytes(log.read_bytes() * 2)
    stamps_ns, _, is_clean = observed(both, profile)
    assert stamps_ns == observed(log, profile)[0]
    assert not is_clean


@pytest.mark.parametrize("first", range(3))
def test_chunks_that_changed_places(tmp_path: Path, profile: Profile, first: int) -> None:
    """Two neighbours of a log in chunks of a few frames: all rows are there, by stamp, with their joints."""
    log = tmp_path / "log.mcap"
    with RecordingWriter(log, {}) as writer:
        for number, entry in enumerate(scene(24)):
            if number and number % 30 == 0:  # three frames
                writer._writer.flush()
            writer.write(entry.topic, entry.sample)
    data = log.read_bytes()
    records = [(part.opcode, part.body) for part in split(data[:-MAGIC_BYTES])]
    chunks = [at for at, (opcode, _) in enumerate(records) if opcode == CHUNK_OPCODE]
    # The definitions stand in the first chunk: the others can be anywhere behind it.
    a, b = chunks[first + 1], chunks[first + 2]
    records[a], records[b] = records[b], records[a]
    swapped = tmp_path / "swapped.mcap"
    swapped.write_bytes(data[:MAGIC_BYTES] + join(records) + data[-MAGIC_BYTES:])
    assert observed(swapped, profile)[:2] == observed(log, profile)[:2]


def test_images_far_out_of_place_are_left_out(tmp_path: Path, profile: Profile) -> None:
    """One that comes seconds too late is a loss; those around it stay in order."""
    entries = scene(50)
    late = next(at for at, entry in enumerate(entries) if entry.topic == "/ECM/left/image")
    moved: list[Entry] = [*entries[:late], *entries[late + 1 :], entries[late]]
    stamps_ns, _, is_clean = observed(write_scene(tmp_path / "late.mcap", moved), profile)
    expected = observed(write_scene(tmp_path / "log.mcap", entries), profile)[0]
    assert stamps_ns == expected[1:]
    assert not is_clean
