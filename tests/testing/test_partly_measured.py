"""Tests that judge a trace of which not all was measured."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from partly_measured import partly_measured

from safety_harness.claims.properties.base import Evaluation, Unit, judged
from safety_harness.claims.properties.measured import reads
from safety_harness.scenario.model import Verdict
from safety_harness.testing import SafetyViolation, assert_holds
from safety_harness.testing.asserting import run_of
from safety_harness.testing.plugin.payloads import EndedTest, junit_properties, of_text
from safety_harness.testing.plugin.reporting import save_runs
from safety_harness.testing.session import Judgement, Session, TestRun, begin
from safety_harness.trace.known import NOT_MEASURED, Gap, Measurement
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import knowing


@dataclass(frozen=True)
class Slow:
    """A user's own claim, which does not say what it reads."""

    sentence: str = "the arm is slow"
    unit: Unit = Unit.SPEED

    def evaluate(self, trace: Trace) -> Evaluation:
        return judged(self, trace, 1.0 - float(trace.ticks["tcp_speed_mps"].max()), 0.0, "", exercised=1)


class SaysWhatItReads(Slow):
    evaluate = reads("tcp_speed_mps")(Slow.evaluate)  # type: ignore[assignment]


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    new = Session(root=tmp_path, failures=tmp_path / "kept", against="opposite pose")
    before = begin(new)
    yield new
    begin(before)


def test_a_claim_that_does_not_say_what_it_reads_never_holds_of_it(visit: Trace) -> None:
    assert assert_holds(Slow(), visit).verdict is Verdict.HOLDS
    with pytest.raises(SafetyViolation, match="does not say what it reads") as caught:
        assert_holds(Slow(), partly_measured(visit))
    assert caught.value.evaluation.verdict is Verdict.INCONCLUSIVE
    assert "mode" in caught.value.evaluation.unmeasured


def test_one_that_says_it_is_judged_by_that(visit: Trace) -> None:
    trace = knowing(visit, {"gain": NOT_MEASURED, "camera_twist": NOT_MEASURED})
    assert assert_holds(SaysWhatItReads(), trace).verdict is Verdict.HOLDS
    with pytest.raises(SafetyViolation, match="not measured: tcp_speed_mps"):
        assert_holds(SaysWhatItReads(), knowing(trace, {"tcp_speed_mps": NOT_MEASURED}))


def test_the_text_of_its_failure_draws_nothing_and_repeats_nothing(visit: Trace, session: Session) -> None:
    with pytest.raises(SafetyViolation) as caught:
        assert_holds(Slow(), partly_measured(visit))  # no reference is run in its place
    text = str(caught.value)
    assert "what was decided was not measured" in text
    assert "to see it again" not in text
    assert "safety-harness run" not in text


@pytest.mark.parametrize(
    ("one", "sound"),
    [
        (NOT_MEASURED, False),
        (Measurement(gaps=(Gap(first=3, after=9),)), False),
        (Measurement(uncertainty=0.001), True),
    ],
)
def test_a_run_is_sound_only_if_its_truth_was_measured(visit: Trace, one: Measurement, sound: bool) -> None:
    assert run_of(visit).sound
    assert run_of(knowing(visit, {"transform_tcp_to_base": one})).sound is sound
    assert run_of(knowing(visit, {"gain": NOT_MEASURED})).sound


def test_what_a_claim_lacks_goes_to_junit_and_through_a_worker(visit: Trace, session: Session) -> None:
    session.test = TestRun("test_it.py::test_slow", draws=False)
    with pytest.raises(SafetyViolation):
        assert_holds(Slow(), partly_measured(visit))
    (found,) = of_text(EndedTest(run=session.test).text).run.judgements
    assert "mode" in found.evaluation.unmeasured
    assert "mode" in str(dict(junit_properties(session.test))["not measured"])
    assert "not measured" not in dict(junit_properties(TestRun("test_it.py::test_other", draws=False)))


def test_a_log_and_a_run_of_one_scenario_are_two_traces(
    visit: Trace, session: Session, tmp_path: Path
) -> None:
    files = []
    for trace in (visit, partly_measured(visit)):
        test = session.test = TestRun("test_it.py::test_slow", draws=False, keep_traces=True)
        evaluation = Slow().evaluate(trace)
        test.show(Judgement(run_of(trace), evaluation, Verdict.HOLDS), trace)
        files += [file for file, *_ in save_runs(test, tmp_path / "report.html")]
    assert len({*files}) == 2
