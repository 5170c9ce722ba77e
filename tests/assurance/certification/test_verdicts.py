from __future__ import annotations

from itertools import product
from typing import Any

import pytest

from safety_harness.cell.simulation.worlds import KINEMATIC, PYBULLET
from safety_harness.extensions.assurance.certification.evidence import Bound, ClaimStatus
from safety_harness.extensions.assurance.certification.verdicts import (
    at_least,
    at_most,
    beside_target,
    confidence_words,
    percent,
    standing_of,
    worst_status,
)


def word(**changes: Any) -> ClaimStatus:
    known: dict[str, Any] = {
        "target": 0.01,
        "bound": Bound(lower=0.0, upper=0.005, confidence=0.99, method="exact"),
        "runs": 1000,
        "planned": 1000,
        "tested": 1000,
        "violated": 0,
        "without_verdict": 0,
        "may_stop_early": False,
        "world": PYBULLET,
    }
    return standing_of(**(known | changes))[0]


def between(lower: float, upper: float) -> Bound:
    return Bound(lower=lower, upper=upper, confidence=0.99, method="exact")


def test_a_claim_is_shown_when_its_upper_bound_meets_the_target() -> None:
    assert word() is ClaimStatus.SHOWN
    assert word(bound=between(0.0, 0.01)) is ClaimStatus.SHOWN
    assert word(bound=between(0.0, 0.0100001)) is ClaimStatus.NOT_SHOWN


def test_it_is_refuted_only_when_the_lower_bound_is_above_the_target() -> None:
    assert word(bound=between(0.02, 0.05)) is ClaimStatus.REFUTED
    assert word(bound=between(0.01, 0.05)) is ClaimStatus.NOT_SHOWN


def test_runs_without_a_verdict_leave_doubt_on_what_is_shown() -> None:
    assert word(without_verdict=1) is ClaimStatus.DOUBTED
    assert word(world=KINEMATIC) is ClaimStatus.DOUBTED


def test_runs_that_are_not_independent_show_nothing_whatever_came_out() -> None:
    assert word(dependent="it remembers") is ClaimStatus.NOT_SHOWN
    assert word(dependent="it remembers", bound=None, target=None) is ClaimStatus.NOT_SHOWN
    assert word(dependent="it remembers", bound=between(0.02, 0.05)) is ClaimStatus.NOT_SHOWN


def test_what_is_missing_is_never_a_verdict() -> None:
    assert word(runs=999, tested=999) is ClaimStatus.INCOMPLETE
    assert word(runs=999, tested=999, may_stop_early=True) is ClaimStatus.SHOWN
    assert word(tested=0, bound=None) is ClaimStatus.UNTESTED
    assert word(target=None) is ClaimStatus.ESTIMATED
    assert word(bound=None) is ClaimStatus.INCOMPLETE


def test_only_complete_tested_runs_with_verdicts_in_the_reference_world_are_ever_shown() -> None:
    """Over every combination: green needs all of it."""
    choices = {
        "target": (None, 0.01),
        "bound": (None, between(0.0, 0.005), between(0.0, 0.5), between(0.3, 0.5)),
        "runs": (900, 1000),
        "tested": (0, 800),
        "without_verdict": (0, 3),
        "may_stop_early": (False, True),
        "world": (PYBULLET, KINEMATIC),
    }
    shown = 0
    for values in product(*choices.values()):
        one = dict(zip(choices, values, strict=True))
        if word(**one) is ClaimStatus.SHOWN:
            shown += 1
            assert one["target"] is not None
            assert one["bound"].upper <= one["target"]
            assert one["without_verdict"] == 0
            assert one["world"] is PYBULLET
            assert one["tested"] > 0
            assert one["runs"] == 1000 or one["may_stop_early"]
    assert shown > 0


def test_the_gravest_standing_speaks_for_all() -> None:
    assert worst_status([ClaimStatus.SHOWN, ClaimStatus.NOT_SHOWN]) is ClaimStatus.NOT_SHOWN
    assert worst_status([ClaimStatus.SHOWN] * 3) is ClaimStatus.SHOWN
    assert worst_status([]) is ClaimStatus.UNTESTED
    assert next(iter(ClaimStatus)) is ClaimStatus.SHOWN


