"""What every kind of recording file gives: topics, and raw messages in file order."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from svmdist.recording.health import Health


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """A topic of a recording; `message_count` is None where the file does not say and was not read."""

    topic: str
    schema: str
    message_encoding: str
    message_count: int | None = None


@dataclass(frozen=True, slots=True)
class RawMessage:
    """A message as it stands in the file; `data` may be a view that must be copied to be kept."""

    topic: str
    schema: str
    message_encoding: str
    log_time_ns: int
    data: bytes | memoryview
    offset: int | None = None


class Source(Protocol):
    """One recording file or folder of one format."""

    path: Path
    health: Health

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the topics, sorted by name."""

    def metadata(self) -> dict[str, str]:
        """Read the metadata of the record `svmdist`, empty where there is none."""

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Yield the messages of some topics, or of all, in file order; nothing is kept in memory."""
