"""Writing a recording: MCAP with zstd chunks, byte-identical on a rerun, readable when cut off."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import IO, Self

from mcap.writer import CompressionType, Writer

from svmdist.errors import OutputError, UsageError
from svmdist.files import BusyError, is_held, lock
from svmdist.recording.encode import EncodedSample, encode, message_type
from svmdist.recording.source import METADATA_NAME
from svmdist.samples import Sample

CHUNK_BYTES = 240 * 1024
"""Leaves room in 256 KiB for the schemas and channels that a chunk may have to declare."""
CHUNK_SPAN_NS = 250_000_000
"""A chunk spans at most a quarter of a second of log time: what a killed recorder loses. It is log time
and not the wall clock that ends a chunk, for a rerun shall be byte-identical."""
IS_HELD = "another process is recording to it; wait for its end, or give another name"
RECORD_HEAD_BYTES = 9
MESSAGE_HEAD_BYTES = 22


class RecordingWriter:
    """Writes samples to `NAME.mcap.part` and renames the file when it is complete.

    >>> with RecordingWriter(path, {"scenario": "sweep"}) as writer:      # doctest: +SKIP
    ...     writer.write("/tf", sample)

    An exception inside the block keeps the `.part` file, which holds everything written so far, and renames
    nothing; a `.part` without any message is removed. Chunks hold at most 256 KiB, or one message that is
    larger. `metadata` becomes the record `svmdist`. Images are written as PNG, or as
    JPEG of a quality from 1 to 100.

    Raises UsageError when the file exists and `force` is not set, OutputError when it cannot be written.
    """

    def __init__(
        self, path: Path, metadata: Mapping[str, str], *, force: bool = False, jpeg_quality: int | None = None
    ) -> None:
        self.path = Path(path)
        self.part_path = self.path.with_name(self.path.name + ".part")
        self._metadata = dict(metadata)
        self._force = force
        self._jpeg_quality = jpeg_quality
        self._file: IO[bytes] | None = None
        self._channels: dict[str, tuple[int, type]] = {}
        self._schemas: dict[type, int] = {}
        self._sequences: dict[int, int] = {}
        self._chunk_bytes = 0
        self._chunk_start_ns: int | None = None

    @property
    def opened(self) -> bool:
        """Whether the `.part` file is this writer's own."""
        return self._file is not None

    def __enter__(self) -> Self:
        if self.path.is_dir():
            raise OutputError(f"{self.path}: is a directory, expected the name of a file to write")
        self._refuse_to_replace(self.path)
        self._refuse_to_replace(self.part_path)
        try:
            # One process at a time: two that write one file would leave what neither wrote.
            self._file = os.fdopen(lock(self.part_path, "wb" if self._force else "xb"), "wb")
            self._writer = Writer(
                self._file,
                chunk_size=1 << 40,  # this class ends the chunks, before they grow too large
                compression=CompressionType.ZSTD,
                enable_data_crcs=True,
            )
            self._writer.start(library=f"svmdist {version('svmdist')}")
            self._writer.add_metadata(METADATA_NAME, dict(sorted(self._metadata.items())))
            self._file.flush()
        except BusyError:
            raise UsageError(f"{self.part_path}: {IS_HELD}") from None
        except FileExistsError:  # it was made since we looked
            self._refuse_to_replace(self.part_path)
            raise
        except OSError as problem:
            raise self._failure(problem) from problem
        return self

    def write(self, topic: str, sample: Sample | EncodedSample) -> None:
        """Append a sample, which may be encoded already; its stamp becomes the log time and the publish time.

        Raises OutputError when the file cannot be written, ValueError when the topic already carries
        another type of sample.
        """
        if isinstance(sample, EncodedSample):
            data, sample_type = sample.data, sample.sample_type
        else:
            data, sample_type = encode(sample, self._jpeg_quality), type(sample)
        needed_bytes = RECORD_HEAD_BYTES + MESSAGE_HEAD_BYTES + len(data)
        try:
            self._end_chunk_before(sample.stamp_ns, needed_bytes)
            channel_id = self._channel(topic, sample_type)
            self._sequences[channel_id] = self._sequences.get(channel_id, -1) + 1
            self._writer.add_message(
                channel_id, sample.stamp_ns, data, sample.stamp_ns, self._sequences[channel_id]
            )
        except OSError as problem:
            raise self._failure(problem) from problem
        self._chunk_bytes += needed_bytes
        if self._chunk_start_ns is None:
            self._chunk_start_ns = sample.stamp_ns

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is None:
            return
        if self._channels and isinstance(error, KeyboardInterrupt | OutputError):
            error.add_note(f"what was recorded until then is in {self.part_path}")
        if self._file.closed:
            return
        if kind is not None:
            # Keep what there is; the caller's exception matters more than another one from here.
            with suppress(OSError):
                self._writer.flush()
            with suppress(OSError):
                self._file.close()
            if not self._channels:  # there is nothing in it worth keeping
                self.part_path.unlink(missing_ok=True)
            return
        try:
            self._writer.finish()
            self._file.flush()
            os.fsync(self._file.fileno())  # a full disk may show only here
            self._refuse_to_replace(self.path)
            if sys.platform == "win32":  # an open file cannot be renamed there
                self._file.close()
            self.part_path.replace(self.path)  # before the lock is given up: until then the file is ours
            self._file.close()
        except OSError as problem:
            raise self._failure(problem) from problem

    def _end_chunk_before(self, stamp_ns: int, needed_bytes: int) -> None:
        if self._chunk_start_ns is None:
            return
        too_long = abs(stamp_ns - self._chunk_start_ns) >= CHUNK_SPAN_NS
        if too_long or self._chunk_bytes + needed_bytes > CHUNK_BYTES:
            self._writer.flush()
            self._chunk_bytes = 0
            self._chunk_start_ns = None

    def _channel(self, topic: str, sample_type: type) -> int:
        if topic in self._channels:
            channel_id, known_type = self._channels[topic]
            if known_type is not sample_type:
                raise ValueError(f"{topic} carries {known_type.__name__}, not {sample_type.__name__}")
            return channel_id
        declared = message_type(sample_type)
        if sample_type not in self._schemas:
            self._schemas[sample_type] = self._writer.register_schema(
                declared.name, "protobuf", declared.descriptor_set
            )
        channel_id = self._writer.register_channel(topic, "protobuf", self._schemas[sample_type])
        self._channels[topic] = (channel_id, sample_type)
        return channel_id

    def _refuse_to_replace(self, path: Path) -> None:
        if not self._force and os.path.lexists(path):
            if path == self.part_path and is_held(path):
                raise UsageError(f"{path}: {IS_HELD}")
            what = "is left from an interrupted recording" if path == self.part_path else "exists already"
            raise UsageError(f"{path}: {what}; give another name, or --force to replace it")

    def _failure(self, problem: OSError) -> OutputError:
        if self._file is not None:
            # Closing tries to write the rest once more and fails in the same way.
            with suppress(OSError):
                self._file.close()
        return OutputError(f"{self.path}: cannot write: {problem.strerror or problem}")
