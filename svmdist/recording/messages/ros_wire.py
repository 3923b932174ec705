"""The byte layouts of ROS messages: CDR of ROS 2 and the plain layout of ROS 1, read strictly."""

from __future__ import annotations

import struct

import numpy as np

from svmdist.recording.messages.checks import NS, DecodeError
from svmdist.transforms import Array

PLAIN_CDR = {0: ">", 1: "<"}
PLAIN_CDR2 = {6: ">", 7: "<"}


class Ros1Wire:
    """Reads little-endian fields one after another; DecodeError where the message ends early."""

    def __init__(self, data: bytes | memoryview) -> None:
        self._view = memoryview(data)
        self._position = 0
        self._origin = 0
        self._order = "<"
        self._max_alignment = 1

    def u8(self) -> int:
        """Read an unsigned byte."""
        return self._take(1)[0]

    def i32(self) -> int:
        """Read a signed number of 32 bits."""
        return self._number("i", 4)

    def u32(self) -> int:
        """Read an unsigned number of 32 bits."""
        return self._number("I", 4)

    def floats(self, count: int) -> Array:
        """Read numbers of 64 bits, shape (count,)."""
        if count == 0:
            return np.zeros(0)
        self._align(8)
        return np.frombuffer(self._take(8 * count), f"{self._order}f8").astype(np.float64)

    def float_sequence(self) -> Array:
        """Read a length and as many numbers of 64 bits."""
        return self.floats(self.u32())

    def octets(self) -> memoryview:
        """Read a length and as many bytes, without copying them."""
        return self._take(self.u32())

    def text(self) -> str:
        """Read a string."""
        return self._decode(self.octets())

    def stamp_ns(self) -> int:
        """Read seconds and nanoseconds."""
        seconds = self.u32()
        return seconds * NS + self.u32()

    def header(self) -> tuple[int, str]:
        """Read a std_msgs/Header: its stamp in ns and its frame."""
        self.u32()  # the sequence number, which ROS 2 has given up
        return self.stamp_ns(), self.text()

    def _number(self, code: str, size: int) -> int:
        self._align(size)
        return int(struct.unpack(self._order + code, self._take(size))[0])

    def _align(self, size: int) -> None:
        size = min(size, self._max_alignment)
        self._position += -(self._position - self._origin) % size

    def _take(self, count: int) -> memoryview:
        end = self._position + count
        if end > len(self._view):
            raise DecodeError(f"the message ends early, at byte {len(self._view)}; {end} are needed")
        taken = self._view[self._position : end]
        self._position = end
        return taken

    @staticmethod
    def _decode(octets: memoryview) -> str:
        try:
            return str(octets, "utf-8")
        except UnicodeDecodeError:
            raise DecodeError("a string is not UTF-8") from None


class CdrWire(Ros1Wire):
    """Reads the fields of ROS 2's plain CDR, which are aligned to their size."""

    def __init__(self, data: bytes | memoryview) -> None:
        super().__init__(data)
        kind = bytes(self._take(4))[:2]
        if kind[0] != 0 or kind[1] not in {**PLAIN_CDR, **PLAIN_CDR2}:
            raise DecodeError(f"not plain CDR: it begins with {kind.hex(' ')}")
        self._order = {**PLAIN_CDR, **PLAIN_CDR2}[kind[1]]
        self._max_alignment = 8 if kind[1] in PLAIN_CDR else 4
        self._origin = 4

    def text(self) -> str:
        """Read a string, which ends in a zero byte."""
        octets = self.octets()
        return self._decode(octets[:-1] if len(octets) and octets[-1] == 0 else octets)

    def stamp_ns(self) -> int:
        """Read seconds, which have a sign here, and nanoseconds."""
        seconds = self.i32()
        return seconds * NS + self.u32()

    def header(self) -> tuple[int, str]:
        """Read a std_msgs/Header: its stamp in ns and its frame."""
        return self.stamp_ns(), self.text()
