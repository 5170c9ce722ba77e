"""The search itself, on one page: ask, evaluate, tell, keep."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from safety_harness.exceptions import InadmissibleError, Place
from safety_harness.search.ask_tell import AskTell, Searcher
from safety_harness.search.cube import Cube
from safety_harness.search.findings import Evaluate, Findings, Goal

# Points of which not one could be tried; later, of which less than one in as many could.
MAX_REJECTION_RATIO = 200


def find_violations(
    cube: Cube,
    goals: Sequence[Goal],
    evaluate: Evaluate,
    searcher: Searcher,
    *,
    budget: int,
    batch: int = 1,
    on_progress: Callable[[Findings], None] | None = None,
    enough: Callable[[Findings], bool] | None = None,
) -> Findings:
    """Try ``budget`` points (those that admission refuses do not count), ``batch`` at a time.

    Ctrl-C ends it early, and what was found is kept.  InadmissibleError when next to no point can be
    tried.  ``on_progress`` sees the findings after each batch; ``enough`` may end the search.
    ValueError without goals, or for a budget or batch below 1.
    """
    if not goals or budget < 1 or batch < 1:
        raise ValueError("expected at least one goal, and a budget and a batch of at least 1")
    asking = AskTell(searcher, cube.dimension, len(goals))
    findings = Findings(tuple(goals), cube, searcher.name)
    scales = np.array([goal.scale for goal in goals])
    try:
        while findings.tried < budget and not (enough is not None and enough(findings)):
            points = asking.ask(min(batch, budget - findings.tried))
            outcomes = evaluate(points, findings.asked)
            asking.tell(outcomes.margins / scales, outcomes.cells)
            findings.add(points, outcomes)
            if on_progress is not None:
                on_progress(findings)
            _refuse_hopeless(findings)
    except KeyboardInterrupt:
        findings.interrupted = True
    return findings


def _refuse_hopeless(findings: Findings) -> None:
    if findings.asked < MAX_REJECTION_RATIO * (findings.tried + 1):
        return
    reason, count = findings.refused.most_common(1)[0]
    raise InadmissibleError(
        place=Place(field="space"),
        expected=f"a space of which at least one point in {MAX_REJECTION_RATIO} can be tried",
        got=f"{findings.tried} of {findings.asked} points",
        hint=f"{count} times it was {reason}",
    )
