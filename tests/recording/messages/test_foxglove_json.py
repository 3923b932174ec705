"""Foxglove's messages in JSON: the same as in protobuf, and the documented error for what does not fit."""

from __future__ import annotations

import base64
import json
from typing import Any

import pytest
from google.protobuf.json_format import MessageToDict

from svmdist.recording.messages.checks import DecodeError
from svmdist.recording.messages.foxglove import MESSAGES, parse_protobuf
from svmdist.recording.messages.foxglove_json import parse_json
from svmdist.recording.source import RawMessage
from tests.recording.builders import Entry
from tests.recording.other_recorders import foxglove_json


def parse(schema: str, document: Any) -> Any:
    """Parse a document as JSON."""
    return parse_text(schema, json.dumps(document).encode())


def parse_text(schema: str, data: bytes) -> Any:
    """Parse text as JSON."""
    return parse_json(RawMessage("/a", schema, "json", 1, data))


def test_a_message_is_that_of_protobuf(entries: list[Entry]) -> None:
    """Every kind of the scene: serialised as protobuf and parsed again it is the same message."""
    schemas = set()
    for entry in entries:
        found = foxglove_json(entry.sample)
        if found is None:
            continue
        schema, document = found
        schemas.add(schema)
        message = parse(schema, document)
        data = message.SerializeToString()
        assert message == parse_protobuf(RawMessage("/a", schema, "protobuf", 1, data))
        stamps = document["transforms"][0] if "transforms" in document else document
        told = message.transforms[0] if "transforms" in document else message
        assert told.timestamp.seconds == stamps["timestamp"]["sec"]
        assert told.timestamp.nanos == stamps["timestamp"]["nsec"]
    assert len(schemas) == 5


def test_bytes_are_base64() -> None:
    data = bytes(range(256))
    message = parse("foxglove.CompressedImage", {"data": base64.b64encode(data).decode(), "format": "png"})
    assert (message.data, message.format) == (data, "png")


def test_unknown_keys_are_ignored_and_missing_ones_keep_their_default() -> None:
    """Newer schemas add fields; null stands for a key that is not there."""
    message = parse("foxglove.RawImage", {"width": 5, "added later": [1], "height": None})
    assert (message.width, message.height, message.encoding) == (5, 0, "")
    assert not message.HasField("timestamp")


def test_an_empty_object_is_there() -> None:
    """As an orientation of four zeros is one that was set."""
    message = parse("foxglove.PoseInFrame", {"pose": {"orientation": {}}})
    assert message.pose.HasField("orientation")
    assert not message.pose.HasField("position")


REFUSED: dict[str, tuple[str, Any]] = {
    "a list for an object": ("foxglove.RawImage", []),
    "null": ("foxglove.RawImage", None),
    "an object for a list": ("foxglove.JointStates", {"joints": {}}),
    "a number in a list of objects": ("foxglove.JointStates", {"joints": [1]}),
    "a text for a number": ("foxglove.RawImage", {"width": "5"}),
    "a fraction for a whole number": ("foxglove.RawImage", {"width": 5.5}),
    "a negative size": ("foxglove.RawImage", {"width": -1}),
    "a number of more bits": ("foxglove.RawImage", {"width": 1 << 32}),
    "a number without an end": ("foxglove.JointStates", {"joints": [{"name": "a", "position": 10**400}]}),
    "a number for a text": ("foxglove.RawImage", {"encoding": 5}),
    "no base64": ("foxglove.RawImage", {"data": "not base64!"}),
    "half of base64": ("foxglove.RawImage", {"data": "abc"}),
    "a time without nsec": ("foxglove.RawImage", {"timestamp": {"sec": 1}}),
    "a time of a text": ("foxglove.RawImage", {"timestamp": "2026-01-01"}),
    "texts in a matrix": ("foxglove.CameraCalibration", {"K": ["1"]}),
    "a number for a matrix": ("foxglove.CameraCalibration", {"K": 1}),
}


@pytest.mark.parametrize("what", REFUSED)
def test_a_value_of_another_type_is_refused(what: str) -> None:
    schema, document = REFUSED[what]
    with pytest.raises(DecodeError, match=f"not a {schema} in JSON"):
        parse(schema, document)


@pytest.mark.parametrize("schema", sorted(MESSAGES))
def test_text_that_is_no_json_is_refused(schema: str) -> None:
    """Truncated, not UTF-8, and nested deeper than any parser goes."""
    for data in (b"", b"{", b"\xff{}", b"[" * 100_000, b'{"a": ' * 100_000):
        with pytest.raises(DecodeError, match=f"not a {schema} in JSON"):
            parse_text(schema, data)


def test_an_empty_object_is_an_empty_message() -> None:
    for schema in MESSAGES:
        assert MessageToDict(parse(schema, {})) == {}
