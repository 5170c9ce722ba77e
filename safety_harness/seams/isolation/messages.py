"""Messages between the harness and the process of a user's file: MessagePack in frames, never a pickle.

These messages serve every kind of object. A kind adds its own calls and answers (``child.ServedKind``), such
as an avoider's ``Ask`` and a controller's ``Act``. Each side decodes only the messages that its peer may
send.
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
    """Return the message behind a header with its length."""
    return HEADER.pack(MAGIC, len(message)) + message


def length_of(header: bytes, most: int) -> int:
    """Return the length of the message after ``header``; ValueError above ``most`` bytes or without MAGIC."""
    magic, length = HEADER.unpack(header)
    if magic != MAGIC or length > most:
        raise ValueError("no frame of ours")
    return int(length)


class ProcessMessage(Struct, tag_field="say"):
    """A message. ``call`` is the method of the user's object that it calls; texts of failures use it."""

    call: ClassVar[str] = "make"


class Make(ProcessMessage, tag="make"):
    """Make an object with this number: ``wanted`` is its JSON description, ``source`` its file's bytes."""

    number: int
    wanted: bytes
    source: bytes

    @classmethod
    def from_file(
        cls, path: Path, source: bytes, name: str, number: int = 0, *, onnx: bool = False, **more: object
    ) -> Make:
        """Return the request for the object behind a file reference, with this process's folder and modules.

        Args:
            path: The user's file.
            source: The bytes of the file.
            name: An attribute of the file, or the layout of an ``onnx`` file.
            number: The number of the object in later calls.
            onnx: True for an ONNX file. The suffix does not decide, since it may be the suffix of a link.
            more: Further entries of the description, by name.

        """
        wanted = {"path": str(path), "name": name, "onnx": onnx, **more}
        wanted |= {"folder": os.getcwd(), "sys_path": sys.path}
        return cls(number, json.dumps(wanted).encode(), source)


class Drop(ProcessMessage, tag="drop"):
    """Forget the object with this number."""

    number: int


class Refused(ProcessMessage, tag="none"):
    """The file gives no such object.

    It has the expected and the actual thing, a hint for further reading, and the field.
    """

    expected: str
    got: str
    hint: str = ""
    field: str = ""


class Failed(ProcessMessage, tag="failed", forbid_unknown_fields=True):
    """The call failed, with the reason."""

    why: str


def decoder_of(messages: Any) -> msgspec.msgpack.Decoder[Any]:
    """Return the decoder of a union of messages; arrays in them are float64 and read-only."""
    return msgspec.msgpack.Decoder(messages, dec_hook=array_of)


def array_of(kind: type, value: object) -> Any:
    """Return the numbers of a message as a read-only float64 array; TypeError or ValueError without."""
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
