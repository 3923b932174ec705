"""The end of a file: trusted when its CRC is right, and otherwise as if it were not there."""

from __future__ import annotations

import random
from io import BytesIO
from pathlib import Path

import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader

from svmdist.profile import Limits
from svmdist.recording.mcap_file.framing import MAGIC, TAIL_BYTES
from svmdist.recording.mcap_file.record_parsers import MalformedRecordError
from svmdist.recording.mcap_file.summary import Summary, read_footer, read_trusted_summary
from tests.recording.builders import rewrite
from tests.recording.faults import CHUNK_OPCODE, split


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory, native: Path) -> bytes:
    """A recording of several chunks with a summary."""
    return rewrite(native, tmp_path_factory.mktemp("summary") / "a.mcap", "zstd").read_bytes()


def summary_of(data: bytes, limits: Limits | None = None) -> Summary | None:
    """What is trusted of a file's end."""
    return read_trusted_summary(BytesIO(data), len(data), limits or Limits())


def test_the_summary_says_what_the_library_reads(data: bytes) -> None:
    """Names, topics and statistics are those that the mcap library finds; the chunks stand where it names them."""
    summary = summary_of(data)
    expected = make_reader(BytesIO(data)).get_summary()
    assert summary is not None
    assert expected is not None
    assert summary.statistics == expected.statistics
    assert {key: each.name for key, each in summary.schemas.items()} == {
        key: each.name for key, each in expected.schemas.items()
    }
    assert {key: each.topic for key, each in summary.channels.items()} == {
        key: each.topic for key, each in expected.channels.items()
    }
    chunks = [part.offset for part in split(data) if part.opcode == CHUNK_OPCODE]
    assert sorted(summary.chunk_offsets) == chunks
    assert len(chunks) > 1


def test_a_flipped_bit_anywhere_in_the_summary_takes_the_trust_away(data: bytes) -> None:
    """Its CRC covers the footer too, up to the CRC itself; a bit of that or of the magic does the same."""
    footer = read_footer(BytesIO(data), len(data))
    assert footer is not None
    rng = random.Random(6)
    for place in rng.sample(range(footer.summary_start, len(data)), 150):
        broken = bytearray(data)
        broken[place] ^= 1 << rng.randrange(8)
        assert summary_of(bytes(broken)) is None


@pytest.mark.parametrize("missing", [1, len(MAGIC), TAIL_BYTES, 10**9])
def test_a_file_that_ends_early_has_no_footer(data: bytes, missing: int) -> None:
    truncated = data[: max(len(data) - missing, 0)]
    assert read_footer(BytesIO(truncated), len(truncated)) is None
    assert summary_of(truncated) is None


def test_a_summary_without_a_crc_is_not_trusted(data: bytes) -> None:
    """A footer that is there all the same is read."""
    without = bytearray(data)
    without[-len(MAGIC) - 4 : -len(MAGIC)] = bytes(4)
    assert read_footer(BytesIO(without), len(without)) is not None
    assert summary_of(bytes(without)) is None


def test_definitions_above_the_limit_are_refused(data: bytes) -> None:
    """As they are in the data section; schemas of a recording take more than a kilobyte."""
    assert summary_of(data, Limits(definition_bytes=1024)) is None


def test_a_record_that_cannot_be_read_is_refused() -> None:
    summary, limits = Summary(), Limits(metadata_bytes=1024)
    refused = {
        "a chunk index is too short": (Opcode.CHUNK_INDEX, bytes(31)),
        "statistics of 1025 bytes, the limit is 1024": (Opcode.STATISTICS, bytes(1025)),
        "bytes expected": (Opcode.SCHEMA, b"\1"),
    }
    for reason, (opcode, body) in refused.items():
        with pytest.raises(MalformedRecordError, match=reason):
            summary.add(opcode, memoryview(body), limits)
    summary.add(0x80, memoryview(b"anything"), limits)  # a record of a writer's own
    assert summary == Summary(definition_bytes=1)
