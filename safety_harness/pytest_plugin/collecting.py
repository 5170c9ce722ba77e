"""Scenario files as tests: an item for each claim, one simulation for all the claims of a scenario."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from safety_harness.admission.claims import property_of
from safety_harness.exceptions import InputError
from safety_harness.pytest_plugin.plugin import TEST, explained
from safety_harness.scenario.expand import gather
from safety_harness.scenario.model import Claim, Scenario
from safety_harness.space.read import space_of
from safety_harness.testing.asserting import SafetyViolation, refuse_fallback, run_of, settle
from safety_harness.testing.simulating import as_asked, looker, simulate
from safety_harness.testing.space_runs import SpaceRuns

Nodes = Iterator[pytest.Item | pytest.Collector]


class ScenarioFile(pytest.File):
    """A scenario file, a matrix, a space or a suite."""

    def collect(self) -> Nodes:
        """An item a claim; where the file holds several scenarios, below a node for each.

        CollectError with every mistake of the file, each with its place.
        """
        scenarios, spaces = self._read()
        several = len(scenarios) + len(spaces) > 1
        for scenario in scenarios:
            yield from self._below(several, scenario.name, partial(_items, scenario=scenario))
        for runs in spaces:
            yield from self._below(several, runs.space.name, partial(_space_items, runs=runs))

    def _below(self, several: bool, name: str, items: Callable[[Any], Nodes]) -> Nodes:
        if not several:
            yield from items(self)
            return
        # pytest splits an id at its first bracket, so that a combination has none: "opposite, fast".
        own = name.removeprefix(self.path.stem) if name.startswith(f"{self.path.stem}[") else name
        plain = own.replace("[", " ").replace("]", "").strip()
        yield ScenarioNode.from_parent(self, name=plain, items=items)

    def _read(self) -> tuple[list[Scenario], list[SpaceRuns]]:
        """What the file holds, all of it looked at; CollectError with all that cannot be tried."""
        gathered = gather([self.path], spaces=True)
        errors, spaces = list(gathered.errors), []
        for scenario in gathered.scenarios:
            try:
                looker.look(as_asked(scenario))
            except InputError as error:
                errors.append(error)
        for variant, file in gathered.spaces:
            try:
                spaces.append(SpaceRuns(space_of(variant.tree, file, name=variant.name)))
            except InputError as error:
                errors.append(error)
        if errors:
            raise self.CollectError("\n".join(dict.fromkeys(explained(error) for error in errors)))
        return gathered.scenarios, spaces


class ScenarioNode(pytest.Collector):
    """One scenario or space of a file that holds several."""

    def __init__(self, *, items: Callable[[pytest.Collector], Nodes], **others: Any) -> None:
        super().__init__(**others)
        self._items = items

    def collect(self) -> Iterable[pytest.Item | pytest.Collector]:
        """Its claims."""
        return self._items(self)


def _items(parent: pytest.Collector, *, scenario: Scenario) -> Nodes:
    for claim in scenario.claims:
        yield ClaimItem.from_parent(parent, name=claim.sentence, scenario=scenario, claim=claim)


def _space_items(parent: pytest.Collector, *, runs: SpaceRuns) -> Nodes:
    for number, claim in enumerate(runs.claims):
        yield SpaceClaimItem.from_parent(parent, name=claim.sentence, runs=runs, number=number)


class ClaimItem(pytest.Item):
    """One claim of one scenario: passes if its verdict is the one that the file expects."""

    def __init__(self, *, scenario: Scenario, claim: Claim, **others: Any) -> None:
        super().__init__(**others)
        self.scenario = scenario
        self.claim = claim

    def runtest(self) -> None:
        """Simulate, unless another claim of the scenario has just done so, and judge."""
        trace = simulate(self.scenario)
        evaluation = property_of(self.claim, trace.scenario).evaluate(trace)
        if not settle(evaluation, run_of(trace), self.claim.expected, trace):
            raise SafetyViolation(evaluation, trace, self.claim.expected)
        refuse_fallback(trace)

    def reportinfo(self) -> tuple[Path, int, str]:
        """The claim's own line."""
        return _where(self, self.claim)


class SpaceClaimItem(pytest.Item):
    """One claim of a space: passes if no draw comes out otherwise than the file expects, and some decide."""

    def __init__(self, *, runs: SpaceRuns, number: int, **others: Any) -> None:
        super().__init__(**others)
        self._runs = runs
        self._number = number

    def runtest(self) -> None:
        """Draw, simulate, judge."""
        self._runs.check(self._number, self.stash[TEST])

    def reportinfo(self) -> tuple[Path, int, str]:
        """The claim's own line."""
        return _where(self, self._runs.claims[self._number])


def _where(item: pytest.Item, claim: Claim) -> tuple[Path, int, str]:
    return item.path, (claim.place.line or 1) - 1, item.name
