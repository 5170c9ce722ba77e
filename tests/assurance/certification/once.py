"""What reports ask of a run after it is made once in all tests: it follows from the run's scenario.

A small report is made and verified hundreds of times, and most of its seconds go into replays of the same
violations, for whose fault they are, and of the same runs in other worlds.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Hashable, Iterator, Sequence
from typing import Any

import pytest

from safety_harness.admission.admit import Admitted
from safety_harness.cell.simulation.worlds import WorldEntry
from safety_harness.extensions.assurance.certification import credibility, whose_fault
from safety_harness.extensions.attribution.search_attribution import SearchAttribution
from safety_harness.scenario.model import Claim, Scenario

_ATTRIBUTE, _EXPLAIN, _TRIAL = whose_fault.attribute, SearchAttribution.explain, credibility.run_trial
_known: dict[Hashable, Any] = {}


def _once(
    function: Callable[..., Any], scenario: Scenario, asked: Hashable, *args: Any, **options: Any
) -> Any:
    if b".py" in pickle.dumps(scenario):  # a user's program, which may answer otherwise the next time
        return function(*args, **options)
    key = (function, scenario, asked)
    if key not in _known:
        _known[key] = function(*args, **options)
    return _known[key]


@pytest.fixture(scope="module")
def replayed_once() -> Iterator[None]:
    def attributed(admitted: Admitted, claims: Sequence[Claim]) -> Any:
        return _once(_ATTRIBUTE, admitted.scenario, tuple(claims), admitted, claims)

    def explained(
        self: SearchAttribution, scenario: Scenario, claim: Claim, _: Any = None, *, confirms: bool = True
    ) -> Any:  # without the allowance, or an answer would depend on the tests before
        return _once(_EXPLAIN, scenario, (claim, confirms), self, scenario, claim, confirms=confirms)

    def tried(admitted: Admitted, *, world: WorldEntry) -> Any:
        return _once(_TRIAL, admitted.scenario, world.label, admitted, world=world)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(whose_fault, "attribute", attributed)
        patch.setattr(SearchAttribution, "explain", explained)
        patch.setattr(credibility, "run_trial", tried)
        yield
