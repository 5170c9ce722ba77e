"""Measure the smallest break that each claim catches.  Run: nice python benchmarks/smallest_breaks.py.

A break is planted in a run, in its motion or in its record, by a magnitude beyond what the claim allows.
The magnitude is bisected between one that is not caught and one that is.  The limits come from here.
Writes docs/smallest-breaks.json; ``python docs/tables.py`` shows it.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "tests" / "properties")]

from broken import passing  # noqa: E402
from examples import VISIT, ConstantSpeed, Displaced, hand, run, scenario  # noqa: E402
from harmless import CERTAIN, IN_DOUBT, Astray  # noqa: E402
from test_fallback_resolution import BUILT_IN, gone  # noqa: E402

from safety_harness.admission.claims import property_of  # noqa: E402
from safety_harness.robot.kinematics import links_in_base  # noqa: E402
from safety_harness.robot.robots import arm_capsules, arm_model  # noqa: E402
from safety_harness.scenario.model import Claim, Verdict  # noqa: E402
from safety_harness.settings import DEFAULTS  # noqa: E402
from safety_harness.trace.records import Mode  # noqa: E402
from safety_harness.trace.trace import Trace  # noqa: E402

RESULTS = ROOT / "docs" / "smallest-breaks.json"
STEPS = 40  # of the bisection, at most
RELATIVE = 1e-3  # of the smallest break, to which it is bisected
LEAST = 1e-6  # a smaller break is not looked for
TO_HAND = np.array([1.0, -1.0, -0.5]) / 1.5  # where a hand rests, from the TCP


@dataclass(frozen=True)
class Break:
    """A way to break a claim: ``plant`` makes the run with a magnitude, which is caught at ``most``.

    ``shown`` are unit and factor from the magnitude; ``whole`` magnitudes are counts.
    """

    sentence: str
    what: str
    plant: Callable[[float], Trace]
    most: float
    shown: tuple[str, float] = ("mm", 1e3)
    whole: bool = False


def caught(sentence: str, trace: Trace) -> bool:
    """Is the claim violated?"""
    claim = Claim(sentence=sentence, expected=Verdict.HOLDS)
    return property_of(claim, trace.scenario).evaluate(trace).verdict is Verdict.VIOLATED


def smallest(one: Break) -> float:
    """The least magnitude that is caught; ValueError if none is, or if the sound run is violated."""
    low, high = 0.0, one.most
    if caught(one.sentence, one.plant(low)) or not caught(one.sentence, one.plant(high)):
        raise ValueError(f"{one.sentence}: {one.what} does not tell right from wrong")
    for _ in range(STEPS):
        if high - low <= (1.0 if one.whole else max(LEAST, RELATIVE * high)):
            break
        middle = float((low + high) // 2.0) if one.whole else 0.5 * (low + high)
        low, high = (low, middle) if caught(one.sentence, one.plant(middle)) else (middle, high)
    return high


def with_tick(trace: Trace, name: str, at: Any, value: Any) -> Trace:
    """With another value in a column of the ticks."""
    ticks = trace.ticks.copy()
    ticks[name][at] = value
    return replace(trace, ticks=ticks)


def with_decision(trace: Trace, name: str, value: Any) -> Trace:
    """With another value in the first decision."""
    decisions = trace.decisions.copy()
    decisions[name][0] = value
    return replace(trace, decisions=decisions)


def tcp_of(trace: Trace) -> Any:
    """(3,) the TCP at the first decision."""
    return trace.ticks["transform_tcp_to_base"][int(trace.decisions["tick"][0]), :3, 3]


def away(trace: Trace, way_m: float, hand_in_base_m: Any) -> Any:
    """(3,) a position ``way_m`` beyond the TCP as seen from a hand (3,), and 100 mm aside."""
    apart = tcp_of(trace) - hand_in_base_m
    unit = apart / np.linalg.norm(apart)
    aside = np.cross(unit, (0.0, 0.0, 1.0))
    return tcp_of(trace) + way_m * unit + 0.1 * aside / np.linalg.norm(aside)


def surface_m(trace: Trace, hand_in_base_m: Any) -> float:
    """How far a hand's sphere at (3,) is from the arm at the first tick, by 4,001 points on each axis."""
    tick, robot = trace.ticks[0], trace.scenario.robot
    links, arm = links_in_base(arm_model(robot), tick["joint_position_rad"]), arm_capsules(robot)
    share, found = np.linspace(0.0, 1.0, 4001)[:, None], np.inf
    for k, link in enumerate(arm.link_index):
        points = (1.0 - share) * arm.start_in_link[k] + share * arm.end_in_link[k]
        points = points @ links[link][:3, :3].T + links[link][:3, 3] - hand_in_base_m
        found = min(found, float(np.linalg.norm(points, axis=1).min()) - arm.radius_m[k])
    return found - trace.scenario.settings.hand.radius_m


def resting(in_base_m: Any) -> Trace:
    """A hand that rests beside an arm that stands still."""
    there = replace(hand(), starts_at_in_base_m=tuple(in_base_m))
    there = replace(there, elbow_towards_in_base_m=tuple(in_base_m + 5.0 * TO_HAND))
    return run(scenario(there, duration_s=0.1), controller=ConstantSpeed((0.0,) * 6))


