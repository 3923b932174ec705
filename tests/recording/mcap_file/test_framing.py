"""Framing: records come out as they were written, and nothing is read beyond a limit or the end."""

from __future__ import annotations

import zlib
from io import BytesIO

import pytest

from svmdist.profile import Limits
from svmdist.recording.mcap_file.framing import HEAD, Frame, FrameStream, split_records
from tests.recording.faults import join

RECORDS = [(3, b"schema"), (4, b""), (5, bytes(range(256))), (15, b"end")]
DATA = join(RECORDS)


def frames_of(data: bytes, limits: Limits | None = None, size_bytes: int | None = None) -> list[Frame]:
    """All frames of a file without a magic."""
    stream = FrameStream(BytesIO(data), len(data) if size_bytes is None else size_bytes, limits or Limits())
    found = []
    while (frame := stream.next_frame()) is not None:
        found.append(frame)
        if frame.is_truncated:
            break
    return found


def test_records_come_out_as_they_were_written() -> None:
    """One behind the other without a gap, up to the end."""
    frames = frames_of(DATA)
    assert [(frame.opcode, frame.body) for frame in frames] == RECORDS
    assert [frame.offset for frame in frames] == [0, *(frame.end for frame in frames[:-1])]
    assert frames[-1].end == len(DATA)
    assert not any(frame.is_truncated for frame in frames)


def test_the_running_crc_is_that_of_everything_before() -> None:
    for frame in frames_of(DATA):
        assert frame.crc_before == zlib.crc32(DATA[: frame.offset])


@pytest.mark.parametrize("end", [0, 5, 9, 12, 20, 24, 60, len(DATA) - 1])
def test_a_file_that_ends_early_gives_its_whole_records_and_at_most_one_truncated(end: int) -> None:
    frames = frames_of(DATA[:end])
    whole = [frame for frame in frames if not frame.is_truncated]
    assert [(frame.opcode, frame.body) for frame in whole] == RECORDS[: len(whole)]
    assert len(frames) - len(whole) in {0, 1}
    for frame in frames[len(whole) :]:
        opcode, body = RECORDS[len(whole)]
        assert frame.opcode == opcode
        assert frame.length == len(body)
        assert frame.body is not None
        assert body.startswith(frame.body)
        assert frame.end > end


def test_a_record_above_the_limit_is_skipped_and_the_next_one_read() -> None:
    large = [(5, bytes(5000)), (15, b"end")]
    frames = frames_of(join(large), Limits(record_bytes=1024))
    assert [(frame.opcode, frame.length, frame.body) for frame in frames] == [
        (5, 5000, None),
        (15, 3, b"end"),
    ]
    assert frames[1].crc_before == zlib.crc32(join(large[:1]))


def test_a_length_beyond_the_file_reads_no_more_than_the_limit() -> None:
    """The rest of the file is left where it is, for a length of 2^63 may be any flipped bit."""
    data = HEAD.pack(5, 1 << 63) + bytes(5000)
    stream = FrameStream(BytesIO(data), len(data), Limits(record_bytes=1024))
    frame = stream.next_frame()
    assert frame is not None
    assert frame.is_truncated
    assert frame.body == b""
    assert stream.remaining_bytes == 5000


def test_a_file_that_shrinks_while_it_is_read_ends() -> None:
    """More bytes are promised than there are: what is there is read, and then there is no next record."""
    stream = FrameStream(BytesIO(DATA), len(DATA) + 1000, Limits())
    bodies = [frame.body for _ in RECORDS if (frame := stream.next_frame()) is not None]
    assert bodies == [body for _, body in RECORDS]
    assert stream.next_frame() is None
    assert stream.remaining_bytes == 0


def test_a_jump_goes_on_at_another_record() -> None:
    stream = FrameStream(BytesIO(DATA), len(DATA), Limits())
    offset = HEAD.size + len(RECORDS[0][1])
    stream.jump(offset)
    frame = stream.next_frame()
    assert frame is not None
    assert (frame.offset, frame.opcode) == (offset, RECORDS[1][0])


def test_the_records_of_a_chunk_stop_at_an_incomplete_one() -> None:
    """At any end: those that are whole come out, each at its place."""
    assert [(opcode, bytes(body)) for opcode, _, body in split_records(DATA)] == RECORDS
    for end in range(len(DATA)):
        found = list(split_records(DATA[:end]))
        assert [(opcode, bytes(body)) for opcode, _, body in found] == RECORDS[: len(found)]
        reached = found[-1][1] + HEAD.size + len(found[-1][2]) if found else 0
        assert reached <= end
        _, body = RECORDS[len(found)]
        assert reached + HEAD.size + len(body) > end


def test_an_extreme_length_in_a_chunk_ends_it() -> None:
    assert list(split_records(HEAD.pack(5, (1 << 64) - 1) + bytes(100))) == []
