"""Report how a shield slowed the arm in a run.

The report states when and how strongly the shield acted, for which part of the arm, and for which hand.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from safety_harness.base.geometry.segments import point_segment_distance
from safety_harness.cell.robot.distance import place_capsules
from safety_harness.cell.robot.kinematics import links_in_base
from safety_harness.cell.robot.robots import arm_model
from safety_harness.claims.properties.shield_theorem import broken_assumptions, counts_words
from safety_harness.claims.properties.touching import theorem_bits
from safety_harness.claims.signals.true_motion import capsules_of
from safety_harness.trace.trace import Trace

NOTHING_SEEN = "before the first frame"


def slowed_by_part(trace: Trace) -> Counter[str]:
    """Count the slowed ticks for each part of the arm, and return the counts by the name of the part.

    The result is empty without a shield.
    """
    done, names = trace.interventions, capsules_of(trace).names
    slowed = done["capsule"][done["scale"] < 1.0].tolist()
    return Counter(names[k].replace("_", " ") if k >= 0 else NOTHING_SEEN for k in slowed)


@dataclass(frozen=True)
class Slowing:
    """A stretch of ticks in which a shield slowed the arm.

    ``least_scale`` is the lowest speed scale. ``part`` is the part of the arm that caused this scale, and
    ``hand`` is the hand nearest to this part at that tick.
    """

    from_s: float
    to_s: float
    part: str
    hand: str  # the hand truly nearest to ``part`` at the slowest tick; empty if none
    least_scale: float

    def __str__(self) -> str:
        cause = f" from {self.hand}" if self.hand else ""
        return (
            f"{self.from_s:.3f} to {self.to_s:.3f} s: {self.part}{cause}, "
            f"down to {100.0 * self.least_scale:.0f} % of the speed"
        )


def slowings(trace: Trace) -> list[Slowing]:
    """Return all slowed stretches in order of time, or an empty list without a shield."""
    slowed = np.concatenate([[False], trace.interventions["scale"] < 1.0, [False]])
    edges = np.flatnonzero(slowed[1:] != slowed[:-1]).reshape(-1, 2)
    return [_slowing(trace, int(begin), int(end)) for begin, end in edges]


def _slowing(trace: Trace, begin: int, end: int) -> Slowing:
    done = trace.interventions[begin:end]
    slowest = int(np.argmin(done["scale"]))
    number, time_s, hand = int(done["capsule"][slowest]), trace.time_s, ""
    part = capsules_of(trace).names[number].replace("_", " ") if number >= 0 else NOTHING_SEEN
    if number >= 0 and trace.scenario.hands:
        tick, ends_m = trace.ticks[begin + slowest], np.empty((1, 2, 3))
        transforms = links_in_base(arm_model(trace.scenario.robot), tick["joint_position_rad"])
        place_capsules(capsules_of(trace).records[number : number + 1], transforms, ends_m)
        hands_m = tick["hand_position_in_base_m"][: len(trace.scenario.hands)]
        away_m = [point_segment_distance(hand_m, *ends_m[0]) for hand_m in hands_m]
        hand = trace.scenario.hands[int(np.argmin(away_m))].name
    return Slowing(float(time_s[begin]), float(time_s[end - 1]), part, hand, float(done["scale"][slowest]))


def shield_data(trace: Trace) -> dict[str, Any] | None:
    """Return data on the shield of a run, or None if the run has no shield.

    The data contain ``ticks``, ``slowed``, ``by_part`` and ``least_scale``. The data also contain the slowed
    stretches and the assumptions that the run broke.
    """
    if len(trace.interventions) == 0:
        return None
    by_part = slowed_by_part(trace)
    return {
        "ticks": len(trace.interventions),
        "slowed": by_part.total(),
        "by_part": dict(by_part.most_common()),
        "least_scale": float(trace.interventions["scale"].min()),
        "slowings": [asdict(item) for item in slowings(trace)],
        "broken_assumptions": [item.text for item in broken_assumptions(trace)],
    }


def shield_lines(traces: Iterable[Trace]) -> list[str]:
    """Return lines that summarise all runs with a shield, or an empty list if no run has a shield."""
    shielded = [trace for trace in traces if len(trace.interventions)]
    if not shielded:
        return []
    by_part = sum(map(slowed_by_part, shielded), Counter[str]())
    ticks, slowed = sum(len(run.interventions) for run in shielded), by_part.total()
    parts = ", ".join(f"{part} {count}" for part, count in by_part.most_common())
    line = f"slowed {slowed} of {ticks} ticks ({slowed / ticks:.1%})".replace("%", " %")
    stands = counts_words(Counter(map(theorem_bits, shielded)).items())
    broken = [
        f"{run.scenario.name}: {items[0].text}" for run in shielded if (items := broken_assumptions(run))
    ]
    return [line + (f": {parts}" if parts else ""), stands, *broken[:10]]
