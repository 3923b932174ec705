"""What the metadata.yaml of a rosbag2 folder declares, read within limits: the file is somebody else's.

Scalars stay text: YAML's own types turn a topic into a date or a truth value. Aliases are refused, for a few lines
of them stand for millions of values, and rosbag2 writes none.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from svmdist.input_file import read_regular, why
from svmdist.recording.rosbag import METADATA_FILE

MAX_BYTES = 1 << 20
MAX_EVENTS = 200_000
"""Keys, values, beginnings and ends: 35 for a topic."""
MAX_DEPTH = 20
MAX_COUNT_DIGITS = 19
Loader: Any = getattr(yaml, "CBaseLoader", yaml.BaseLoader)


class MetadataError(ValueError):
    """A metadata.yaml that cannot be used; the message is one line."""


@dataclass(frozen=True)
class BagMetadata:
    """Names of the storage files, the storage's name, and counts of messages by topic, as far as declared."""

    files: tuple[str, ...] = ()
    storage: str | None = None
    is_message_compressed: bool = False
    counts: dict[str, int] = field(default_factory=dict)


def read_metadata(folder: Path) -> BagMetadata:
    """Read a folder's metadata.yaml; MetadataError where it is too large, no YAML, or not rosbag2's."""
    path = folder / METADATA_FILE
    try:
        data = read_regular(path, MAX_BYTES)
    except OSError as problem:
        raise MetadataError(f"cannot read {METADATA_FILE}: {why(problem)}") from None
    return parse_metadata(data)


def parse_metadata(data: bytes) -> BagMetadata:
    """Parse the bytes of a metadata.yaml; MetadataError says in one line why they cannot be used."""
    if len(data) > MAX_BYTES:
        raise MetadataError(f"{METADATA_FILE} has more than {MAX_BYTES} bytes")
    try:
        _check_structure(data)
        document = yaml.load(data, Loader)  # a base loader: it makes text, lists and mappings, no objects
    except (yaml.YAMLError, UnicodeError, RecursionError, ValueError) as problem:
        raise MetadataError(f"{METADATA_FILE} is not usable: {' '.join(str(problem).split())}") from None
    information = document.get("rosbag2_bagfile_information") if isinstance(document, dict) else None
    if not isinstance(information, dict):
        raise MetadataError(f"{METADATA_FILE} has no rosbag2_bagfile_information")
    storage = information.get("storage_identifier")
    return BagMetadata(
        tuple(text for text in _list(information, "relative_file_paths") if isinstance(text, str)),
        storage if isinstance(storage, str) else None,
        str(information.get("compression_mode", "")).upper() == "MESSAGE",
        dict(_counts(information)),
    )


def _check_structure(data: bytes) -> None:
    """Go through a document without building it; ValueError where it is deep, long, or has aliases."""
    depth = 0
    for number, event in enumerate(yaml.parse(data, Loader)):
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > MAX_DEPTH:
            raise ValueError(f"nested more than {MAX_DEPTH} deep")
        if number > MAX_EVENTS:
            raise ValueError(f"more than {MAX_EVENTS} keys and values")
        if isinstance(event, yaml.AliasEvent):
            raise ValueError("it has an alias")


def _counts(information: dict[str, Any]) -> Iterator[tuple[str, int]]:
    for item in _list(information, "topics_with_message_count"):
        if not isinstance(item, dict):
            continue
        topic, count = item.get("topic_metadata"), item.get("message_count")
        name = topic.get("name") if isinstance(topic, dict) else None
        is_number = isinstance(count, str) and count.isdecimal() and len(count) <= MAX_COUNT_DIGITS
        if isinstance(name, str) and is_number:
            yield name, int(str(count))


def _list(mapping: dict[str, Any], key: str) -> list[Any]:
    value = mapping.get(key)
    return value if isinstance(value, list) else []
