"""Rows of numbers by their stamps, in a temporary file: a log of any length takes the memory of a few blocks."""

from __future__ import annotations

import tempfile
from bisect import bisect_right
from types import TracebackType
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from svmdist.tracks import Stamps, sort_stamps
from svmdist.transforms import Array

BLOCK = 1 << 14


class StampedRows:
    """Rows of `width` numbers each, added in any order and read by stamp; of equal stamps the last one counts.

    Where stamps come out of order, sorting takes 24 bytes a row.
    """

    def __init__(self, width: int) -> None:
        self._type = np.dtype([("stamp", "<i8"), ("row", "<f8", (width,))])
        self._file: IO[bytes] = tempfile.TemporaryFile(prefix="svmdist-")  # noqa: SIM115  (closed by __exit__)
        self._buffer: NDArray[Any] = np.empty(BLOCK, self._type)
        self._filled = 0
        self._written = 0
        self._last: int | None = None
        self._is_sorted = True
        self._order: NDArray[np.intp] | None = None
        self._starts: list[int] = []

    def __enter__(self) -> StampedRows:
        """Begin."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Remove the file."""
        self._file.close()

    def __len__(self) -> int:
        """Count the rows."""
        return self._written + self._filled if self._order is None else len(self._order)

    def add(self, stamp_ns: int, row: Any) -> None:
        """Add a row, shape (width,)."""
        self._is_sorted &= self._last is None or stamp_ns > self._last
        self._last = stamp_ns
        self._buffer[self._filled] = stamp_ns, row
        self._filled += 1
        if self._filled == BLOCK:
            self._flush()

    def finish(self) -> int:
        """Sort the rows; gives how many of them had the stamp of a later one, and are gone."""
        self._flush()
        total = self._written
        if not self._is_sorted:
            self._file.flush()
            everything = np.memmap(self._file, self._type, "r", shape=(total,))
            self._order = sort_stamps(np.ascontiguousarray(everything["stamp"]))
        self._starts = [int(self.read(at, at + 1)[0][0]) for at in range(0, len(self), BLOCK)]
        return total - len(self)

    def read(self, begin: int, end: int) -> tuple[Stamps, Array]:
        """Stamps and rows, by their numbers in the order of time."""
        end = min(end, len(self))
        if self._order is None:
            self._file.seek(begin * self._type.itemsize)
            size = max(end - begin, 0) * self._type.itemsize
            found = np.frombuffer(self._file.read(size), self._type)
        else:
            everything = np.memmap(self._file, self._type, "r", shape=(self._written,))
            found = np.array(everything[self._order[begin:end]])
        return np.ascontiguousarray(found["stamp"]), np.ascontiguousarray(found["row"])

    def around(self, first_ns: int, last_ns: int) -> tuple[Stamps, Array]:
        """The rows between two stamps, and at least one before and one behind them where there are any."""
        # Of the block before the one that a stamp falls into: its last row may be the neighbour.
        begin = max(bisect_right(self._starts, first_ns) - 2, 0)
        end = bisect_right(self._starts, last_ns) + 1
        return self.read(begin * BLOCK, end * BLOCK)

    def _flush(self) -> None:
        self._file.seek(0, 2)
        self._file.write(self._buffer[: self._filled].tobytes())
        self._written += self._filled
        self._filled = 0
