"""Hypothesis as a searcher: its generation with ``target()``, turned inside out.

Hypothesis calls a test; a searcher is called.  So its engine runs in a thread of its own, which waits
whenever it wants to know what came of an example: one example at a time, and nothing runs at once.
"""

from __future__ import annotations

import threading
from collections.abc import Hashable, Sequence
from queue import SimpleQueue

from safety_harness.search.cube import Cube, Points, Scores


class HypothesisSearch:
    """Hypothesis' own generation; scores are its targets, one for each claim."""

    name = "hypothesis"

    def __init__(self, cube: Cube, *, claims: int, seed: int) -> None:
        self._cube, self._seed = cube, seed
        self._examples: SimpleQueue[Points | BaseException] = SimpleQueue()
        self._scores: SimpleQueue[Points | None] = SimpleQueue()
        self._thread: threading.Thread | None = None

    def propose(self, count: int) -> Points:
        """The one example that the engine is waiting for."""
        if self._thread is None:
            from safety_harness.search.hypothesis_engine import engine  # half a second, for those who search

            # Without a reference to this object, so that it can end the thread when it is given up.
            arguments = (self._cube, self._seed, self._examples, self._scores)
            self._thread = threading.Thread(target=engine, args=arguments, daemon=True)
            self._thread.start()
        example = self._examples.get()
        if isinstance(example, BaseException):
            raise example
        return example[None]

    def learn(self, points: Points, scores: Scores, cells: Sequence[Hashable]) -> None:
        """Let the engine go on."""
        self._scores.put(scores[0])

    def __del__(self) -> None:
        """End the engine's thread."""
        self._scores.put(None)
