"""Messages to the user about a user's file that a command executes, and about the file's output."""

from __future__ import annotations

import hashlib
import logging
import multiprocessing
from pathlib import Path

from safety_harness.base.exceptions import printable

MOST_LINES, MOST_CHARACTERS = 5, 200  # a command repeats at most so much of a file's output

executed: dict[tuple[Path, str], str] = {}  # executed files, each with its text for messages


def say_it_is_executed(path: Path, source: bytes, logger: logging.Logger) -> None:
    """Warn before this command executes a file for the first time.

    Worker processes print no warning.
    """
    key = path, hashlib.sha256(source).hexdigest()
    if key in executed:
        return
    here = Path.cwd()
    shown = printable(str(path.relative_to(here) if here in path.parents else path))
    executed[key] = f"{shown} (sha256 {key[1][:12]}), in a process of its own, as you"
    if multiprocessing.parent_process() is None:
        logger.warning("executes %s", executed[key])


class Heard:
    """A listener that logs the first lines of the output of the file ``name``.

    If ``silent`` is true, it logs no lines.
    """

    def __init__(self, name: str, logger: logging.Logger, *, silent: bool = False) -> None:
        self._name, self._logger = name, logger
        self._begun = b""
        self._lines = MOST_LINES + 1 if silent else 0

    def hear(self, written: bytes) -> None:
        """Log the next bytes of the output.

        Empty bytes mean that the output has ended.
        """
        if self._lines > MOST_LINES:
            return
        *lines, self._begun = (self._begun + written[:65_536]).split(b"\n")
        if len(self._begun) > MOST_CHARACTERS or (not written and self._begun):
            lines, self._begun = [*lines, self._begun], b""
        for line in lines:
            self._lines += 1
            if self._lines > MOST_LINES:
                self._logger.warning("%s wrote more lines, here omitted", self._name)
                return
            text = printable(line.decode(errors="replace")[:MOST_CHARACTERS])
            self._logger.warning("%s wrote: %s", self._name, text)
