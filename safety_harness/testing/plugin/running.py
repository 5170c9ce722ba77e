"""Watch one test while it runs, and add its judgements to its test report.

The report contains plain data, because xdist can transfer nothing else in a report.
"""

from __future__ import annotations

import inspect
import os
import re
import traceback
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from types import CodeType
from typing import Any

import pytest

from safety_harness.base.exceptions import FlakyAvoiderError, InputError, SafetyHarnessError
from safety_harness.claims.properties.answered import ANSWERED
from safety_harness.report.words import count_words
from safety_harness.scenario.model import Verdict
from safety_harness.testing.asserting import NotEstablished, SafetyViolation, refuse_fallback, run_of
from safety_harness.testing.drawing import gives_scenarios
from safety_harness.testing.failure_text import in_store
from safety_harness.testing.plugin.collecting import FileItem, SpaceClaimItem
from safety_harness.testing.plugin.explained import JUDGES_ITSELF, TEST, explained
from safety_harness.testing.plugin.payloads import EndedTest, junit_properties
from safety_harness.testing.session import Judgement, TestRun, session
from safety_harness.testing.watching import keep, watched

_OF_TARGETS = re.compile(r"Highest target|\s*\S+\s+\(label=|\s*$")  # lines of Hypothesis's notes on targets


@contextmanager
def watch(item: pytest.Item) -> Iterator[None]:
    """Keep a TestRun for ``item`` during its call.

    Raise NotEstablished if the item should test claims about runs, but its runs tested no claim.
    """
    function = _hypothesis_function(item)
    draws = function is not None or isinstance(item, SpaceClaimItem)
    test = TestRun(item.nodeid, draws=draws, keep_traces=session().report is not None)
    test.judges_itself = item.get_closest_marker(JUDGES_ITSELF) is not None
    item.stash[TEST] = test
    session().test = test
    try:
        with ExitStack() as stack:
            about_scenarios = function is not None and _is_about_scenarios(item, function)
            if about_scenarios:
                stack.enter_context(watched(function, test))
            yield
        if about_scenarios and not test.judgements and _asserts(function.hypothesis.inner_test):
            count = count_words(test.examples, "draw", "draws")
            raise NotEstablished(f"assert_holds was never reached in {count}: nothing was put to the test")
        if not (draws or test.judges_itself or test.asked) and "simulate" in _arguments(item):
            raise NotEstablished(
                "simulate was never called: no run was made, and nothing was put to the test"
            )
        refuse_untested(test)
        if test.fallback is not None and ANSWERED.example not in test.worst:
            refuse_fallback(test.fallback)
        if test.shared:
            pytest.skip("; ".join(dict.fromkeys(test.shared)))
    except SafetyHarnessError as error:
        _leave_hypothesis_out(error, function)
        if isinstance(error, SafetyViolation):
            _show(error, test)
        raise
    finally:
        session().test = None
        item.user_properties += junit_properties(test)


def _show(violation: SafetyViolation, test: TestRun) -> None:
    """Show the reduced failing run in place of the first failure, and keep its scenario."""
    trace = violation.trace
    test.show(Judgement(run_of(trace), violation.evaluation, violation.expected), trace)
    if test.draws and trace.known.simulated and not in_store(violation.scenario):
        test.kept = keep(test.id, violation)


def _leave_hypothesis_out(error: SafetyHarnessError, function: Any) -> None:
    """Shorten the traceback of ``error`` so that it shows only the test itself.

    Hypothesis's note on the failing example remains only if the test draws more than a scenario.
    """
    draws_more = function is not None and len(function.hypothesis._given_kwargs) > 1
    notes = [note for note in getattr(error, "__notes__", []) if not _OF_TARGETS.match(note)]
    error.__notes__ = [note for note in notes if draws_more or not note.startswith("Failing ")]
    frames = []
    step = error.__traceback__
    while step is not None:
        frames.append(step)
        step = step.tb_next
    files = [Path(frame.tb_frame.f_code.co_filename) for frame in frames]
    positions = [k for k, file in enumerate(files) if "hypothesis" in file.parts]
    if positions and positions[-1] + 1 < len(frames):
        # The frame before Hypothesis's first is the function that @given made; it looks like the test itself.
        outer = frames[max(positions[0] - 2, 0)]
        outer.tb_next = frames[positions[-1] + 1]


