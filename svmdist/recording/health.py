"""What was lost while a recording was read: every loss once, with its place and its reason."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

from svmdist.recording.names import plain

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

    def __str__(self) -> str:
        place = "" if self.byte_offset is None else f" at byte {self.byte_offset}"
        topic = "" if self.topic is None else f" on {plain(self.topic)}"
        separator = ", " if self.kind is LossKind.TRUNCATED and place else ": "
        return f"{self.kind}{place}{topic}{separator}{plain(self.detail)}"


@dataclass
class Health:
    """The losses of one recording, filled while it is read.

    Reading a file twice finds the same losses again; each is kept once. Before a pass over the whole
    file has ended, the report is incomplete.
    """

    unlisted_count: int = 0
    """Losses found beyond the listed ones; a lower bound of distinct ones, and 0 only where there are none."""
    _losses: dict[Loss, None] = field(default_factory=dict)

    def add(self, loss: Loss) -> None:
        """Report a loss; one that is known already changes nothing."""
        if loss in self._losses:
            return
        if len(self._losses) >= MAX_LISTED_LOSSES:
            self.unlisted_count = 1 if self.unlisted_count == 0 else self.unlisted_count
            return
        self._losses[loss] = None

    @property
    def losses(self) -> tuple[Loss, ...]:
        """The losses in the order in which they were found."""
        return tuple(self._losses)

    @property
    def is_clean(self) -> bool:
        """Whether nothing was lost, so far as the file has been read."""
        return not self._losses

    def describe(self, max_lines: int = 10) -> tuple[str, ...]:
        """Say what was lost in a few lines for a person."""
        lines = [str(loss) for loss in self._losses]
        hidden = len(lines) - max_lines
        if hidden > 0 or self.unlisted_count:
            more = f"{max(hidden, 0)} more" if not self.unlisted_count else "many more"
            lines = [*lines[:max_lines], f"and {more} losses"]
        return tuple(lines)
