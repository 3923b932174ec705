"""Single faults, one by one: what exactly is lost, what is still read, and what the report says."""

import struct
from pathlib import Path

import pytest

from svmdist.recording.log import open_recording
from svmdist.recording.source import MAX_LISTED_LOSSES, Health, Loss, LossKind
from tests.reading import read_images

from .builders import rewrite, scene, write_scene
from .faults import CHUNK_OPCODE, MAGIC_BYTES, Reading, chunks, join, read, split


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A recording in some chunks."""
    folder = tmp_path_factory.mktemp("losses")
    native = write_scene(folder / "native.mcap", scene(6))
    return rewrite(native, folder / "a.mcap", "zstd", chunk_size=4000).read_bytes()


@pytest.fixture(scope="module")
def intact(data: bytes, tmp_path_factory: pytest.TempPathFactory) -> Reading:
    """What it holds."""
    return reading_of(data, tmp_path_factory.mktemp("intact"))


def reading_of(data: bytes, folder: Path) -> Reading:
    """Read a file that must be usable."""
    path = folder / "broken.mcap"
    path.write_bytes(data)
    reading = read(path)
    assert reading is not None
    return reading


def test_a_chunk_with_a_wrong_crc_is_dropped_whole_and_reading_goes_on(data, intact, tmp_path):
    (_, start), (second, count) = chunks(data)[:2]
    place = second.offset + 9 + 24  # its CRC
    reading = reading_of(data[:place] + b"\1\2\3\4" + data[place + 4 :], tmp_path)
    assert reading.messages == intact.messages[:start] + intact.messages[start + count :]
    assert reading.kinds == {LossKind.CHUNK, LossKind.DATA_CRC, LossKind.STATISTICS, LossKind.RECORD}
    assert reading.metadata == {}  # outside of chunks, where the data section's CRC alone could vouch for it


@pytest.mark.parametrize("length", [1 << 40, (1 << 64) - 1, 3])
def test_what_follows_a_broken_length_is_a_loss(data, intact, tmp_path, length):
    (_, count), (second, _) = chunks(data)[:2]
    place = second.offset + 1
    reading = reading_of(data[:place] + struct.pack("<Q", length) + data[place + 8 :], tmp_path)
    assert reading.messages == intact.messages[:count]
    assert {LossKind.STRUCTURE, LossKind.STATISTICS} <= reading.kinds


def test_a_chunk_that_claims_the_next_ones_is_read_and_they_are_losses(data, intact, tmp_path):
    parts, counts = zip(*chunks(data)[:4], strict=True)
    _, second, _, fourth = parts
    broken = bytearray(data)
    struct.pack_into("<Q", broken, second.offset + 1, fourth.end - second.offset - 9)
    reading = reading_of(bytes(broken), tmp_path)
    assert reading.messages == intact.messages[: sum(counts[:2])] + intact.messages[sum(counts) :]
    assert LossKind.STATISTICS in reading.kinds


def test_a_chunk_with_fields_of_a_newer_version_is_read(data, intact, tmp_path):
    """The specification lets records grow at their end: no chunk begins inside, and nothing is lost of the data."""
    parts = split(data[:-MAGIC_BYTES])
    grown = [(part.opcode, part.body + b"new" * (part.opcode == CHUNK_OPCODE)) for part in parts]
    whole = data[:MAGIC_BYTES] + join(grown) + data[-MAGIC_BYTES:]
    assert reading_of(whole, tmp_path).messages == intact.messages


def test_a_summary_that_promises_more_is_a_loss(data, intact, tmp_path):
    """A recording from which a whole chunk was cut out, its summary made right but for the statistics."""
    last, count = chunks(data)[-1]
    kept = {part.offset: (part.opcode, part.body) for part in split(data[:-MAGIC_BYTES])}
    del kept[last.offset]
    without_crc = {2: lambda body: body[:-4] + bytes(4), 15: lambda _: bytes(4)}  # of summary and data
    kept = [(opcode, without_crc.get(opcode, bytes)(body)) for opcode, body in kept.values()]
    reading = reading_of(data[:MAGIC_BYTES] + join(kept) + data[-MAGIC_BYTES:], tmp_path)
    assert len(reading.messages) == len(intact.messages) - count
    assert reading.kinds == {LossKind.STATISTICS}


def test_a_cut_file_says_so_once_with_its_figures(data, tmp_path, profile):
    path = tmp_path / "cut.mcap"
    path.write_bytes(data[: chunks(data)[2][0].end])
    recording = open_recording(path, profile)
    expected = sum(count for _, count in chunks(data)[:3])
    for _ in range(3):
        list(read_images(recording))
    line = f"truncated at byte {path.stat().st_size}, {expected} messages recovered"
    assert recording.health.describe() == (line,)
    assert recording.metadata == {"scenario": "test", "seed": "7"}


def test_reports_of_losses_stay_short():
    health = Health()
    for number in range(3 * MAX_LISTED_LOSSES):
        health.add(Loss(LossKind.CHUNK, "dropped", number, "/a\x1b"))
    assert len(health.losses) == MAX_LISTED_LOSSES
    assert health.unlisted_count > 0
    lines = health.describe(5)
    assert len(lines) == 6
    assert all(line.isprintable() for line in lines)
