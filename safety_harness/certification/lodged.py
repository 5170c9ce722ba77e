"""What is written down to be lodged elsewhere by its hash: declarations and seals."""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Self, TypeVar

from safety_harness.exceptions import InputError, OutputError, Place
from safety_harness.whole_file import write_whole


class Lodged(ABC):
    """One text for one content, and the hash of it."""

    @property
    @abstractmethod
    def as_json(self) -> str:
        """The text."""

    @property
    def sha256(self) -> str:
        """What is lodged."""
        return hashlib.sha256(self.as_json.encode()).hexdigest()

    @abstractmethod
    def changes(self, now: Self) -> Iterator[str]:
        """What is otherwise now, in words."""


L = TypeVar("L", bound=Lodged)


def write_once(made: L, file: Path, read: Callable[[Path], L], *, expected: str) -> L:
    """Write ``made``; InputError if ``file`` has something else, as ``read`` has it: it may be lodged."""
    if file.exists() and (there := read(file)) != made:
        raise InputError(
            place=Place(file=file),
            expected=expected,
            got="; ".join(there.changes(made)),
            hint="it may be lodged already: move it away to begin anew",
        )
    try:
        write_whole(file, made.as_json)
    except OSError as error:
        raise OutputError.of(file, error) from error
    return made
