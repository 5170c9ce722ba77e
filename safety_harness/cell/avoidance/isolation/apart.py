"""Mark a context in which the avoiders of files get processes of their own.

This module imports nothing of the isolation, so that a run without such an avoider does not load it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

CONTEXTS: list[dict[str, Any]] = []  # the open contexts, each with what ``isolated`` keeps for it


@contextmanager
def processes_apart() -> Iterator[None]:
    """Start new processes for the avoiders that are created in this context.

    The new processes have no memory of earlier questions, and run silently.
    """
    CONTEXTS.append({})
    try:
        yield
    finally:
        CONTEXTS.pop()
