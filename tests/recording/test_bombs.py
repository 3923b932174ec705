"""Bombs: small files that ask for gigabytes are refused within 512 MiB; `benchmarks.speed` has the time it takes."""

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
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from .builders import write_messages
from .faults import chunk_body, join

MAGIC = b"\x89MCAP0\r\n"
GIB = 1 << 30
ROOT = Path(__file__).parents[2]
READ = """
import sys
from svmdist.errors import RecordingError
from svmdist.profile import load_profile
from svmdist.recording.summary import inspect_recording
from svmdist.recording.log import open_recording
from svmdist.samples import Rejection
from tests.reading import read_images
try:
    inspect_recording(open_recording(sys.argv[1], load_profile()))
    recording = open_recording(sys.argv[1], load_profile(), topics={"image": "/image"})
    found = list(read_images(recording))
    assert all(isinstance(item, Rejection) for item in found), found
    assert not recording.health.is_clean
    reasons = recording.health.describe()
except RecordingError as problem:
    reasons = [str(problem)]
# Not ru_maxrss: a process inherits that of the one which started it.
peak_kib = next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM:"))
peak_mib = int(peak_kib) / 1024
assert peak_mib < 512, f"took {peak_mib} MiB"
print(reasons[0])
"""


def chunk_of(compression: str, declared_bytes: int) -> Callable[[Path], None]:
    """A chunk of zeros that grows to 1 GiB, whatever it declares; made piece by piece, so that it costs no memory."""

    def write(path: Path) -> None:
        if compression == "zstd":
            compressor, begin = zstandard.ZstdCompressor(level=1).compressobj(size=GIB), b""
        else:
            compressor = lz4.frame.LZ4FrameCompressor()
            begin = compressor.begin()
        pieces = (compressor.compress(bytes(1 << 20)) for _ in range(GIB >> 20))
        body = chunk_body(compression, b"".join([begin, *pieces, compressor.flush()]), declared_bytes)
        path.write_bytes(MAGIC + join([(1, bytes(8)), (6, body), (15, bytes(4)), (2, bytes(20))]) + MAGIC)

    return write


def false_record_length(path: Path) -> None:
    """A record that claims nearly all of a 64-bit address space."""
    path.write_bytes(MAGIC + struct.pack("<BQ", 6, (1 << 63) - 1) + bytes(100))


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


def endless_image_encoding(path: Path) -> None:
    """Raw images whose encoding has 50 MiB: 500 MiB of messages in 20 KB."""
    image = RawImage(width=2, height=2, encoding="x" * (50 << 20), step=6, data=bytes(12)).SerializeToString()
    write_messages(path, [("/image", "foxglove.RawImage", "protobuf", image, n) for n in range(10)])


BOMBS: dict[str, Callable[[Path], None]] = {
    "zstd false": chunk_of("zstd", 1 << 20),
    "zstd true": chunk_of("zstd", GIB),
    "lz4 false": chunk_of("lz4", 1 << 20),
    "lz4 true": chunk_of("lz4", GIB),
    "length": false_record_length,
    "png": png_bomb,
    "encoding": endless_image_encoding,
}


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads its peak memory from /proc")
@pytest.mark.parametrize("bomb", BOMBS)
def test_bombs_are_refused(tmp_path, bomb):
    path = tmp_path / "bomb.mcap"
    BOMBS[bomb](path)
    command = [sys.executable, "-c", READ, path]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()
