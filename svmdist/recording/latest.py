"""The latest samples of a stream, sorted by stamp: memory does not grow with the log."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from typing import Generic, TypeVar

Value = TypeVar("Value")


class Latest(Generic[Value]):
    """Samples by stamp; beyond a limit the older half is forgotten."""

    def __init__(self) -> None:
        self.stamps_ns: list[int] = []
        self.values: list[Value] = []

    @property
    def newest_ns(self) -> int:
        """Largest stamp, -1 where there is none."""
        return self.stamps_ns[-1] if self.stamps_ns else -1

    def add(self, stamp_ns: int, value: Value, limit: int) -> None:
        """Put a sample in its place; one with the same stamp is replaced."""
        place = len(self.stamps_ns)
        if place and self.stamps_ns[-1] >= stamp_ns:  # out of order: the rare case
            place = bisect_left(self.stamps_ns, stamp_ns)
            if self.stamps_ns[place] == stamp_ns:
                self.values[place] = value
                return
        self.stamps_ns.insert(place, stamp_ns)
        self.values.insert(place, value)
        if len(self.stamps_ns) > limit:
            # Half at once, so that forgetting costs nothing per sample.
            del self.stamps_ns[: limit // 2], self.values[: limit // 2]

    def clear(self) -> None:
        """Forget all samples."""
        self.stamps_ns.clear()
        self.values.clear()

    def around(self, stamp_ns: int) -> tuple[list[int], list[Value]]:
        """The stamps and values of the samples before and after a stamp: one at the ends and where one meets it."""
        right = bisect_left(self.stamps_ns, stamp_ns)
        is_met = right < len(self.stamps_ns) and self.stamps_ns[right] == stamp_ns
        chosen = slice(right if is_met else max(right - 1, 0), right + 1)
        return self.stamps_ns[chosen], self.values[chosen]

    def between(self, first_ns: int, last_ns: int) -> tuple[list[int], list[Value]]:
        """The stamps and values of all samples from one stamp to another, both included."""
        chosen = slice(bisect_left(self.stamps_ns, first_ns), bisect_right(self.stamps_ns, last_ns))
        return self.stamps_ns[chosen], self.values[chosen]
