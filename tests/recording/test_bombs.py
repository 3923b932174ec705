"""Bombs: small files that ask for gigabytes are refused within 2 s and 512 MiB."""

from __future__ import annotations

import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from .builders import write_messages
from .faults import join, pack_chunk

MAGIC = b"\x89MCAP0\r\n"
GIB = 1 << 30
READ = """
import sys, time
from svmdist.errors import RecordingError
from svmdist.profile import load_profile
from svmdist.recording.summary import inspect_recording
from svmdist.recording.log import open_recording
from svmdist.samples import Rejection
started = time.process_time()
try:
    inspect_recording(sys.argv[1], load_profile())
    inspected = time.process_time() - started
    assert inspected < 2.0, f"to inspect it took {inspected} s"
    started = time.process_time()
    recording = open_recording(sys.argv[1], load_profile(), topics={"image": "/image"})
    found = list(recording.images())
    assert all(isinstance(item, Rejection) for item in found), found
    assert not recording.health.is_clean
    reasons = recording.health.describe()
except RecordingError as problem:
    reasons = [str(problem)]
seconds = time.process_time() - started
assert seconds < 2.0, f"took {seconds} s"
# Not ru_maxrss: a process inherits that of the one which started it.
peak_kib = next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM:"))
peak_mib = int(peak_kib) / 1024
assert peak_mib < 512, f"took {peak_mib} MiB"
print(reasons[0])
"""


def zeros_zstd(size_bytes: int) -> bytes:
    """Zeros, compressed piece by piece so that the bomb itself costs no memory."""
    compressor = zstandard.ZstdCompressor(level=1).compressobj(size=size_bytes)
    piece = bytes(1 << 20)
    parts = [compressor.compress(piece) for _ in range(size_bytes >> 20)]
    return b"".join([*parts, compressor.flush()])


def zeros_lz4(size_bytes: int) -> bytes:
    """The same in LZ4's frame format."""
    with lz4.frame.LZ4FrameCompressor() as compressor:
        piece = bytes(1 << 20)
        parts = [compressor.begin(), *(compressor.compress(piece) for _ in range(size_bytes >> 20))]
        return b"".join([*parts, compressor.flush()])


def file_with_chunk(path: Path, compression: str, data: bytes, size_bytes: int, crc: int = 0) -> None:
    """Write a file of one chunk with a given declared size."""
    name = compression.encode()
    head = struct.pack("<QQQII", 0, 0, size_bytes, crc, len(name)) + name + struct.pack("<Q", len(data))
    path.write_bytes(MAGIC + join([(1, bytes(8)), (6, head + data), (15, bytes(4)), (2, bytes(20))]) + MAGIC)


def zstd_false_size(path: Path) -> None:
    """A chunk that declares 1 MiB and grows to 1 GiB."""
    file_with_chunk(path, "zstd", zeros_zstd(GIB), 1 << 20)


def zstd_true_size(path: Path) -> None:
    """A chunk that declares what it grows to."""
    file_with_chunk(path, "zstd", zeros_zstd(GIB), GIB)


def lz4_false_size(path: Path) -> None:
    """The same in LZ4."""
    file_with_chunk(path, "lz4", zeros_lz4(GIB), 1 << 20)


def lz4_true_size(path: Path) -> None:
    """The same in LZ4, honestly declared."""
    file_with_chunk(path, "lz4", zeros_lz4(GIB), GIB)


def zero_records(path: Path) -> None:
    """A chunk within the limit, full of empty records of opcode 0."""
    file_with_chunk(path, "zstd", zeros_zstd(200 << 20), 200 << 20)


def a_million_and_more_records(path: Path) -> None:
    """A chunk of empty records of an unknown opcode."""
    content = struct.pack("<BQ", 0x80, 0) * 3_000_000
    file_with_chunk(path, "zstd", zstandard.compress(content), len(content))


def many_definitions(path: Path) -> None:
    """Chunks whose schemas would all have to be kept."""
    records = [(1, bytes(8))]
    for number in range(1, 9):
        schema = struct.pack("<HI", number, 1) + b"s" + struct.pack("<II", 0, 30 << 20) + bytes(30 << 20)
        content = join([(3, schema)])
        head = struct.pack("<QQQII", 0, 0, len(content), zlib.crc32(content), 4) + b"zstd"
        data = zstandard.compress(content)
        records.append((6, head + struct.pack("<Q", len(data)) + data))
    path.write_bytes(MAGIC + join([*records, (15, bytes(4)), (2, bytes(20))]) + MAGIC)


def false_record_length(path: Path) -> None:
    """A record that claims nearly all of a 64-bit address space."""
    path.write_bytes(MAGIC + struct.pack("<BQ", 6, (1 << 63) - 1) + bytes(100))


def many_map_entries(path: Path) -> None:
    """Metadata of millions of empty pairs."""
    pairs = bytes(100 << 20)
    metadata = struct.pack("<I", 7) + b"svmdist" + struct.pack("<I", len(pairs)) + pairs
    path.write_bytes(MAGIC + join([(1, bytes(8)), (12, metadata), (15, bytes(4)), (2, bytes(20))]) + MAGIC)


