"""rosbag2 folders as a source of messages, whether their files are MCAP or SQLite.

Messages are read from the storage files alone. What `metadata.yaml` says of files and counts is only held
against what is there: a name in a file is never used as a path.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from pathlib import Path

from svmdist.errors import RecordingError
from svmdist.profile import Limits
from svmdist.recording.decompress import DecompressionError, decompress_message
from svmdist.recording.effort import Effort, TooMuchError
from svmdist.recording.mcap_file.source import McapSource
from svmdist.recording.rosbag import METADATA_FILE
from svmdist.recording.rosbag.bag2_metadata import BagMetadata, MetadataError, read_metadata
from svmdist.recording.rosbag.sqlite_source import SqliteSource
from svmdist.recording.source import (
    Health,
    Loss,
    LossKind,
    RawMessage,
    Source,
    TopicInfo,
    is_message_compressed,
    merge_topics,
    sanitize,
)


class Rosbag2Source:
    """A rosbag2 folder: its storage files one after another, messages expanded where they are compressed."""

    def __init__(self, path: Path, limits: Limits) -> None:
        self.path = path
        self.health = Health()
        self._limits = limits
        self._message_bytes = 4 * limits.image_pixels + limits.message_bytes
        metadata = self._read_metadata()
        packed = sorted(
            file.name for file in path.iterdir() if file.name.endswith((".mcap.zstd", ".db3.zstd"))
        )
        if packed:
            raise RecordingError(
                f"{path}: its files are compressed as a whole; expand them first: zstd -d {sanitize(packed[0])}"
            )
        files = storage_files(path)
        if not files:
            found = f"; its storage is {sanitize(metadata.storage)}" if metadata.storage else ""
            raise RecordingError(f"{path}: a rosbag2 folder without any .mcap or .db3 file{found}")
        missing = sorted({Path(name).name for name in metadata.files} - {file.name for file in files})
        if missing:
            detail = f"{', '.join(missing[:3])} named in {METADATA_FILE} but not there"
            self.health.add(Loss(LossKind.STRUCTURE, detail))
        self._declared_counts = metadata.counts
        self._is_compressed = metadata.is_message_compressed
        open_one: dict[str, Callable[[Path, Limits], Source]] = {".mcap": McapSource, ".db3": SqliteSource}
        self._parts = [open_one[file.suffix](file, limits) for file in files]
        for part in self._parts:
            for loss in part.health.losses:
                self.health.add(loss)
            part.health = self.health
        if metadata == BagMetadata():
            self._is_compressed = is_message_compressed(self._parts[0])

    def _read_metadata(self) -> BagMetadata:
        """What the folder declares; where that cannot be read, nothing, and a loss: the messages are not in it."""
        try:
            return read_metadata(self.path)
        except MetadataError as problem:
            self.health.add(Loss(LossKind.STRUCTURE, str(problem)))
            return BagMetadata()

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the topics of all files."""
        return merge_topics(info for part in self._parts for info in part.topics())

    def metadata(self) -> dict[str, str]:
        """Read the record `svmdist` of the first file that has one."""
        return next((found for part in self._parts if (found := part.metadata())), {})

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Yield the messages of some topics, or of all, file by file."""
        losses = 0
        counts: Counter[str] = Counter()
        effort = Effort(sum(file.stat().st_size for file in storage_files(self.path)))
        for part in self._parts:
            part_losses = 0
            for raw in part.messages(topics):
                counts[raw.topic] += 1
                part_losses = raw.losses_before
                message = replace(raw, losses_before=losses + part_losses)
                if not self._is_compressed:
                    yield message
                    continue
                try:
                    data = decompress_message(raw.data, self._message_bytes, self._limits)
                    effort.expand(len(data))
                except (DecompressionError, TooMuchError) as problem:
                    losses += 1
                    self.health.add(Loss(LossKind.MESSAGE, str(problem), raw.offset, raw.topic))
                    continue
                yield replace(message, data=data)
            losses += part_losses + 1  # what the end of a file lost shows in no message of it
        if self.health.is_clean:
            for topic, declared in self._declared_counts.items():
                if (topics is None or topic in topics) and declared != counts[topic]:
                    detail = f"{METADATA_FILE} declares {declared} messages, {counts[topic]} were read"
                    self.health.add(Loss(LossKind.STATISTICS, detail, None, topic))


def storage_files(folder: Path) -> list[Path]:
    """List the storage files of a folder in the order in which they were written: `_2` before `_10`."""

    def order(path: Path) -> list[tuple[int, str]]:
        return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.name)]

    return sorted((path for path in folder.iterdir() if path.suffix in {".mcap", ".db3"}), key=order)
