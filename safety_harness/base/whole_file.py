"""Write files so that a file is either complete or absent, and compute the hash of a file."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from safety_harness.base.exceptions import OutputError


def sha256_of(file: Path) -> str:
    """Return the SHA-256 of a file's bytes.

    The file is read in pieces.  Raise OSError if it cannot be read.
    """
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside ``path``, to which the caller writes.

    At the end of the block, the new file replaces ``path``.  The old file remains until the new file is
    completely on disk.  If the block raises an exception, the old file remains and the new file is removed.
    Missing folders are created.  Raises OSError.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.unlink(missing_ok=True)  # left by an earlier process with our process number
        yield part
        with part.open("rb") as file:
            os.fsync(file.fileno())  # the contents must be on the disk before the renaming
        os.replace(part, path)
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def write_whole(path: Path, text: str) -> None:
    """Write ``text`` to ``path`` in UTF-8, either completely or not at all.  Raises OSError."""
    with (
        replacing(path) as part,
        part.open("w", encoding="utf-8", errors="backslashreplace", newline="\n") as file,
    ):
        file.write(text)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Raise OutputError for ``path`` if the code in the block raises OSError."""
    try:
        yield
    except OSError as error:
        raise OutputError.from_os_error(path, error) from error


def write_text(path: Path, text: str) -> None:
    """Write ``text`` to ``path`` as ``write_whole`` does, but raise OutputError if writing fails."""
    with writing(path):
        write_whole(path, text)
