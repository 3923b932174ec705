"""Foxglove's messages in JSON, turned into the protobuf messages of the same names."""

from __future__ import annotations

import base64
import json
from collections.abc import MutableSequence
from typing import Any

from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import Message

from svmdist.recording.messages.checks import DecodeError
from svmdist.recording.messages.foxglove import MESSAGES
from svmdist.recording.source import RawMessage


def parse_json(raw: RawMessage) -> Any:
    """Parse JSON text as the message that the schema names; DecodeError when it does not fit.

    Unknown keys are ignored, for newer schemas add fields; missing ones keep their default.
    """
    try:
        document = json.loads(bytes(raw.data))
        message = MESSAGES[raw.schema]()
        _fill(message, document)
    except (ValueError, TypeError, RecursionError, MemoryError, OverflowError) as problem:
        raise DecodeError(f"not a {raw.schema} in JSON: {problem}") from None
    return message


def _fill(message: Message, document: Any) -> None:
    if not isinstance(document, dict):
        raise TypeError(
            f"an object is expected for {message.DESCRIPTOR.name}, found {type(document).__name__}"
        )
    if message.DESCRIPTOR.full_name == "google.protobuf.Timestamp":
        # Foxglove's JSON schemas call the parts of a time sec and nsec.
        if not {"sec", "nsec"} <= document.keys():
            raise TypeError("a time needs sec and nsec")
        document = {"seconds": document["sec"], "nanos": document["nsec"]}
    message.SetInParent()
    for field in message.DESCRIPTOR.fields:
        value = document.get(field.name)
        if value is not None:
            _set(message, field, value)


def _set(message: Message, field: Any, value: Any) -> None:
    target: Any = getattr(message, field.name)
    if isinstance(target, MutableSequence):  # protobuf before 6 has no field.is_repeated
        if not isinstance(value, list):
            raise TypeError(f"a list is expected for {field.name}")
        if field.type != FieldDescriptor.TYPE_MESSAGE:
            target.extend(value)
            return
        for item in value:
            _fill(getattr(message, field.name).add(), item)
    elif field.type == FieldDescriptor.TYPE_MESSAGE:
        _fill(target, value)
    elif field.type == FieldDescriptor.TYPE_BYTES:
        setattr(message, field.name, base64.b64decode(value, validate=True))
    else:
        setattr(message, field.name, value)
