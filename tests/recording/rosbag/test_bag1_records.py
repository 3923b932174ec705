"""The records of ROS 1 bags: fields and data as they were written, and no memory for what cannot be."""

from __future__ import annotations

import bz2
import random
import struct
from io import BytesIO

import lz4.frame
import pytest

from svmdist.profile import Limits
from svmdist.recording.effort import Effort
from svmdist.recording.rosbag.bag1_records import (
    MAX_HEADER_BYTES,
    OP_CHUNK,
    OP_MESSAGE,
    BagRecord,
    BrokenRecordError,
    chunk_records,
    parse_fields,
    read_record,
)

LIMITS = Limits()
COMPRESS = {"none": bytes, "lz4": lz4.frame.compress, "bz2": bz2.compress}
COMPRESSIONS = pytest.mark.parametrize("compression", COMPRESS)


def fields_bytes(fields: dict[bytes, bytes]) -> bytes:
    """A header without its length."""
    pairs = [name + b"=" + value for name, value in fields.items()]
    return b"".join(struct.pack("<I", len(pair)) + pair for pair in pairs)


def record_bytes(fields: dict[bytes, bytes], data: bytes) -> bytes:
    """A whole record."""
    header = fields_bytes(fields)
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def message(number: int, data: bytes) -> tuple[dict[bytes, bytes], bytes]:
    """The fields and data of a message record."""
    time = struct.pack("<II", number, 5)
    return {b"op": bytes([OP_MESSAGE]), b"conn": struct.pack("<I", 1), b"time": time}, data


MESSAGES = [message(number, random.Random(number).randbytes(200 * number)) for number in range(5)]
CONTENT = b"".join(record_bytes(*each) for each in MESSAGES)


def chunk(compression: str, *, size_bytes: int | None = None, end: int | None = None) -> BagRecord:
    """A chunk of the messages, whose data end where the file does."""
    data = COMPRESS[compression](CONTENT)
    declared = struct.pack("<I", len(CONTENT) if size_bytes is None else size_bytes)
    fields = {b"op": bytes([OP_CHUNK]), b"compression": compression.encode(), b"size": declared}
    return BagRecord(99, fields, data[:end], len(data))


def read(data: bytes, limits: Limits = LIMITS) -> BagRecord | None:
    """The first record of a file."""
    return read_record(BytesIO(data), len(data), limits)


def test_records_are_read_one_after_another() -> None:
    file = BytesIO(CONTENT)
    offset = 0
    for fields, data in MESSAGES:
        record = read_record(file, len(CONTENT), LIMITS)
        assert record is not None
        assert (record.offset, record.fields, record.data) == (offset, fields, data)
        assert not record.is_truncated
        offset += len(record_bytes(fields, data))
    assert read_record(file, len(CONTENT), LIMITS) is None


def test_fields_are_numbers_texts_and_times() -> None:
    """Little-endian; a value may hold the sign that separates it from its name."""
    record = read(record_bytes({**MESSAGES[3][0], b"topic": "/é=b".encode(), b"size": b"\1\2"}, b""))
    assert record is not None
    assert record.op == OP_MESSAGE
    assert record.number(b"size") == 0x201
    assert record.text(b"topic") == "/é=b"
    assert record.time_ns() == 3 * 10**9 + 5


def test_a_field_that_is_missing_or_of_another_kind_is_told() -> None:
    record = BagRecord(0, {b"long": bytes(9), b"no text": b"\xff", b"time": bytes(7)}, b"", 0)
    assert record.op == -1
    for name in (b"none", b"long"):
        with pytest.raises(BrokenRecordError, match=f"no number {name.decode()}"):
            record.number(name)
    for name in (b"none", b"no text"):
        with pytest.raises(BrokenRecordError, match=f"no text {name.decode()}"):
            record.text(name)
    with pytest.raises(BrokenRecordError, match="has no time"):
        record.time_ns()


@pytest.mark.parametrize("end", range(0, 60, 7))
def test_a_header_that_ends_early_is_malformed(end: int) -> None:
    """Unless it ends between two fields: then it is a shorter one."""
    header = fields_bytes(MESSAGES[1][0])
    ends = [0]
    for name, value in MESSAGES[1][0].items():
        ends.append(ends[-1] + 4 + len(name) + 1 + len(value))
    if end in ends:
        assert len(parse_fields(header[:end])) == ends.index(end)
    elif end < len(header):
        with pytest.raises(BrokenRecordError, match="a header is malformed"):
            parse_fields(header[:end])
    with pytest.raises(BrokenRecordError, match="a header is malformed"):
        parse_fields(struct.pack("<I", 3) + b"abc")


