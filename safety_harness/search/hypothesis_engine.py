"""The thread in which Hypothesis' engine runs, for ``hypothesis_search``."""

from __future__ import annotations

from queue import SimpleQueue

import hypothesis
import numpy as np
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from safety_harness.search.cube import Column, Cube, Points
from safety_harness.seeds import Branch
from safety_harness.seeds import seed as leaf

_GRID = 10_000  # steps of a coordinate: Hypothesis climbs in whole numbers, not within 0 to 1
_EXAMPLES = 1000  # in one call of the engine, which goes for its targets after half of them; then anew


class _Over(BaseException):
    """Ends the thread: nothing that Hypothesis takes for a failing example."""


def engine(
    cube: Cube,
    seed: int,
    examples: SimpleQueue[Points | BaseException],
    scores: SimpleQueue[Points | None],
) -> None:
    """Call the engine again and again, each time with another seed, until there are no more scores."""
    point = st.tuples(*(_coordinate(column) for column in cube.columns))
    quiet = settings(
        max_examples=_EXAMPLES,
        phases=(Phase.generate, Phase.target),
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
    )

    def try_one(example: tuple[float, ...]) -> None:
        examples.put(np.array(example))
        told = scores.get()
        if told is None:
            raise _Over
        for claim, score in enumerate(told):
            if np.isfinite(score):
                hypothesis.target(-float(score), label=str(claim))

    try:
        for call in range(1_000_000):
            test = hypothesis.seed(leaf(seed, Branch.SEARCH, call))(quiet(given(point)(try_one)))
            test()
    except _Over:
        pass
    except BaseException as error:  # it belongs to whoever asks next
        examples.put(error)


def _coordinate(column: Column) -> st.SearchStrategy[float]:
    if column.flat:
        count = len(column.edges) - 1
        return st.sampled_from(column.middle_of(np.arange(count)).tolist())
    return st.integers(0, _GRID).map(lambda k: k / _GRID)