def nearer(by_m: float) -> Trace:
    """A resting hand whose true distance is 50 mm less ``by_m``."""
    tcp_m = np.array(DEFAULTS.cell.desired_tcp_position_in_base_m) + (0.04, -0.12, 0.06)
    arm, low, high = resting(tcp_m + 0.3 * TO_HAND), 0.1, 0.3
    while high - low > 1e-8:
        middle = 0.5 * (low + high)
        near = surface_m(arm, tcp_m + middle * TO_HAND) < 0.05 - by_m
        low, high = (middle, high) if near else (low, middle)
    return resting(tcp_m + high * TO_HAND)


def towards(trace: Trace, by_m: float) -> Trace:
    """A run as ``trace``, in which the avoider's way leads towards the hand by ``by_m``."""
    hand_m = trace.ticks["hand_position_in_base_m"][int(trace.decisions["tick"][0]), 0]
    by = away(trace, -by_m, hand_m) - tcp_of(trace)
    return run(scenario(VISIT), avoider=Displaced(tuple(by)), gate=passing())


def breaks() -> list[Break]:
    """Every break that is measured."""
    visit, sure = run(scenario(VISIT)), run(scenario(VISIT), avoider=CERTAIN)
    arm, first = arm_model(visit.scenario.robot), int(visit.decisions["tick"][0])
    hand_m = visit.ticks["hand_position_in_base_m"][first, 0]
    seen_m = visit.decisions["hand_position_in_base_m"][0]
    fall, used = "uncertain answers fall back within 2 cycles", "certain answers are used"
    doubt = run(scenario(VISIT), avoider=IN_DOUBT)
    up = np.array([0.0, 0.0, 1.0])
    return [
        Break(fall, "direction, off", lambda m: gone(BUILT_IN, Astray(off_deg=m)), 8.0, ("deg", 1.0)),
        Break(
            fall,
            "onset, late beyond 2",
            lambda m: gone(BUILT_IN, Astray(late=int(m) + 2)),
            8.0,
            ("cycles", 1.0),
            True,
        ),
        Break(fall, "speed, lost", lambda m: gone(BUILT_IN, Astray(speed=1.0 - m)), 0.5, ("%", 100.0)),
        Break(fall, "end, sideways", lambda m: gone(BUILT_IN, Astray(aside_m=m)), 0.02),
        Break(
            fall,
            "position handed over, beyond 1 mm",
            lambda m: with_decision(
                doubt,
                "chosen_position_in_base_m",
                doubt.decisions["chosen_position_in_base_m"][0] + (0.001 + m - 1e-6 * (m == 0)) * up,
            ),
            0.1,
        ),
        Break(
            used,
            "position handed over, beyond 1 mm",
            lambda m: with_decision(
                sure,
                "chosen_position_in_base_m",
                sure.decisions["proposed_position_in_base_m"][0] + (0.001 + m - 1e-6 * (m == 0)) * up,
            ),
            0.1,
        ),
        Break(
            "joint speeds within limits",
            "one joint in one tick, beyond its limit",
            lambda m: with_tick(visit, "joint_velocity_radps", (first, 0), arm.velocity_limit_radps[0] + m),
            1.0,
            ("deg/s", 180.0 / np.pi),
        ),
        Break(
            "TCP speed never above 250 mm/s",
            "one tick, beyond the limit",
            lambda m: with_tick(visit, "tcp_speed_mps", first, 0.25 + m),
            1.0,
            ("mm/s", 1e3),
        ),
        Break(
            "joint positions within limits",
            "one joint in one tick, beyond its end",
            lambda m: with_tick(visit, "joint_position_rad", (first, 0), arm.position_upper_rad[0] + m),
            1.0,
            ("deg", 180.0 / np.pi),
        ),
        Break(
            "proposals lead away to within 10 mm",
            "a proposal nearer than that to the hand",
            lambda m: with_decision(visit, "proposed_position_in_base_m", away(visit, -0.01 - m, seen_m)),
            0.05,
        ),
        Break(
            "repulsion moves away from every hand",
            "a way towards the hand",
            lambda m: towards(visit, m - 1e-4 * (m == 0)),
            0.05,
        ),
        Break("hand distance never below 50 mm", "a resting hand, beyond the limit", nearer, 0.01),
        Break(
            "fallback poses reachable and away",
            "a pose towards the hand",
            lambda m: with_decision(
                visit, "opposite_position_in_base_m", away(visit, (1e-6 if m == 0 else -m), hand_m)
            ),
            0.05,
        ),
        Break(
            "gives way within 100 ms of a predicted hand",
            "ticks without an answer, beyond 12",
            lambda m: with_tick(visit, "mode", slice(first, first + 12 + int(m)), Mode.SERVOING),
            30.0,
            ("cycles", 1.0),
            True,
        ),
        Break(
            "trace finite and monotone",
            "one value that is not finite",
            lambda m: with_tick(visit, "sse", first, np.nan if m else visit.ticks["sse"][first]),
            1.0,
            ("value", 1.0),
            True,
        ),
    ]


def measured(found: list[Break]) -> list[dict[str, Any]]:
    """A row for each break."""
    return [
        {
            "claim": one.sentence,
            "what": one.what,
            "smallest": float(f"{smallest(one) * one.shown[1]:.2g}"),
            "unit": one.shown[0],
        }
        for one in found
    ]


if __name__ == "__main__":
    RESULTS.write_text(json.dumps(measured(breaks()), indent=1) + "\n")
