"""``assert_holds``: fail a test whose run violates a claim, with margin, moment, decision and command."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from math import isfinite
from pathlib import Path

from safety_harness.admission.avoiders import told_avoider
from safety_harness.admission.claims import property_of
from safety_harness.base.exceptions import (
    InadmissibleError,
    InputError,
    Place,
    SafetyHarnessError,
    refuse_other_type,
)
from safety_harness.claims.formulas.claim import FormulaClaim
from safety_harness.claims.formulas.formula import Formula
from safety_harness.claims.properties.against import ClaimDifference, RunDifference, VerdictChange
from safety_harness.claims.properties.answered import AvoiderAnswered, by_default
from safety_harness.claims.properties.base import Evaluation, Property, inconclusive, unreadable
from safety_harness.claims.properties.measured import columns_read_by
from safety_harness.claims.properties.tally import made_in
from safety_harness.report.words import tested_words
from safety_harness.scenario.model import Claim, Scenario, Verdict
from safety_harness.testing.failure_text import failure_text
from safety_harness.testing.session import Judgement, Run, session
from safety_harness.testing.simulating import digest_of, original, run_key, simulate
from safety_harness.trace.overruling import Overruling
from safety_harness.trace.trace import Trace

_WORSE = (VerdictChange.NEW, VerdictChange.DEEPER, VerdictChange.SILENT)
TRUTH = ("joint_position_rad", "joint_velocity_radps", "transform_tcp_to_base", "hand_position_in_base_m")


class SafetyViolation(SafetyHarnessError, AssertionError):
    """A claim has another verdict than the test requires; the text shows when and why."""

    __module__ = "safety_harness.testing"  # as one imports it, and as test summaries show it

    def __init__(self, evaluation: Evaluation, trace: Trace, expected: Verdict) -> None:
        super().__init__(evaluation, trace, expected)
        self.evaluation = evaluation
        self.trace = trace
        self.expected = expected
        self.test = session().test

    @property
    def scenario(self) -> Scenario:
        """The scenario of the test, before ``--avoider`` changes it."""
        return original(self.trace)

    def __str__(self) -> str:
        return failure_text(
            self.evaluation, self.trace, expected=self.expected, scenario=self.scenario, test=self.test
        )


class NotEstablished(SafetyHarnessError, AssertionError):
    """A test drew scenarios, and none of them exercised its claims."""


def assert_holds(claim: Formula | Property | str, trace: Trace) -> Evaluation:
    """Fail the test unless ``claim`` holds of ``trace``; returns the evaluation.

    Args:
        claim: A formula, a property, or a sentence as in a scenario file.
        trace: The run.

    Where Hypothesis draws the scenarios, an inconclusive run fails nothing (the hand never came near), but a
    test without any conclusive run fails.

    Raises:
        SafetyViolation: The claim is violated, or the run is inconclusive.  Or the avoider gave no answer,
            and the scenario does not claim that (``the avoider answered: violated``).
        InputError: The sentence is neither a claim of the catalogue nor a formula.

    """
    __tracebackhide__ = True
    try:
        refuse_other_type("assert_holds(trace)", trace, Trace, hint="simulate(scenario) makes one")
        prop = _property(claim, trace.scenario)
        evaluation = judged_of(prop, trace)
    except InputError as error:
        raise error.with_traceback(None) from None
    aim(evaluation, Verdict.HOLDS)
    require(evaluation, Verdict.HOLDS, trace, prop.evaluate)
    refuse_fallback(trace)
    return evaluation


def judged_of(prop: Property, trace: Trace) -> Evaluation:
    """Judge ``trace``; a property that does not name its columns is inconclusive unless all was measured."""
    if trace.known.whole or columns_read_by(prop) is not None:
        return prop.evaluate(trace)
    limited = tuple(name for name, one in trace.known.columns.items() if one.limited)
    why = f"the claim does not say what it reads, and not all was measured: {limited[0]}"
    why += f" and {len(limited) - 1} others" * (len(limited) > 1)
    return replace(inconclusive(prop, why), unmeasured=limited)


def refuse_fallback(trace: Trace) -> None:
    """Raise SafetyViolation if the avoider did not answer and the scenario does not expect that."""
    __tracebackhide__ = True
    evaluation = by_default(trace)
    if evaluation is not None:
        require(evaluation, Verdict.HOLDS, trace, AvoiderAnswered().evaluate)


def require(
    evaluation: Evaluation, expected: Verdict, trace: Trace, judge: Callable[[Trace], Evaluation]
) -> None:
    """Raise SafetyViolation if the running test has to fail for the evaluation that ``judge`` gives.

    A run that was not simulated is not compared with a reference, which cannot be run in its place.
    """
    __tracebackhide__ = True
    if trace.known.simulated:
        session().judged.add(run_key(trace))
    found = against_reference(trace, evaluation, judge) if trace.known.simulated else None
    if not settle(evaluation, run_of(trace), expected, trace) and not is_shared(found):
        raise violation_of(evaluation, trace, expected, found)


def violation_of(
    evaluation: Evaluation, trace: Trace, expected: Verdict, found: ClaimDifference | None
) -> SafetyViolation:
    """Return the violation, with a note on the reference's verdict if there is a reference."""
    violation = SafetyViolation(evaluation, trace, expected)
    if found is not None:
        violation.add_note(note_of(found))
    return violation


