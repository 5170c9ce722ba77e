"""Import PyBullet, and suppress the lines that its C code prints."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def quiet(descriptor: int) -> Iterator[None]:
    """Discard the output of C code on file descriptor 1 or 2 within the block."""
    stream = sys.stdout if descriptor == 1 else sys.stderr
    if stream is not None:
        stream.flush()
    try:
        kept = os.dup(descriptor)
    except OSError:  # the process has no such stream
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, descriptor)
        yield
    finally:
        os.dup2(kept, descriptor)
        os.close(kept)
        os.close(nowhere)


with quiet(2):  # a line with the build time
    import pybullet

__all__ = ["pybullet", "quiet"]
