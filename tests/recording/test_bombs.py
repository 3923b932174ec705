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

from .builders import write_messages
from .faults import join

MAGIC = b"\x89MCAP0\r\n"
GIB = 1 << 30
READ = """
import sys, time
from svmdist.errors import RecordingError
from svmdist.profile import load_profile
from svmdist.recording.reader import open_recording
from svmdist.samples import Rejection
started = time.process_time()
try:
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
    ],
)
def test_bombs_are_refused(tmp_path: Path, bomb: Callable[[Path], None]) -> None:
    path = tmp_path / "bomb.mcap"
    bomb(path)
    command = [sys.executable, "-c", READ, path]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()
