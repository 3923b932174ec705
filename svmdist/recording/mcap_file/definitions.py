"""The schemas and channels of one MCAP file: who may be registered, and which ids contradict each other."""

from __future__ import annotations

from collections.abc import Mapping

from svmdist.profile import Limits
from svmdist.recording.mcap_file.record_parsers import (
    ChannelBody,
    MalformedRecordError,
    SchemaBody,
    parse_channel,
    parse_schema,
)

NO_SCHEMA_ID = 0


class DefinitionError(ValueError):
    """A schema or channel that cannot be accepted."""


class Definitions:
    """Schemas and channels by id, as far as a file has been read.

    An id that is defined twice in different ways means nothing from then on: its messages could belong
    to either. Their channels are `ambiguous`.
    """

    def __init__(self, limits: Limits) -> None:
        self.schemas: dict[int, SchemaBody] = {}
        self.channels: dict[int, ChannelBody] = {}
        self.ambiguous: set[int] = set()
        self._limits = limits
        self._bytes = 0

    def add_schema(self, body: memoryview) -> None:
        """Register a schema; DefinitionError when it is malformed or another one has its id."""
        try:
            schema = parse_schema(body)
        except MalformedRecordError as problem:
            raise DefinitionError(f"a schema is malformed: {problem}") from None
        if schema.id == NO_SCHEMA_ID:
            raise DefinitionError("schema id 0 means that there is no schema")
        known = self.schemas.get(schema.id)
        if known == schema:
            return
        if known is not None:
            self.ambiguous |= {
                channel.id for channel in self.channels.values() if channel.schema_id == schema.id
            }
            raise DefinitionError(f"schema {schema.id} is {known.name!r} and {schema.name!r}")
        self._count(len(body))
        self.schemas[schema.id] = schema

    def add_channel(self, body: memoryview) -> None:
        """Register a channel; DefinitionError when it is malformed, has no schema, or another one has its id."""
        try:
            channel = parse_channel(body)
        except MalformedRecordError as problem:
            raise DefinitionError(f"a channel is malformed: {problem}") from None
        known = self.channels.get(channel.id)
        if known == channel:
            return
        if known is not None:
            self.ambiguous.add(channel.id)
            raise DefinitionError(f"channel {channel.id} is {known.topic!r} and {channel.topic!r}")
        if channel.schema_id not in self.schemas and channel.schema_id != NO_SCHEMA_ID:
            raise DefinitionError(
                f"channel {channel.topic!r} names schema {channel.schema_id}, which is not defined"
            )
        self._count(len(body))
        self.channels[channel.id] = channel

    def complete(self, schemas: Mapping[int, SchemaBody], channels: Mapping[int, ChannelBody]) -> None:
        """Add what is not known yet from another account of the same file."""
        self.schemas = {**schemas, **self.schemas}
        self.channels.update({key: channel for key, channel in channels.items() if key not in self.channels})

    def schema_name(self, channel: ChannelBody) -> str:
        """Name of a channel's schema, empty where it has none."""
        return self.schemas[channel.schema_id].name if channel.schema_id in self.schemas else ""

    def _count(self, size_bytes: int) -> None:
        self._bytes += size_bytes
        if self._bytes > self._limits.definition_bytes:
            raise DefinitionError(
                f"schemas and channels take more than {self._limits.definition_bytes} bytes"
            )
