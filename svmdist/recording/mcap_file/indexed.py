"""Reading MCAP by its index, for files that are far away: only the chunks that hold what is asked for.

What a pass in file order verifies of each chunk is verified here too. What is not read is not verified: the CRC of the
data section, and chunks without a wanted topic.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

from mcap.opcode import Opcode
from mcap.records import Metadata

from svmdist.errors import RecordingError
from svmdist.input_file import LogPath, open_regular
from svmdist.profile import Limits
from svmdist.recording.effort import Effort, TooMuchError
from svmdist.recording.mcap_file.chunks import ChunkError, expand_chunk
from svmdist.recording.mcap_file.content import Content, MessageRecord
from svmdist.recording.mcap_file.framing import HEAD
from svmdist.recording.mcap_file.record_parsers import MalformedRecordError, parse
from svmdist.recording.mcap_file.summary import ChunkPlace, Summary, read_trusted_summary
from svmdist.recording.source import Health, LossKind


@dataclass(frozen=True)
class Index:
    """Where everything is in a file whose messages all stand in chunks, by a summary whose CRC is right."""

    summary: Summary
    chunks: tuple[ChunkPlace, ...]
    size_bytes: int

    def counts(self, channels: Collection[int]) -> int:
        """How many messages some channels have."""
        statistics = self.summary.statistics
        return sum(statistics.channel_message_counts.get(key, 0) for key in channels) if statistics else 0


def read_index(path: LogPath, limits: Limits) -> Index | None:
    """Read the index of a file; None where it has none that says where every message is. Raises OSError."""
    with open_regular(path) as file:
        size_bytes = file.seek(0, 2)
        summary = read_trusted_summary(file, size_bytes, limits, with_places=True)
    statistics = summary.statistics if summary else None
    if summary is None or statistics is None or not summary.chunks:
        return None
    places = sorted(summary.chunks, key=lambda chunk: chunk.offset)
    counts = statistics.channel_message_counts
    is_complete = (
        len(places) == statistics.chunk_count
        and sum(counts.values()) == statistics.message_count
        and statistics.channel_count == len(summary.channels)
        and {key for key, count in counts.items() if count} <= {key for one in places for key in one.channels}
        and all(one.length <= limits.record_bytes + HEAD.size for one in places)
        and all(one.offset + one.length <= summary.start for one in places)
    )
    return Index(summary, tuple(places), size_bytes) if is_complete else None


class IndexedPass:
    """One pass over the chunks that hold some topics; `content` has definitions and counts, losses go to `health`."""

    def __init__(
        self,
        path: LogPath,
        index: Index,
        limits: Limits,
        health: Health,
        topics: Collection[str] | None = None,
    ) -> None:
        self.content = Content(path, limits, health, topics)
        self.content.definitions.complete(index.summary.schemas, index.summary.channels)
        self.content.effort = Effort(index.size_bytes)
        self._path = path
        self._index = index
        self._limits = limits
        self._wanted = frozenset(
            key for key, one in index.summary.channels.items() if topics is None or one.topic in topics
        )

    def messages(self) -> Iterator[MessageRecord]:
        """Yield the messages in file order; raises RecordingError where the file cannot be read."""
        try:
            yield from self._chunks()
        except TooMuchError as problem:
            self.content.report_lost_messages()
            self.content.record_loss(LossKind.STRUCTURE, f"{problem}; the rest is not read")
        except OSError as problem:
            raise RecordingError(f"{self._path}: cannot read: {problem.strerror or problem}") from None

    def _chunks(self) -> Iterator[MessageRecord]:
        with open_regular(self._path) as file:
            for chunk in self._index.chunks:
                self.content.effort.idle()
                if chunk.channels and not chunk.channels & self._wanted:
                    continue
                file.seek(chunk.offset)
                record = file.read(chunk.length)
                try:
                    data, _ = expand_chunk(_body(record), self._limits, self.content.effort)
                except ChunkError as problem:
                    self.content.record_loss(LossKind.CHUNK, f"dropped: {problem}", chunk.offset)
                    continue
                for one in self.content.read_chunk(data, chunk.offset):
                    if isinstance(one, MessageRecord):
                        yield one
        self.content.report_lost_messages()
        declared = self._index.counts(self._wanted)
        found = sum(self.content.tally.messages_by_channel[key] for key in self._wanted)
        if declared != found:
            detail = (
                f"the statistics declare {declared} messages on the topics that are read, {found} were read"
            )
            self.content.record_loss(LossKind.STATISTICS, detail)


def metadata_records(path: LogPath, index: Index, limits: Limits) -> Iterator[tuple[int, Metadata | str]]:
    """Yield place and content of each metadata record, or what is wrong with it; raises OSError."""
    with open_regular(path) as file:
        for offset, length in index.summary.metadata_places or ():
            if length > limits.metadata_bytes + HEAD.size:
                yield offset, "metadata above the limit"
                continue
            file.seek(offset)
            record = file.read(length)
            try:
                metadata = parse(Opcode.METADATA, _body(record, Opcode.METADATA))
            except (MalformedRecordError, ChunkError) as problem:
                yield offset, f"metadata: {problem}"
                continue
            assert isinstance(metadata, Metadata)
            yield offset, metadata


def _body(record: bytes, opcode: int = Opcode.CHUNK) -> bytes:
    """The body of a record where the index says that one is; ChunkError where there is another."""
    if len(record) < HEAD.size or HEAD.unpack_from(record) != (opcode, len(record) - HEAD.size):
        raise ChunkError("the index names a place where no such record is")
    return record[HEAD.size :]