@pytest.mark.parametrize(
    ("share", "text"),
    [
        (1.0, "100 %"),
        (0.9997, "99.97 %"),
        (0.999999, "99.9999 %"),
        (0.99999, "99.999 %"),
        (0.99995, "99.995 %"),
    ],
)
def test_a_large_one_is_never_shown_as_all(share: float, text: str) -> None:
    assert percent(share) == text


@pytest.mark.parametrize(
    ("share", "text"),
    [
        (0.0, "0 %"),
        (0.002, "0.2 %"),
        (0.01747, "1.75 %"),
        (1e-6, "0.0001 %"),
        (1.0, "100 %"),
        (0.9999, "99.99 %"),
    ],
)
def test_a_small_probability_is_never_shown_as_none(share: float, text: str) -> None:
    assert percent(share) == text


@pytest.mark.parametrize(
    "share", [1.23e-7, 0.0012345, 0.01747, 0.0174449, 0.099951, 0.5, 0.8765, 0.99951, 0.9999]
)
def test_a_bound_in_words_is_never_better_than_the_bound(share: float) -> None:
    upper, lower = (float(words(share).removesuffix(" %")) / 100.0 for words in (at_most, at_least))
    assert lower * (1.0 - 1e-9) <= share <= upper * (1.0 + 1e-9)
    assert upper - lower <= 0.011 * share
    assert float(confidence_words(share).removesuffix(" %")) / 100.0 <= share * (1.0 + 1e-9)


def test_bounds_of_few_digits_are_said_as_they_are() -> None:
    assert [at_most(one) for one in (0.0, 0.02, 0.0171, 1.0)] == ["0 %", "2 %", "1.71 %", "100 %"]
    assert [at_least(one) for one in (0.0, 0.02, 0.0171, 1.0)] == ["0 %", "2 %", "1.71 %", "100 %"]
    assert confidence_words(0.9875) == "98.75 %"


def test_the_reason_of_a_verdict_rounds_its_bound_away_from_the_target() -> None:
    known: dict[str, Any] = {"target": 0.02, "runs": 9, "planned": 9, "tested": 9, "violated": 0}
    known |= {"without_verdict": 0, "may_stop_early": False, "world": PYBULLET}
    _, shown = standing_of(**known, bound=between(0.0, 0.017901))
    assert "at most 1.8 % of them" in shown
    _, missed = standing_of(**known, bound=between(0.0, 0.020001))
    assert "up to 2.01 % of them" in missed


def test_the_reason_of_a_verdict_never_says_the_contrary_of_it() -> None:
    """8.0817 % rounded up is 8.09 %, and 8.0820 % to the nearest 8.08 %."""
    _, why = standing_of(
        target=0.08082,
        bound=between(0.0, 0.080817),
        runs=60,
        planned=60,
        tested=60,
        violated=1,
        without_verdict=0,
        may_stop_early=False,
        world=PYBULLET,
    )
    assert why.endswith("at most 8.0817 % of them do, and 8.082 % was the target")
    assert beside_target(between(0.08087, 0.2), 0.08086) == ("8.086 %", "20 %")  # not more than 8.09 %
    assert beside_target(between(0.0, 0.05), 0.1) == ("10 %", "5 %")


def test_what_is_refuted_says_with_which_confidence() -> None:
    known: dict[str, Any] = {"target": 0.02, "runs": 300, "planned": 300, "tested": 300, "violated": 31}
    known |= {"without_verdict": 0, "may_stop_early": False, "world": PYBULLET}
    bound = Bound(lower=0.07, upper=0.15, confidence=0.99, method="exact")
    _, why = standing_of(**known, bound=bound)
    assert why == "31 of 300 tested runs violate it: with 99.5 % confidence more than 2 % of them do"
    assert "doubt" not in why
