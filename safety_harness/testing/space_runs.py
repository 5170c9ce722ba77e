"""The claims of one space: the same draws for each, every draw simulated once for all of them."""

from __future__ import annotations

from dataclasses import dataclass

from hypothesis import given, seed

from safety_harness.admission.claims import property_of
from safety_harness.properties.answered import by_default
from safety_harness.properties.base import Evaluation
from safety_harness.scenario.model import Claim, Scenario, Verdict
from safety_harness.space.space import ScenarioSpace
from safety_harness.testing.asserting import SafetyViolation, aim, run_of, settle
from safety_harness.testing.drawing import drawn
from safety_harness.testing.kept import kept_for
from safety_harness.testing.session import Judgement, Run, TestRun, session
from safety_harness.testing.simulating import digest_of, simulate
from safety_harness.testing.watching import under_profile, watching
from safety_harness.trace.trace import Trace


@dataclass(frozen=True, eq=False)
class _Judged:
    run: Run
    evaluations: tuple[Evaluation, ...]  # in the order of the claims
    fallback: Evaluation | None  # that the avoider did not answer, where nobody expects it


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
        for file, scenario in kept_for(test.id):
            test.replayed.append(file)
            self._examine(scenario, number)

        def example(scenario: Scenario) -> None:
            __tracebackhide__ = True
            self._examine(scenario, number)

        drawing = given(scenario=self._strategy)(watching(example, test))
        if not session().derandomize:
            drawing = seed(session().seed)(drawing)
        drawing._hypothesis_internal_use_settings = under_profile()  # type: ignore[attr-defined]
        try:
            drawing()
        finally:
            shown = self._shown.get(self.claims[number].sentence)
            if shown is not None:
                test.show(*shown)

    def _examine(self, scenario: Scenario, number: int) -> None:
        __tracebackhide__ = True
        judged = self._judge(scenario)
        for claim, evaluation in zip(self.claims, judged.evaluations, strict=True):
            aim(evaluation, claim.expected)
        evaluation, expected = judged.evaluations[number], self.claims[number].expected
        if not settle(evaluation, judged.run, expected, None):
            raise SafetyViolation(evaluation, simulate(scenario), expected)
        if judged.fallback is not None and not settle(judged.fallback, judged.run, Verdict.HOLDS, None):
            raise SafetyViolation(judged.fallback, simulate(scenario), Verdict.HOLDS)

    def _judge(self, scenario: Scenario) -> _Judged:
        digest = digest_of(scenario)
        if digest not in self._judged:
            trace = simulate(scenario)
            run = run_of(trace)
            properties = [property_of(claim, trace.scenario) for claim in self.claims]
            evaluations = tuple(prop.evaluate(trace) for prop in properties)
            self._judged[digest] = _Judged(run, evaluations, by_default(trace))
            if session().report is not None:
                self._remember(run, evaluations, trace)
        return self._judged[digest]

    def _remember(self, run: Run, evaluations: tuple[Evaluation, ...], trace: Trace) -> None:
        """The worst run of each claim, for the report."""
        for claim, evaluation in zip(self.claims, evaluations, strict=True):
            judgement, before = Judgement(run, evaluation, claim.expected), self._shown.get(claim.sentence)
            if before is None or judgement.severity < before[0].severity:
                self._shown[claim.sentence] = judgement, trace