def test_a_file_that_ends_in_a_record_gives_what_is_there() -> None:
    data = record_bytes(*MESSAGES[2])
    data_start = len(data) - len(MESSAGES[2][1])
    for end in range(len(data)):
        record = read(data[:end])
        if end < data_start:
            assert record is None
            continue
        assert record is not None
        assert record.is_truncated
        assert record.data == MESSAGES[2][1][: end - data_start]


def test_lengths_above_the_limits_are_refused() -> None:
    """Before a byte of them is read; the header has a limit of its own."""
    with pytest.raises(BrokenRecordError, match=f"a header of {MAX_HEADER_BYTES + 1} bytes"):
        read(struct.pack("<I", MAX_HEADER_BYTES + 1))
    header = fields_bytes(MESSAGES[0][0])
    data = struct.pack("<I", len(header)) + header + struct.pack("<I", 1 << 31)
    with pytest.raises(BrokenRecordError, match=f"a record of {1 << 31} bytes"):
        read(data)


@COMPRESSIONS
def test_a_chunk_holds_the_records_that_were_put_into_it(compression: str) -> None:
    records = list(chunk_records(chunk(compression), LIMITS, Effort(0)))
    assert [(record.fields, bytes(record.data)) for record in records] == MESSAGES
    assert {record.offset for record in records} == {99}


@COMPRESSIONS
@pytest.mark.parametrize("wrong_by", [-1, 1])
def test_a_chunk_of_another_size_is_refused(compression: str, wrong_by: int) -> None:
    with pytest.raises(BrokenRecordError, match="bytes declared, found"):
        list(chunk_records(chunk(compression, size_bytes=len(CONTENT) + wrong_by), LIMITS, Effort(0)))


@COMPRESSIONS
def test_a_chunk_above_the_limit_is_refused(compression: str) -> None:
    with pytest.raises(BrokenRecordError, match="the limit is 1024"):
        list(chunk_records(chunk(compression), Limits(chunk_bytes=1024), Effort(0)))
    with pytest.raises(BrokenRecordError, match="more than 3 records"):
        list(chunk_records(chunk(compression), Limits(chunk_records=3), Effort(0)))


def test_a_bomb_of_bz2_stops_at_the_declared_size() -> None:
    """64 MiB of zeros in some fifty bytes, which declare one kilobyte."""
    bomb = bz2.compress(bytes(1 << 26))
    fields = {b"compression": b"bz2", b"size": struct.pack("<I", 1024)}
    with pytest.raises(BrokenRecordError, match="1024 bytes declared, found 1025 or more"):
        list(chunk_records(BagRecord(0, fields, bomb, len(bomb)), LIMITS, Effort(0)))


@COMPRESSIONS
def test_a_truncated_chunk_gives_its_first_records(compression: str) -> None:
    """Those that are whole in its readable prefix, and never another one.

    The last byte may be one of the compression's own end: then all of the content is there.
    """
    size_bytes = len(COMPRESS[compression](CONTENT))
    for end in (0, 10, size_bytes // 2, size_bytes - 1):
        try:
            records = list(chunk_records(chunk(compression, end=end), LIMITS, Effort(0)))
        except BrokenRecordError:
            assert end <= 10  # not even the head of the compression is there
            continue
        assert [(record.fields, bytes(record.data)) for record in records] == MESSAGES[: len(records)]
        assert len(records) < len(MESSAGES) or end == size_bytes - 1


def test_a_chunk_whose_last_record_is_incomplete_is_told_after_the_others() -> None:
    content = CONTENT[:-1]
    fields = {b"compression": b"none", b"size": struct.pack("<I", len(content))}
    records = chunk_records(BagRecord(0, fields, content, len(content)), LIMITS, Effort(0))
    assert [bytes(next(records).data) for _ in MESSAGES[:-1]] == [data for _, data in MESSAGES[:-1]]
    with pytest.raises(BrokenRecordError, match="the last record of a chunk is incomplete"):
        next(records)


def test_what_does_not_expand_is_told() -> None:
    for compression, reason in (
        (b"zstd", "the choices are none, lz4, bz2"),
        (b"bz2", "expand"),
        (b"lz4", "expand"),
    ):
        fields = {b"compression": compression, b"size": struct.pack("<I", 10)}
        with pytest.raises(BrokenRecordError, match=reason):
            list(chunk_records(BagRecord(0, fields, b"\xff" * 50, 50), LIMITS, Effort(0)))
