"""The parts of a failure: picture, text, kept file; and what the end of a session is sent."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples import VISIT, scenario

from safety_harness import Proposal, admit, read_scenario, run_trial
from safety_harness.base.exceptions import FlakyAvoiderError, InputError
from safety_harness.cell.avoidance.flaky import refuse_flaky
from safety_harness.claims.properties.base import Evaluation, Unit
from safety_harness.scenario.faults import AvoiderLate
from safety_harness.scenario.model import Scenario, Verdict
from safety_harness.space.read import parse_space
from safety_harness.testing import SafetyViolation, assert_holds, hand_distance, mm
from safety_harness.testing.drawing import one_system
from safety_harness.testing.failure_text import picture
from safety_harness.testing.plugin.payloads import EndedTest, junit_properties, of_text
from safety_harness.testing.session import Judgement, Run, Session, TestRun, begin
from safety_harness.testing.simulating import Simulate, digest_of
from safety_harness.testing.watching import folder_of, keep, kept_for
from safety_harness.trace.trace import Trace
from tests.search.short_space import TEXT

DISTANCE = "hand distance never below 50 mm"


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    new = Session(root=tmp_path, failures=tmp_path / "kept")
    before = begin(new)
    yield new
    begin(before)


def evaluation(
    verdict: Verdict = Verdict.VIOLATED, margin: float | None = -0.01, **others: object
) -> Evaluation:
    given = Evaluation(
        sentence=DISTANCE,
        verdict=verdict,
        unit=Unit.LENGTH,
        margin=margin,
        worst_time_s=1.0,
        reason="it came near",
        exercised=1,
    )
    return replace(given, **others)  # type: ignore[arg-type]


def test_the_picture_shows_the_limit_the_decisions_and_the_worst_moment(visit: Trace) -> None:
    lines = picture(visit, evaluation(worst_time_s=2.0))
    assert max(map(len, lines)) <= 70
    (limit,) = [line for line in lines if line.startswith("    50 |")]
    assert limit.count("-") > 50
    marks = lines[-3]
    assert marks.index("!") == 8 + 30  # half of four seconds
    assert marks.count("D") == len({int(t / 4.0 * 60) for t in visit.decisions["time_s"]} - {30})
    nearest = visit.ticks["hand_distance_m"].min()
    drawn = [row for row, line in enumerate(lines) if "*" in line]
    assert nearest > 0.05
    assert max(drawn) < lines.index(limit)  # the hand stayed above the limit


def test_the_picture_of_a_speed_is_of_the_speed_and_none_of_a_run_without_hands(visit: Trace) -> None:
    speed = evaluation(sentence="TCP speed never above 250 mm/s", unit=Unit.SPEED)
    assert picture(visit, speed)[0] == "TCP speed [mm/s]"
    alone = replace(visit, scenario=replace(visit.scenario, hands=()))
    assert picture(alone, evaluation()) == []
    assert picture(replace(visit, ticks=visit.ticks[:1]), evaluation()) == []


def test_outside_a_test_of_hypothesis_no_evidence_is_a_failure(visit: Trace) -> None:
    assert assert_holds(hand_distance() > mm(50), visit).verdict is Verdict.HOLDS
    with pytest.raises(SafetyViolation, match=": violated"):
        assert_holds("hand distance never below 900 mm", visit)
    half = replace(
        visit, ticks=visit.ticks[:200], decisions=visit.decisions[:0], decision_latency_s=np.zeros(0)
    )
    with pytest.raises(SafetyViolation, match="no evidence either way"):
        assert_holds(DISTANCE, half)


def test_a_kept_failure_reads_as_the_same_scenario(session: Session, visit: Trace) -> None:
    violation = SafetyViolation(evaluation(), visit, Verdict.HOLDS)
    file = keep("tests/test_a.py::Test::test_b[x/y]", violation)
    assert file.parent == folder_of("tests/test_a.py::Test::test_b[x/y]")
    assert session.failures in file.parents
    test = TestRun("tests/test_a.py::Test::test_b[x/y]", draws=True)
    (again,) = kept_for(test, None)
    assert (test.replayed, test.as_kept) == ([file], True)
    assert digest_of(replace(again, claims=visit.scenario.claims)) == digest_of(visit.scenario)
    assert [(claim.sentence, claim.expected) for claim in again.claims] == [(DISTANCE, Verdict.HOLDS)]
    assert "A failure of tests/test_a.py::Test::test_b[x/y]" in file.read_text()
    another = TestRun("tests/test_a.py::Test::test_b[x-y]", draws=True)  # however alike
    assert not list(kept_for(another, None))


def test_the_claim_of_a_property_that_no_file_can_name_is_not_claimed_there(
    session: Session, visit: Trace
) -> None:
    violation = SafetyViolation(evaluation(sentence="my own thought"), visit, Verdict.HOLDS)
    file = keep("test_a.py::test_b", violation)
    assert [claim.sentence for claim in read_scenario(file).claims] == ["trace finite and monotone"]
    assert "# my own thought: violated" in file.read_text()


def test_a_kept_file_names_an_own_avoider_and_keeps_its_way_to_it(session: Session, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "from safety_harness import Proposal\nclass Up:\n name = 'up'\n"
        " def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):\n"
        "  return Proposal(tcp_position_in_base_m + [0, 0, 0.1])\n"
    )
    own = replace(scenario(VISIT, avoider="mine.py:Up"), file=tmp_path / "some.yaml")
    trace = run_trial(admit(own))
    again = read_scenario(keep("test_a.py::test_b", SafetyViolation(evaluation(), trace, Verdict.HOLDS)))
    assert admit(again).avoider.name == "up"


def test_what_is_sent_home_is_plain_and_comes_back_the_same() -> None:
    part = evaluation(Verdict.INCONCLUSIVE, None, worst_time_s=None)
    whole = evaluation(margin=np.float64(-0.25), parts=(part,))
    test = TestRun("a::b", draws=True)
    run = Run("some", "mine", 3, True, "PyBullet")
    test.note(Judgement(run, evaluation(Verdict.HOLDS, 0.5), Verdict.HOLDS), None)
    test.note(Judgement(run, whole, Verdict.HOLDS), None)
    test.note(Judgement(run, evaluation(Verdict.HOLDS, 0.7), Verdict.HOLDS), None)
    test.failure = KeyError()
    home = of_text(json.loads(json.dumps(EndedTest(run=test).text))).run.judgements
    assert [j.evaluation for j in home] == [j.evaluation for j in test.judgements]
    assert [j.run for j in home] == [run] * 3
    found = dict(junit_properties(test))
    assert (found["margin"], found["unit"], found["verdict"]) == ("-250", "mm", "violated")
    assert (found["runs"], found["exercised"], found["seed"]) == (3, 3, 3)


class Up:
    """Straight up, and with ``drift_m`` a little more each time."""

    name = "up"

    def __init__(self, drift_m: float) -> None:
        self.drift_m = drift_m
        self.asked = 0

    def propose(
        self, *, hand_position_in_base_m: np.ndarray, tcp_position_in_base_m: np.ndarray, seed: int
    ) -> Proposal:
        self.asked += 1
        return Proposal(tcp_position_in_base_m + [0.0, 0.0, 0.1 + self.drift_m * self.asked])


def visited(avoider: Up, *faults: AvoiderLate) -> tuple[Scenario, Trace]:
    what = replace(scenario(VISIT, duration_s=2.0), faults=faults)
    return what, run_trial(admit(what, avoider=avoider))


def test_an_avoider_with_a_memory_is_told_by_its_second_answer() -> None:
    _, trace = visited(Up(1e-9))
    with pytest.raises(
        FlakyAvoiderError, match="'up' answers the same question in two ways\n  decision  1 of"
    ):
        refuse_flaky(Up(5e-9), trace)
    _, trace = visited(Up(0.0))
    assert len(trace.decisions) > 0
    refuse_flaky(Up(0.0), trace)


def test_an_answer_that_a_simulated_fault_delayed_is_not_held_against_the_avoider() -> None:
    _, trace = visited(Up(0.0), AvoiderLate(delay_s=0.040))
    late = trace.decisions[:1]
    moved = late["tcp_position_in_base_m"][0] + [0.0, 0.0, 0.1]
    assert not np.array_equal(late["proposed_position_in_base_m"][0], moved)  # asked 40 ms before
    refuse_flaky(Up(0.0), trace)


@pytest.mark.judges_runs_itself
def test_simulate_remembers_a_run_and_forgets_nothing_of_who_asked() -> None:
    run = Simulate()
    what = scenario(VISIT, duration_s=0.4)
    first, again = run(what), run(replace(what, name="another"))
    assert again.ticks is first.ticks
    assert (first.scenario.name, again.scenario.name) == ("example", "another")
    assert run(replace(what, seed=2)).ticks is not first.ticks


def test_simulate_refuses_what_cannot_be_tried() -> None:
    with pytest.raises(InputError):
        Simulate()(scenario(VISIT, avoider="nobody"))


@pytest.mark.parametrize(
    ("avoider", "varies"),
    [
        ("avoider: nearest candidate", False),
        ("avoider: one of nearest candidate, opposite pose", True),
        ("choices:\n  about:\n    one of: [nearest candidate, opposite pose]\navoider: the about", True),
    ],
    ids=["named", "drawn", "chosen elsewhere"],
)
def test_a_space_has_one_system_only_where_no_draw_has_another(avoider: str, varies: bool) -> None:
    like = one_system(parse_space(TEXT.replace("avoider: opposite pose", avoider)))
    assert (like is None) == varies
    assert varies or (like is not None and like.avoider == "nearest candidate")
