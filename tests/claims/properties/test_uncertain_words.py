"""What a controller told, beside columns that are uncertain: a verdict is that of every true run, or none."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from test_uncertain_columns import HAND, TCP, agree, measured, run

from safety_harness.claims.properties.base import Property
from safety_harness.claims.properties.giving_way import MovesAway
from safety_harness.claims.properties.hand_prediction import HandPredictions
from safety_harness.claims.properties.reaction import GivesWay, GivesWayToTrueHand, NoFalseAlarms
from safety_harness.claims.signals.predictions import prediction_errors_m
from safety_harness.claims.signals.true_motion import nearest_hand_m
from safety_harness.scenario.model import Verdict
from safety_harness.trace.known import Gap, Measurement, Source
from safety_harness.trace.records import Mode
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import knowing

Drawn = tuple[Property, Trace, tuple[str, ...]]
DRAWS = 40


def answering(rng: np.random.Generator, trace: Trace) -> Trace:
    """With a controller that gives way at any time about that at which a hand is as near as is critical."""
    ticks, nearest_m = trace.ticks.copy(), nearest_hand_m(trace)
    critical_m = float(rng.uniform(nearest_m.min() + 0.01, nearest_m.min() + 0.15))
    near = np.flatnonzero(nearest_m < critical_m)
    begins = int(np.clip(near[0] + rng.integers(-10, 40), 0, len(ticks) - 2))
    ends = int(np.clip(near[-1] + rng.integers(-20, 40), begins + 1, len(ticks)))
    ticks["mode"] = Mode.SERVOING
    ticks["mode"][begins:ends] = Mode.REPULSING
    settings = trace.scenario.settings
    settings = replace(settings, avoidance=replace(settings.avoidance, critical_distance_m=critical_m))
    return replace(trace, ticks=ticks, scenario=replace(trace.scenario, settings=settings))


def predicted(rng: np.random.Generator, trace: Trace) -> Drawn:
    prop = GivesWay(within_s=0.008 * float(rng.integers(0, 60)))
    return prop, answering(rng, trace), ("mode", "track_valid", "predicted_hand_in_base_m")


def true(rng: np.random.Generator, trace: Trace) -> Drawn:
    return GivesWayToTrueHand(within_s=0.008 * float(rng.integers(0, 40))), answering(rng, trace), ("mode",)


def alarms(rng: np.random.Generator, trace: Trace) -> Drawn:
    found = answering(rng, trace)
    begun = float(nearest_hand_m(found)[found.ticks["mode"] == Mode.REPULSING][0])
    return NoFalseAlarms(within_m=begun + float(rng.uniform(-0.05, 0.08))), found, ("mode", "limits")


def foreseen(rng: np.random.Generator, trace: Trace) -> Drawn:
    errors_m = prediction_errors_m(trace)
    worst_m = float(errors_m[trace.ticks["track_valid"][: len(errors_m)]].max())
    return HandPredictions(maximum_m=worst_m + float(rng.uniform(-0.02, 0.02))), trace, ("track_valid",)


def away(rng: np.random.Generator, trace: Trace) -> Drawn:
    decisions = trace.decisions.copy()
    decisions["chosen_position_in_base_m"] += rng.normal(0.0, rng.choice([0.001, 0.1]), (len(decisions), 3))
    prop = MovesAway(tolerance_m=float(rng.choice([0.0, 0.005, 0.02])))
    return prop, replace(trace, decisions=decisions), ()


DRAWN = {"predicted": predicted, "true": true, "alarms": alarms, "foreseen": foreseen, "away": away}


def with_gaps(rng: np.random.Generator, trace: Trace, seen: Trace, names: tuple[str, ...]) -> Trace:
    """``seen`` without some words: about where the mode changes, and anywhere."""
    changes = np.flatnonzero(np.diff(trace.ticks["mode"])) + 1
    columns = {}
    for name in names:
        if rng.uniform() < 0.4:
            continue
        at = (
            int(rng.choice(changes))
            if len(changes) and rng.uniform() < 0.7
            else int(rng.integers(len(seen.ticks)))
        )
        first = max(at - int(rng.integers(1, 8)), 0)
        gap = Gap(first=first, after=min(at + int(rng.integers(1, 8)), len(seen.ticks)))
        columns[name] = replace(seen.known.column(name), source=Source.LOG, gaps=(gap,))
    if "predicted_hand_in_base_m" in names and rng.uniform() < 0.5:
        ticks, off = seen.ticks.copy(), rng.normal(size=seen.ticks["predicted_hand_in_base_m"].shape)
        off /= np.linalg.norm(off, axis=-1, keepdims=True)
        ticks["predicted_hand_in_base_m"] += 0.00999 * off
        gaps = columns.get("predicted_hand_in_base_m", Measurement()).gaps
        columns["predicted_hand_in_base_m"] = Measurement(source=Source.LOG, uncertainty=0.01, gaps=gaps)
        seen = replace(seen, ticks=ticks)
    return knowing(seen, columns)


@pytest.mark.parametrize("name", DRAWN)
@pytest.mark.parametrize("which", ["visit", "comes"])
def test_what_is_said_of_words_is_so_for_the_truth(name: str, which: str) -> None:
    rng = np.random.default_rng([20261124, *name.encode(), len(which)])
    seen: Counter[Verdict] = Counter()
    for _ in range(DRAWS):
        prop, truth, names = DRAWN[name](rng, run(which))
        evaluated = prop.evaluate(truth)
        found = prop.evaluate(with_gaps(rng, truth, measured(rng, truth), names))
        assert agree(found, evaluated), (found, evaluated)
        seen[found.verdict] += 1
    assert seen[Verdict.INCONCLUSIVE] > 0
    assert len(seen) > 1 or (name, which) == ("away", "comes")  # whose way is never clear


def test_what_was_told_alone_is_as_certain_as_ever() -> None:
    trace = run("visit")
    told = {name: Measurement(source=Source.LOG) for name in ("mode", "limits", "track_valid", TCP, HAND)}
    for prop in (GivesWay(within_s=0.1), NoFalseAlarms(), HandPredictions(maximum_m=0.1), MovesAway()):
        assert prop.evaluate(knowing(trace, told)) == prop.evaluate(trace)
