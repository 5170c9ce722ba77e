"""Locks so that two processes do not compile the same function at the same time.

A process waits while another one compiles a function with the same types, and then reads its machine code.
The order of locks follows the calls between functions, which contain no cycle, so no two processes wait for
each other.  A wait has an end, because the other process may be suspended.
"""

from __future__ import annotations

import fcntl
import os
import time
from contextlib import suppress
from hashlib import sha256
from pathlib import Path

LONGEST_WAIT_S, EVERY_S = 60.0, 0.02

_held: dict[Path, int] = {}  # the descriptors of this process, by lock file


def lock_file(folder: str, function: str, types: object) -> Path:
    """Return the path of the lock for a ``function`` with some argument ``types`` in a cache folder."""
    return Path(folder) / f"{function}-{sha256(str(types).encode()).hexdigest()[:16]}.lock"


def hold(file: Path, *, wait: bool = True) -> bool:
    """Take the lock, and return whether this process has it; a folder that cannot be written has none.

    Args:
        file: The lock.
        wait: Whether to wait, for at most ``LONGEST_WAIT_S``, until no other process holds it.

    """
    until_s = time.monotonic() + (LONGEST_WAIT_S if wait else 0.0)
    with suppress(OSError):  # another process has it, or the disk has no locks
        file.parent.mkdir(parents=True, exist_ok=True)
        while file not in _held:
            descriptor = os.open(file, os.O_RDWR | os.O_CREAT, 0o666)
            try:
                _lock(descriptor, until_s)
                if _is_file(descriptor, file):  # else its last holder has removed it
                    _held[file] = descriptor
            finally:
                if _held.get(file) != descriptor:
                    os.close(descriptor)
    return file in _held


def _lock(descriptor: int, until_s: float) -> None:
    """Lock an open file; raise OSError if another process holds it until ``until_s`` of the clock."""
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        except BlockingIOError:
            if time.monotonic() >= until_s:
                raise
            time.sleep(EVERY_S)


def _is_file(descriptor: int, file: Path) -> bool:
    """Return whether ``file`` exists and is the one that is open."""
    try:
        return os.path.samestat(os.fstat(descriptor), file.stat())
    except FileNotFoundError:
        return False


def release(file: Path) -> None:
    """Release the lock, if this process holds it, and remove its file."""
    descriptor = _held.pop(file, None)
    if descriptor is not None:
        with suppress(OSError):
            file.unlink()
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_UN)  # a forked process may still have the file open
        os.close(descriptor)
