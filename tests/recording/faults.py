"""Breaking recordings on purpose: cuts, flipped bits and structural mutants, and what a reader makes of them."""

import random
import struct
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import lz4.frame
import zstandard

from svmdist.errors import RecordingError
from svmdist.profile import Limits
from svmdist.recording.mcap import McapSource
from svmdist.recording.source import LossKind

HEAD = struct.Struct("<BQ")
MAGIC_BYTES = 8
MESSAGE_OPCODE, CHUNK_OPCODE = 5, 6
COMPRESS = {"zstd": zstandard.compress, "lz4": lz4.frame.compress, "": bytes}
EXTREMES = (0, 1, 7, 0xFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 1 << 40, (1 << 63) - 1, (1 << 64) - 1)

Delivered = tuple[str, int, bytes]


@dataclass(frozen=True)
class Reading:
    """What a reader delivered of a file, and what it said was lost."""

    messages: list[Delivered]
    kinds: frozenset[LossKind]
    metadata: dict[str, str]

    @property
    def is_clean(self) -> bool:
        """Whether the reader claims that nothing is missing."""
        return not self.kinds


def read(path: Path) -> Reading | None:
    """Read every message; None where the reader refuses the file."""
    source = McapSource(path, Limits())
    try:
        _ = source.topics  # first of all, as whoever opens a log does
        messages = [(m.topic, m.log_time_ns, bytes(m.data)) for m in source.messages()]
        metadata = source.metadata()
    except RecordingError:
        return None
    return Reading(messages, frozenset(loss.kind for loss in source.health.losses), metadata)


def is_subsequence(part: Iterable[Delivered], whole: Iterable[Delivered]) -> bool:
    """Whether `part` is `whole` with some messages left out, in the same order."""
    rest = iter(whole)
    return all(message in rest for message in part)


@dataclass(frozen=True)
class Part:
    """One record of a file: opcode, place of its head, and body."""

    opcode: int
    offset: int
    body: bytes

    @property
    def end(self) -> int:
        """Place behind it."""
        return self.offset + HEAD.size + len(self.body)


def split(data: bytes, start: int = MAGIC_BYTES) -> list[Part]:
    """Split an intact file, or the content of a chunk, into its records."""
    parts, position = [], start
    while position + HEAD.size <= len(data):
        opcode, length = HEAD.unpack_from(data, position)
        parts.append(Part(opcode, position, data[position + HEAD.size : position + HEAD.size + length]))
        position = parts[-1].end
    return parts


def join(parts: Sequence[tuple[int, bytes]]) -> bytes:
    """Join records without a magic."""
    return b"".join(HEAD.pack(opcode, len(body)) + body for opcode, body in parts)


def expand(chunk_body: bytes) -> tuple[str, bytes]:
    """Give compression and content of an intact chunk."""
    (name_length,) = struct.unpack_from("<I", chunk_body, 28)
    name = chunk_body[32 : 32 + name_length].decode()
    data = chunk_body[40 + name_length :]
    if name == "zstd":
        return name, zstandard.decompress(data)
    return name, lz4.frame.decompress(data) if name == "lz4" else data


def chunk_body(compression: str, data: bytes, size_bytes: int, crc: int = 0) -> bytes:
    """Make the body of a chunk of compressed data, which declares a size."""
    name = compression.encode()
    head = struct.pack("<QQQII", 0, 0, size_bytes, crc, len(name))
    return head + name + struct.pack("<Q", len(data)) + data


def chunks(data: bytes) -> list[tuple[Part, int]]:
    """The chunks of an intact file, and the number of messages in each."""
    found = [part for part in split(data[:-MAGIC_BYTES]) if part.opcode == CHUNK_OPCODE]
    return [(part, sum(inner.opcode == MESSAGE_OPCODE for inner in split(expand(part.body)[1], 0))) for part in found]


def flip_bit(data: bytes, rng: random.Random) -> bytes:
    """Flip one random bit."""
    place = rng.randrange(len(data))
    return data[:place] + bytes([data[place] ^ (1 << rng.randrange(8))]) + data[place + 1 :]


def mutate_body(body: bytes, rng: random.Random) -> bytes:
    """Change a length, a number or some bytes somewhere in a body."""
    if not body:
        return bytes(rng.randrange(1, 30))
    place = rng.randrange(len(body))
    if rng.random() < 0.5:
        place = min(place, rng.randrange(64))  # most structure stands in the first bytes
    match rng.randrange(5):
        case 0:
            size = rng.choice((1, 2, 4, 8))
            value = rng.choice(EXTREMES) & ((1 << 8 * size) - 1)
            new = value.to_bytes(size, "little")
            return body[:place] + new + body[place + size :]
        case 1:
            return body[:place]
        case 2:
            return body[:place] + rng.randbytes(rng.randrange(1, 40)) + body[place:]
        case 3:
            return body[:place] + rng.randbytes(4) + body[place + 4 :]
        case _:
            return flip_bit(body, rng)


def mutate(data: bytes, rng: random.Random) -> bytes:
    """Make a structural mutant of a file: in its records, or inside a chunk whose CRC is made right again."""
    parts = split(data[:-MAGIC_BYTES])
    records = [(part.opcode, part.body) for part in parts]
    for _ in range(rng.choice((1, 1, 1, 2, 5))):
        index = rng.randrange(len(records))
        opcode, body = records[index]
        choice = rng.randrange(9)
        if choice <= 2 and opcode == CHUNK_OPCODE:
            try:
                records[index] = (opcode, _mutate_inside(body, rng))
            except (struct.error, ValueError, RuntimeError, KeyError, zstandard.ZstdError):
                continue  # an earlier step has broken this chunk already
        elif choice == 3:
            records[index] = (rng.choice((*range(18), 0x80, 0xFF)), body)
        elif choice == 4:
            del records[index]
            if not records:
                break
        elif choice == 5:
            records.insert(rng.randrange(len(records)), records[index])
        elif choice == 6:
            other = rng.randrange(len(records))
            records[index], records[other] = records[other], records[index]
        else:
            records[index] = (opcode, mutate_body(body, rng))
    mutant = bytearray(data[:MAGIC_BYTES] + join(records) + data[-MAGIC_BYTES:])
    if rng.random() < 0.3:  # a length that does not fit its record
        place = rng.choice(parts).offset + 1
        mutant[place : place + 8] = rng.choice((*EXTREMES, rng.randrange(1, len(data)))).to_bytes(8, "little")
    if rng.random() < 0.1:
        del mutant[rng.randrange(len(mutant)) :]
    return bytes(mutant)


def _mutate_inside(body: bytes, rng: random.Random) -> bytes:
    compression, content = expand(body)
    inner = [(part.opcode, part.body) for part in split(content, 0)]
    index = rng.randrange(len(inner))
    opcode, inner_body = inner[index]
    match rng.randrange(5):
        case 0:
            inner[index] = (rng.choice((*range(18), 0x80)), inner_body)
        case 1:
            inner.insert(rng.randrange(len(inner)), inner[index])
        case 2:
            del inner[index]
        case _:
            inner[index] = (opcode, mutate_body(inner_body, rng))
    content = join(inner)
    if rng.random() < 0.1:
        content = mutate_body(content, rng)
    size_bytes = rng.choice((*[len(content)] * 3, *EXTREMES, 1 << 28))
    other = rng.choice((compression, compression, "zstd", "lz4", ""))
    return chunk_body(other, COMPRESS[other](content), size_bytes, zlib.crc32(content))
