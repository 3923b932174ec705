"""What every kind of recording file gives: topics, raw messages in file order, and what was lost."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple, Protocol

from svmdist.remote import LogPath

MAX_NAME_LENGTH = 300
MAX_LISTED_NAMES = 40
MAX_LISTED_LOSSES = 1000  # reports about a file with a million broken chunks must not fill the memory
METADATA_FILE = "metadata.yaml"  # makes a folder a rosbag2 recording


def cut(text: str) -> str:
    """The beginning of a text of any length, to be kept or shown."""
    return text if len(text) <= MAX_NAME_LENGTH else f"{text[:MAX_NAME_LENGTH]}..."


def sanitize(name: str) -> str:
    r"""Write a name from a file in one line: control characters escaped, shortened where it is very long.

    >>> sanitize("/left\x1b[31m")
    '/left\\x1b[31m'
    """
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in cut(name))


def sanitize_list(names: Iterable[str]) -> str:
    """List names, the first forty of them."""
    listed = [sanitize(name) for name in names]
    more = [f"and {len(listed) - MAX_LISTED_NAMES} more"] if len(listed) > MAX_LISTED_NAMES else []
    return ", ".join(listed[:MAX_LISTED_NAMES] + more)


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
    CONTRADICTION = "contradiction"  # what log or profile say twice does not agree, and distances rest on it; no loss


@dataclass(frozen=True, slots=True)
class Loss:
    """One part of a recording that could not be used; `byte_offset` is its place in the file where known."""

    kind: LossKind
    detail: str
    byte_offset: int | None = None
    topic: str | None = None

    def __str__(self) -> str:
        place = "" if self.byte_offset is None else f" at byte {self.byte_offset}"
        topic = "" if self.topic is None else f" on {sanitize(self.topic)}"
        separator = ", " if self.kind is LossKind.TRUNCATED and place else ": "
        return f"{self.kind}{place}{topic}{separator}{sanitize(self.detail)}"


@dataclass
class Health:
    """The losses of one recording, each once, by their places; complete after a pass over the whole file."""

    unlisted_count: int = 0  # losses beyond the listed ones: a lower bound, and 0 only where there are none
    _losses: dict[Loss, int] = field(default_factory=dict)
    _place_count: int = 0  # a plain number: Python 3.14 sends no iterators between processes

    def next_place(self) -> int:
        """Reserve a place in the order of losses, for one that another thread may find later, as if it came at once."""
        self._place_count += 1
        return self._place_count

    def add(self, loss: Loss, place: int | None = None) -> None:
        """Report a loss, at a reserved place or at the next one."""
        place = self.next_place() if place is None else place
        if loss in self._losses or len(self._losses) < MAX_LISTED_LOSSES:
            self._losses[loss] = min(place, self._losses.get(loss, place))
        else:
            self.unlisted_count = 1

    def lose(self, kind: LossKind, detail: str, offset: int | None = None, topic: str | None = None) -> None:
        """Report a loss at the next place."""
        self.add(Loss(kind, detail, offset, topic))

    def join(self, other: Health) -> None:
        """Take in what another process lost of the same recording."""
        for loss in other.losses:
            self.add(loss)
        self.unlisted_count = max(self.unlisted_count, other.unlisted_count)

    @property
    def losses(self) -> tuple[Loss, ...]:
        """The losses in the order of their places."""
        return tuple(sorted(self._losses, key=self._losses.__getitem__))

    @property
    def contradictions(self) -> tuple[str, ...]:
        """What of the log, or of log and profile, does not agree."""
        return tuple(one.detail for one in self.losses if one.kind is LossKind.CONTRADICTION)

    @property
    def is_clean(self) -> bool:
        """Whether nothing was lost, so far as the file has been read."""
        return not self._losses

    def describe(self, max_lines: int = 10) -> tuple[str, ...]:
        """Say in a few human-readable lines what was lost."""
        lines = [str(loss) for loss in self.losses if loss.kind is not LossKind.CONTRADICTION]
        hidden = len(lines) - max_lines
        if hidden > 0 or self.unlisted_count:
            lines[max_lines:] = [f"and {'many' if self.unlisted_count else hidden} more losses"]
        return tuple(lines)


class TopicInfo(NamedTuple):
    """A topic of a recording; `message_count` is None where the file does not say and was not read."""

    topic: str
    schema: str
    message_encoding: str
    message_count: int | None = None


class RawMessage(NamedTuple):
    """A message as the file has it; where `losses_before`, lost so far in this pass, grows, some may be missing."""

    topic: str
    schema: str
    message_encoding: str
    log_time_ns: int
    data: bytes
    offset: int | None = None
    losses_before: int = 0


class Source(Protocol):
    """One recording file or folder of one format."""

    path: LogPath
    health: Health

    @property
    def topics(self) -> tuple[TopicInfo, ...]:
        """The topics, sorted by name."""

    def metadata(self) -> dict[str, str]:
        """Read the pairs of the metadata record `svmdist`; empty where there is none."""

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Yield the messages of some topics, or of all, in file order."""


def merge_topics(infos: Iterable[TopicInfo]) -> tuple[TopicInfo, ...]:
    """Join channels that share topic, schema and encoding: several publishers of one topic."""
    counts: defaultdict[tuple[str, str, str], list[int | None]] = defaultdict(list)
    for info in infos:
        counts[info[:3]].append(info.message_count)
    totals = {key: None if None in found else sum(filter(None, found)) for key, found in sorted(counts.items())}
    return tuple(TopicInfo(*key, total) for key, total in totals.items())
