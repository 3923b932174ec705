"""How much work a file may ask for: by its size, so that a small one cannot take minutes or gigabytes.

The smallest messages there are, of values that hardly change, take a few bytes each when they are compressed, and
black images a thousandth of theirs.
"""

from __future__ import annotations

from pathlib import Path

FREE_EXPANDED_BYTES = 256 << 20
EXPANDED_PER_BYTE = 1000
FREE_RECORDS = 50_000
BYTES_PER_RECORD = 2
FREE_IDLE_RECORDS = 20_000
IDLE_PER_MESSAGE = 4
"""Indexes, definitions and chunks are no more than messages; what is beyond is there to be counted."""


class TooMuchError(ValueError):
    """A file asks for more than its size allows; what it asks for beyond is not read."""


class Effort:
    """What one pass over a file of some size may still take."""

    def __init__(self, size_bytes: int) -> None:
        self._expanded_bytes = FREE_EXPANDED_BYTES + EXPANDED_PER_BYTE * size_bytes
        self._records = FREE_RECORDS + size_bytes // BYTES_PER_RECORD
        self._idle_records = FREE_IDLE_RECORDS

    @classmethod
    def of_file(cls, path: Path) -> Effort:
        """What a file may take; OSError where it is not there."""
        return cls(path.stat().st_size)

    def expand(self, size_bytes: int) -> None:
        """Take so many bytes of what was compressed; raises TooMuchError."""
        self._expanded_bytes -= size_bytes
        if self._expanded_bytes < 0:
            raise TooMuchError("the file expands to more than a thousand times its size")

    def message(self) -> None:
        """Take a message; raises TooMuchError."""
        self._idle_records += IDLE_PER_MESSAGE
        self._records -= 1
        if self._records < 0:
            raise TooMuchError("the file has more messages than half its bytes")

    def idle(self) -> None:
        """Take a record that brings no message; raises TooMuchError."""
        self._idle_records -= 1
        if self._idle_records < 0:
            raise TooMuchError("the file is full of records that hold nothing")
