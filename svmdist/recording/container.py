"""Reading MCAP in file order: verified records out of a file that may be broken anywhere, and what was lost.

Nothing here needs the index. A chunk is delivered when its CRC is right, and dropped whole otherwise;
what stands outside of chunks is delivered unless the CRC of the data section speaks against it. Of a
file that ends early, everything before the end is delivered, for a cut changes no byte.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from mcap.opcode import Opcode

from svmdist.errors import RecordingError
from svmdist.recording.bodies import MESSAGE_HEAD, MalformedRecordError, is_attachment_intact
from svmdist.recording.chunks import ChunkError, expand_chunk, expand_cut_chunk
from svmdist.recording.definitions import DefinitionError, Definitions
from svmdist.recording.framing import HEAD, MAGIC, Frame, FrameStream, split_records
from svmdist.recording.health import Health, Loss, LossKind
from svmdist.recording.limits import Limits
from svmdist.recording.summary import Summary, read_footer, read_trusted_summary
from svmdist.recording.tally import Tally
from svmdist.recording.vouching import DataSectionCheck

IN_CHUNKS = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE})


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


class Container:
    """One pass over an MCAP file; make a new one for each pass.

    `definitions` and `tally` grow while the records are read; losses go to `health`.
    """

    def __init__(
        self, path: Path, limits: Limits, health: Health, check: DataSectionCheck | None = None
    ) -> None:
        self.path = path
        self.definitions = Definitions(limits)
        self.tally = Tally()
        self.loss_count = 0
        self._limits = limits
        self._health = health
        self._check = check or DataSectionCheck(path, limits)
        self._summary = Summary()
        self._data_ended = False
        self._has_recalled = False
        self._is_aligned = True  # no record was jumped over, so running CRCs mean something

    def records(self) -> Iterator[Record | MessageRecord]:
        """Yield verified records and messages in file order, chunks unpacked.

        Raises RecordingError when the file cannot be opened or read, or does not begin as MCAP does.
        """
        try:
            with self.path.open("rb") as file:
                size_bytes = file.seek(0, 2)
                file.seek(0)
                yield from self._walk(file, size_bytes)
        except OSError as problem:
            raise RecordingError(f"{self.path}: cannot read: {problem.strerror or problem}") from None

    def _walk(self, file: BinaryIO, size_bytes: int) -> Iterator[Record | MessageRecord]:
        stream = FrameStream(file, size_bytes, self._limits)
        if stream.read(len(MAGIC)) != MAGIC:
            raise RecordingError(f"{self.path}: not an MCAP file")
        while (frame := stream.next_frame()) is not None:
            if frame.opcode == Opcode.FOOTER and frame.end + len(MAGIC) == size_bytes:
                yield Record(frame.opcode, memoryview(frame.body or b""), frame.offset)
                self._finish(frame, stream)
                return
            if frame.opcode == 0 or frame.is_cut:
                was_cut = frame.opcode != 0 and read_footer(file, size_bytes) is None
                yield from self._salvage(frame, was_cut=was_cut)
                if was_cut:
                    break
                if not self._resume(file, size_bytes, stream, frame):
                    return
            elif frame.opcode == Opcode.DATA_END and not self._data_ended:
                self._end_data(frame, stream)
                yield Record(frame.opcode, memoryview(frame.body or b""), frame.offset)
            elif frame.opcode == Opcode.CHUNK and frame.body is not None:
                try:
                    data = expand_chunk(frame.body, self._limits)
                except ChunkError as problem:
                    self._lose(LossKind.CHUNK, f"dropped: {problem}", frame.offset)
                    if problem.is_misframed:
                        self._resume(file, size_bytes, stream, frame, or_go_on=True)
                    continue
                yield from self._chunk_content(data, frame.offset)
            else:
                yield from self._outside_chunks(frame, size_bytes)
        self._report_lost_messages()
        detail = f"truncated at byte {size_bytes}, {self.tally.message_count} messages recovered"
        self._lose(LossKind.TRUNCATED, detail, size_bytes)

    # What the records mean

    def _outside_chunks(self, frame: Frame, size_bytes: int) -> Iterator[Record | MessageRecord]:
        if frame.body is None:
            limit = self._limits.record_bytes
            self._lose(LossKind.RECORD, f"{frame.length} bytes; the limit is {limit}", frame.offset)
            return
        body = memoryview(frame.body)
        if frame.opcode in IN_CHUNKS and not self._data_ended:
            if self._is_believable(frame):
                yield from self._content(frame.opcode, body, frame.offset)
        elif frame.opcode == Opcode.MESSAGE:
            self._lose(LossKind.STRUCTURE, "a message behind the end of the data", frame.offset)
        elif frame.opcode == Opcode.FOOTER:
            if frame.end + len(MAGIC) < size_bytes:
                self._lose(LossKind.STRUCTURE, "a footer before the end of the file", frame.offset)
        elif frame.opcode == Opcode.ATTACHMENT and not is_attachment_intact(body):
            self._lose(LossKind.RECORD, "an attachment's CRC is wrong", frame.offset)
        else:
            self.tally.attachment_count += frame.opcode == Opcode.ATTACHMENT
            self.tally.metadata_count += frame.opcode == Opcode.METADATA
            if self._data_ended:
                self._note_summary(frame)
            if frame.opcode != Opcode.MESSAGE_INDEX:
                yield Record(frame.opcode, body, frame.offset)

    def _is_believable(self, frame: Frame) -> bool:
        """Judge a schema, channel or message that stands outside of chunks, where no chunk's CRC covers it."""
        vouched = self._check.result()
        # Writers of chunks put everything into chunks: a lone message there is most likely another
        # record with a broken opcode, unless the CRC of the data section says otherwise.
        is_usual = self.tally.chunk_count == 0 or frame.opcode != Opcode.MESSAGE
        if vouched or (vouched is None and is_usual):
            return True
        reason = "no CRC covers it" if vouched is None else "the CRC of the data section is wrong"
        self._lose(
            LossKind.RECORD, f"{_name(frame.opcode)} outside of chunks dropped: {reason}", frame.offset
        )
        return False

    def _chunk_content(
        self, data: memoryview, offset: int, *, is_prefix: bool = False
    ) -> Iterator[Record | MessageRecord]:
        self.tally.chunk_count += 1
        self.tally.chunk_offset_sum += offset
        reached = 0
        for number, (opcode, position, body) in enumerate(split_records(data)):
            if number >= self._limits.chunk_records:
                detail = f"more than {self._limits.chunk_records} records; the rest is dropped"
                self._lose(LossKind.CHUNK, detail, offset)
                return
            if opcode == 0:
                self._lose(LossKind.CHUNK, f"no record at {position} inside it; the rest is dropped", offset)
                return
            reached = position + HEAD.size + len(body)
            if opcode in IN_CHUNKS:
                yield from self._content(opcode, body, offset)
        if reached < len(data) and not is_prefix:
            self._lose(LossKind.CHUNK, "its last record is incomplete", offset)

    def _content(self, opcode: int, body: memoryview, offset: int) -> Iterator[Record | MessageRecord]:
        if opcode == Opcode.MESSAGE:
            if len(body) < MESSAGE_HEAD.size:
                self._lose(LossKind.RECORD, "a message without a head", offset)
                return
            channel_id, sequence, log_time_ns, publish_time_ns = MESSAGE_HEAD.unpack_from(body)
            if channel_id not in self.definitions.channels:
                self._recall_definitions()
            if channel_id not in self.definitions.channels or channel_id in self.definitions.ambiguous:
                self.tally.lost_by_channel[channel_id] += 1
                self.loss_count += 1
                return
            self.tally.add_message(channel_id, log_time_ns)
            data = body[MESSAGE_HEAD.size :]
            yield MessageRecord(channel_id, sequence, log_time_ns, publish_time_ns, data, offset)
            return
        try:
            if opcode == Opcode.SCHEMA:
                self.definitions.add_schema(body)
            else:
                self.definitions.add_channel(body)
        except DefinitionError as problem:
            self._lose(LossKind.DEFINITION, str(problem), offset)
            return
        yield Record(opcode, body, offset)

    def _recall_definitions(self) -> None:
        """Take definitions that were lost with their chunk from the summary, where its CRC vouches for it."""
        if self._has_recalled:
            return
        self._has_recalled = True
        with self.path.open("rb") as file:
            summary = read_trusted_summary(file, file.seek(0, 2), self._limits)
        if summary is not None:
            self.definitions.complete(summary.schemas, summary.channels)

    def _note_summary(self, frame: Frame) -> None:
        try:
            self._summary.add(frame.opcode, memoryview(frame.body or b""), self._limits)
        except MalformedRecordError as problem:
            self._lose(LossKind.SUMMARY, f"{_name(frame.opcode)}: {problem}", frame.offset)

    # Broken ends and broken lengths

    def _salvage(self, frame: Frame, *, was_cut: bool) -> Iterator[Record | MessageRecord]:
        """Deliver what is certain of a record that reaches beyond the end of the file."""
        if frame.opcode != Opcode.CHUNK or not frame.body:
            return
        try:
            data = expand_cut_chunk(frame.body, self._limits, may_be_prefix=was_cut)
        except ChunkError as problem:
            self._lose(LossKind.CHUNK, f"dropped: {problem}", frame.offset)
            return
        yield from self._chunk_content(data, frame.offset, is_prefix=True)

    def _resume(
        self, file: BinaryIO, size_bytes: int, stream: FrameStream, frame: Frame, *, or_go_on: bool = False
    ) -> bool:
        """Find the next chunk after a record whose length is wrong, by an index that its CRC vouches for."""
        self._is_aligned = False
        summary = read_trusted_summary(file, size_bytes, self._limits)
        places = [] if summary is None else [place for place in summary.chunk_offsets if place > frame.offset]
        if summary is not None and not places and summary.start > frame.offset:
            self._data_ended = True
            stream.crc = 0
            places = [summary.start]
        if places:
            stream.jump(min(places))
            detail = f"a record of impossible length {frame.length}; reading goes on at byte {min(places)}"
        else:
            detail = f"a record of impossible length {frame.length}"
            if not or_go_on:
                self._report_lost_messages()
                detail += f"; the rest is unreadable, {self.tally.message_count} messages recovered"
        self._lose(LossKind.STRUCTURE, detail, frame.offset)
        return bool(places) or or_go_on

    # The end of the data and of the file

    def _end_data(self, frame: Frame, stream: FrameStream) -> None:
        declared = int.from_bytes((frame.body or b"")[:4], "little")
        if len(frame.body or b"") < 4:
            self._lose(LossKind.STRUCTURE, "the end of the data is malformed", frame.offset)
        elif self._is_aligned and declared not in {0, frame.crc_before}:
            self._lose(LossKind.DATA_CRC, "the CRC of the data section is wrong", frame.offset)
        self._data_ended = True
        stream.crc = 0

    def _finish(self, frame: Frame, stream: FrameStream) -> None:
        self._report_lost_messages()
        if not self._data_ended:
            self._lose(LossKind.STRUCTURE, "the end of the data is missing", frame.offset)
        body = frame.body or b""
        crc = zlib.crc32(body[:16], zlib.crc32(HEAD.pack(frame.opcode, frame.length), frame.crc_before))
        declared = int.from_bytes(body[16:20], "little")
        if self._data_ended and declared not in {0, crc}:
            self._lose(LossKind.SUMMARY, "the CRC of the summary is wrong", frame.offset)
        else:
            for disagreement in self.tally.disagreements(self._summary, self.definitions):
                self._lose(LossKind.STATISTICS, disagreement, frame.offset)
        if stream.read(len(MAGIC)) != MAGIC:
            self._lose(LossKind.STRUCTURE, "the file does not end as MCAP does", frame.end)

    def _report_lost_messages(self) -> None:
        for channel_id, count in sorted(self.tally.lost_by_channel.items()):
            self._lose(
                LossKind.MESSAGE, f"{count} messages of channel {channel_id}, which is not (uniquely) defined"
            )

    def _lose(self, kind: LossKind, detail: str, offset: int | None = None) -> None:
        self.loss_count += 1
        self._health.add(Loss(kind, detail, offset))


def _name(opcode: int) -> str:
    return Opcode(opcode).name.lower() if opcode in set(Opcode) else f"record {opcode:#x}"
