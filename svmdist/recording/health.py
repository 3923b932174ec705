"""What was lost while a recording was read: every loss once, with its place and its reason."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import count

from svmdist.recording.names import cut, sanitize

MAX_LISTED_LOSSES = 1000
"""A file with a million broken chunks must not fill the memory with reports about them."""


class LossKind(StrEnum):
    """What kind of thing could not be used."""

    TRUNCATED = "truncated"
    STRUCTURE = "structure"
    CHUNK = "chunk"
    RECORD = "record"
    DEFINITION = "definition"
    MESSAGE = "message"
    IMAGE = "image"
    DATA_CRC = "data_crc"
    SUMMARY = "summary"
    STATISTICS = "statistics"


@dataclass(frozen=True, slots=True)
class Loss:
    """One part of a recording that could not be used; `byte_offset` is its place in the file where known."""

    kind: LossKind
    detail: str
    byte_offset: int | None = None
    topic: str | None = None

    def __post_init__(self) -> None:
        """Keep no more of a text than is shown: it may come from the file."""
        object.__setattr__(self, "detail", cut(self.detail))
        if self.topic is not None:
            object.__setattr__(self, "topic", cut(self.topic))

    def __str__(self) -> str:
        place = "" if self.byte_offset is None else f" at byte {self.byte_offset}"
        topic = "" if self.topic is None else f" on {sanitize(self.topic)}"
        separator = ", " if self.kind is LossKind.TRUNCATED and place else ": "
        return f"{self.kind}{place}{topic}{separator}{sanitize(self.detail)}"


@dataclass
class Health:
    """The losses of one recording, filled while it is read.

    Reading a file twice finds the same losses again; each is kept once. Before a pass over the whole
    file has ended, the report is incomplete. Losses are listed in the order of `place`, so that images that
    are decoded late, by other threads, are listed as if they had been decoded at once.
    """

    unlisted_count: int = 0
    """Losses found beyond the listed ones; a lower bound of distinct ones, and 0 only where there are none."""
    _losses: dict[Loss, int] = field(default_factory=dict)
    _places: Iterator[int] = field(default_factory=count)

    def next_place(self) -> int:
        """Reserve a place in the order of losses, for a loss that may be found later."""
        return next(self._places)

    def add(self, loss: Loss, place: int | None = None) -> None:
        """Report a loss, at a place that was reserved or at the next one; one that is known is listed once."""
        place = self.next_place() if place is None else place
        known = self._losses.get(loss)
        if known is None and len(self._losses) >= MAX_LISTED_LOSSES:
            self.unlisted_count = 1
            return
        self._losses[loss] = place if known is None else min(place, known)

    def join(self, other: Health) -> None:
        """Take in what another process lost of the same recording."""
        for loss in other.losses:
            self.add(loss)
        self.unlisted_count = max(self.unlisted_count, other.unlisted_count)

    @property
    def losses(self) -> tuple[Loss, ...]:
        """The losses in the order of their places."""
        found = dict(self._losses)
        return tuple(sorted(found, key=lambda loss: found[loss]))

    @property
    def is_clean(self) -> bool:
        """Whether nothing was lost, so far as the file has been read."""
        return not self._losses

    def describe(self, max_lines: int = 10) -> tuple[str, ...]:
        """Say what was lost in a few lines for a person."""
        lines = [str(loss) for loss in self.losses]
        hidden = len(lines) - max_lines
        if hidden > 0 or self.unlisted_count:
            more = f"{max(hidden, 0)} more" if not self.unlisted_count else "many more"
            lines = [*lines[:max_lines], f"and {more} losses"]
        return tuple(lines)
