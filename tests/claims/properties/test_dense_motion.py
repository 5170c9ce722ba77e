"""No distance is judged against what following the motion in a thousand parts of each tick shows."""

from __future__ import annotations

import pytest
from dense_motion import least_m, ran

from safety_harness.claims.formulas.claim import FormulaClaim
from safety_harness.claims.formulas.language import always, hand_distance, m, nearest_hand_to_tcp
from safety_harness.claims.properties.hand_distance import HandDistance
from safety_harness.claims.signals.true_motion import RESOLUTION_M
from safety_harness.scenario.model import Verdict

BESIDE_M = 1.05 * RESOLUTION_M


def judged_at(seed: int) -> None:
    """Both mechanisms say the same, and right, a resolution below the least distance and above."""
    trace = ran(seed)
    true_m = least_m(trace)
    for limit_m, verdict in ((true_m - BESIDE_M, Verdict.HOLDS), (true_m + BESIDE_M, Verdict.VIOLATED)):
        claim = HandDistance(minimum_m=limit_m, near_m=10.0).evaluate(trace)
        formula = FormulaClaim(always(hand_distance() >= m(limit_m))).evaluate(trace)
        assert claim.margin is not None
        assert formula.margin == pytest.approx(claim.margin, abs=RESOLUTION_M)
        assert claim.verdict is verdict, (claim.margin, claim.reason)
        if limit_m > hand_distance.limits[0]:
            assert formula.verdict is verdict or formula.exercised == 0, (formula.margin, formula.reason)


def nearest_judged_at(seed: int) -> None:
    """So is the hand's centre from the TCP, by a formula."""
    trace = ran(seed)
    true_m = least_m(trace, from_tcp=True)
    for limit_m, verdict in ((true_m - BESIDE_M, Verdict.HOLDS), (true_m + BESIDE_M, Verdict.VIOLATED)):
        found = FormulaClaim(always(nearest_hand_to_tcp() >= m(limit_m))).evaluate(trace)
        assert found.verdict is verdict or found.exercised == 0, (found.margin, found.reason)


def test_least_distances_are_judged_to_a_tenth_of_a_millimetre() -> None:
    for seed in range(60):
        judged_at(seed)
        nearest_judged_at(seed)


@pytest.mark.long
def test_least_distances_are_judged_to_a_tenth_of_a_millimetre_in_many_runs() -> None:
    for seed in range(60, 2000):
        judged_at(seed)
        nearest_judged_at(seed)
