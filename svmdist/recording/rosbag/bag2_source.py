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
from svmdist.recording.health import Health, Loss, LossKind
from svmdist.recording.mcap_file.source import McapSource
from svmdist.recording.names import plain
from svmdist.recording.rosbag.sqlite_source import SqliteSource
from svmdist.recording.sources import RawMessage, Source, TopicInfo, merge_topics

METADATA_FILE = "metadata.yaml"
MAX_METADATA_BYTES = 1 << 20
STORED_FILE = re.compile(r"^\s*-\s*['\"]?([^'\"\n]+\.(?:mcap|db3)(?:\.zstd)?)['\"]?\s*$", re.MULTILINE)
STORAGE = re.compile(r"^\s*storage_identifier:\s*['\"]?([^'\"\s]+)", re.MULTILINE)
COMPRESSION_MODE = re.compile(r"^\s*compression_mode:\s*['\"]?(\w*)", re.MULTILINE)


class Rosbag2Source:
    """A rosbag2 folder: its storage files one after another, messages expanded where they are compressed."""

    def __init__(self, path: Path, limits: Limits) -> None:
        self.path = path
        self.health = Health()
        self._limits = limits
        self._message_bytes = 4 * limits.image_pixels + limits.message_bytes
        text = _read_metadata(path)
        packed = sorted(
            file.name for file in path.iterdir() if file.name.endswith((".mcap.zstd", ".db3.zstd"))
        )
        if packed:
            raise RecordingError(
                f"{path}: its files are compressed as a whole; expand them first: zstd -d {plain(packed[0])}"
            )
        files = storage_files(path)
        if not files:
            storage = STORAGE.search(text)
            found = f"; its storage is {plain(storage[1])}" if storage else ""
            raise RecordingError(f"{path}: a rosbag2 folder without any .mcap or .db3 file{found}")
        missing = sorted(
            {Path(name).name for name in STORED_FILE.findall(text)} - {file.name for file in files}
        )
        if missing:
            detail = f"{', '.join(missing[:3])} named in {METADATA_FILE} but not there"
            self.health.add(Loss(LossKind.STRUCTURE, detail))
        mode = COMPRESSION_MODE.search(text)
        self._declared_counts = declared_counts(text)
        self._is_compressed = mode is not None and mode[1].upper() == "MESSAGE"
        open_one: dict[str, Callable[[Path, Limits], Source]] = {".mcap": McapSource, ".db3": SqliteSource}
        self._parts = [open_one[file.suffix](file, limits) for file in files]
        for part in self._parts:
            for loss in part.health.losses:
                self.health.add(loss)
            part.health = self.health

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
                except DecompressionError as problem:
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


def declared_counts(text: str) -> dict[str, int]:
    """Read the counts of messages by topic out of metadata.yaml: the items of `topics_with_message_count`."""
    counts: dict[str, int] = {}
    name: str | None = None
    count: int | None = None
    item_indent: int | None = None
    lines = iter(text.splitlines())
    for line in lines:
        if line.strip() == "topics_with_message_count:":
            break
    for line in lines:
        key, _, value = line.strip().removeprefix("- ").partition(":")
        indent = len(line) - len(line.lstrip())
        is_item = line.lstrip().startswith("- ")
        item_indent = indent if item_indent is None else item_indent
        if indent < item_indent or (indent == item_indent and not is_item):
            break
        if is_item and indent == item_indent:
            name = count = None
        value = value.strip().strip("'\"")
        if key == "name" and name is None:
            name = value
        elif key == "message_count" and count is None and value.isdecimal() and len(value) < 20:
            count = int(value)
        if name is not None and count is not None:
            counts[name] = count
    return counts


def _read_metadata(folder: Path) -> str:
    try:
        with (folder / METADATA_FILE).open("rb") as file:
            return file.read(MAX_METADATA_BYTES).decode("utf-8", "replace")
    except OSError as problem:
        raise RecordingError(
            f"{folder}: cannot read {METADATA_FILE}: {problem.strerror or problem}"
        ) from None
