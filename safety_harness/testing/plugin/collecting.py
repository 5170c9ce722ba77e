"""Turn scenario files into tests: one test item for each claim, and one simulation for each scenario.

The claims of a space judge the same draws, so the plug-in simulates every draw only once.
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
from safety_harness.admission.taking import Incompatible, accept, made_equal
from safety_harness.base.exceptions import InputError, SafetyHarnessError
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
from safety_harness.testing.simulating import avoiders_asked, checker, digest_of, simulate
from safety_harness.testing.watching import kept_for, under_profile, watching
from safety_harness.trace.trace import Trace

Claims = tuple[Claim, ...]
Nodes = Iterator[pytest.Item | pytest.Collector]


class ScenarioFile(pytest.File):
    """The pytest node of a scenario file, a matrix, a space or a suite."""

    def collect(self) -> Nodes:
        """Yield a test item for each claim; in a file with several scenarios, yield a node for each scenario.

        Raises:
            CollectError: the file has mistakes; the error lists each with its place.

        """
        scenarios, spaces, refused = self._read()
        several = len(scenarios) + len(spaces) + len(refused) > 1
        for skip, claims in refused:
            yield from self._below(several, skip.scenario, partial(_skipped_items, claims=claims, why=skip))
        for scenario in scenarios:
            yield from self._below(several, scenario.name, partial(_items, scenario=scenario))
        for runs in spaces:
            yield from self._below(several, runs.space.name, partial(_space_items, runs=runs))

    def _below(self, several: bool, name: str, items: Callable[[Any], Nodes]) -> Nodes:
        if not several:
            yield from items(self)
            return
        # pytest splits an id at its first bracket, so the name of a combination has none: "opposite, fast".
        own = name.removeprefix(self.path.stem) if name.startswith(f"{self.path.stem}[") else name
        plain = own.replace("[", " ").replace("]", "").strip()
        yield ScenarioNode.from_parent(self, name=plain, items=items)

    def _read(self) -> tuple[list[Scenario], list[SpaceRuns], list[tuple[Incompatible, Claims]]]:
        """Return the admissible scenarios, the spaces, and the scenarios that an avoider cannot take.

        The third list contains each scenario that an avoider given on the command line cannot take, with the
        scenario's claims.

        Raises:
            CollectError: some scenarios are inadmissible; the error lists all their mistakes.

        """
        gathered = gather([self.path], spaces=True)
        errors, scenarios, spaces = list(gathered.errors), [], []
        refused: list[tuple[Incompatible, Claims]] = []
        equal = made_equal(gathered.scenarios, *avoiders_asked()[0])
        for scenario in gathered.scenarios:
            try:
                outcome = equal.get(scenario.name) or accept(scenario, avoiders_asked(), checker.check)
            except InputError as error:
                errors.append(error)
                continue
            if isinstance(outcome, Incompatible):
                refused.append((outcome, scenario.claims))
            else:
                scenarios.append(scenario)
        for variant, file in gathered.spaces:
            try:
                space = space_of(variant.tree, file, name=variant.name)
                outcome = accept(first_of(space), avoiders_asked(), checker.check)
                if isinstance(outcome, Incompatible):
                    refused.append((replace(outcome, scenario=space.name), space.simplest.claims))
                else:
                    spaces.append(SpaceRuns(space))
            except InputError as error:
                errors.append(error)
        if errors:
            raise self.CollectError("\n".join(dict.fromkeys(explained(error) for error in errors)))
        return scenarios, spaces, refused


class LogFile(pytest.File):
    """The pytest node of a cell's log, which the harness judges without a simulation."""

    def collect(self) -> Nodes:
        """Yield a test item for each claim of the log.

        Raise CollectError if the log is unusable or has no claims.
        """
        try:
            recorded = recorded_run(self.path)
        except InputError as error:
            raise self.CollectError(explained(error)) from None
        session().recordings.update(recorded.recordings)
        scenario = recorded.trace.scenario
        if not scenario.claims:
            raise self.CollectError(f'{self.path}: expected the key "claims"; got a log that claims nothing')
        for claim in scenario.claims:
            check = partial(_judge_log, recorded.trace, claim)
            item = ClaimItem.from_parent(self, name=claim.sentence, claim=claim, check=check)
            item.user_properties += [("note", note) for note in recorded.notes]
            yield item


class ScenarioNode(pytest.Collector):
    """The pytest node of one scenario or space, for a file that contains several."""

    def __init__(self, *, items: Callable[[pytest.Collector], Nodes], **options: Any) -> None:
        super().__init__(**options)
        self._items = items

    def collect(self) -> Iterable[pytest.Item | pytest.Collector]:
        """Return the test items of the scenario's or space's claims."""
        return self._items(self)


class FileItem(pytest.Item):
    """The test item of one claim of a file; the function ``check`` judges the claim."""

    def __init__(self, *, claim: Claim, check: Callable[[TestRun], None], **options: Any) -> None:
        super().__init__(**options)
        self.claim, self._check = claim, check

    def runtest(self) -> None:
        """Judge the claim.

        The scenario is simulated first, unless the test of another claim has just simulated it.
        """
        self._check(self.stash[TEST])

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], style: Any = None) -> Any:
        """Return a mistake or a violation as text.

        The text omits pytest's frames, because formatting them takes a second.
        """
        error = excinfo.value
        return (
            explained(error)
            if isinstance(error, SafetyHarnessError)
            else super().repr_failure(excinfo, style)
        )

    def reportinfo(self) -> tuple[Path, int, str]:
        """Return the file, the line of the claim (counted from 0) and the name of the test."""
        return self.path, (self.claim.place.line or 1) - 1, self.name


