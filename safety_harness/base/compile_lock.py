"""Locks that prevent two processes from compiling the same function at the same time.

If another process already compiles a function with the same argument types, a process waits and then loads
the machine code.  A process takes the locks in the order of the calls between functions.  This order has no
cycle, so a deadlock is impossible.  The waiting time is limited, because the other process may be suspended.
"""

from __future__ import annotations

import fcntl
import os
import time
from contextlib import suppress
from hashlib import sha256
from pathlib import Path

# A choice: after a minute, a process compiles the function itself and does not wait for a suspended process.
# Between two attempts it sleeps for 20 ms, which is little beside a compilation of seconds.
LONGEST_WAIT_S, EVERY_S = 60.0, 0.02

_held: dict[Path, int] = {}  # the descriptors of this process, by lock file


def lock_file(folder: str, function: str, types: object) -> Path:
    """Return the path of the lock file for a function with the given argument types, in the cache folder."""
    return Path(folder) / f"{function}-{sha256(str(types).encode()).hexdigest()[:16]}.lock"


def hold(file: Path, *, wait: bool = True) -> bool:
    """Try to acquire the lock, and return whether this process now has it.

    If the folder is not writable, there is no lock and the result is False.

    Args:
        file: The lock.
        wait: Whether to wait for at most ``LONGEST_WAIT_S`` if another process has the lock.

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
    """Lock an open file.

    Raise OSError if another process still has the lock when the monotonic clock reaches ``until_s``.
    """
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        except BlockingIOError:
            if time.monotonic() >= until_s:
                raise
            time.sleep(EVERY_S)


def _is_file(descriptor: int, file: Path) -> bool:
    """Return whether ``descriptor`` still refers to the file that exists at the path ``file``."""
    try:
        return os.path.samestat(os.fstat(descriptor), file.stat())
    except FileNotFoundError:
        return False


def release(file: Path) -> None:
    """If this process has the lock, release it and remove its file."""
    descriptor = _held.pop(file, None)
    if descriptor is not None:
        with suppress(OSError):
            file.unlink()
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_UN)  # a forked process may still have the file open
        os.close(descriptor)
