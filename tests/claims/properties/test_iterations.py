"""Iterations are whole control ticks, counted as the paper does."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from examples import ConstantSpeed, run, scenario

from safety_harness.admission.claims import property_of
from safety_harness.claims.properties.servoing import GainSwitchIterations, GainSwitchReached
from safety_harness.scenario.model import Claim, Verdict
from safety_harness.trace.trace import Trace


@lru_cache
def alone() -> Trace:
    return run(scenario(duration_s=3.0))


def first_below(trace: Trace) -> int:
    below = trace.ticks["sse"] < trace.scenario.settings.servo.gain_switch_sse
    return int(np.argmax(below))


@pytest.mark.parametrize("spare", [-1, 0, 1, 100])
def test_the_margin_is_the_number_of_iterations_left(spare: int) -> None:
    took = first_below(alone())
    evaluation = GainSwitchIterations(within=took + spare).evaluate(alone())
    assert evaluation.margin == float(spare)
    assert evaluation.verdict is (Verdict.HOLDS if spare >= 0 else Verdict.VIOLATED)
    assert f"after {took} iterations" in evaluation.reason


def test_the_closed_form_says_how_many() -> None:
    """ln(d / 70.7 mm)/(lambda dt) from 140 mm; the arm has to get up to speed."""
    d_m, switch_m = float(np.linalg.norm((0.04, -0.12, 0.06))), float(np.sqrt(0.005))
    closed = np.log(d_m / switch_m) / (0.4 * 0.008)
    assert first_below(alone()) == pytest.approx(closed, abs=10)


def test_it_agrees_with_the_same_claim_in_seconds() -> None:
    for within in (50, 150, 250, 300):
        counted = GainSwitchIterations(within=within).evaluate(alone())
        timed = GainSwitchReached(within_s=(within + 0.5) * 0.008).evaluate(alone())
        assert counted.verdict is timed.verdict


def test_a_controller_that_does_nothing_has_not_got_there_when_the_run_ends() -> None:
    idle = run(scenario(duration_s=1.0), controller=ConstantSpeed((0.0,) * 6))
    late = GainSwitchIterations(within=100).evaluate(idle)
    assert (late.verdict, late.margin, late.reason) == (
        Verdict.VIOLATED,
        -25.0,
        "not reached in 125 iterations; 100 were allowed",
    )
    assert GainSwitchIterations(within=200).evaluate(idle).verdict is Verdict.INCONCLUSIVE


def test_the_sentence_in_seconds_and_that_in_iterations_are_told_apart() -> None:
    scene = alone().scenario
    for sentence, kind in (
        ("gain switch reached within 5 s", GainSwitchReached),
        ("GAIN switch reached within 600 ITERATIONS", GainSwitchIterations),
    ):
        prop = property_of(Claim(sentence=sentence, expected=Verdict.HOLDS), scene)
        assert isinstance(prop, kind)