class ClaimItem(FileItem):
    """The test item of one claim of one scenario, which passes if the verdict is the expected one."""


class SpaceClaimItem(FileItem):
    """The test item of one claim of a space.

    It passes if no draw contradicts the file and at least some draws decide the claim.
    """


def _items(parent: pytest.Collector, *, scenario: Scenario) -> Nodes:
    for claim in scenario.claims:
        check = partial(_judge, scenario, claim)
        yield ClaimItem.from_parent(parent, name=claim.sentence, claim=claim, check=check)


def _skipped_items(parent: pytest.Collector, *, claims: Claims, why: Incompatible) -> Nodes:
    for claim in claims:
        yield FileItem.from_parent(parent, name=claim.sentence, claim=claim, check=partial(_skip, why))


def _skip(why: Incompatible, test: TestRun) -> None:
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
    """Record that ``--avoider`` causes a violation that the file expects of another avoider, its own."""
    if session().avoider is not None and claim.is_loosely(evaluation.verdict):
        test.of_another.append(f"{scenario.name.partition('#')[0]}: {claim.sentence}")


def _skip_inapplicable(evaluations: Iterable[Evaluation]) -> None:
    """Skip the test if the claim does not apply to the controller under test."""
    every = list(evaluations)
    if every and not any(evaluation.applicable for evaluation in every):
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
    fallback: Evaluation | None  # the violation that the avoider did not answer, unless it is expected
    differences: tuple[ClaimDifference | None, ...]  # from a reference: for each claim, then for the fallback


class SpaceRuns:
    """A space, and the judgements of its draws so far.

    The tests of all claims use the same seed for their draws, and each test is guided by the margins of all
    claims. All tests therefore see the same scenarios until one of them fails.

    Raises:
        InputError: admission refuses the space.

    """

    def __init__(self, space: ScenarioSpace) -> None:
        self.space = space
        self.claims: tuple[Claim, ...] = space.simplest.claims
        self._strategy = drawn(space)
        self._judged: dict[str, _Judged] = {}
        self._shown: dict[str, tuple[Judgement, Trace]] = {}

    def check(self, number: int, test: TestRun) -> None:
        """Draw scenarios and judge claim ``number`` in each.

        Raise SafetyViolation with the smallest failing scenario.
        """
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
            _skip_inapplicable(judged.evaluations[number] for judged in self._judged.values())
        finally:
            shown = self._shown.get(self.claims[number].sentence)
            if shown is not None:
                test.show(*shown)

    def _examine(self, scenario: Scenario, number: int, test: TestRun) -> None:
        __tracebackhide__ = True
        judged = self._judge(scenario)
        # The margins of all claims guide the drawing, so that the tests of all claims see the same scenarios.
        for claim, evaluation in zip(self.claims, judged.evaluations, strict=True):
            aim(evaluation, claim.expected)
        evaluation, expected = judged.evaluations[number], self.claims[number].expected
        difference = judged.differences[number]
        if not settle(evaluation, judged.run, expected, None) and not is_shared(difference):
            raise violation_of(evaluation, simulate(scenario), expected, difference)
        _note_of_another(self.claims[number], evaluation, scenario, test)
        difference, fallback = judged.differences[-1], judged.fallback
        if fallback is None or settle(fallback, judged.run, Verdict.HOLDS, None) or is_shared(difference):
            return
        raise violation_of(fallback, simulate(scenario), Verdict.HOLDS, difference)

    def _judge(self, scenario: Scenario) -> _Judged:
        digest = digest_of(scenario)
        if digest not in self._judged:
            trace = simulate(scenario)
            run = run_of(trace)
            properties = [property_of(claim, trace.scenario) for claim in self.claims]
            evaluations = tuple(prop.evaluate(trace) for prop in properties)
            fallback = by_default(trace)
            judges = [(judge, prop.evaluate) for judge, prop in zip(evaluations, properties, strict=True)]
            differences = [against_reference(trace, *judge) for judge in judges]
            answered = AvoiderAnswered().evaluate
            differences.append(None if fallback is None else against_reference(trace, fallback, answered))
            self._judged[digest] = _Judged(run, evaluations, fallback, tuple(differences))
            # Without a report, the traces need not stay in memory.
            if session().report is not None:
                self._remember(run, evaluations, trace)
        return self._judged[digest]

    def _remember(self, run: Run, evaluations: tuple[Evaluation, ...], trace: Trace) -> None:
        """Keep the worst run of each claim for the report."""
        for claim, evaluation in zip(self.claims, evaluations, strict=True):
            judgement, worst = Judgement(run, evaluation, claim.expected), self._shown.get(claim.sentence)
            if worst is None or judgement.severity < worst[0].severity:
                self._shown[claim.sentence] = judgement, trace
