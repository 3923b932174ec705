"""What a pass over an MCAP file has read, held against what the end of the file declares."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

from svmdist.recording.mcap_file.definitions import Definitions
from svmdist.recording.mcap_file.summary import Summary


@dataclass
class Tally:
    """Counts of a pass; times are log times."""

    messages_by_channel: Counter[int] = field(default_factory=Counter)
    lost_by_channel: Counter[int] = field(default_factory=Counter)
    start_ns: int = 0
    end_ns: int = 0
    chunk_count: int = 0
    chunk_offset_sum: int = 0
    attachment_count: int = 0
    metadata_count: int = 0

    @property
    def message_count(self) -> int:
        """Messages that were delivered."""
        return self.messages_by_channel.total()

    def add_message(self, channel_id: int, log_time_ns: int) -> None:
        """Count a delivered message."""
        if not self.messages_by_channel:
            self.start_ns = self.end_ns = log_time_ns
        elif log_time_ns < self.start_ns:
            self.start_ns = log_time_ns
        elif log_time_ns > self.end_ns:
            self.end_ns = log_time_ns
        self.messages_by_channel[channel_id] += 1

    def disagreements(self, summary: Summary, definitions: Definitions) -> Iterator[str]:
        """Say in which ways a summary contradicts what was read."""
        for channel_id in summary.channels.keys() & definitions.channels.keys():
            if summary.channels[channel_id] != definitions.channels[channel_id]:
                yield f"channel {channel_id} is another one in the summary"
        for schema_id in summary.schemas.keys() & definitions.schemas.keys():
            if summary.schemas[schema_id] != definitions.schemas[schema_id]:
                yield f"schema {schema_id} is another one in the summary"
        offsets = summary.chunk_offsets
        if len(offsets) and (len(offsets), sum(offsets)) != (self.chunk_count, self.chunk_offset_sum):
            yield f"the index names {len(offsets)} chunks, {self.chunk_count} were read, or others"
        statistics = summary.statistics
        if statistics is None:
            return
        pairs = [
            ("messages", statistics.message_count, self.message_count),
            ("chunks", statistics.chunk_count, self.chunk_count),
            ("attachments", statistics.attachment_count, self.attachment_count),
            ("metadata records", statistics.metadata_count, self.metadata_count),
        ]
        for what, declared, found in pairs:
            if declared != found:
                yield f"the statistics declare {declared} {what}, {found} were read"
        declared_counts = {key: count for key, count in statistics.channel_message_counts.items() if count}
        if declared_counts and declared_counts != self.messages_by_channel:
            yield "the statistics declare other counts of messages by channel than were read"
        declared_span = (statistics.message_start_time, statistics.message_end_time)
        if self.message_count and declared_span != (self.start_ns, self.end_ns):
            yield f"the statistics declare log times {declared_span}, found {(self.start_ns, self.end_ns)}"
