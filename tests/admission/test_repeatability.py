"""A second avoider, asked what the first was, shows whether an avoider is a function of its question."""

from __future__ import annotations

import itertools
import re
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from examples import VISIT, scenario

from safety_harness.admission import repeatability
from safety_harness.admission.admit import Admitter
from safety_harness.admission.avoiders import NAMES
from safety_harness.admission.repeatability import LEAST, Repeatability, RepeatabilityResult
from safety_harness.admission.trial import run_many
from safety_harness.cell.avoidance.flaky import asked_in
from safety_harness.scenario.faults import AvoiderLate, AvoiderNaN
from safety_harness.scenario.model import OffsetStart
from safety_harness.trace.compare import first_difference
from safety_harness.trace.trace import Trace
from tests.admission.remembering import NO_FUNCTIONS, TEXT


@pytest.fixture
def file(tmp_path: Path) -> Path:
    file = tmp_path / "mine.py"
    file.write_text(TEXT)
    return file


def runs(avoider: str, admitter: Admitter, seeds: Sequence[int] = range(4)) -> list[Trace]:
    """A few runs with some decisions each, asked together where the avoider takes many."""
    drawn = [scenario(VISIT, seed=seed, avoider=avoider, duration_s=1.6) for seed in seeds]
    starts = [OffsetStart(offset_in_base_m=(0.04, -0.12 + 0.01 * k, 0.06)) for k in range(len(drawn))]
    drawn = [
        replace(one, name=f"run-{k}", start=start)
        for k, (one, start) in enumerate(zip(drawn, starts, strict=True))
    ]
    return list(run_many(admitter.admit(one) for one in drawn))


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file that no test changes, and whose process runs go on to share."""
    kept = tmp_path_factory.mktemp("kept") / "mine.py"
    kept.write_text(TEXT)
    return kept


@pytest.fixture(scope="module")
def admitter() -> Admitter:
    return Admitter()


@pytest.fixture(scope="module")
def of_pure(kept: Path, admitter: Admitter) -> list[Trace]:
    return runs(f"{kept}:Pure", admitter)


def with_avoider(traces: Sequence[Trace], avoider: str) -> list[Trace]:
    return [replace(one, scenario=replace(one.scenario, avoider=avoider)) for one in traces]


def asked_again(traces: Sequence[Trace]) -> RepeatabilityResult:
    sampler = Repeatability()
    for trace in traces:
        sampler.add(trace)
    return sampler.check()


@pytest.mark.parametrize("name", NO_FUNCTIONS)
def test_an_avoider_that_is_no_function_of_its_question_is_noticed(
    name: str, kept: Path, admitter: Admitter
) -> None:
    found = asked_again(runs(f"{kept}:{name}", admitter))
    assert found.apart
    assert found.differing > 0
    assert "asked again" in found.remembers
    assert re.search(r"mm elsewhere \(question \d of run-\d\); \d of \d answers differ$", found.line)
    heeds = "or heeds what else is asked" in found.line
    assert heeds == (name == "Batched")


def test_one_that_answers_a_batch_otherwise_is_noticed_though_it_was_asked_alone(
    of_pure: list[Trace], file: Path
) -> None:
    found = asked_again(with_avoider(of_pure[1:2], f"{file}:Batched"))
    assert found.asked == found.questions
    assert "asked again in one call with others it answered" in found.line


@pytest.mark.parametrize(
    ("body", "told"),
    [
        ("raise ValueError", "alone and in another order: the same"),
        pytest.param("return []", "alone and in another order: the same", marks=pytest.mark.long),
        pytest.param(
            "return np.full((len(seeds), 3), np.nan), None",
            "alone and in another order: the same",
            marks=pytest.mark.long,
        ),
        (
            "return np.array(tcps) + [0.0, 0.0, 0.1], np.zeros((len(seeds), 3))",
            "order and together: the same",
        ),
    ],
)
def test_together_is_said_only_of_one_that_answers_together(body: str, told: str, file: Path) -> None:
    question = "propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed)"
    file.write_text(
        "import numpy as np\nfrom safety_harness import Proposal\nclass Many:\n    name = 'many'\n"
        f"    def {question}: return Proposal(tcp_position_in_base_m + [0.0, 0.0, 0.1], np.zeros(3))\n"
        f"    def propose_many(self, hands, tcps, seeds): {body}\n"
    )
    assert told in asked_again(runs(f"{file}:Many", Admitter())).line


def test_rounding_is_told_and_is_no_problem_and_a_spread_is_no_rounding(
    kept: Path, admitter: Admitter
) -> None:
    found = asked_again(runs(f"{kept}:Rounds", admitter))
    assert (found.differing, found.remembers, found.problem) == (0, "", "")
    assert re.search(r"rounds otherwise .*, \d of \d answers: .*1\.73e-10 mm elsewhere", found.line)
    doubts = asked_again(runs(f"{kept}:Doubts", admitter))
    assert doubts.differing > 0
    assert doubts.problem == doubts.words != ""
    assert "its spread was 10 mm otherwise" in doubts.line


def test_one_that_is_a_function_of_its_question_is_not(of_pure: list[Trace]) -> None:
    found = asked_again(of_pure)
    assert (found.differing, found.words) == (0, "")
    assert found.asked == found.questions >= 4
    assert "of a second avoider in a process of its own" in found.line
    assert "the same answers" in found.line


@pytest.mark.parametrize("name", NAMES)
def test_none_of_ours_is_noticed(name: str, admitter: Admitter) -> None:
    found = asked_again(runs(name, admitter))
    assert (found.differing, found.words, found.apart) == (0, "", False)
    assert found.asked == found.questions >= 4


def test_asking_again_leaves_the_first_avoider_and_its_runs_alone(file: Path) -> None:
    other = file.with_name("another.py")  # has a process of its own
    other.write_text(TEXT)
    untouched, checked = Admitter(), Admitter()
    alone = [trace for _ in range(2) for trace in runs(f"{other}:Drawn", untouched, [1, 2])]
    first = runs(f"{file}:Drawn", checked, [1, 2])
    assert asked_again(first).differing
    second = runs(f"{file}:Drawn", checked, [1, 2])
    assert first_difference(first[0], second[0]) is not None
    for one, same in zip(alone, [*first, *second], strict=True):
        assert first_difference(one, same) is None


def test_what_is_asked_again_does_not_hang_on_the_order_in_which_runs_end(
    kept: Path, admitter: Admitter, monkeypatch: pytest.MonkeyPatch
) -> None:
    traces = runs(f"{kept}:Counts", admitter)
    monkeypatch.setattr(repeatability, "MOST", 3)
    first, second = asked_again(traces), asked_again(traces[::-1])
    assert first.asked == second.asked == 3
    assert first == second


def test_a_wall_clock_budget_decides_how_many_are_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    traces = runs("opposite pose", Admitter(), seeds=range(12))
    now = itertools.count(0.0, 10.0)
    monkeypatch.setattr(time, "monotonic", lambda: next(now))
    found = asked_again(traces)  # every look at the clock costs ten seconds, and 2 % of ten is less
    assert found.asked == LEAST < found.questions


def test_answers_that_did_not_count_or_were_spoilt_are_not_asked_again() -> None:
    plain = scenario(VISIT, duration_s=1.6)
    admitter = Admitter()
    for faults, left in (
        ((), 1),
        ((AvoiderNaN(),), 0),
        ((AvoiderLate(delay_s=5.0),), 0),
        ((AvoiderLate(delay_s=0.05),), 1),
    ):
        (trace,) = run_many([admitter.admit(replace(plain, faults=faults))])
        assert len(trace.decisions) > 0
        assert bool(asked_in(trace)) == bool(left), faults
        assert not asked_again([trace]).words, faults


def test_a_file_that_has_changed_meanwhile_is_not_blamed_for_a_memory(
    of_pure: list[Trace], file: Path
) -> None:
    traces = with_avoider(of_pure, f"{file}:Pure")
    file.write_text(TEXT.replace("0.07", "0.08"))
    found = asked_again(traces)
    assert (found.asked, found.differing) == (0, 0)
    assert "has changed since" in found.line


def test_one_that_cannot_be_made_again_is_told(of_pure: list[Trace], file: Path) -> None:
    traces = with_avoider(of_pure, f"{file}:Pure")
    file.unlink()
    found = asked_again(traces)
    assert not found.remembers
    assert "could not be asked again" in found.line


def test_nothing_asked_is_told() -> None:
    assert "nothing that could be asked again" in Repeatability().check().line
