"""Telling how far work is: how many steps of how many are done, over several recordings."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TypeVar

from svmdist.recording.log import Recording

Progress = Callable[[int, int | None], None]
"""Is told how much is done, and how much there is where that is known."""
Item = TypeVar("Item")


class Steps:
    """Counts what goes by, in all passes over all recordings, and tells it."""

    def __init__(self, on_progress: Progress | None, total: int | None) -> None:
        self._on_progress = on_progress
        self._total = total
        self._done = 0

    def of(self, items: Iterable[Item]) -> Iterator[Item]:
        """The items as they come, each a step."""
        for item in items:
            yield item
            self.advance()

    def advance(self) -> None:
        """One step is done."""
        self._done += 1
        if self._on_progress is not None:
            self._on_progress(self._done, self._total)


def image_total(
    recordings: Sequence[Recording], each: Callable[[Recording], int] = lambda _: 1
) -> int | None:
    """The images of recordings, times the steps that each image of a recording takes; None where it is not known."""
    total = 0
    for recording in recordings:
        count = recording.image_count()
        if count is None:
            return None
        total += count * each(recording)
    return total
