"""Small convolutional networks, written as ONNX graphs and run by OpenCV."""

import struct
from collections.abc import Sequence
from itertools import count

import cv2
import numpy as np

from rholoc.geometry import ByteArray, FloatArray, IntArray

Attribute = int | float | str | Sequence[int]

_OPSET, _IR_VERSION = 17, 8  # of ONNX
_FLOAT, _INT64 = 1, 7  # TensorProto.DataType


class Graph:
    """A graph of ONNX operators on float32 arrays of fixed shapes. A tensor is known by its name."""

    def __init__(self) -> None:
        self._fields: list[bytes] = [_text(2, "graph")]
        self._numbers = count()

    def input(self, name: str, shape: Sequence[int]) -> str:
        """Declare a float32 input of the network; returns its name."""
        self._fields.append(_bytes(11, _value(name, shape)))
        return name

    def output(self, tensor: str, name: str, shape: Sequence[int]) -> None:
        """Declare a named output of the network."""
        self._fields.append(_bytes(1, _node("Identity", [tensor], name, {})))
        self._fields.append(_bytes(12, _value(name, shape)))

    def constant(self, array: FloatArray | IntArray) -> str:
        """Add weights (stored as float32), or whole numbers such as a shape (int64); returns the tensor's name."""
        name = self._new_name()
        self._fields.append(_bytes(5, _tensor(name, array)))
        return name

    def add(self, operator: str, *inputs: str, **attributes: Attribute) -> str:
        """Add an operator, by ONNX's name for it; returns the name of its output."""
        name = self._new_name()
        self._fields.append(_bytes(1, _node(operator, inputs, name, attributes)))
        return name

    def convolution(self, x: str, weights: FloatArray, bias: FloatArray, stride: int = 1) -> str:
        """Add a convolution of weights (O, I, K, K), K odd, zero padding and a ``stride``; returns its output."""
        size = weights.shape[-1]
        geometry = {"kernel_shape": (size, size), "pads": (size // 2,) * 4, "strides": (stride, stride)}
        return self.add("Conv", x, self.constant(weights), self.constant(bias), **geometry)

    def network(self) -> cv2.dnn.Net:
        """The graph, ready to run by one thread at a time.

        Raises:
            cv2.error: an operator is unknown, or does not fit its inputs.
        """
        model = _int(1, _IR_VERSION) + _bytes(8, _int(2, _OPSET)) + _bytes(7, b"".join(self._fields))
        buffer: ByteArray = np.frombuffer(model, np.uint8)
        return cv2.dnn.readNetFromONNX(buffer)

    def _new_name(self) -> str:
        return f"t{next(self._numbers)}"


# -- ONNX's messages (onnx.proto) in the format of Protocol Buffers: a field is its number and kind, then its value ----


def _value(name: str, shape: Sequence[int]) -> bytes:
    """ONNX's ValueInfoProto of a float32 tensor."""
    sizes = b"".join(_bytes(1, _int(1, size)) for size in shape)
    return _text(1, name) + _bytes(2, _bytes(1, _int(1, _FLOAT) + _bytes(2, sizes)))


def _tensor(name: str, array: FloatArray | IntArray) -> bytes:
    """ONNX's TensorProto of an array, as float32 or int64."""
    kind, dtype = (_INT64, "<i8") if np.issubdtype(array.dtype, np.integer) else (_FLOAT, "<f4")
    shape = b"".join(_int(1, size) for size in array.shape)
    return shape + _int(2, kind) + _text(8, name) + _bytes(9, np.ascontiguousarray(array, dtype).tobytes())


def _node(operator: str, inputs: Sequence[str], output: str, attributes: dict[str, Attribute]) -> bytes:
    """ONNX's NodeProto, named like its output."""
    wires = b"".join(_text(1, name) for name in inputs) + _text(2, output) + _text(3, output)
    return wires + _text(4, operator) + b"".join(_bytes(5, _attribute(*item)) for item in attributes.items())


def _attribute(name: str, value: Attribute) -> bytes:
    """ONNX's AttributeProto: an integer, a float, a text or integers."""
    match value:
        case int():
            kind, content = 2, _int(3, value)
        case float():
            kind, content = 1, _varint(2 << 3 | 5) + struct.pack("<f", value)
        case str():
            kind, content = 3, _text(4, value)
        case _:
            kind, content = 7, b"".join(_int(8, part) for part in value)
    return _text(1, name) + content + _int(20, kind)


def _text(field: int, value: str) -> bytes:
    return _bytes(field, value.encode())


def _bytes(field: int, value: bytes) -> bytes:
    """A field of Protocol Buffers with a length, such as a text or a message."""
    return _varint(field << 3 | 2) + _varint(len(value)) + value


def _int(field: int, value: int) -> bytes:
    """A field of Protocol Buffers with a non-negative number."""
    return _varint(field << 3) + _varint(value)


def _varint(value: int) -> bytes:
    """A number, at least 0, in Protocol Buffers: seven bits a byte, the lowest first; the highest bit: more follow."""
    parts = []
    while value > 127:
        parts.append(value & 127 | 128)
        value >>= 7
    return bytes([*parts, value])
