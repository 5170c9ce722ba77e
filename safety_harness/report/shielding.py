"""What the shields of runs did, in words and as data: how many ticks were slowed, and for which part."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Any

from safety_harness.properties.true_motion import capsules_of
from safety_harness.trace.trace import Trace

NOTHING_SEEN = "before the first frame"


def slowed_by_part(trace: Trace) -> Counter[str]:
    """How many ticks were slowed for each part of the arm, by its name; empty without a shield."""
    done, names = trace.interventions, capsules_of(trace).names
    slowed = done["capsule"][done["scale"] < 1.0].tolist()
    return Counter(names[k].replace("_", " ") if k >= 0 else NOTHING_SEEN for k in slowed)


def shield_data(trace: Trace) -> dict[str, Any] | None:
    """``ticks``, ``slowed``, ``by_part`` and the ``least_scale``; None for a run without a shield."""
    if len(trace.interventions) == 0:
        return None
    by_part = slowed_by_part(trace)
    return {
        "ticks": len(trace.interventions),
        "slowed": by_part.total(),
        "by_part": dict(by_part.most_common()),
        "least_scale": float(trace.interventions["scale"].min()),
    }


def shield_lines(traces: Iterable[Trace]) -> list[str]:
    """One line on all runs that have a shield; none where no run has."""
    shielded = [trace for trace in traces if len(trace.interventions)]
    if not shielded:
        return []
    by_part = sum(map(slowed_by_part, shielded), Counter[str]())
    ticks, slowed = sum(len(one.interventions) for one in shielded), by_part.total()
    parts = ", ".join(f"{part} {count}" for part, count in by_part.most_common())
    line = f"slowed {slowed} of {ticks} ticks ({slowed / ticks:.1%})".replace("%", " %")
    return [line + (f": {parts}" if parts else "")]
