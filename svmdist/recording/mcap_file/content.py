"""What schemas, channels and messages of an MCAP file mean, whether they stand in chunks or not."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

from mcap.opcode import Opcode

from svmdist.input_file import LogPath, open_regular
from svmdist.profile import Limits
from svmdist.recording.effort import Effort
from svmdist.recording.mcap_file.definitions import DefinitionError, Definitions
from svmdist.recording.mcap_file.framing import HEAD, split_records
from svmdist.recording.mcap_file.record_parsers import MESSAGE_HEAD
from svmdist.recording.mcap_file.summary import read_trusted_summary
from svmdist.recording.mcap_file.tally import Tally
from svmdist.recording.source import Health, Loss, LossKind

MESSAGE = int(Opcode.MESSAGE)
IN_CHUNKS = frozenset({int(Opcode.SCHEMA), int(Opcode.CHANNEL), MESSAGE})


@dataclass(frozen=True, slots=True)
class Record:
    """A record that is no message; `offset` is its place in the file, or that of the chunk it was in."""

    opcode: int
    body: memoryview
    offset: int


@dataclass(frozen=True, slots=True)
class MessageRecord:
    """A message; `data` is a view into its chunk, to be copied by whoever keeps it."""

    channel_id: int
    sequence: int
    log_time_ns: int
    publish_time_ns: int
    data: memoryview
    offset: int


class Content:
    """The definitions, counts and losses of one pass over a file, which grow while it is read.

    Messages are yielded of `topics` alone where these are given; the others are counted all the same.
    """

    def __init__(
        self, path: LogPath, limits: Limits, health: Health, topics: Collection[str] | None = None
    ) -> None:
        self.definitions = Definitions(limits)
        self.tally = Tally()
        self.loss_count = 0
        self._path = path
        self._limits = limits
        self._health = health
        self._topics = topics
        self._has_recalled = False
        self.effort = Effort(0)  # of a file whose size is not known yet

    def read_chunk(
        self, data: memoryview, offset: int, *, is_prefix: bool = False
    ) -> Iterator[Record | MessageRecord]:
        """Yield what an expanded and verified chunk holds; of a prefix, the records that are complete."""
        self.tally.chunk_count += 1
        self.tally.chunk_offset_sum += offset
        reached = 0
        for number, (opcode, position, body) in enumerate(split_records(data)):
            if number >= self._limits.chunk_records:
                detail = f"more than {self._limits.chunk_records} records; the rest is dropped"
                self.record_loss(LossKind.CHUNK, detail, offset)
                return
            if opcode == 0:
                self.record_loss(
                    LossKind.CHUNK, f"no record at {position} inside it; the rest is dropped", offset
                )
                return
            reached = position + HEAD.size + len(body)
            if opcode == MESSAGE:
                message = self._message(body, offset)
                if message is not None:
                    yield message
            elif opcode in IN_CHUNKS:
                yield from self.read(opcode, body, offset)
            else:
                self.effort.idle()
        if reached < len(data) and not is_prefix:
            self.record_loss(LossKind.CHUNK, "its last record is incomplete", offset)

    def read(self, opcode: int, body: memoryview, offset: int) -> Iterator[Record | MessageRecord]:
        """Take up a schema, a channel or a message, and yield it where it is sound."""
        if opcode == MESSAGE:
            message = self._message(body, offset)
            if message is not None:
                yield message
            return
        self.effort.idle()
        try:
            if opcode == Opcode.SCHEMA:
                self.definitions.add_schema(body)
            else:
                self.definitions.add_channel(body)
        except DefinitionError as problem:
            self.record_loss(LossKind.DEFINITION, str(problem), offset)
            return
        yield Record(opcode, body, offset)

    def _message(self, body: memoryview, offset: int) -> MessageRecord | None:
        """Count a message; None for one that is lost, or that nobody asked for."""
        if len(body) < MESSAGE_HEAD.size:
            self.effort.idle()
            self.record_loss(LossKind.RECORD, "a message without a head", offset)
            return None
        channel_id, sequence, log_time_ns, publish_time_ns = MESSAGE_HEAD.unpack_from(body)
        channel = self.definitions.channels.get(channel_id)
        if channel is None:
            self._recall_definitions()
            channel = self.definitions.channels.get(channel_id)
        if channel is None or channel_id in self.definitions.ambiguous:
            self.effort.idle()
            self.tally.lost_by_channel[channel_id] += 1
            self.loss_count += 1
            return None
        self.effort.message()
        self.tally.add_message(channel_id, log_time_ns)
        if self._topics is not None and channel.topic not in self._topics:
            return None
        return MessageRecord(
            channel_id, sequence, log_time_ns, publish_time_ns, body[MESSAGE_HEAD.size :], offset
        )

    def _recall_definitions(self) -> None:
        """Take definitions that were lost with their chunk from the summary, where its CRC is right."""
        if self._has_recalled:
            return
        self._has_recalled = True
        with open_regular(self._path) as file:
            summary = read_trusted_summary(file, file.seek(0, 2), self._limits)
        if summary is not None:
            self.definitions.complete(summary.schemas, summary.channels)

    def report_lost_messages(self) -> None:
        """Report the messages whose channel is missing or ambiguous; call it where reading ends."""
        for channel_id, count in sorted(self.tally.lost_by_channel.items()):
            detail = f"{count} messages of channel {channel_id}, which is not (uniquely) defined"
            self.record_loss(LossKind.MESSAGE, detail)

    def record_loss(self, kind: LossKind, detail: str, offset: int | None = None) -> None:
        """Report a loss."""
        self.loss_count += 1
        self._health.add(Loss(kind, detail, offset))
