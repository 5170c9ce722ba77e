"""A bad answer is laid at the avoider and not at who judges it; a setting that a user changed is named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from examples import hand, scenario
from numpy.typing import NDArray

from safety_harness.admission.admit import admit
from safety_harness.base.settings import DEFAULTS, Settings
from safety_harness.cell.avoidance.avoider import Avoider, AvoiderAround, Proposal
from safety_harness.cell.avoidance.simple import OppositePose
from safety_harness.extensions.attribution.attribute import Attribution, attribute
from safety_harness.extensions.attribution.ingredients import CHANGES, Altered, Ingredient
from safety_harness.scenario.faults import HandSensorBlind
from safety_harness.scenario.gate import AskedRegion, GateRule, PositionBox
from safety_harness.scenario.model import Claim, Scenario, Verdict
from safety_harness.scenario.moves import MoveTo, Wait, Withdraw
from safety_harness.scenario.read import read_scenario
from safety_harness.seams.contract import Seen

SCENARIOS = Path(__file__).parents[2] / "scenarios"
NOMINAL_HAND = np.array(DEFAULTS.avoidance.nominal_hand_position_in_base_m)
SURE_AND_OFF = "proposals never sure and more than 40 mm from the optimum"
WITHIN_SPREAD = "proposals within 3 spreads and 30 mm of the optimum"
OVERRULED = "at most 50 % of proposals overruled"
JUDGES_AND_QUESTIONS = {Ingredient.GATE, Ingredient.FALLBACK, Ingredient.PREDICTION}
Vector = NDArray[np.float64]
Point = tuple[float, float, float]


def unseen(place_m: Point, offset_m: Point = (0.0, 0.2, 0.1)) -> Scenario:
    """A hand comes to where the network saw none."""
    moves = MoveTo(position_in_base_m=place_m, speed_mps=1.0), Wait(duration_s=0.6), Withdraw(speed_mps=1.0)
    return scenario(hand(*moves), avoider="mc-dropout", offset=offset_m, duration_s=3.0)


UNSEEN = unseen((0.9, 0.3, 0.5))
OTHER_START = unseen((0.9, 0.3, 0.5), (0.04, -0.12, 0.06))
BETWEEN = replace(read_scenario(SCENARIOS / "lost-between-two-hands.yaml"), avoider="mc-dropout")


@dataclass(frozen=True, eq=False)
class OfTheOtherHand(AvoiderAround):
    """It answers for the hand that is farthest away, and was asked about the nearest."""

    sees = ("predicted hands",)

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int, seen: Seen
    ) -> Proposal:
        hands = [one.position_in_base_m for one in seen.predicted_hands]
        far = max(hands, key=lambda one: float(np.linalg.norm(one - tcp_position_in_base_m)))
        return self.avoider.propose(
            hand_position_in_base_m=far, tcp_position_in_base_m=tcp_position_in_base_m, seed=seed
        )


@dataclass(frozen=True, eq=False)
class SureWhereNothingWasSeen(AvoiderAround):
    """Its spread collapses away from the hands that it learnt from."""

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        answer = self.avoider.propose(
            hand_position_in_base_m=hand_position_in_base_m,
            tcp_position_in_base_m=tcp_position_in_base_m,
            seed=seed,
        )
        seen = np.all(np.abs(hand_position_in_base_m - NOMINAL_HAND) <= 0.2)
        return Proposal(answer.position_in_base_m, (1.0 if seen else 0.05) * answer.spread_m)


@dataclass(frozen=True, eq=False)
class StaleNormalisation(AvoiderAround):
    """Its inputs are normalised with mean and deviation of another data set."""

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        return self.avoider.propose(
            hand_position_in_base_m=NOMINAL_HAND
            + 0.6 * (hand_position_in_base_m - NOMINAL_HAND)
            + [0.1, 0.15, 0.05],
            tcp_position_in_base_m=tcp_position_in_base_m,
            seed=seed,
        )


@dataclass(frozen=True, eq=False)
class Late(AvoiderAround):
    """It says honestly that an answer takes 96 ms, 4 ms less than the deadline."""

    decision_time_s = 0.096

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        return self.avoider.propose(
            hand_position_in_base_m=hand_position_in_base_m,
            tcp_position_in_base_m=tcp_position_in_base_m,
            seed=seed,
        )


def only(what: Scenario, sentence: str, spoil: Callable[[Avoider], Avoider] | None = None) -> Attribution:
    admitted = admit(what)
    if spoil is not None:
        admitted = admit(what, avoider=spoil(admitted.avoider))
    (found,) = attribute(admitted, [Claim(sentence=sentence, expected=Verdict.HOLDS)])
    return found


def with_settings(group: str, **changed: object) -> Settings:
    return replace(DEFAULTS, **{group: replace(getattr(DEFAULTS, group), **changed)})


@pytest.mark.parametrize(
    ("spoil", "what", "sentence"),
    [
        (OfTheOtherHand, BETWEEN, OVERRULED),
        (SureWhereNothingWasSeen, UNSEEN, WITHIN_SPREAD),
        (SureWhereNothingWasSeen, UNSEEN, SURE_AND_OFF),
        (SureWhereNothingWasSeen, UNSEEN, OVERRULED),
        (StaleNormalisation, UNSEEN, SURE_AND_OFF),
        (StaleNormalisation, UNSEEN, OVERRULED),
        (Late, OTHER_START, OVERRULED),
    ],
)
def test_a_bad_answer_is_laid_at_the_avoider_and_not_at_who_judges_it(
    spoil: Callable[[Avoider], Avoider], what: Scenario, sentence: str
) -> None:
    found = only(what, sentence, spoil)
    assert found.cause == (Ingredient.AVOIDER,)
    assert not any(JUDGES_AND_QUESTIONS & set(one.ingredients) for one in found.replays)


def test_an_answer_is_laid_at_the_avoider_before_a_setting_that_leads_to_other_questions() -> None:
    settings = with_settings("hand_filter", prediction_horizon_s=0.25)
    found = only(
        replace(unseen((0.84, -0.1, 0.4)), settings=settings), WITHIN_SPREAD, SureWhereNothingWasSeen
    )
    assert [one.ingredients for one in found.helping[:2]] == [(Ingredient.AVOIDER,), (Ingredient.SETTINGS,)]


POINT = PositionBox(low_m=(0.6, -0.5, -0.2), high_m=(0.6001, -0.4999, -0.1999))
NOTHING = GateRule(questions_within=AskedRegion(hand=POINT, tcp=POINT))
SLOW_REPULSION = with_settings("avoidance", repulsion_speed_mps=0.02)
NO_PREDICTION = with_settings("hand_filter", prediction_horizon_s=0.0)


def approached(speed_mps: float, settings: Settings = DEFAULTS, avoider: str = "opposite pose") -> Scenario:
    moves = (
        MoveTo(position_in_base_m=(0.76, -0.08, 0.38), speed_mps=speed_mps),
        Wait(duration_s=1.0),
        Withdraw(speed_mps=1.0),
    )
    return scenario(hand(*moves), duration_s=6.0, settings=settings, avoider=avoider)


@pytest.mark.parametrize(
    ("what", "sentence", "words"),
    [
        (
            approached(0.25, SLOW_REPULSION),
            "hand distance never below 50 mm",
            "settings (repulsion speed at its default): +151",
        ),
        (replace(approached(0.25), gate=NOTHING), OVERRULED, "settings (no rule for the gate): +50"),
        (
            approached(0.4, NO_PREDICTION),
            "hand distance never below 100 mm",
            "settings (prediction horizon at its default): +8.6 mm",
        ),
    ],
)
def test_a_setting_that_a_user_changed_is_named_first(what: Scenario, sentence: str, words: str) -> None:
    found = only(what, sentence)
    assert found.cause == (Ingredient.SETTINGS,)
    assert found.summary.startswith(words)


def test_what_is_broken_is_named_before_a_setting_that_makes_up_for_it() -> None:
    blind = replace(approached(0.25, NO_PREDICTION), faults=(HandSensorBlind(),))
    assert only(blind, "hand distance never below 50 mm").cause == (Ingredient.PERCEPTION,)


def test_settings_that_nobody_changed_are_not_tried_and_two_are_tried_together_too() -> None:
    def tried(settings: Settings) -> dict[str, Altered]:
        system = Altered.from_admitted(admit(approached(0.25, settings, "nearest candidate")))
        own = [change for change in CHANGES if change.ingredient is Ingredient.SETTINGS]
        return {one.words: changed for one in own if (changed := one.on(system)) is not None}

    assert tried(DEFAULTS) == {}
    assert list(tried(NO_PREDICTION)) == ["prediction horizon at its default"]
    two = tried(with_settings("avoidance", radius_m=0.2, repulsion_speed_mps=0.1))
    assert list(two) == [
        "radius at its default",
        "repulsion speed at its default",
        "all at their defaults",
    ]
    assert two["all at their defaults"].scenario.settings == DEFAULTS


def test_an_avoider_made_of_a_setting_is_made_anew_with_it() -> None:
    system = Altered.from_admitted(admit(approached(0.25, with_settings("avoidance", radius_m=0.2))))
    (change,) = (one for one in CHANGES if one.words == "radius at its default")
    changed = change.on(system)
    assert changed is not None
    assert changed.avoider == OppositePose(DEFAULTS.avoidance.radius_m)
