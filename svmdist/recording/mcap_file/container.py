"""Reading MCAP in file order: verified records out of a file that may be broken anywhere, and what was lost.

Nothing here needs the index. A chunk is delivered when its CRC is right, and dropped whole otherwise;
what stands outside of chunks is delivered unless the CRC of the data section speaks against it. Of a
file that ends early, everything before the end is delivered, for truncation changes no byte.
"""

from __future__ import annotations

import zlib
from bisect import bisect_right
from collections.abc import Collection, Iterator
from typing import BinaryIO

from mcap.opcode import Opcode

from svmdist.errors import RecordingError
from svmdist.input_file import LogPath, open_regular
from svmdist.profile import Limits
from svmdist.recording.effort import Effort, TooMuchError
from svmdist.recording.mcap_file.chunks import ChunkError, expand_chunk, expand_truncated_chunk
from svmdist.recording.mcap_file.content import IN_CHUNKS, Content, MessageRecord, Record
from svmdist.recording.mcap_file.crc_check import DataSectionCheck
from svmdist.recording.mcap_file.framing import HEAD, MAGIC, Frame, FrameStream
from svmdist.recording.mcap_file.record_parsers import MalformedRecordError, is_attachment_intact
from svmdist.recording.mcap_file.summary import Summary, read_footer, read_trusted_summary
from svmdist.recording.source import Health, LossKind


