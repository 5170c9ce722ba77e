"""Provide ``assert_holds``, which fails a test with a full explanation unless a claim holds in a run."""

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
    """The error for a claim with the wrong verdict.

    Its text states the time, the reason and a command that repeats the run.
    """

    __module__ = "safety_harness.testing"  # the module from which users import it, for test summaries

    def __init__(self, evaluation: Evaluation, trace: Trace, expected: Verdict) -> None:
        super().__init__(evaluation, trace, expected)
        self.evaluation = evaluation
        self.trace = trace
        self.expected = expected
        self.test = session().test

    @property
    def scenario(self) -> Scenario:
        """Return the scenario as the test requested it, before ``--avoider`` replaced its avoider."""
        return original(self.trace)

    def __str__(self) -> str:
        return failure_text(
            self.evaluation, self.trace, expected=self.expected, scenario=self.scenario, test=self.test
        )


class NotEstablished(SafetyHarnessError, AssertionError):
    """The error for a test that drew scenarios, if no run tested the test's claims."""


def assert_holds(claim: Formula | Property | str, trace: Trace) -> Evaluation:
    """Fail the test unless the claim ``claim`` holds in ``trace``.

    Under Hypothesis, an inconclusive run does not fail the test. For example, a run is inconclusive if the
    hand never came near. After the last run, the test fails if every run was inconclusive.

    Args:
        claim: a formula, a property, or a sentence as in a scenario file.
        trace: the run to judge, as ``simulate(scenario)`` returns it.

    Returns:
        The evaluation of the claim, with verdict, margin and reason.

    Raises:
        SafetyViolation: the run violates the claim or is no evidence for the claim. The error is also raised
            if the avoider gave no answer in the run. A scenario can allow that by the claim ``the avoider
            answered: violated``.
        InputError: the harness does not know the sentence, or an argument has the wrong type.

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
    """Return the evaluation of ``trace`` by the property ``prop``.

    The verdict is inconclusive if the trace lacks measurements and the property does not declare its columns.
    """
    if trace.known.whole or columns_read_by(prop) is not None:
        return prop.evaluate(trace)
    limited = tuple(name for name, column in trace.known.columns.items() if column.limited)
    why = f"the claim does not say what it reads, and not all was measured: {limited[0]}"
    why += f" and {len(limited) - 1} others" * (len(limited) > 1)
    return replace(inconclusive(prop, why), unmeasured=limited)


def refuse_fallback(trace: Trace) -> None:
    """Raise SafetyViolation if the avoider gave no answer, unless the scenario expects a missing answer."""
    __tracebackhide__ = True
    evaluation = by_default(trace)
    if evaluation is not None:
        require(evaluation, Verdict.HOLDS, trace, AvoiderAnswered().evaluate)


def require(
    evaluation: Evaluation, expected: Verdict, trace: Trace, judge: Callable[[Trace], Evaluation]
) -> None:
    """Raise SafetyViolation if ``evaluation`` must fail the running test.

    If the session has a reference (``--against``), the function also judges the reference's run. For a log,
    the function makes no such comparison, because the reference cannot run in the recorded cell.

    Args:
        evaluation: the judgement of ``trace``.
        expected: the verdict that lets the test pass.
        trace: the run.
        judge: the function that evaluates the same claim in the reference's run.

    """
    __tracebackhide__ = True
    if trace.known.simulated:
        session().judged.add(run_key(trace))
    difference = against_reference(trace, evaluation, judge) if trace.known.simulated else None
    if not settle(evaluation, run_of(trace), expected, trace) and not is_shared(difference):
        raise violation_of(evaluation, trace, expected, difference)


def violation_of(
    evaluation: Evaluation, trace: Trace, expected: Verdict, difference: ClaimDifference | None
) -> SafetyViolation:
    """Return the violation to raise.

    If the reference has run, the violation has a note on the reference's run.
    """
    violation = SafetyViolation(evaluation, trace, expected)
    if difference is not None:
        violation.add_note(note_of(difference))
    return violation


def run_of(trace: Trace) -> Run:
    """Return the record of a run that a session keeps after the trace is deleted."""
    return Run(
        name=trace.scenario.name,
        tested=trace.system.label,
        seed=trace.scenario.seed,
        sound=trace.complete and unreadable(trace, TRUTH) is None and _is_measured(trace),
        world=made_in(trace),
        beside=tested_words(trace.scenario, trace.system),
    )


def _is_measured(trace: Trace) -> bool:
    return not trace.known.missing(TRUTH) and trace.known.first_gap(TRUTH) is None


def settle(evaluation: Evaluation, run: Run, expected: Verdict, trace: Trace | None) -> bool:
    """Record a judgement in the running test.

    Return False if the test must fail because of this judgement.
    """
    test = session().test
    # Only a sound run may be inconclusive without a failure: it simply did not test the claim.
    undecided = evaluation.verdict is Verdict.INCONCLUSIVE and run.sound
    good = evaluation.verdict is expected or (test is not None and test.draws and undecided)
    if test is None:
        return good
    if test.counts:
        test.note(Judgement(run, evaluation, expected), trace)
    if good or not (test.draws and isinstance(test.failure, SafetyViolation)):
        return good
    # While Hypothesis reduces one failure, a failure of another claim must not replace it.
    return test.failure.evaluation.sentence != evaluation.sentence


def aim(evaluation: Evaluation, expected: Verdict) -> None:
    """Tell Hypothesis how near the run was to a failure, so that it searches for nearer runs."""
    margin = evaluation.margin
    if margin is None or not isfinite(margin) or expected is Verdict.INCONCLUSIVE:
        return
    if "hypothesis" not in sys.modules:
        return
    from hypothesis import currently_in_test_context, target
    from hypothesis.errors import InvalidArgument

    if currently_in_test_context():
        # If an example judges the claim in a second run, Hypothesis refuses a second target for it.
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
    """Return the innermost line of the call stack that is outside this file."""
    frame = inspect.currentframe()
    while frame is not None and frame.f_code.co_filename == __file__:
        frame = frame.f_back
    if frame is None:
        return Place(field="assert_holds")
    return Place(file=Path(frame.f_code.co_filename), line=frame.f_lineno, field="assert_holds")


def against_reference(
    trace: Trace, mine: Evaluation, judge: Callable[[Trace], Evaluation]
) -> ClaimDifference | None:
    """Judge the same claim in the reference's run of this scenario.

    Return None if the session has no reference. The running test stores the difference, so that the session
    can include it in its summary.

    Args:
        trace: the run by the avoider under test.
        mine: the evaluation of that run.
        judge: the function that evaluates the claim in the reference's run.

    """
    if session().against is None:
        return None
    reference = simulate.with_reference(trace)
    difference = ClaimDifference(mine=mine, reference=judge(reference))
    test = session().test
    if test is not None and test.counts:
        new = RunDifference(
            run=trace.scenario.name,
            claims=(),
            mine=Overruling.from_traces([trace]),
            reference=Overruling.from_traces([reference]),
        )
        run = test.differences.setdefault(digest_of(trace.scenario), new)
        claims = (*run.claims, difference)
        test.differences[digest_of(trace.scenario)] = replace(run, claims=claims)
    return difference


def is_shared(difference: ClaimDifference | None) -> bool:
    """Return whether the reference is no better than the avoider under test.

    In this case, the running test ends as skipped.
    """
    test = session().test
    if difference is None or test is None or difference.change in _WORSE:
        return False
    test.shared.append(f"{difference.mine.sentence}: {_comparison(difference)}")
    return True


def note_of(difference: ClaimDifference) -> str:
    """Return the line that compares a failure with the reference's run.

    The line becomes part of the failure's text.
    """
    return f"{difference.change.value}: {difference.summary(_name())}"


def _comparison(difference: ClaimDifference) -> str:
    mine, theirs = difference.mine, difference.reference
    if mine.verdict is theirs.verdict:
        return (
            f"{theirs.verdict.value} with {_name()} too ({mine.margin_text()} against {theirs.margin_text()})"
        )
    return f"{mine.verdict.value}, and {theirs.verdict.value} with {_name()}"


def _name() -> str:
    return told_avoider(session().against or "")
