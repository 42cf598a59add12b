"""A network of one convolution, a ReLU and a mean over the image, as an ONNX file written by hand.

Protocol buffers of onnx.proto: ModelProto (ir_version 1, graph 7, opset_import 8), GraphProto (node 1, name 2,
initializer 5, input 11, output 12), NodeProto (input 1, output 2, op_type 4), TensorProto (dims 1, data_type 2, name 8,
raw_data 9), ValueInfoProto (name 1, type 2).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np


def write_tiny_onnx(path: Path, size: tuple[int, int] = (64, 48), features: int = 12, op: str = "Relu") -> Path:
    """Input (1, 3, height, width), output (1, features, 1, 1)."""
    weights = np.random.default_rng(0).normal(size=(features, 3, 3, 3)).astype(np.float32)
    tensor = b"".join(_int(1, n) for n in weights.shape) + _int(2, 1) + _text(8, "w") + _bytes(9, weights.tobytes())
    nodes = [_node("Conv", ["x", "w"], "a"), _node(op, ["a"], "b"), _node("GlobalAveragePool", ["b"], "y")]
    graph = b"".join(_bytes(1, node) for node in nodes) + _text(2, "tiny") + _bytes(5, tensor)
    graph += _bytes(11, _value("x", (1, 3, size[1], size[0]))) + _bytes(12, _value("y", (1, features, 1, 1)))
    path.write_bytes(_int(1, 8) + _bytes(7, graph) + _bytes(8, _int(2, 13)))
    return path


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    return bytes([*out, value])


def _int(number: int, value: int) -> bytes:
    return _varint(number << 3) + _varint(value)


def _bytes(number: int, content: bytes) -> bytes:
    return _varint(number << 3 | 2) + _varint(len(content)) + content


def _text(number: int, content: str) -> bytes:
    return _bytes(number, content.encode())


def _node(op: str, inputs: list[str], output: str) -> bytes:
    return b"".join(_text(1, name) for name in inputs) + _text(2, output) + _text(3, op.lower()) + _text(4, op)


def _value(name: str, shape: tuple[int, ...]) -> bytes:
    """A tensor of floats: TypeProto (tensor_type 1), its elem_type 1 and shape 2 of dim 1 with dim_value 1."""
    dims = b"".join(_bytes(1, _int(1, n)) for n in shape)
    return _text(1, name) + _bytes(2, _bytes(1, _int(1, 1) + _bytes(2, dims)))
