"""The learned part in a report: its hash, how far runs lie from its training, whose fault failures are."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from safety_harness.cell.avoidance.shipped import shipped_model
from safety_harness.cell.controller.named import LEARNED_FILE
from safety_harness.cli.console import AS_EXPECTED, DIFFERS
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.session import plan_of
from safety_harness.extensions.assurance.certification.counterexamples import FAULT, MOST_ASKED
from safety_harness.extensions.assurance.certification.evidence import (
    Evidence,
    LearnedPart,
    as_text,
    read_evidence,
)
from safety_harness.extensions.assurance.certification.learned import (
    NOT_STATED,
    PROGRAM,
    TRAINING,
    learned_of,
)
from safety_harness.extensions.assurance.certification.page import render
from safety_harness.extensions.assurance.certification.stored import Stored, random_traces
from safety_harness.extensions.assurance.commands.certify import certify, verify
from safety_harness.search.counterexample import circumstances, seen_of, sure_about_unseen
from tests.assurance.campaign.plans import PLAN, plan_in
from tests.assurance.certification import made_up_evidence
from tests.search.short_space import CRASHING, TEXT

NETWORK = (
    PLAN.replace("opposite pose", "mc-dropout")
    .replace("runs: 30", "runs: 8")
    .replace("runs: 20", "runs: 4")
    .replace("    violated in at most: 50 %\n", "")
)
FAR = TEXT.replace("-500 mm, 400 mm", "-380 mm, 700 mm")


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of eight and four runs with a network."""
    folder = tmp_path_factory.mktemp("learned")
    plan_in(folder, NETWORK, FAR)
    assert certify(folder / "plan.yaml", out=folder / "report", workers=1) == DIFFERS
    return folder / "report"


@pytest.fixture(scope="module")
def evidence(report: Path) -> Evidence:
    return read_evidence(report / "evidence.json")


def test_the_network_is_known_by_the_hash_of_its_file(evidence: Evidence) -> None:
    assert evidence.learned is not None
    sha256 = hashlib.sha256(shipped_model("mc-dropout").read_bytes()).hexdigest()
    assert evidence.learned.networks == (("mc-dropout", sha256),)
    assert evidence.learned.seen == ("mc-dropout",)


def test_every_run_with_a_hand_is_counted_by_whether_training_had_it(evidence: Evidence) -> None:
    assert evidence.learned is not None
    assert [sum(one.runs) for one in evidence.learned.strata] == [8, 4]
    assert sum(sum(one.runs[1:]) for one in evidence.learned.strata) > 0


def test_distances_are_those_of_the_hands_that_were_asked_about(report: Path) -> None:
    with Ledger.open(report / "ledger.sqlite") as ledger, plan_of(ledger) as plan:
        stored, _ = random_traces(plan, ledger)
        (one, *_) = (each for each in stored if len(each.trace.decisions))
        box = seen_of(one.trace.scenario).hand
        decisions = one.trace.decisions[:1].repeat(4)
        x, y, z = box.high_m
        decisions["hand_position_in_base_m"] = [
            (x, y, z),
            (x + 0.3, y, z + 0.4),
            (x, y + 0.1, z),
            (x, y, np.nan),
        ]
        moved = Stored(0, one.episode, replace(one.trace, decisions=decisions))
        found = learned_of(plan, ledger, [moved])
    assert found is not None
    first, second = found.strata
    assert (first.decisions, first.share_outside) == (4, 0.75)  # one that is no number is not inside
    assert first.median_outside_m == pytest.approx(0.3)
    assert first.largest_outside_m == pytest.approx(0.5)
    assert (second.decisions, second.share_outside, second.largest_outside_m) == (0, None, None)


def test_an_avoider_that_is_no_network_has_no_learned_part(tmp_path: Path) -> None:
    plan = plan_in(tmp_path)
    with Ledger.create(tmp_path / "ledger.sqlite", plan) as ledger:
        assert learned_of(plan, ledger, []) is None
    assert '"learned"' not in as_text(made_up_evidence.evidence(only_shown=True))


def learned_in(folder: Path, tested: str) -> LearnedPart:
    plan = plan_in(folder, PLAN.replace("avoider: opposite pose", tested), TEXT)
    with Ledger.create(folder / "ledger.sqlite", plan) as ledger:
        found = learned_of(plan, ledger, [])
    assert found is not None
    return found