def png_of(width_px: int, height_px: int, data: bytes) -> bytes:
    """A PNG with true CRCs."""

    def part(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = struct.pack(">IIBBBBB", width_px, height_px, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + part(b"IHDR", head) + part(b"IDAT", data) + part(b"IEND", b"")


def png_bomb(path: Path) -> None:
    """An image of 20,000 x 20,000 pixels in a few hundred kilobytes, three times."""
    data = zlib.compress(bytes(200 << 20), 1)
    message = CompressedImage(data=png_of(20_000, 20_000, data), format="png").SerializeToString()
    write_messages(path, [("/image", "foxglove.CompressedImage", "protobuf", message, n) for n in range(3)])


def many_joints(path: Path) -> None:
    """A message of millions of empty joints, on the topic of images."""
    data = b"\x12\x00" * (30 << 20)
    write_messages(path, [("/image", "foxglove.JointStates", "protobuf", data, 1)])


def whole(records: list[tuple[int, bytes]]) -> bytes:
    """A file of some records, without a summary."""
    return MAGIC + join([(1, bytes(8)), *records, (15, bytes(4)), (2, bytes(20))]) + MAGIC


def indexed(records: list[tuple[int, bytes]], places: list[int]) -> bytes:
    """A file whose index, with a true CRC, names chunks at some places."""
    body = MAGIC + join([(1, bytes(8)), *records, (15, bytes(4))])
    head = struct.Struct("<QQQQ")
    index = join([(8, head.pack(0, 0, place, 0) + bytes(32)) for place in places])
    footer = struct.pack("<BQQQ", 2, 20, len(body), 0)
    return body + index + footer + struct.pack("<I", zlib.crc32(index + footer)) + MAGIC


def text(content: bytes) -> bytes:
    """A text behind its length."""
    return struct.pack("<I", len(content)) + content


def endless_names(path: Path) -> None:
    """A topic, a schema and an encoding of 60 MiB each, in chunks of a few kilobytes."""
    name = b"\x1b" * (60 << 20)
    plain = (3, struct.pack("<H", 1) + text(b"foxglove.CompressedImage") + text(b"protobuf") + text(b""))
    channels = [
        [(3, struct.pack("<H", 2) + text(name) + text(b"protobuf") + text(b""))],
        [plain, (4, struct.pack("<HH", 1, 1) + text(name) + text(b"protobuf") + text(b""))],
        [plain, (4, struct.pack("<HH", 2, 1) + text(b"/image") + text(name) + text(b""))],
    ]
    path.write_bytes(whole([(6, pack_chunk("zstd", join(records))) for records in channels]))


def endless_image_encoding(path: Path) -> None:
    """Raw images whose encoding has 50 MiB: 500 MiB of messages in 20 KB."""
    image = RawImage(width=2, height=2, encoding="x" * (50 << 20), step=6, data=bytes(12)).SerializeToString()
    write_messages(path, [("/image", "foxglove.RawImage", "protobuf", image, n) for n in range(10)])


def misframed_chunks(path: Path) -> None:
    """Chunks that contradict themselves, each of which sends the reader to the index of all of them."""
    size, count = 49, 20_000
    path.write_bytes(indexed([(6, b"\xff" * 40)] * count, [25 + size * n for n in range(count)]))


def chunks_that_are_too_long(path: Path) -> None:
    """The same with chunks behind whose data something else follows."""
    body = pack_chunk("", b"") + bytes(30)
    path.write_bytes(indexed([(6, body)] * 20_000, [30 + (9 + len(body)) * n for n in range(20_000)]))


def a_million_empty_chunks(path: Path) -> None:
    """Chunks that hold nothing, and are expanded one by one."""
    path.write_bytes(whole([(6, pack_chunk("zstd", b""))] * 1_000_000))


def a_million_tiny_messages(path: Path) -> None:
    """Messages without content, in a few kilobytes."""
    definitions = [
        (3, struct.pack("<H", 1) + text(b"foxglove.CompressedImage") + text(b"protobuf") + text(b"")),
        (4, struct.pack("<HH", 1, 1) + text(b"/image") + text(b"protobuf") + text(b"")),
    ]
    chunk = (6, pack_chunk("zstd", join([(5, struct.pack("<HIQQ", 1, 0, 0, 0))]) * 900_000))
    path.write_bytes(whole([(6, pack_chunk("zstd", join(definitions))), *[chunk] * 5]))


def messages_of_endless_joints(path: Path) -> None:
    """Thousands of messages of ten thousand joints each."""
    joints = JointStates()
    for number in range(10_000):
        joints.joints.add(name=f"j{number}", position=1.0)
    data = joints.SerializeToString()
    messages = [("/PSM1/measured_js", "foxglove.JointStates", "protobuf", data, n) for n in range(1000)]
    write_messages(path, [*messages, ("/image", "foxglove.JointStates", "protobuf", data, 1)])


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads its peak memory from /proc")
@pytest.mark.parametrize(
    "bomb",
    [
        zstd_false_size,
        zstd_true_size,
        lz4_false_size,
        lz4_true_size,
        zero_records,
        a_million_and_more_records,
        many_definitions,
        false_record_length,
        many_map_entries,
        png_bomb,
        many_joints,
        endless_names,
        endless_image_encoding,
        misframed_chunks,
        chunks_that_are_too_long,
        a_million_empty_chunks,
        a_million_tiny_messages,
        messages_of_endless_joints,
    ],
)
def test_bombs_are_refused(tmp_path: Path, bomb: Callable[[Path], None]) -> None:
    path = tmp_path / "bomb.mcap"
    bomb(path)
    command = [sys.executable, "-c", READ, path]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()
