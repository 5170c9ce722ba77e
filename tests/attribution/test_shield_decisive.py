"""Whether the shield or the avoider was decisive."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from safety_harness.admission.admit import admit
from safety_harness.extensions.attribution.shielding import attribute_shield
from safety_harness.report.shielding import slowings
from safety_harness.scenario.model import Verdict
from safety_harness.scenario.read import parse_scenario
from tests.cell.controller.test_shield import REACH, Swings, shielded, swinging


def test_who_was_decisive_is_said_with_when_and_for_whom() -> None:
    text = REACH + "shield: speed and separation\n"
    found = attribute_shield(admit(parse_scenario(text), controller=Swings()))
    assert found is not None
    assert found.summary == f"the shield was decisive: {swinging()[1].margin_text()} without it"
    for run in ("shielded", "plain", "alone"):
        untold = replace(found.plain, verdict=Verdict.INCONCLUSIVE, reason="a joint is NaN from 1.2 s on")
        told = replace(found, **{run: untold}).summary
        assert told == "who was decisive is not known: a joint is NaN from 1.2 s on"
    near = found.shielded.margin_text()
    kept = replace(found, plain=found.shielded)
    assert replace(kept, alone=None).summary == f"the shield was not needed: {near} without it"
    for alone, only in ((found.shielded, "would have sufficed"), (found.plain, "would not have")):
        words = f"the avoider was decisive: {near} without it; the shield alone {only}: {alone.margin_text()}"
        assert replace(kept, alone=alone).summary == words
    trace, _ = shielded()
    stretches = slowings(trace)
    assert stretches == slowings(found.trace)
    slowed = np.zeros(len(trace.ticks), bool)
    for one in stretches:
        slowed |= (trace.time_s >= one.from_s) & (trace.time_s <= one.to_s)
        assert one.hand == "right hand"
        assert one.part != "before the first frame"
    np.testing.assert_array_equal(slowed, trace.interventions["scale"] < 1.0)
    assert min(one.least_scale for one in stretches) == 0.0
    assert attribute_shield(admit(parse_scenario(REACH), controller=Swings())) is None


def test_an_avoider_that_gives_way_to_a_slow_hand_is_decisive_before_its_shield() -> None:
    slow = REACH.replace("2 m/s", "150 mm/s").replace("after: 1 s", "after: 9 s").replace("4 s", "6 s", 1)
    text = f"{slow}avoider: opposite pose\nshield: speed and separation\n"
    found = attribute_shield(admit(parse_scenario(text)))
    assert found is not None
    assert found.summary.startswith("the avoider was decisive: ")