def refuse_untested(test: TestRun) -> None:
    """Raise NotEstablished if a test draws scenarios and all its judgements are inconclusive."""
    if not test.draws or not test.judgements:
        return
    if all(j.evaluation.verdict is Verdict.INCONCLUSIVE is not j.expected for j in test.judgements):
        sentences = "; ".join(dict.fromkeys(j.evaluation.sentence for j in test.judgements))
        last = test.judgements[-1].evaluation.reason
        runs = len(test.judgements)
        raise NotEstablished(
            f"{sentences}: inconclusive in {runs} of {runs} judgements (the last: {last})\n"
            "  nothing was put to the test, and that is no pass: draw scenarios in which a hand comes near"
        )


def complete(
    report: pytest.TestReport, item: pytest.Item, call: pytest.CallInfo[None], test: TestRun
) -> None:
    """Add the judgements to the report, and remove the frames of the harness from its traceback."""
    error = call.excinfo.value if call.excinfo is not None else None
    if isinstance(error, NotEstablished | InputError | FlakyAvoiderError):
        report.longrepr = "\n".join([explained(error), *_asked_at(error, item)])
    swallowed = False
    if report.passed and not test.draws:  # the test expected the failures, or swallowed them
        swallowed = any(j.evaluation.verdict is not j.expected for j in test.judgements)
        test.judgements = [j for j in test.judgements if j.evaluation.verdict is j.expected]
    now = session()
    judges = test.judges_itself or isinstance(item, FileItem) or (test.draws and test.judgements)
    ended = EndedTest(
        run=test,
        failed=report.failed,
        swallowed=swallowed,
        simulated=() if judges else tuple(sorted(now.simulated)),
        judged=tuple(sorted(now.judged)),
    )
    now.simulated, now.judged = set(), set()
    if now.report is not None:
        from safety_harness.testing.plugin.reporting import save_runs

        ended = replace(ended, traces=save_runs(test, now.report))
    vars(report)["safety_harness"] = ended.text
    vars(item).pop("_hypothesis_failing_examples", None)  # a patch with a scenario's repr is useless


def _asked_at(error: BaseException, item: pytest.Item) -> list[str]:
    """Return the line of the test that led to a mistake.

    The result is empty if the error already states a place in the file of the test.
    """
    lines = [
        step.lineno for step in traceback.extract_tb(error.__traceback__) if step.filename == str(item.path)
    ]
    named = isinstance(error, InputError) and error.place.file == item.path
    path = os.path.relpath(item.path)
    return [f"  asked for at {path}:{lines[-1]}"] if lines and not named else []


def _hypothesis_function(item: pytest.Item) -> Any:
    """Return the function with ``@given`` that the item calls, or None if it calls no such function."""
    function = getattr(item, "obj", None)
    function = getattr(function, "__func__", function)
    return function if getattr(function, "is_hypothesis_test", False) else None


def _arguments(item: pytest.Item) -> tuple[str, ...]:
    """Return the names of the fixtures that the test function itself requests."""
    info = getattr(item, "_fixtureinfo", None)
    return () if info is None else info.argnames


def _is_about_scenarios(item: pytest.Item, function: Any) -> bool:
    """Return whether a test with ``@given`` draws scenarios of this package or uses ``simulate``."""
    given = function.hypothesis._given_kwargs.values()
    return "simulate" in getattr(item, "fixturenames", ()) or any(map(gives_scenarios, given))


def _asserts(function: Any) -> bool:
    """Return whether the code of a test, or of a function within it, refers to ``assert_holds``."""
    codes = [getattr(inspect.unwrap(function), "__code__", None)]
    for code in codes:
        if code is not None and "assert_holds" in code.co_names:
            return True
        # A function within a test is a constant of the test's code.
        codes += [constant for constant in getattr(code, "co_consts", ()) if isinstance(constant, CodeType)]
    return False
