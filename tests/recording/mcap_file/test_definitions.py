"""Definitions: an id means one thing; where it would mean two, it means nothing."""

from __future__ import annotations

import struct

import pytest

from svmdist.profile import Limits
from svmdist.recording.mcap_file.definitions import DefinitionError, Definitions
from svmdist.recording.mcap_file.record_parsers import ChannelBody, SchemaBody


def text(value: str) -> bytes:
    """A string behind its length."""
    return struct.pack("<I", len(value.encode())) + value.encode()


def schema(key: int, name: str = "foxglove.JointStates", data: bytes = b"") -> memoryview:
    """The body of a schema record."""
    body = struct.pack("<H", key) + text(name) + text("protobuf") + struct.pack("<I", len(data)) + data
    return memoryview(body)


def channel(key: int, schema_id: int, topic: str = "/js") -> memoryview:
    """The body of a channel record without metadata."""
    return memoryview(struct.pack("<HH", key, schema_id) + text(topic) + text("protobuf") + text(""))


def test_what_was_added_is_known_by_its_id() -> None:
    """The same definition may come again, as each chunk repeats those that it needs."""
    definitions = Definitions(Limits())
    for _ in range(2):
        definitions.add_schema(schema(7, data=b"text"))
        definitions.add_channel(channel(3, 7))
    assert definitions.schemas == {7: SchemaBody(7, "foxglove.JointStates", "protobuf", b"text")}
    assert definitions.channels == {3: ChannelBody(3, 7, "/js", "protobuf")}
    assert definitions.schema_name(definitions.channels[3]) == "foxglove.JointStates"
    assert not definitions.ambiguous


def test_a_channel_may_have_no_schema() -> None:
    definitions = Definitions(Limits())
    definitions.add_channel(channel(1, 0))
    assert definitions.schema_name(definitions.channels[1]) == ""
    with pytest.raises(DefinitionError, match="names schema 9, which is not defined"):
        definitions.add_channel(channel(2, 9))
    with pytest.raises(DefinitionError, match="schema id 0 means"):
        definitions.add_schema(schema(0))


def test_an_id_with_two_meanings_is_ambiguous() -> None:
    """A channel by itself, and all channels of a schema; the others stay what they are."""
    definitions = Definitions(Limits())
    for key in (1, 2):
        definitions.add_schema(schema(key))
    for key, schema_id in ((1, 1), (2, 1), (3, 2), (4, 2)):
        definitions.add_channel(channel(key, schema_id, f"/{key}"))
    with pytest.raises(DefinitionError, match=r"schema 1 is 'foxglove\.JointStates' and 'other'"):
        definitions.add_schema(schema(1, "other"))
    assert definitions.ambiguous == {1, 2}
    with pytest.raises(DefinitionError, match="channel 4 is '/4' and '/other'"):
        definitions.add_channel(channel(4, 2, "/other"))
    assert definitions.ambiguous == {1, 2, 4}


@pytest.mark.parametrize("end", range(0, 20, 3))
def test_a_body_that_ends_early_is_malformed(end: int) -> None:
    definitions = Definitions(Limits())
    with pytest.raises(DefinitionError, match="a schema is malformed"):
        definitions.add_schema(schema(1)[:end])
    with pytest.raises(DefinitionError, match="a channel is malformed"):
        definitions.add_channel(channel(1, 0, "/a long topic")[:end])
    assert not definitions.schemas
    assert not definitions.channels


def test_a_name_that_is_no_text_is_malformed() -> None:
    broken = bytearray(channel(1, 0))
    broken[8] = 0xFF
    with pytest.raises(DefinitionError, match="a channel is malformed"):
        Definitions(Limits()).add_channel(memoryview(broken))


def test_all_definitions_together_keep_to_the_limit() -> None:
    """A repeated one costs nothing."""
    definitions = Definitions(Limits(definition_bytes=1024))
    for _ in range(10):
        definitions.add_schema(schema(1, data=bytes(600)))
    with pytest.raises(DefinitionError, match="more than 1024 bytes"):
        definitions.add_schema(schema(2, data=bytes(600)))
    assert set(definitions.schemas) == {1}


def test_what_the_summary_knows_completes_and_replaces_nothing() -> None:
    definitions = Definitions(Limits())
    definitions.add_schema(schema(1))
    definitions.add_channel(channel(1, 1))
    mine, others = definitions.channels[1], ChannelBody(2, 1, "/x", "json")
    known = definitions.schemas[1]
    definitions.complete(
        {1: SchemaBody(1, "other", "", b""), 2: SchemaBody(2, "new", "", b"")},
        {1: ChannelBody(1, 2, "/other", ""), 2: others},
    )
    assert definitions.channels == {1: mine, 2: others}
    assert definitions.schemas[1] == known
    assert definitions.schemas[2].name == "new"
