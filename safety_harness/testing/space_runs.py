"""The claims of one space: the same draws for each, every draw simulated once for all of them."""

from __future__ import annotations

from dataclasses import dataclass

from hypothesis import given, seed, settings

from safety_harness.admission.claims import property_of
from safety_harness.properties.base import Evaluation
from safety_harness.scenario.model import Claim, Scenario
from safety_harness.space.space import ScenarioSpace
from safety_harness.testing.asserting import SafetyViolation, aim, run_of, settle
from safety_harness.testing.drawing import drawn
from safety_harness.testing.kept import kept_for
from safety_harness.testing.session import Run, TestRun, session
from safety_harness.testing.simulating import digest_of, simulate
from safety_harness.testing.watching import under_profile, watching
from safety_harness.trace.trace import Trace


@dataclass(frozen=True, eq=False)
class _Judged:
    run: Run
    evaluations: tuple[Evaluation, ...]  # in the order of the claims


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
        self._worst: dict[str, tuple[float, Trace]] = {}

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
        drawing._hypothesis_internal_use_settings = under_profile(settings.default)  # type: ignore[attr-defined]
        drawing()
        sentence = self.claims[number].sentence
        if sentence in self._worst:
            test.traces[sentence] = self._worst[sentence][1]

    def _examine(self, scenario: Scenario, number: int) -> None:
        __tracebackhide__ = True
        judged = self._judge(scenario)
        for claim, evaluation in zip(self.claims, judged.evaluations, strict=True):
            aim(evaluation, claim.expected)
        evaluation, expected = judged.evaluations[number], self.claims[number].expected
        if not settle(evaluation, judged.run, expected, None):
            raise SafetyViolation(evaluation, simulate(scenario), expected)

    def _judge(self, scenario: Scenario) -> _Judged:
        digest = digest_of(scenario)
        if digest not in self._judged:
            trace = simulate(scenario)
            properties = [property_of(claim, trace.scenario) for claim in self.claims]
            evaluations = tuple(prop.evaluate(trace) for prop in properties)
            self._judged[digest] = _Judged(run_of(trace), evaluations)
            self._remember(trace, evaluations)
        return self._judged[digest]

    def _remember(self, trace: Trace, evaluations: tuple[Evaluation, ...]) -> None:
        """The worst run of each claim, if there will be a report."""
        if not session().keep_traces:
            return
        for claim, evaluation in zip(self.claims, evaluations, strict=True):
            margin = evaluation.margin
            before = self._worst.get(claim.sentence)
            if before is None or (margin is not None and margin < before[0]):
                self._worst[claim.sentence] = (float("inf") if margin is None else margin, trace)