class Container:
    """One pass over an MCAP file; make a new one for each pass.

    `content` holds the definitions and counts, which grow while the records are read; losses go to `health`.
    """

    def __init__(
        self,
        path: LogPath,
        limits: Limits,
        health: Health,
        check: DataSectionCheck | None = None,
        topics: Collection[str] | None = None,
    ) -> None:
        self.path = path
        self.content = Content(path, limits, health, topics)
        self._limits = limits
        self._check = check or DataSectionCheck(path, limits)
        self._summary = Summary()
        self._trusted: tuple[Summary | None, list[int]] | None = None
        self._data_ended = False
        self._is_aligned = True  # no record was jumped over, so running CRCs mean something

    def records(self) -> Iterator[Record | MessageRecord]:
        """Yield verified records and messages in file order, chunks unpacked.

        Raises RecordingError when the file cannot be opened or read, or does not begin as MCAP does.
        """
        try:
            with open_regular(self.path) as file:
                size_bytes = file.seek(0, 2)
                file.seek(0)
                self.content.effort = Effort(size_bytes)
                try:
                    yield from self._walk(file, size_bytes)
                except TooMuchError as problem:
                    self.content.report_lost_messages()
                    detail = f"{problem}; the rest is not read"
                    self.content.record_loss(LossKind.STRUCTURE, detail, file.tell())
        except OSError as problem:
            raise RecordingError(f"{self.path}: cannot read: {problem.strerror or problem}") from None

    def _walk(self, file: BinaryIO, size_bytes: int) -> Iterator[Record | MessageRecord]:
        stream = FrameStream(file, size_bytes, self._limits)
        if stream.read(len(MAGIC)) != MAGIC:
            raise RecordingError(f"{self.path}: not an MCAP file")
        while (frame := stream.next_frame()) is not None:
            self.content.effort.idle()
            if frame.opcode == Opcode.FOOTER and frame.end + len(MAGIC) == size_bytes:
                yield Record(frame.opcode, memoryview(frame.body or b""), frame.offset)
                self._finish(frame, stream)
                return
            if frame.opcode == 0 or frame.is_truncated:
                was_truncated = frame.opcode != 0 and read_footer(file, size_bytes) is None
                yield from self._salvage(frame, was_truncated=was_truncated)
                if was_truncated:
                    break
                if not self._resume(file, size_bytes, stream, frame):
                    return
            elif frame.opcode == Opcode.DATA_END and not self._data_ended:
                self._end_data(frame, stream)
                yield Record(frame.opcode, memoryview(frame.body or b""), frame.offset)
            elif frame.opcode == Opcode.CHUNK and frame.body is not None:
                try:
                    data, length = expand_chunk(frame.body, self._limits, self.content.effort)
                except ChunkError as problem:
                    self.content.record_loss(LossKind.CHUNK, f"dropped: {problem}", frame.offset)
                    if problem.is_misframed:
                        self._resume(file, size_bytes, stream, frame, or_go_on=True)
                    continue
                yield from self.content.read_chunk(data, frame.offset)
                if length < frame.length:
                    self._return_to_end(file, size_bytes, stream, frame, length)
            else:
                yield from self._outside_chunks(frame, size_bytes)
        self.content.report_lost_messages()
        detail = f"{self.content.tally.message_count} messages recovered"
        self.content.record_loss(LossKind.TRUNCATED, detail, size_bytes)

    # What the records mean

    def _outside_chunks(self, frame: Frame, size_bytes: int) -> Iterator[Record | MessageRecord]:
        if frame.body is None:
            limit = self._limits.record_bytes
            self.content.record_loss(
                LossKind.RECORD, f"{frame.length} bytes; the limit is {limit}", frame.offset
            )
            return
        body = memoryview(frame.body)
        if frame.opcode in IN_CHUNKS and not self._data_ended:
            if self._is_trusted(frame):
                yield from self.content.read(frame.opcode, body, frame.offset)
        elif frame.opcode == Opcode.MESSAGE:
            self.content.record_loss(LossKind.STRUCTURE, "a message behind the end of the data", frame.offset)
        elif frame.opcode == Opcode.FOOTER:
            if frame.end + len(MAGIC) < size_bytes:
                self.content.record_loss(
                    LossKind.STRUCTURE, "a footer before the end of the file", frame.offset
                )
        elif frame.opcode == Opcode.ATTACHMENT and not is_attachment_intact(body):
            self.content.record_loss(LossKind.RECORD, "an attachment's CRC is wrong", frame.offset)
        else:
            self.content.tally.attachment_count += frame.opcode == Opcode.ATTACHMENT
            self.content.tally.metadata_count += frame.opcode == Opcode.METADATA
            if self._data_ended:
                self._note_summary(frame)
            if frame.opcode != Opcode.MESSAGE_INDEX:
                yield Record(frame.opcode, body, frame.offset)

    def _is_trusted(self, frame: Frame) -> bool:
        """Judge a schema, channel or message that stands outside of chunks, where no chunk's CRC covers it."""
        is_intact = self._check.result()
        # Writers of chunks put everything into chunks: a lone message there is most likely another
        # record with a broken opcode, unless the CRC of the data section says otherwise.
        is_usual = self.content.tally.chunk_count == 0 or frame.opcode != Opcode.MESSAGE
        if is_intact or (is_intact is None and is_usual):
            return True
        reason = "no CRC covers it" if is_intact is None else "the CRC of the data section is wrong"
        self.content.record_loss(
            LossKind.RECORD, f"{_name(frame.opcode)} outside of chunks dropped: {reason}", frame.offset
        )
        return False

    def _note_summary(self, frame: Frame) -> None:
        try:
            self._summary.add(frame.opcode, memoryview(frame.body or b""), self._limits)
        except MalformedRecordError as problem:
            self.content.record_loss(LossKind.SUMMARY, f"{_name(frame.opcode)}: {problem}", frame.offset)

    # Broken ends and broken lengths

    def _salvage(self, frame: Frame, *, was_truncated: bool) -> Iterator[Record | MessageRecord]:
        """Deliver what is certain of a record that reaches beyond the end of the file."""
        if frame.opcode != Opcode.CHUNK or not frame.body:
            return
        try:
            data = expand_truncated_chunk(frame.body, self._limits, may_be_prefix=was_truncated)
        except ChunkError as problem:
            self.content.record_loss(LossKind.CHUNK, f"dropped: {problem}", frame.offset)
            return
        yield from self.content.read_chunk(data, frame.offset, is_prefix=True)

    def _return_to_end(
        self, file: BinaryIO, size_bytes: int, stream: FrameStream, frame: Frame, length: int
    ) -> None:
        """Go back to the end of a chunk whose record is too long, where an index whose CRC is right says so."""
        _, places = self._index(file, size_bytes)
        next_at = bisect_right(places, frame.offset)
        if next_at == len(places) or places[next_at] >= frame.end:
            stream.jump(stream.position)  # looking for a summary has moved the file
            return
        self._is_aligned = False
        stream.jump(frame.offset + HEAD.size + length)
        detail = f"a chunk of impossible length {frame.length}; reading goes on at byte {stream.position}"
        self.content.record_loss(LossKind.STRUCTURE, detail, frame.offset)

    def _resume(
        self, file: BinaryIO, size_bytes: int, stream: FrameStream, frame: Frame, *, or_go_on: bool = False
    ) -> bool:
        """Find the next chunk after a record whose length is wrong, by an index whose CRC is right."""
        self._is_aligned = False
        summary, offsets = self._index(file, size_bytes)
        next_at = bisect_right(offsets, frame.offset)
        places = offsets[next_at : next_at + 1]
        if summary is not None and not places and summary.start > frame.offset:
            self._data_ended = True
            stream.crc = 0
            places = [summary.start]
        if places:
            stream.jump(places[0])
            detail = f"a record of impossible length {frame.length}; reading goes on at byte {places[0]}"
        else:
            stream.jump(stream.position)  # looking for a summary has moved the file
            detail = f"a record of impossible length {frame.length}"
            if not or_go_on:
                self.content.report_lost_messages()
                detail += f"; the rest is unreadable, {self.content.tally.message_count} messages recovered"
        self.content.record_loss(LossKind.STRUCTURE, detail, frame.offset)
        return bool(places) or or_go_on

    def _index(self, file: BinaryIO, size_bytes: int) -> tuple[Summary | None, list[int]]:
        """The summary where its CRC is right, and the places of chunks that it names, sorted; read once."""
        if self._trusted is None:
            summary = read_trusted_summary(file, size_bytes, self._limits)
            self._trusted = summary, sorted(summary.chunk_offsets) if summary is not None else []
        return self._trusted

    # The end of the data and of the file

    def _end_data(self, frame: Frame, stream: FrameStream) -> None:
        declared = int.from_bytes((frame.body or b"")[:4], "little")
        if len(frame.body or b"") < 4:
            self.content.record_loss(LossKind.STRUCTURE, "the end of the data is malformed", frame.offset)
        elif self._is_aligned and declared not in {0, frame.crc_before}:
            self.content.record_loss(LossKind.DATA_CRC, "the CRC of the data section is wrong", frame.offset)
        self._data_ended = True
        stream.crc = 0

    def _finish(self, frame: Frame, stream: FrameStream) -> None:
        self.content.report_lost_messages()
        if not self._data_ended:
            self.content.record_loss(LossKind.STRUCTURE, "the end of the data is missing", frame.offset)
        body = frame.body or b""
        crc = zlib.crc32(body[:16], zlib.crc32(HEAD.pack(frame.opcode, frame.length), frame.crc_before))
        declared = int.from_bytes(body[16:20], "little")
        if self._data_ended and declared not in {0, crc}:
            self.content.record_loss(LossKind.SUMMARY, "the CRC of the summary is wrong", frame.offset)
        else:
            for disagreement in self.content.tally.disagreements(self._summary, self.content.definitions):
                self.content.record_loss(LossKind.STATISTICS, disagreement, frame.offset)
        if stream.read(len(MAGIC)) != MAGIC:
            self.content.record_loss(LossKind.STRUCTURE, "the file does not end as MCAP does", frame.end)


def _name(opcode: int) -> str:
    return Opcode(opcode).name.lower() if opcode in set(Opcode) else f"record {opcode:#x}"
