"""A decision that is called the same is so for every hand in its box, as the network itself answers."""

from __future__ import annotations

import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples import VISIT, scenario

from safety_harness import admit
from safety_harness.admission.trial import run_kinematic
from safety_harness.base.exceptions import TraceError
from safety_harness.cell.avoidance.asking import Question
from safety_harness.cell.avoidance.learned import LearnedAvoider
from safety_harness.cell.avoidance.model_file import Model, load_model
from safety_harness.cell.avoidance.shipped import shipped_model
from safety_harness.cli.console import BAD_INPUT, DIFFERS
from safety_harness.cli.replay import judge_again
from safety_harness.extensions.lab.commands.prove import prove
from safety_harness.extensions.lab.proof.box_kernel import PROVEN, REFUTED
from safety_harness.extensions.lab.proof.claims import ClaimKind, DecisionClaim, optimum_constants
from safety_harness.extensions.lab.proof.decisions import AWAY, CHEAP, certified
from safety_harness.extensions.lab.proof.network import network_of
from safety_harness.extensions.lab.proof.plan import ProofRegion
from safety_harness.extensions.lab.proof.tree import examined
from safety_harness.trace.certified import Sameness
from safety_harness.trace.store import load_trace, save_trace
from safety_harness.trace.trace import Trace

HAND, TCP = np.array([0.75, -0.30, 0.15]), np.array([0.70, -0.05, 0.35])
RESNETS = ("mc-dropout", "mc-dropout-full", "ensemble", "deterministic")


@pytest.fixture(scope="module")
def trace() -> Trace:
    return run_kinematic(admit(scenario(VISIT, duration_s=1.6, avoider="mc-dropout")))


@pytest.mark.parametrize("name", RESNETS)
@pytest.mark.parametrize("passes", [1, 10])
def test_what_is_known_from_other_masks_changes_nothing(name: str, passes: int) -> None:
    def fresh() -> Model:
        return replace(load_model(shipped_model(name)), passes=passes)

    asked = fresh()
    network_of(asked, 6)
    for again, alone in zip(network_of(asked, 5), network_of(fresh(), 5), strict=True):
        np.testing.assert_array_equal(again, alone)


@pytest.mark.parametrize("name", RESNETS)
def test_bounds_of_a_residual_network_hold_its_own_answer_and_hardly_more(name: str) -> None:
    model, seed = load_model(shipped_model(name)), 5
    answers, spreads = LearnedAvoider.from_model(model).propose_many(
        HAND[None], TCP[None], np.array([seed], np.uint64)
    )
    network, region = network_of(model, seed), ProofRegion.around(TCP, HAND, HAND)
    step_m, spread_m = float(np.linalg.norm(answers[0] - TCP)), float(spreads.max())
    for kind, value_m in ((ClaimKind.AT_MOST, step_m), (ClaimKind.CERTAIN, spread_m)):
        for limit_m, code in ((value_m - 2e-3, REFUTED), (value_m + 2e-3, PROVEN)):
            claim = DecisionClaim(kind, limit_m)
            codes = examined(network, optimum_constants(), claim, region, region.corners())
            if limit_m > 0.0:
                assert codes.tolist() == [code], (kind, limit_m)
        exact = DecisionClaim(kind, value_m)
        assert examined(network, optimum_constants(), exact, region, region.corners())[0] < PROVEN


def test_the_cheap_bound_decides_nothing_otherwise_than_the_tight_one() -> None:
    tight, decided = network_of(load_model(shipped_model("mc-dropout")), 5), 0
    cheap = tight._replace(gathers=CHEAP)
    for half_m in (0.0, 0.01, 0.03):
        region = ProofRegion.around(TCP, HAND - half_m, HAND + half_m)
        for claim in (AWAY, DecisionClaim(ClaimKind.AT_MOST, 0.10), DecisionClaim(ClaimKind.AT_MOST, 0.12)):
            one, other = (
                examined(network, optimum_constants(), claim, region, region.corners())[0]
                for network in (cheap, tight)
            )
            assert one < PROVEN or one == other
            decided += int(one >= PROVEN)
    assert decided >= 3


def test_a_seed_has_its_own_masks() -> None:
    model = load_model(shipped_model("mc-dropout"))
    assert (network_of(model, 5).weight != network_of(model, 6).weight).any()


@pytest.mark.parametrize("half_m", [0.01, 0.03])
def test_no_hand_in_the_box_contradicts_what_is_called_the_same(half_m: float) -> None:
    rng, avoider = (
        np.random.default_rng(3),
        LearnedAvoider.from_model(load_model(shipped_model("mc-dropout"))),
    )
    found = []
    for seed in range(4):
        hand = TCP + rng.uniform(-0.25, 0.25, 3)
        one = certified(avoider, Question(hand, TCP, seed), half_m)
        found.append(one.whole)
        hands = hand + rng.uniform(-half_m, half_m, (300, 3))
        tcps = np.repeat(TCP[None], 300, axis=0)
        answers, spreads = avoider.propose_many(hands, tcps, np.full(300, seed, np.uint64))
        for said, came in (
            (one.certain, spreads.max(axis=1) <= (avoider.spread_threshold_m or 0.0)),
            (one.away, AWAY.margins(hands, tcps, answers) >= 0.0),
        ):
            assert said is not Sameness.SAME or came.all() or not came.any()
    assert Sameness.SAME in found


def test_it_is_part_of_a_trace_on_request_alone(
    trace: Trace, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before, out = tmp_path / "run.trace", tmp_path / "out"
    save_trace(trace, before)
    assert prove(before, decisions="30 mm", out=out) in (0, DIFFERS)
    assert "decisions for every hand within 30 mm" in capsys.readouterr().out
    after = load_trace(out / "run.trace")
    assert after.certified is not None
    assert len(after.certified.decisions) == len(trace.decisions) > 0
    assert all(one.whole is not Sameness.NONE for one in after.certified.decisions)
    judge_again([out / "run.trace"], ("trace finite and monotone",), keep_going=False, out=out)
    page = (out / "report.html").read_text()
    assert after.certified.summary in page
    assert after.certified.decisions[0].summary in page
    again, plain = tmp_path / "again.trace", tmp_path / "plain.trace"
    save_trace(load_trace(before), again)
    save_trace(replace(after, certified=None), plain)
    with zipfile.ZipFile(again) as archive:
        assert "certified.json" not in archive.namelist()
    assert again.read_bytes() == plain.read_bytes()

    lost = replace(after.certified, decisions=after.certified.decisions[1:])
    save_trace(replace(after, certified=lost), plain)
    with pytest.raises(TraceError, match=r"certified\.json"):
        load_trace(plain)


def test_a_run_without_a_network_of_ours_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "run.trace"
    save_trace(run_kinematic(admit(scenario(duration_s=0.2))), path)
    assert prove(path, decisions="30 mm") == BAD_INPUT
    assert "a network that ships" in capsys.readouterr().err
    assert prove(path, decisions="3 m") == BAD_INPUT
    assert "from 0 m to 1 m" in capsys.readouterr().err
