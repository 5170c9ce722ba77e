"""Import PyBullet without its greeting, the build time that its C code prints on standard error."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def _quiet_standard_error() -> Iterator[None]:
    """Discard the output of C code to file descriptor 2 within the block."""
    sys.stderr.flush()
    kept = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


with _quiet_standard_error():
    import pybullet

__all__ = ["pybullet"]
