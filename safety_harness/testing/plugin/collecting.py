"""Scenario files as tests: an item for each claim, one simulation for all the claims of a scenario.

The claims of a space see the same draws, and every draw is simulated once for all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, seed

from safety_harness.admission.claims import property_of
from safety_harness.admission.taking import NotTaken, made_equal, taken
from safety_harness.base.exceptions import InputError
from safety_harness.claims.properties.against import ClaimDifference
from safety_harness.claims.properties.answered import AvoiderAnswered, by_default
from safety_harness.claims.properties.base import Evaluation
from safety_harness.claims.signals.true_motion import refuse_contradictions
from safety_harness.scenario.expand import gather
from safety_harness.scenario.kinds import recorded_run
from safety_harness.scenario.model import Claim, Scenario, Verdict
from safety_harness.space.read import space_of
from safety_harness.space.space import ScenarioSpace
from safety_harness.testing.asserting import (
    against_reference,
    aim,
    is_shared,
    refuse_fallback,
    require,
    run_of,
    settle,
    violation_of,
)
from safety_harness.testing.drawing import drawn, first_of, one_system
from safety_harness.testing.plugin.explained import TEST, explained
from safety_harness.testing.session import Judgement, Run, TestRun, session
from safety_harness.testing.simulating import avoiders_asked, digest_of, looker, simulate
from safety_harness.testing.watching import kept_for, under_profile, watching
from safety_harness.trace.trace import Trace

Claims = tuple[Claim, ...]
Nodes = Iterator[pytest.Item | pytest.Collector]


class ScenarioFile(pytest.File):
    """A scenario file, a matrix, a space or a suite."""

    def collect(self) -> Nodes:
        """An item a claim; where the file holds several scenarios, below a node for each.

        CollectError with the mistakes of the file, each with its place.
        """
        scenarios, spaces, refused = self._read()
        several = len(scenarios) + len(spaces) + len(refused) > 1
        for one, claims in refused:
            yield from self._below(several, one.scenario, partial(_skipped_items, claims=claims, why=one))
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

    def _read(self) -> tuple[list[Scenario], list[SpaceRuns], list[tuple[NotTaken, Claims]]]:
        """What the file holds, all of it looked at; CollectError with all that cannot be tried.

        Last what an avoider of the command line cannot take, with its claims.
        """
        gathered = gather([self.path], spaces=True)
        errors, scenarios, spaces = list(gathered.errors), [], []
        refused: list[tuple[NotTaken, Claims]] = []
        equal = made_equal(gathered.scenarios, *avoiders_asked()[0])
        for scenario in gathered.scenarios:
            try:
                found = equal.get(scenario.name) or taken(scenario, avoiders_asked(), looker.look)
            except InputError as error:
                errors.append(error)
                continue
            if isinstance(found, NotTaken):
                refused.append((found, scenario.claims))
            else:
                scenarios.append(scenario)
        for variant, file in gathered.spaces:
            try:
                space = space_of(variant.tree, file, name=variant.name)
                found = taken(first_of(space), avoiders_asked(), looker.look)
                if isinstance(found, NotTaken):
                    refused.append((replace(found, scenario=space.name), space.simplest.claims))
                else:
                    spaces.append(SpaceRuns(space))
            except InputError as error:
                errors.append(error)
        if errors:
            raise self.CollectError("\n".join(dict.fromkeys(explained(error) for error in errors)))
        return scenarios, spaces, refused


class LogFile(pytest.File):
    """The log of a cell, judged without simulating."""

    def collect(self) -> Nodes:
        """An item a claim; CollectError for a log that cannot be used, or that claims nothing."""
        try:
            found = recorded_run(self.path)
        except InputError as error:
            raise self.CollectError(explained(error)) from None
        session().recordings.update(found.recordings)
        scenario = found.trace.scenario
        if not scenario.claims:
            raise self.CollectError(f'{self.path}: expected the key "claims"; got a log that claims nothing')
        for claim in scenario.claims:
            check = partial(_judge_log, found.trace, claim)
            item = ClaimItem.from_parent(self, name=claim.sentence, claim=claim, check=check)
            item.user_properties += [("note", note) for note in found.notes]
            yield item


class ScenarioNode(pytest.Collector):
    """One scenario or space of a file that holds several."""

    def __init__(self, *, items: Callable[[pytest.Collector], Nodes], **others: Any) -> None:
        super().__init__(**others)
        self._items = items

    def collect(self) -> Iterable[pytest.Item | pytest.Collector]:
        """Its claims."""
        return self._items(self)


class FileItem(pytest.Item):
    """One claim of a file, which ``check`` judges."""

    def __init__(self, *, claim: Claim, check: Callable[[TestRun], None], **others: Any) -> None:
        super().__init__(**others)
        self.claim, self._check = claim, check

    def runtest(self) -> None:
        """Simulate, unless another claim has just done so, and judge."""
        self._check(self.stash[TEST])

    def reportinfo(self) -> tuple[Path, int, str]:
        """The claim's own line."""
        return self.path, (self.claim.place.line or 1) - 1, self.name


class ClaimItem(FileItem):
    """One claim of one scenario: passes if its verdict is the one that the file expects."""


class SpaceClaimItem(FileItem):
    """One claim of a space: passes if no draw comes out otherwise than the file expects, and some decide."""


def _items(parent: pytest.Collector, *, scenario: Scenario) -> Nodes:
    for claim in scenario.claims:
        check = partial(_judge, scenario, claim)
        yield ClaimItem.from_parent(parent, name=claim.sentence, claim=claim, check=check)


def _skipped_items(parent: pytest.Collector, *, claims: Claims, why: NotTaken) -> Nodes:
    for claim in claims:
        yield FileItem.from_parent(parent, name=claim.sentence, claim=claim, check=partial(_skip, why))


