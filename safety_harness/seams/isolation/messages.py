"""Messages between the harness and the process of a user's file: MessagePack in frames, never a pickle.

These are of every kind of object.  A kind adds its own calls and answers (``child.ServedKind``): an avoider's
``Ask``, a controller's ``Act``.  Each side decodes what the other may say and nothing else.
"""

from __future__ import annotations

import json
import os
import struct
import sys
from pathlib import Path
from typing import Any, ClassVar

import msgspec
import numpy as np
from msgspec import Struct

HEADER = struct.Struct("<4sI")  # MAGIC, bytes of the message
MAGIC = b"AVO2"
MOST_WORDS = 240  # of why a call failed: what a trace keeps
MEMORY_BYTES = 4 << 30  # of the file's own data; libraries and reserved addresses do not count


def framed(message: bytes) -> bytes:
    """Return the message behind a header that tells its length."""
    return HEADER.pack(MAGIC, len(message)) + message


def length_of(header: bytes, most: int) -> int:
    """Return the length of the message, at most ``most`` bytes; ValueError otherwise."""
    magic, length = HEADER.unpack(header)
    if magic != MAGIC or length > most:
        raise ValueError("no frame of ours")
    return int(length)


class ProcessMessage(Struct, tag_field="say"):
    """A message; ``call`` is the method of the user's object that it asks, for the words of a failure."""

    call: ClassVar[str] = "make"


class Make(ProcessMessage, tag="make"):
    """Make an object with that number: ``wanted`` says which in JSON, ``source`` is its file."""

    number: int
    wanted: bytes
    source: bytes

    @classmethod
    def of(
        cls, path: Path, source: bytes, name: str, number: int = 0, *, onnx: bool = False, **more: object
    ) -> Make:
        """Make what stands behind a file in a reference, in this process's folder and with its modules.

        ``name`` is an attribute, or the layout of an ``onnx`` file: the suffix may be that of a link alone.
        """
        wanted = {"path": str(path), "name": name, "onnx": onnx, **more}
        wanted |= {"folder": os.getcwd(), "sys_path": sys.path}
        return cls(number, json.dumps(wanted).encode(), source)


class Drop(ProcessMessage, tag="drop"):
    """Forget the object with that number."""

    number: int


class Refused(ProcessMessage, tag="none"):
    """The file gives no such object: what was expected, what came, where to read on, and in which field."""

    expected: str
    got: str
    hint: str = ""
    field: str = ""


class Failed(ProcessMessage, tag="failed", forbid_unknown_fields=True):
    """The call failed, and why."""

    why: str


def decoder_of(messages: Any) -> msgspec.msgpack.Decoder[Any]:
    """Return what decodes a union of messages; arrays in them are float64 and read-only."""
    return msgspec.msgpack.Decoder(messages, dec_hook=array_of)


def array_of(kind: type, value: object) -> Any:
    """Return the numbers of a message as an array; TypeError or ValueError for what are none."""
    array = np.array(value, dtype=np.float64)
    array.flags.writeable = False
    return array


def plain(value: object) -> object:
    """Return numbers for arrays, and bytes for pixels; TypeError for anything else."""
    if isinstance(value, np.ndarray):
        return value.tobytes() if value.dtype == np.uint8 else value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"no numbers, text or array of those: {type(value).__name__}")


packed = msgspec.msgpack.Encoder(enc_hook=plain).encode
