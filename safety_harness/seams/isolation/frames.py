"""A message in a frame: behind a header that tells its length."""

from __future__ import annotations

import struct

HEADER = struct.Struct("<4sI")  # MAGIC, bytes of the message
MAGIC = b"AVO2"
MEMORY_BYTES = 4 << 30  # of the file's own data; libraries and reserved addresses do not count


def framed(message: bytes) -> bytes:
    """The frame."""
    return HEADER.pack(MAGIC, len(message)) + message


def length_of(header: bytes, most: int) -> int:
    """How long the message is, which is at most ``most`` bytes; ValueError otherwise."""
    magic, length = HEADER.unpack(header)
    if magic != MAGIC or length > most:
        raise ValueError("no frame of ours")
    return int(length)
