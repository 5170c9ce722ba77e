"""What a counterexample is known by after shrinking: its file without the numbers."""

from __future__ import annotations

from dataclasses import replace

import pytest
from examples import hand, scenario

from safety_harness.scenario.faults import AvoiderSilent, HandSensorBlind
from safety_harness.scenario.model import Claim, Scenario, Verdict
from safety_harness.scenario.moves import MoveTo, Wait
from safety_harness.search.confirm import Complaint
from safety_harness.search.counterexample import Counterexample
from safety_harness.search.shrink import Shrunk

CLAIM = Claim(sentence="joint speeds within limits", expected=Verdict.HOLDS)
MOVE = MoveTo(position_in_base_m=(0.84, -0.35, 0.25), speed_mps=1.0)
ONE = replace(
    scenario(hand(MOVE), avoider="mine-1.py:Mine"), faults=(HandSensorBlind(from_s=0.5),), claims=(CLAIM,)
)
OTHER_NUMBERS = replace(
    scenario(
        hand(MoveTo(position_in_base_m=(-0.3, 0.0, 1.0), speed_mps=0.25), at=(0.0, 1.5, -0.2)),
        avoider="mine-1.py:Mine",
        duration_s=7.25,
        offset=(0.0, 1e-5, -0.1),
        seed=8,
    ),
    name="another",
    title="another",
    faults=(HandSensorBlind(from_s=1e-3),),
)


def of(shrunk: Scenario, complaint: Complaint | None = None) -> Counterexample:
    return Counterexample(
        complaint=complaint or Complaint(CLAIM),
        shrunk=Shrunk(shrunk, (), used=1, settled=True),
        run=RuntimeError("not run"),
        evaluations=(),
        found_margin=None,
        found_contact="contact unknown",
        circumstances=(),
        attribution=(),
        draws=None,
    )


def test_other_numbers_another_name_and_seed_are_the_same_story() -> None:
    assert of(ONE).is_same_as(of(OTHER_NUMBERS))
    assert "0.84" not in of(ONE).structure
    assert "mine-1.py:Mine" in of(ONE).structure


@pytest.mark.parametrize(
    "other",
    [
        replace(ONE, hands=(hand(MOVE, Wait(duration_s=1.0)),)),
        replace(ONE, hands=(hand(MOVE, name="left"),)),
        replace(ONE, hands=()),
        replace(ONE, faults=()),
        replace(ONE, faults=(AvoiderSilent(from_s=0.5),)),
        replace(ONE, faults=(HandSensorBlind(from_s=0.5, for_s=0.5),)),
        replace(ONE, avoider="mine-2.py:Mine"),
    ],
    ids=["a move more", "another hand", "no hand", "no fault", "another fault", "it ends", "another avoider"],
)
def test_another_structure_is_another_story(other: Scenario) -> None:
    assert not of(ONE).is_same_as(of(other))


def test_another_complaint_is_another_story() -> None:
    silent = [Complaint(CLAIM, f"the avoider gave no answer: {why}") for why in ("x", "y")]
    for complaint in (Complaint(replace(CLAIM, sentence="x")), silent[0]):
        assert not of(ONE).is_same_as(of(ONE, complaint))
    assert not of(ONE, silent[0]).is_same_as(of(ONE, silent[1]))
