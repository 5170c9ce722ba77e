"""Locks so that two processes do not compile the same function at the same time.

A process waits while another one compiles a function with the same types, and then reads its machine code.
The order of locks follows the calls between functions, which contain no cycle, so no two processes wait for
each other.
"""

from __future__ import annotations

import fcntl
import os
from contextlib import suppress
from hashlib import sha256
from pathlib import Path

_held: dict[Path, int] = {}  # the descriptors of this process, by lock file


def lock_file(folder: str, function: str, types: object) -> Path:
    """Return the path of the lock for a ``function`` with some argument ``types`` in a cache folder."""
    return Path(folder) / f"{function}-{sha256(str(types).encode()).hexdigest()[:16]}.lock"


def hold(file: Path, *, wait: bool = True) -> bool:
    """Take the lock, and return whether this process has it; a folder that cannot be written has none.

    Args:
        file: The lock.
        wait: Whether to wait until no other process holds it.

    """
    if file in _held:
        return True
    with suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(file, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BaseException:  # another process has it, the disk has no locks, or Ctrl-C ended the wait
            os.close(descriptor)
            raise
        _held[file] = descriptor
    return file in _held


def release(file: Path) -> None:
    """Release the lock, if this process holds it, and remove its file."""
    descriptor = _held.pop(file, None)
    if descriptor is not None:
        with suppress(OSError):
            file.unlink()
        os.close(descriptor)