def test_a_learned_controller_is_known_by_its_hash_and_its_training_is_told(tmp_path: Path) -> None:
    found = learned_in(tmp_path, "controller: learned policy")
    assert found.networks == (("learned policy", hashlib.sha256(LEARNED_FILE.read_bytes()).hexdigest()),)
    assert found.strata == ()  # of what it saw in training nothing is measured
    assert dict(found.life)["learned policy, trained"].startswith("by PPO in the space reaching-hands")
    assert "With an unknown hash" in dict(found.life)


@pytest.mark.parametrize("stated", ["on ten hours of one cell", ""])
def test_the_metadata_of_an_onnx_file_may_state_its_training(tmp_path: Path, stated: str) -> None:
    onnx = pytest.importorskip("onnx", exc_type=ImportError)
    model = onnx.load(LEARNED_FILE)
    model.metadata_props.add(key=TRAINING, value=stated)
    onnx.save(model, tmp_path / "mine.onnx")
    found = learned_in(tmp_path, "controller: mine.onnx")
    assert found.networks[0][1] == hashlib.sha256((tmp_path / "mine.onnx").read_bytes()).hexdigest()
    assert dict(found.life)["mine.onnx, trained"] == (stated or NOT_STATED)


def test_of_a_program_it_is_said_that_nothing_is_stated_and_how_it_can_be(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(CRASHING)
    found = learned_in(tmp_path, "avoider: mine.py:Crashing")
    assert (found.networks, found.strata) == ((), ())
    assert found.life == (("mine.py:Crashing, whether learned", PROGRAM),)
    unstated = replace(made_up_evidence.evidence(only_shown=True), learned=found)
    assert "not stated: a program may have a learned part" in render(unstated, {})


def test_declared_failures_say_whose_fault_they_are_as_searched_ones_do(evidence: Evidence) -> None:
    told = [one for one in evidence.counterexamples if any(line.startswith(FAULT) for line in one.lines)]
    by_claim = {one.claim: 0 for one in evidence.counterexamples}
    assert by_claim
    for one in told:
        by_claim[one.claim] += 1
        assert one.lines[0].startswith("kind: ")
        assert one.lines[1].startswith(FAULT)
    kinds = [sum(one.claim == claim for one in evidence.counterexamples) for claim in by_claim]
    assert [*by_claim.values()] == [min(count, MOST_ASKED) for count in kinds]


def test_what_is_said_of_the_learned_part_stands(report: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert verify(report, runs=0) == AS_EXPECTED, capsys.readouterr().out


def test_it_is_told_where_the_network_was_sure_about_what_it_never_saw(report: Path) -> None:
    with Ledger.open(report / "ledger.sqlite") as ledger, plan_of(ledger) as plan:
        stored, _ = random_traces(plan, ledger)
    trace = next(each.trace for each in stored if len(each.trace.decisions))
    seen = seen_of(trace.scenario)
    decisions = trace.decisions[:1].repeat(3)
    decisions["outcome"] = 0
    decisions["spread_threshold_m"] = 0.0178
    decisions["proposed_spread_m"] = [[0.009] * 3, [0.001, 0.0058, 0.002], [0.001] * 3]
    x, y, z = seen.hand.high_m
    decisions["hand_position_in_base_m"] = [(x + 0.1, y, z), (x + 0.108, y, z), (x, y, z)]
    (line,) = sure_about_unseen(replace(trace, decisions=decisions), seen)
    assert line.startswith(
        "sure (5.8 mm) about a hand never seen in training, 108 mm from the nearest that was"
    )
    assert line.endswith("in decision 2; 2 of 3 decisions are so")
    assert line in circumstances(replace(trace, decisions=decisions))
    for name, value in (("spread_threshold_m", 0.0005), ("spread_threshold_m", np.nan), ("outcome", 1)):
        other = decisions.copy()
        other[name] = value
        assert sure_about_unseen(replace(trace, decisions=other), seen) == []


def test_the_page_has_the_learned_part() -> None:
    page = render(made_up_evidence.evidence(), {})
    assert "The learned part" in page
    assert "With an unknown hash" in page
    assert "28 mm" in page
    assert "The learned part" not in render(made_up_evidence.evidence(only_shown=True), {})
