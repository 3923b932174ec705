"""MCAP files as a source of messages."""

from __future__ import annotations

from collections.abc import Collection, Iterator

from mcap.opcode import Opcode
from mcap.records import Metadata

from svmdist.errors import RecordingError
from svmdist.input_file import LogPath, open_regular
from svmdist.profile import Limits
from svmdist.recording.mcap_file.container import Container
from svmdist.recording.mcap_file.content import MessageRecord, Record
from svmdist.recording.mcap_file.crc_check import DataSectionCheck
from svmdist.recording.mcap_file.indexed import Index, IndexedPass, metadata_records, read_index
from svmdist.recording.mcap_file.record_parsers import MalformedRecordError, parse
from svmdist.recording.mcap_file.summary import read_trusted_summary
from svmdist.recording.source import (
    METADATA_NAME,
    Health,
    Loss,
    LossKind,
    RawMessage,
    TopicInfo,
    merge_topics,
)
from svmdist.remote_file import RemoteFile


class McapSource:
    """One MCAP file."""

    def __init__(self, path: LogPath, limits: Limits) -> None:
        self.path = path
        self.health = Health()
        self._limits = limits
        self._check = DataSectionCheck(path, limits)
        self._topics: tuple[TopicInfo, ...] | None = None
        self._known_index: tuple[Index | None] | None = None

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the topics: from the summary where its CRC is right, else by reading the whole file."""
        if self._topics is None:
            self._topics = self._topics_of_summary()
        if self._topics is None:
            container = self._container()
            for _ in container.records():
                pass
            definitions, counts = container.content.definitions, container.content.tally.messages_by_channel
            self._topics = merge_topics(
                TopicInfo(
                    channel.topic, definitions.schema_name(channel), channel.message_encoding, counts[key]
                )
                for key, channel in definitions.channels.items()
            )
        return self._topics

    def metadata(self) -> dict[str, str]:
        """Read the record `svmdist`, unless the CRC of the data section speaks against it."""
        index = self._index()
        if index is not None:
            return self._indexed_metadata(index)
        for record in self._container().records():
            if isinstance(record, MessageRecord) or record.opcode != Opcode.METADATA:
                continue
            if len(record.body) > self._limits.metadata_bytes:
                self.health.add(Loss(LossKind.RECORD, "metadata above the limit", record.offset))
                continue
            try:
                metadata = parse(record.opcode, record.body)
            except MalformedRecordError as problem:
                self.health.add(Loss(LossKind.RECORD, f"metadata: {problem}", record.offset))
                continue
            if isinstance(metadata, Metadata) and metadata.name == METADATA_NAME:
                if self._check.result() is False:
                    detail = "metadata dropped: the CRC of the data section is wrong"
                    self.health.add(Loss(LossKind.RECORD, detail, record.offset))
                    continue
                return dict(metadata.metadata)
        return {}

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Yield the messages of some topics, or of all, in file order."""
        index = self._index()
        walk: Container | IndexedPass
        records: Iterator[Record | MessageRecord]
        if index is None:
            walk = self._container(topics)
            records = walk.records()
        else:
            walk = IndexedPass(self.path, index, self._limits, self.health, topics)
            records = walk.messages()
        content = walk.content
        channels, definitions = content.definitions.channels, content.definitions
        for record in records:
            if isinstance(record, MessageRecord):
                channel = channels[record.channel_id]
                yield RawMessage(
                    channel.topic,
                    definitions.schema_name(channel),
                    channel.message_encoding,
                    record.log_time_ns,
                    record.data,
                    record.offset,
                    content.loss_count,
                )

    def _index(self) -> Index | None:
        """The index of a file that is far away; None for one on a disk, which is read and verified whole."""
        if not isinstance(self.path, RemoteFile):
            return None
        if self._known_index is None:
            try:
                self._known_index = (read_index(self.path, self._limits),)
            except OSError as problem:
                raise RecordingError(f"{self.path}: cannot read: {problem.strerror or problem}") from None
        return self._known_index[0]

    def _indexed_metadata(self, index: Index) -> dict[str, str]:
        try:
            for offset, found in metadata_records(self.path, index, self._limits):
                if isinstance(found, str):
                    self.health.add(Loss(LossKind.RECORD, found, offset))
                elif found.name == METADATA_NAME:
                    return dict(found.metadata)
        except OSError as problem:
            raise RecordingError(f"{self.path}: cannot read: {problem.strerror or problem}") from None
        return {}

    def _container(self, topics: Collection[str] | None = None) -> Container:
        return Container(self.path, self._limits, self.health, self._check, topics)

    def _topics_of_summary(self) -> tuple[TopicInfo, ...] | None:
        try:
            with open_regular(self.path) as file:
                size_bytes = file.seek(0, 2)
                summary = read_trusted_summary(file, size_bytes, self._limits)
        except OSError as problem:
            raise RecordingError(f"{self.path}: cannot read: {problem.strerror or problem}") from None
        if summary is None or summary.statistics is None:
            return None
        if summary.statistics.channel_count != len(summary.channels):
            return None  # the summary does not repeat the channels
        counts = summary.statistics.channel_message_counts
        has_counts = sum(counts.values()) == summary.statistics.message_count
        schemas = {key: schema.name for key, schema in summary.schemas.items()}
        if any(channel.schema_id not in {0, *schemas} for channel in summary.channels.values()):
            return None
        return merge_topics(
            TopicInfo(
                channel.topic,
                schemas.get(channel.schema_id, ""),
                channel.message_encoding,
                counts.get(key, 0) if has_counts else None,
            )
            for key, channel in summary.channels.items()
        )
