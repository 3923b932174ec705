"""ONNX files written field by field (protobuf, onnx.proto3), so that tests of networks need no further package."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

FLOAT, INT64 = 1, 7
"""TensorProto.DataType."""


def varint(value: int) -> bytes:
    """Seven bits a byte, least first; negative numbers as 64 bits."""
    value &= (1 << 64) - 1
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    return bytes([*out, value])


def number(field: int, value: int) -> bytes:
    return varint(field << 3) + varint(value)


def chunk(field: int, content: bytes | str) -> bytes:
    """A field of wire type 2: text, bytes or a message."""
    raw = content.encode() if isinstance(content, str) else content
    return varint(field << 3 | 2) + varint(len(raw)) + raw


def tensor(name: str, values: np.ndarray) -> bytes:
    """TensorProto of float32: dims, data_type, name, raw_data."""
    values = np.ascontiguousarray(values, np.float32)
    dims = b"".join(number(1, length) for length in values.shape)
    return dims + number(2, FLOAT) + chunk(8, name) + chunk(9, values.tobytes())


def value_info(name: str, shape: Sequence[int], kind: int = FLOAT) -> bytes:
    """ValueInfoProto: name, type.tensor_type with elem_type and shape."""
    dims = b"".join(chunk(1, number(1, length)) for length in shape)
    return chunk(1, name) + chunk(2, chunk(1, number(1, kind) + chunk(2, dims)))


def node(operator: str, inputs: Sequence[str], output: str, **attributes: int | Sequence[int]) -> bytes:
    """NodeProto whose attributes are an INT (type 2) or INTS (type 7) each."""
    parts = [chunk(1, name) for name in inputs] + [
        chunk(2, output),
        chunk(3, f"to_{output}"),
        chunk(4, operator),
    ]
    for name, value in attributes.items():
        if isinstance(value, int):
            parts.append(chunk(5, chunk(1, name) + number(3, value) + number(20, 2)))
        else:
            parts.append(chunk(5, chunk(1, name) + b"".join(number(8, v) for v in value) + number(20, 7)))
    return b"".join(parts)


def write_model(
    path: Path,
    nodes: Sequence[bytes],
    tensors: Sequence[bytes],
    inputs: Sequence[bytes],
    outputs: Sequence[bytes],
) -> Path:
    """ModelProto: ir_version 8, operator set 13, and the graph."""
    fields = ((1, nodes), (5, tensors), (11, inputs), (12, outputs))
    graph = chunk(2, "graph") + b"".join(chunk(field, item) for field, items in fields for item in items)
    path.write_bytes(number(1, 8) + chunk(7, graph) + chunk(8, chunk(1, "") + number(2, 13)))
    return path


def write_classifier(
    path: Path,
    weights: np.ndarray,
    bias: np.ndarray,
    size: tuple[int, int],
    strides: tuple[int, int] = (1, 1),
    labels: str = "",
    pad: int = 0,
) -> Path:
    """A 1x1 convolution: `weights` (C, 3) and `bias` (C,) give the scores of C classes, for an input of `size` (w, h).

    `labels`: "" leaves the scores; "keep" and "drop" take their highest, shape (1, 1, h, w) or (1, h, w).
    """
    width, height = size
    out = [1, len(bias), -(-(height + 2 * pad) // strides[0]), -(-(width + 2 * pad) // strides[1])]
    conv = {"kernel_shape": [1, 1], "strides": strides, "pads": [pad] * 4}
    nodes = [node("Conv", ["image", "W", "b"], "scores", **conv)]
    outputs = [value_info("scores", out)]
    if labels:
        keep = int(labels == "keep")
        nodes.append(node("ArgMax", ["scores"], "labels", axis=1, keepdims=keep))
        outputs = [value_info("labels", [1, 1, *out[2:]] if keep else [1, *out[2:]], INT64)]
    tensors = [tensor("W", np.asarray(weights)[..., None, None]), tensor("b", np.asarray(bias))]
    return write_model(path, nodes, tensors, [value_info("image", [1, 3, height, width])], outputs)