def run_of(trace: Trace) -> Run:
    """Return the facts that outlive a run's trace."""
    return Run(
        name=trace.scenario.name,
        tested=trace.system.words,
        seed=trace.scenario.seed,
        sound=trace.complete and unreadable(trace, TRUTH) is None and _is_measured(trace),
        world=made_in(trace),
        beside=tested_words(trace.scenario, trace.system),
    )


def _is_measured(trace: Trace) -> bool:
    return not trace.known.missing(TRUTH) and trace.known.first_gap(TRUTH) is None


def settle(evaluation: Evaluation, run: Run, expected: Verdict, trace: Trace | None) -> bool:
    """Count a judgement in the test that is running; False if the test has to fail for it."""
    test = session().test
    # A sound run may simply be no test of the claim; of one cut short or not finite that is not said.
    undecided = evaluation.verdict is Verdict.INCONCLUSIVE and run.sound
    good = evaluation.verdict is expected or (test is not None and test.draws and undecided)
    if test is None:
        return good
    if test.counts:
        test.note(Judgement(run, evaluation, expected), trace)
    if good or not (test.draws and isinstance(test.failure, SafetyViolation)):
        return good
    # while one failure is made smaller, that of another claim does not take its place
    return test.failure.evaluation.sentence != evaluation.sentence


def aim(evaluation: Evaluation, expected: Verdict) -> None:
    """Tell Hypothesis how near the run was to a failure, so that it looks for nearer ones."""
    margin = evaluation.margin
    if margin is None or not isfinite(margin) or expected is Verdict.INCONCLUSIVE:
        return
    if "hypothesis" not in sys.modules:
        return
    from hypothesis import currently_in_test_context, target
    from hypothesis.errors import InvalidArgument

    if currently_in_test_context():
        # A claim may be made of a second run in the same example, which cannot have a second target.
        with suppress(InvalidArgument):
            target(-margin if expected is Verdict.HOLDS else margin, label=evaluation.sentence)


def _property(claim: Formula | Property | str, scenario: Scenario) -> Property:
    if isinstance(claim, str):
        return property_of(Claim(sentence=claim, expected=Verdict.HOLDS, place=_caller()), scenario)
    if isinstance(claim, Formula):
        formula = FormulaClaim(claim)
        formula.check(scenario, _caller())
        return formula
    if not callable(getattr(claim, "evaluate", None)):
        expected = "a formula, a property or a sentence"
        raise InadmissibleError(place=_caller(), expected=expected, got=repr(claim))
    return claim


def _caller() -> Place:
    """Return the nearest line below that another file has."""
    frame = inspect.currentframe()
    while frame is not None and frame.f_code.co_filename == __file__:
        frame = frame.f_back
    if frame is None:
        return Place(field="assert_holds")
    return Place(file=Path(frame.f_code.co_filename), line=frame.f_lineno, field="assert_holds")


def against_reference(
    trace: Trace, mine: Evaluation, judge: Callable[[Trace], Evaluation]
) -> ClaimDifference | None:
    """Judge the same claim with the reference and note it for the summary; None without a reference."""
    if session().against is None:
        return None
    other = simulate.with_reference(trace)
    found = ClaimDifference(mine=mine, reference=judge(other))
    test = session().test
    if test is not None and test.counts:
        new = RunDifference(
            run=trace.scenario.name,
            claims=(),
            mine=Overruling.of([trace]),
            reference=Overruling.of([other]),
        )
        run = test.differences.setdefault(digest_of(trace.scenario), new)
        claims = (*run.claims, found)
        test.differences[digest_of(trace.scenario)] = replace(run, claims=claims)
    return found


def is_shared(found: ClaimDifference | None) -> bool:
    """Return whether the reference does no better; the running test is then skipped and does not fail."""
    test = session().test
    if found is None or test is None or found.change in _WORSE:
        return False
    test.shared.append(f"{found.mine.sentence}: {_words(found)}")
    return True


def note_of(found: ClaimDifference) -> str:
    """Return a note for a failure: the reference's verdict in the same scenario."""
    return f"{found.change.value}: {found.words(_name())}"


def _words(found: ClaimDifference) -> str:
    mine, other = found.mine, found.reference
    if mine.verdict is other.verdict:
        return (
            f"{other.verdict.value} with {_name()} too ({mine.margin_text()} against {other.margin_text()})"
        )
    return f"{mine.verdict.value}, and {other.verdict.value} with {_name()}"


def _name() -> str:
    return told_avoider(session().against or "")
