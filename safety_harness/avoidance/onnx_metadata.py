"""The metadata of an ONNX file, read from its bytes: no runtime loads it, nothing in it is computed.

A model is one message of protocol buffers (onnx.proto, ModelProto), whose field 14 is the metadata, each a
message of two texts: 1 the key, 2 the value.  Fields: https://protobuf.dev/programming-guides/encoding
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path

from safety_harness.avoidance.model_file import refuse

GRAPH, METADATA = 7, 14
MOST_FIELDS = 10_000  # of which a file may have millions to no purpose; what comes later is not read
_FIXED = {1: 8, 5: 4}  # bytes of a value by its wire type


def onnx_metadata(path: Path, data: bytes) -> dict[str, str]:
    """Of the file ``path`` with the contents ``data``; ModelError for what is no ONNX file."""
    try:
        fields = list(islice(_fields(memoryview(data)), MOST_FIELDS))
        pairs = [dict(islice(_fields(value), 2)) for number, value in fields if number == METADATA]
        found = {bytes(pair.get(1, b"")).decode(): bytes(pair.get(2, b"")).decode() for pair in pairs}
    except (ValueError, IndexError):
        fields = []
    if GRAPH not in [number for number, _ in fields]:
        refuse(path, None, "an ONNX file", "something else, or a part of one")
    return found


def _fields(data: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Number and value of each field of a message; ValueError or IndexError for what is none."""
    at = 0
    while at < len(data):
        key, at = _varint(data, at)
        if key & 7 == 2:
            length, at = _varint(data, at)
        elif key & 7 == 0:
            length = _varint(data, at)[1] - at
        else:
            length = _FIXED.get(key & 7, len(data))
        if at + length > len(data):
            raise ValueError("a field beyond the end")
        yield key >> 3, data[at : at + length]
        at += length


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    """A number of seven bits a byte, the lowest first, and where it ends."""
    number = 0
    for shift in range(0, 70, 7):
        number |= (data[at + shift // 7] & 0x7F) << shift
        if data[at + shift // 7] < 0x80:
            return number, at + shift // 7 + 1
    raise ValueError("a number without an end")
