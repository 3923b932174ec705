"""The byte layouts of ROS: what the rosbags serializer writes is read to the bit, and no byte beyond the end."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from svmdist.recording.messages.checks import DecodeError
from svmdist.recording.messages.ros_wire import CdrWire, Ros1Wire
from tests.recording.other_recorders import build, header

STAMP_NS = 1_700_000_123_456_789_012
JOINTS: dict[str, Any] = {
    "header": header(STAMP_NS, "base é"),
    "name": ["a", "", "joint 3"],
    "position": [0.5, -1e-300, 1e300],
    "velocity": [],
    "effort": [1.0],
}
WIRES = pytest.mark.parametrize("wire_type", [Ros1Wire, CdrWire], ids=["ROS 1", "CDR"])


def serialized(wire_type: type[Ros1Wire], type_name: str, fields: dict[str, Any]) -> bytes:
    """A message as rosbags writes it."""
    fields = {
        name: np.array(value) if name in {"position", "velocity", "effort"} else value
        for name, value in fields.items()
    }
    if wire_type is CdrWire:
        store = get_typestore(Stores.ROS2_HUMBLE)
        return bytes(store.serialize_cdr(build(store, type_name, fields), type_name))
    store = get_typestore(Stores.ROS1_NOETIC)
    return bytes(store.serialize_ros1(build(store, type_name, fields), type_name))


def read_joints(wire: Ros1Wire) -> tuple[tuple[int, str], list[str], list[list[float]]]:
    """A sensor_msgs/JointState."""
    head = wire.header()
    names = [wire.text() for _ in range(wire.u32())]
    return head, names, [wire.float_sequence().tolist() for _ in range(3)]


@WIRES
def test_what_the_serializer_wrote_is_read(wire_type: type[Ros1Wire]) -> None:
    """Texts of every alignment before numbers of 64 bits."""
    data = serialized(wire_type, "sensor_msgs/msg/JointState", JOINTS)
    for kind in (bytes, memoryview):
        head, names, numbers = read_joints(wire_type(kind(data)))
        assert head == (STAMP_NS, "base é")
        assert names == JOINTS["name"]
        assert numbers == [JOINTS[name] for name in ("position", "velocity", "effort")]


@WIRES
@pytest.mark.parametrize("length", range(9))
def test_numbers_behind_a_text_of_any_length_are_found(wire_type: type[Ros1Wire], length: int) -> None:
    fields = JOINTS | {"header": header(STAMP_NS, "x" * length), "name": [], "effort": []}
    _, _, numbers = read_joints(wire_type(serialized(wire_type, "sensor_msgs/msg/JointState", fields)))
    assert numbers == [JOINTS["position"], [], []]


@WIRES
def test_a_message_that_ends_early_is_told_wherever_it_ends(wire_type: type[Ros1Wire]) -> None:
    """The last field is a number, so that no byte of the message is padding."""
    data = serialized(wire_type, "sensor_msgs/msg/JointState", JOINTS)
    for end in range(len(data)):
        with pytest.raises(DecodeError, match=f"ends early, at byte {end}; "):
            read_joints(wire_type(data[:end]))


@WIRES
def test_a_length_beyond_the_message_takes_no_memory(wire_type: type[Ros1Wire]) -> None:
    data = bytes([0, 1, 0, 0]) * (wire_type is CdrWire) + struct.pack("<I", (1 << 32) - 1) + bytes(8)
    for read in (Ros1Wire.float_sequence, Ros1Wire.octets, Ros1Wire.text):
        with pytest.raises(DecodeError, match="ends early"):
            read(wire_type(data))


@WIRES
def test_a_text_that_is_not_utf_8_is_told(wire_type: type[Ros1Wire]) -> None:
    data = bytes([0, 1, 0, 0]) * (wire_type is CdrWire) + struct.pack("<I", 2) + b"\xff\xfe"
    with pytest.raises(DecodeError, match="not UTF-8"):
        wire_type(data).text()


@pytest.mark.parametrize(
    ("kind", "order", "alignment"),
    [(0, ">", 8), (1, "<", 8), (6, ">", 4), (7, "<", 4)],
    ids=["CDR big", "CDR little", "CDR2 big", "CDR2 little"],
)
def test_plain_cdr_has_two_orders_and_two_alignments(kind: int, order: str, alignment: int) -> None:
    """XCDR2 aligns numbers of 64 bits to 4 (OMG DDS-XTypes 1.3, 7.4.3.2); places count from behind the head."""
    body = struct.pack(f"{order}i", -5) + bytes(4 * (alignment == 8)) + struct.pack(f"{order}2d", 0.25, -2.0)
    wire = CdrWire(bytes([0, kind, 0, 0]) + body + b"\7")
    assert wire.i32() == -5
    assert wire.floats(2).tolist() == [0.25, -2.0]
    assert wire.u8() == 7


@pytest.mark.parametrize(
    "head", [b"\0\2\0\0", b"\0\3\0\0", b"\1\1\0\0", b"\0\x0b\0\0"], ids=["PL", "PL-LE", "1", "D"]
)
def test_other_kinds_of_cdr_are_refused(head: bytes) -> None:
    with pytest.raises(DecodeError, match=f"not plain CDR: it begins with {head[:2].hex(' ')}"):
        CdrWire(head + bytes(20))


def test_no_message_without_a_head() -> None:
    for end in range(4):
        with pytest.raises(DecodeError, match="ends early"):
            CdrWire(bytes([0, 1, 0, 0])[:end])


def test_a_text_of_cdr_ends_with_or_without_a_zero() -> None:
    """An empty one may have no byte at all."""
    for octets, text in ((b"ab\0", "ab"), (b"ab", "ab"), (b"\0", ""), (b"", "")):
        assert CdrWire(b"\0\1\0\0" + struct.pack("<I", len(octets)) + octets).text() == text


def test_seconds_have_a_sign_in_ros_2_alone() -> None:
    data = struct.pack("<iI", -1, 5)
    assert CdrWire(b"\0\1\0\0" + data).stamp_ns() == -1_000_000_000 + 5
    assert Ros1Wire(data).stamp_ns() == (2**32 - 1) * 1_000_000_000 + 5


def test_no_floats_need_no_place() -> None:
    """A sequence of no numbers is not followed by the padding that numbers would need."""
    wire = CdrWire(b"\0\1\0\0" + struct.pack("<I", 0) + struct.pack("<I", 9))
    assert wire.float_sequence().shape == (0,)
    assert wire.u32() == 9
