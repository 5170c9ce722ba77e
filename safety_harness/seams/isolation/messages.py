"""Messages between the harness and the process of a user's file.

The messages are MessagePack data in frames. They are never pickles, because a pickle could execute code. The
messages in this module are common to all kinds of objects. Each kind adds its own requests and answers
(``child.ServedKind``), such as ``Ask`` for an avoider and ``Act`` for a controller. Each side decodes only
the messages that its peer may send.
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
MOST_WORDS = 240  # characters of the reason for a failed call, as many as a trace keeps
MEMORY_BYTES = 4 << 30  # for the file's own data, without libraries and reserved addresses


def framed(message: bytes) -> bytes:
    """Return the message after a header that states its length."""
    return HEADER.pack(MAGIC, len(message)) + message


def length_of(header: bytes, most: int) -> int:
    """Return the message length that ``header`` states.

    Raise ValueError if it is above ``most`` or MAGIC is missing.
    """
    magic, length = HEADER.unpack(header)
    if magic != MAGIC or length > most:
        raise ValueError("no frame of ours")
    return int(length)


class ProcessMessage(Struct, tag_field="say"):
    """A message.

    The message calls a method of the user. Texts about failures state this method's name, which is ``call``.
    """

    call: ClassVar[str] = "make"


class Make(ProcessMessage, tag="make"):
    """A request to create an object.

    ``wanted`` describes the object in JSON, and ``source`` contains the bytes of the user's file.
    """

    number: int
    wanted: bytes
    source: bytes

    @classmethod
    def from_file(
        cls, path: Path, source: bytes, name: str, number: int = 0, *, onnx: bool = False, **more: object
    ) -> Make:
        """Return the request for the object to which a file reference refers.

        The request also states this process's working directory and its search path for modules.

        Args:
            path: The user's file.
            source: The bytes of the file.
            name: The name of an attribute of the file, or the layout of an ``onnx`` file.
            number: The number by which later calls refer to the object.
            onnx: Whether the file is an ONNX file. The suffix does not always show this, because the path may
                be a link.
            more: Further entries of the description, by name.

        """
        wanted = {"path": str(path), "name": name, "onnx": onnx, **more}
        wanted |= {"folder": os.getcwd(), "sys_path": sys.path}
        return cls(number, json.dumps(wanted).encode(), source)


class Drop(ProcessMessage, tag="drop"):
    """A request to forget the object with this number."""

    number: int


class Refused(ProcessMessage, tag="none"):
    """The answer that the file does not provide the requested object.

    The answer states the expected and the actual object, a hint on further reading, and the field.
    """

    expected: str
    got: str
    hint: str = ""
    field: str = ""


class Failed(ProcessMessage, tag="failed", forbid_unknown_fields=True):
    """The answer that a call failed, with the reason."""

    why: str


def decoder_of(messages: Any) -> msgspec.msgpack.Decoder[Any]:
    """Return the decoder for a union of messages.

    The decoder converts the messages' arrays to read-only float64 arrays.
    """
    return msgspec.msgpack.Decoder(messages, dec_hook=array_of)


def array_of(kind: type, value: object) -> Any:
    """Return the numbers in a message as a read-only float64 array.

    Raise TypeError or ValueError for other values.
    """
    array = np.array(value, dtype=np.float64)
    array.flags.writeable = False
    return array


def plain(value: object) -> object:
    """Return an array as a list of numbers, or an array of pixels as bytes.

    Raise TypeError for any other type.
    """
    if isinstance(value, np.ndarray):
        return value.tobytes() if value.dtype == np.uint8 else value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"no numbers, text or array of those: {type(value).__name__}")


packed = msgspec.msgpack.Encoder(enc_hook=plain).encode
