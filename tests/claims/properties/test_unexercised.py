"""A claim that was never exercised says how near the run came, and what it advises exercises the claim."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from broken import CERTAIN, IN_DOUBT, TOO_FAR
from examples import Displaced, Raising, hand, scenario

from safety_harness.admission.admit import admit
from safety_harness.admission.claims import property_of
from safety_harness.admission.trial import run_kinematic
from safety_harness.base.settings import DEFAULTS, DecisionTimes, Settings
from safety_harness.cell.avoidance.avoider import Avoider
from safety_harness.claims.properties.base import Evaluation
from safety_harness.claims.properties.catalogue import CATALOGUE
from safety_harness.claims.properties.entry import CatalogueEntry
from safety_harness.claims.signals.occasions import beside, nearest_of
from safety_harness.scenario.gate import AskedRegion, GateRule, PositionBox
from safety_harness.scenario.model import Claim, MovingHand, Verdict
from safety_harness.scenario.moves import MoveTo, Wait, Withdraw
from safety_harness.scenario.obstacles import Obstacle
from safety_harness.trace.trace import Trace

SLOW = replace(
    DEFAULTS, avoidance=replace(DEFAULTS.avoidance, decision_time=DecisionTimes(quantiles_s=(0.04,)))
)
OUT_OF_REACH = Displaced((2.0, 0.0, 0.0))
OFF = (0.04, -0.12, 0.06)
NUMBER = r"(-?[\d.]+)"
OF_THE_AVOIDER = (  # which no number tells
    "computing time not modelled|gives no spread|no answer had a spread|the gate has no region"
)
EVERYWHERE = PositionBox(low_m=(-9.0, -9.0, -9.0), high_m=(9.0, 9.0, 9.0))
REGION = GateRule(questions_within=AskedRegion(hand=EVERYWHERE, tcp=EVERYWHERE))


def visit(place: tuple[float, float, float] = (0.84, -0.35, 0.25), stays_s: float = 0.6) -> MovingHand:
    return hand(
        MoveTo(position_in_base_m=place, speed_mps=1.0), Wait(duration_s=stays_s), Withdraw(speed_mps=1.0)
    )


@dataclass(frozen=True)
class Situation:
    hand: MovingHand | None = None
    offset: tuple[float, float, float] = OFF
    duration_s: float = 2.5
    avoider: Avoider = CERTAIN
    settings: Settings = DEFAULTS
    obstacles: tuple[Obstacle, ...] = ()
    gate: GateRule | None = None

    @lru_cache(maxsize=40)  # noqa: B019
    def trace(self) -> Trace:
        what = scenario(
            *([self.hand] if self.hand else []),
            duration_s=self.duration_s,
            offset=self.offset,
            settings=self.settings,
        )
        what = replace(what, obstacles=self.obstacles, gate=self.gate)
        return run_kinematic(admit(what, avoider=self.avoider))

    def judged(self, entry: CatalogueEntry) -> Evaluation:
        trace = self.trace()
        return property_of(Claim(sentence=entry.example, expected=Verdict.HOLDS), trace.scenario).evaluate(
            trace
        )


NEAR = Situation(visit())
STAYS = hand(MoveTo(position_in_base_m=(0.8, -0.25, 0.3), speed_mps=1.0), Wait(duration_s=9.0))
BOX = Obstacle(size_m=(0.1, 0.1, 0.1), position_in_base_m=(0.0, 1.0, 0.5))
IDLE = {
    "nobody, and nothing to do": Situation(offset=(0.0, 0.0, 0.0), duration_s=1.0),
    "a hand that stays away": Situation(visit((1.0, -0.65, 0.25))),
    "a hand that stays": Situation(hand(Wait(duration_s=9.0), at=(0.84, -0.35, 0.25)), duration_s=1.0),
    "in doubt": replace(NEAR, avoider=IN_DOUBT),
    "without a spread": replace(NEAR, avoider=Displaced((0.0, 0.05, 0.08))),
    "silent": replace(NEAR, avoider=Raising()),
    "a hand at the very end": replace(NEAR, duration_s=0.45),
}


def followed(now: Situation, reason: str) -> Situation:
    """``now`` changed as ``reason`` advises."""
    if found := re.search(
        f"came to {NUMBER} mm of .* at {NUMBER} s; within {NUMBER} mm exercises it", reason
    ):
        return replace(now, hand=approaching(now, *(float(number) for number in found.groups())))
    advised: dict[str, dict[str, Any]] = {
        "in this scenario; one within": {"hand": visit()},
        "a decision time in the settings exercises it": {"settings": SLOW},
        "a hand that leaves earlier": {"hand": visit()},
        "that stays until the arm comes back exercises it": {"hand": STAYS, "duration_s": 8.0},
        "farther": {"offset": OFF},
        "above .* the avoider's threshold, exercises it": {"avoider": IN_DOUBT},
        "at most .* the avoider's threshold, exercises it": {"avoider": CERTAIN},
        "one that does exercises it": {"avoider": CERTAIN},
        "one of an avoider that states both exercises it": {"avoider": CERTAIN},
        "a box in the cell exercises it": {"obstacles": (BOX,)},
        "questions within exercises it": {"gate": REGION},
        "a usable one to a question within": {"hand": visit(), "avoider": CERTAIN, "duration_s": 2.5},
        "one usable answer exercises it": {"avoider": CERTAIN},
        "neither within reach exercises it": {"avoider": OUT_OF_REACH, "settings": TOO_FAR},
        "beyond .* mm.* exercises it": {"hand": visit(stays_s=0.1), "duration_s": 3.0},
    }
    for advice, changed in advised.items():
        if re.search(advice, reason):
            return replace(now, **changed)
    if found := re.search(f"a duration of {NUMBER} s exercises it if no hand comes near again", reason):
        return replace(now, duration_s=float(found[1]), hand=now.hand and visit())
    if found := re.search(f"longer than {NUMBER} s exercises it", reason):
        return replace(now, duration_s=float(found[1]) + 1.0)
    assert re.search("longer duration|before the end of the run exercises it", reason), reason
    return replace(now, duration_s=2.0 * now.duration_s)


def approaching(now: Situation, came_mm: float, time_s: float, within_mm: float) -> MovingHand:
    """The visiting hand, its way that much longer."""
    assert now.hand is not None
    first = now.hand.moves[0]
    assert isinstance(first, MoveTo)
    place = np.array(first.position_in_base_m)
    trace = now.trace()
    tick = round(time_s / trace.scenario.settings.clock.control_period_s)
    way = trace.ticks["transform_tcp_to_base"][tick, :3, 3] - place
    nearer = place + (came_mm - within_mm + 20.0) * 1e-3 * way / np.linalg.norm(way)
    return visit((float(nearer[0]), float(nearer[1]), float(nearer[2])))


IDS = [entry.example.replace(" ", "-") for entry in CATALOGUE]
ALWAYS = [entry for entry in CATALOGUE if entry.exercised == "always"]


@pytest.mark.parametrize("entry", CATALOGUE, ids=IDS)
def test_what_is_advised_exercises_the_claim(entry: CatalogueEntry) -> None:
    untested = {name: now for name, now in IDLE.items() if now.judged(entry).exercised == 0}
    assert bool(untested) is (entry not in ALWAYS)
    for name, now in untested.items():
        reasons = []
        for _ in range(5):
            found = now.judged(entry)
            if found.exercised:
                break
            reasons.append(found.reason)
            assert found.verdict is not Verdict.HOLDS
            now = followed(now, found.reason)
        assert now.judged(entry).exercised, (name, reasons)


@pytest.mark.parametrize("entry", CATALOGUE, ids=IDS)
def test_a_reason_has_the_numbers_of_its_run(entry: CatalogueEntry) -> None:
    for name, now in IDLE.items():
        found = now.judged(entry)
        if found.exercised == 0 and not re.search(OF_THE_AVOIDER, found.reason):
            assert re.search(
                rf"{NUMBER} (mm|s|ms|deg|mrad/s|mm/s)\b|questions: \d|= [\d.e-]+;", found.reason
            ), (
                name,
                found.reason,
            )


def test_the_nearest_hand_is_that_of_the_trace() -> None:
    trace = IDLE["a hand that stays away"].trace()
    apart = trace.ticks["hand_position_in_base_m"][:, 0] - trace.ticks["transform_tcp_to_base"][:, :3, 3]
    distance_m = np.linalg.norm(apart, axis=1)
    tick = int(np.argmin(distance_m))
    told = nearest_of(trace, distance_m, 0.4, "hand")
    assert told == (
        f"the nearest hand came to {distance_m[tick] * 1e3:.1f} mm of the TCP at {0.008 * tick:.3f} s; "
        "within 400 mm exercises it"
    )


def test_a_number_is_never_rounded_onto_its_limit() -> None:
    assert beside(0.40001, 0.4, "mm", 1e3) == "400.01 mm"
    assert beside(0.4, 0.4, "mm", 1e3) == "400.0 mm"