def _skip(why: NotTaken, test: TestRun) -> None:
    test.not_taken = why.avoider
    pytest.skip(str(why))


def _space_items(parent: pytest.Collector, *, runs: SpaceRuns) -> Nodes:
    for number, claim in enumerate(runs.claims):
        check = partial(runs.check, number)
        yield SpaceClaimItem.from_parent(parent, name=claim.sentence, claim=claim, check=check)


def _judge(scenario: Scenario, claim: Claim, test: TestRun) -> None:
    trace = simulate(scenario)
    prop = property_of(claim, trace.scenario)
    evaluation = prop.evaluate(trace)
    _skip_inapplicable([evaluation])
    require(evaluation, claim.given(evaluation.margin), trace, prop.evaluate)
    _note_of_another(claim, evaluation, scenario, test)
    refuse_fallback(trace)


def _note_of_another(claim: Claim, evaluation: Evaluation, scenario: Scenario, test: TestRun) -> None:
    """Note a violation that the file expects of its own avoider, where ``--avoider`` stands in its place."""
    if session().avoider is not None and claim.is_loosely(evaluation.verdict):
        test.of_another.append(f"{scenario.name.partition('#')[0]}: {claim.sentence}")


def _skip_inapplicable(evaluations: Iterable[Evaluation]) -> None:
    """Of a claim about what the controller under test does not have or say, there is nothing to test."""
    every = list(evaluations)
    if every and not any(one.applicable for one in every):
        pytest.skip(f"not applicable to the controller: {every[0].reason}")


def _judge_log(trace: Trace, claim: Claim, _: TestRun) -> None:
    prop = property_of(claim, trace.scenario)
    refuse_contradictions(trace, trace.scenario.file)
    evaluation = prop.evaluate(trace)
    require(evaluation, claim.given(evaluation.margin), trace, prop.evaluate)


@dataclass(frozen=True, eq=False)
class _Judged:
    run: Run
    evaluations: tuple[Evaluation, ...]  # in the order of the claims
    fallback: Evaluation | None  # that the avoider did not answer, where nobody expects it
    differences: tuple[ClaimDifference | None, ...]  # of the claims, then of the fallback, from a reference


class SpaceRuns:
    """A space and what came of its draws.

    Each claim's test draws by the same seed and is led by the margins of all claims, so that they all see
    the same scenarios until one of them fails.  InputError for a space that cannot be tried.
    """

    def __init__(self, space: ScenarioSpace) -> None:
        self.space = space
        self.claims: tuple[Claim, ...] = space.simplest.claims
        self._strategy = drawn(space)
        self._judged: dict[str, _Judged] = {}
        self._shown: dict[str, tuple[Judgement, Trace]] = {}

    def check(self, number: int, test: TestRun) -> None:
        """Draw scenarios and judge claim ``number`` of them; SafetyViolation with the smallest that fails."""
        __tracebackhide__ = True
        for scenario in kept_for(test, one_system(self.space)):
            self._examine(scenario, number, test)

        def example(scenario: Scenario) -> None:
            __tracebackhide__ = True
            self._examine(scenario, number, test)

        drawing = given(scenario=self._strategy)(watching(example, test))
        if not session().derandomize:
            drawing = seed(session().seed)(drawing)
        drawing._hypothesis_internal_use_settings = under_profile()  # type: ignore[attr-defined]
        try:
            drawing()
            _skip_inapplicable(one.evaluations[number] for one in self._judged.values())
        finally:
            shown = self._shown.get(self.claims[number].sentence)
            if shown is not None:
                test.show(*shown)

    def _examine(self, scenario: Scenario, number: int, test: TestRun) -> None:
        __tracebackhide__ = True
        judged = self._judge(scenario)
        for claim, evaluation in zip(self.claims, judged.evaluations, strict=True):
            aim(evaluation, claim.expected)
        evaluation, expected = judged.evaluations[number], self.claims[number].expected
        found = judged.differences[number]
        if not settle(evaluation, judged.run, expected, None) and not is_shared(found):
            raise violation_of(evaluation, simulate(scenario), expected, found)
        _note_of_another(self.claims[number], evaluation, scenario, test)
        found, fallback = judged.differences[-1], judged.fallback
        if fallback is None or settle(fallback, judged.run, Verdict.HOLDS, None) or is_shared(found):
            return
        raise violation_of(fallback, simulate(scenario), Verdict.HOLDS, found)

    def _judge(self, scenario: Scenario) -> _Judged:
        digest = digest_of(scenario)
        if digest not in self._judged:
            trace = simulate(scenario)
            run = run_of(trace)
            properties = [property_of(claim, trace.scenario) for claim in self.claims]
            evaluations = tuple(prop.evaluate(trace) for prop in properties)
            fallback = by_default(trace)
            judges = [(one, prop.evaluate) for one, prop in zip(evaluations, properties, strict=True)]
            differences = [against_reference(trace, *one) for one in judges]
            answered = AvoiderAnswered().evaluate
            differences.append(None if fallback is None else against_reference(trace, fallback, answered))
            self._judged[digest] = _Judged(run, evaluations, fallback, tuple(differences))
            if session().report is not None:
                self._remember(run, evaluations, trace)
        return self._judged[digest]

    def _remember(self, run: Run, evaluations: tuple[Evaluation, ...], trace: Trace) -> None:
        """The worst run of each claim, for the report."""
        for claim, evaluation in zip(self.claims, evaluations, strict=True):
            judgement, before = Judgement(run, evaluation, claim.expected), self._shown.get(claim.sentence)
            if before is None or judgement.severity < before[0].severity:
                self._shown[claim.sentence] = judgement, trace
