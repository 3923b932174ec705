"""What every kind of recording file gives: topics, and raw messages in file order."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol

from svmdist.input_file import LogPath
from svmdist.recording.health import Health

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
METADATA_NAME = "svmdist"
"""The metadata record that says what a recording came from."""


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """A topic of a recording; `message_count` is None where the file does not say and was not read."""

    topic: str
    schema: str
    message_encoding: str
    message_count: int | None = None


@dataclass(frozen=True, slots=True)
class RawMessage:
    """A message as it stands in the file; `data` may be a view that must be copied to be kept.

    `losses_before` counts what this pass has lost so far: where it grows, messages may be missing.
    """

    topic: str
    schema: str
    message_encoding: str
    log_time_ns: int
    data: bytes | memoryview
    offset: int | None = None
    losses_before: int = 0


class Source(Protocol):
    """One recording file or folder of one format."""

    @property
    def path(self) -> LogPath:
        """The file or folder."""

    health: Health

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the topics, sorted by name."""

    def metadata(self) -> dict[str, str]:
        """Read the metadata of the record `svmdist`, empty where there is none."""

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Yield the messages of some topics, or of all, in file order; nothing is kept in memory."""


def merge_topics(infos: Iterable[TopicInfo]) -> tuple[TopicInfo, ...]:
    """Join channels that share topic, schema and encoding: several publishers of one topic."""
    merged: dict[tuple[str, str, str], int | None] = {}
    for info in infos:
        key = (info.topic, info.schema, info.message_encoding)
        known = merged.get(key, 0)
        both = known is not None and info.message_count is not None
        merged[key] = (known or 0) + (info.message_count or 0) if both else None
    return tuple(TopicInfo(*key, count) for key, count in sorted(merged.items()))


def is_message_compressed(source: Source) -> bool:
    """Tell whether the messages of a single file were compressed one by one, as only the folder of a bag knows."""
    topics = {info.topic for info in source.topics() if info.message_encoding == "cdr"}
    if not topics:
        return False
    first = next(iter(source.messages(topics)), None)
    # CDR begins with a zero byte, so these four cannot be a message.
    return first is not None and bytes(first.data[:4]) == ZSTD_MAGIC
