"""MCAP files as a source of messages."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Metadata

from svmdist.errors import RecordingError
from svmdist.input_file import open_regular
from svmdist.profile import Limits
from svmdist.recording.health import Health, Loss, LossKind
from svmdist.recording.mcap_file.container import Container
from svmdist.recording.mcap_file.content import MessageRecord
from svmdist.recording.mcap_file.crc_check import DataSectionCheck
from svmdist.recording.mcap_file.record_parsers import MalformedRecordError, parse
from svmdist.recording.mcap_file.summary import read_trusted_summary
from svmdist.recording.sources import METADATA_NAME, RawMessage, TopicInfo, merge_topics


class McapSource:
    """One MCAP file."""

    def __init__(self, path: Path, limits: Limits) -> None:
        self.path = path
        self.health = Health()
        self._limits = limits
        self._check = DataSectionCheck(path, limits)
        self._topics: tuple[TopicInfo, ...] | None = None

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
        container = self._container(topics)
        channels, definitions = container.content.definitions.channels, container.content.definitions
        for record in container.records():
            if isinstance(record, MessageRecord):
                channel = channels[record.channel_id]
                yield RawMessage(
                    channel.topic,
                    definitions.schema_name(channel),
                    channel.message_encoding,
                    record.log_time_ns,
                    record.data,
                    record.offset,
                    container.content.loss_count,
                )

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
