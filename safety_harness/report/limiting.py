"""Report how often the settings' limits changed the commands of a controller."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.proportions import share_words
from safety_harness.trace.records import Limit, Mode
from safety_harness.trace.trace import Trace

LIMIT_NAMES = {
    Limit.TCP_SPEED: "TCP speed",
    Limit.TCP_ACCELERATION: "TCP acceleration",
    Limit.JOINT_SPEED: "joint speed",
    Limit.SINGULARITY: "stop near a singularity",
}
BY_FILTER = "safety filter"
SPEEDS = {LIMIT_NAMES[Limit.TCP_SPEED], LIMIT_NAMES[Limit.JOINT_SPEED]}
OFTEN = 0.5  # a share of commands at a limit of speed from which the scale of the actions is in doubt


def limited_commands(trace: Trace) -> Counter[str] | None:
    """Return how many commands each limit changed, by its name; None if the trace does not have limits.

    The key "" counts the commands that any limit changed. Commands of a protective stop do not count.
    """
    if trace.known.missing(["limits"]):
        return None
    flags = trace.ticks["limits"][_moving(trace)]
    counts = Counter({name: int(((flags & int(limit)) != 0).sum()) for limit, name in LIMIT_NAMES.items()})
    counts[""] = int(((flags & sum(map(int, LIMIT_NAMES))) != 0).sum())
    return counts


def _moving(trace: Trace) -> NDArray[np.bool_]:
    """Return (n,) true where no protective stop brakes the arm."""
    return np.asarray(trace.ticks["mode"] != int(Mode.PROTECTIVE_STOP))


def limited_data(trace: Trace) -> dict[str, Any] | None:
    """Return the number of ``commands``, of ``limited`` ones, and of each limit, or None without limits."""
    counts = limited_commands(trace)
    if counts is None:
        return None
    by_limit = {name: counts[name] for name in LIMIT_NAMES.values() if counts[name]}
    if trace.scenario.safety_filter:
        by_limit[BY_FILTER] = int(changed_by_filter(trace).sum())
    return {"commands": int(_moving(trace).sum()), "limited": counts[""], "by_limit": by_limit}


def limit_lines(traces: Iterable[Trace]) -> list[str]:
    """Return a line for each user's controller whose commands a limit changed, with a hint if often.

    The visual servo has no line, because it relies on the limit of the TCP's speed. Each safety filter has a
    line with the number of commands that it changed.
    """
    commands: Counter[str] = Counter()
    limited: dict[str, Counter[str]] = {}
    changed: dict[str, NDArray[np.int64]] = {}
    for trace in traces:
        part = trace.system.safety_filter
        if part is not None and not trace.known.missing(["limits"]):
            own = np.array([changed_by_filter(trace).sum(), len(trace.ticks), overridden_stops(trace)])
            changed[part.name] = changed.get(part.name, np.zeros(3, np.int64)) + own
        counts = limited_commands(trace) if trace.scenario.driven else None
        if counts is not None:
            name = trace.system.controller.name
            commands[name] += int(_moving(trace).sum())
            limited.setdefault(name, Counter()).update(counts)
    lines = [_line(name, counts, commands[name]) for name, counts in limited.items() if counts[""]]
    return lines + [
        f"{BY_FILTER} {name}: changed {count:,} of {of_all:,} commands ({share_words(count, of_all)})"
        + (f", and overrode {stops:,} protective stops of the controller" if stops else "")
        for name, (count, of_all, stops) in ((name, row.tolist()) for name, row in changed.items())
    ]


def overridden_stops(trace: Trace) -> int:
    """Return at how many ticks the safety filter overrode a protective stop of the controller."""
    return int(np.count_nonzero(changed_by_filter(trace) & trace.filtered["wanted_stop"]))


def changed_by_filter(trace: Trace) -> NDArray[np.bool_]:
    """Return (n,) true at each tick at which the safety filter changed the command."""
    return np.asarray(trace.ticks["limits"] & int(Limit.SAFETY_FILTER) != 0)


def _line(name: str, counts: Counter[str], commands: int) -> str:
    parts = ", ".join(f"{limit} {count}" for limit, count in counts.most_common() if limit and count)
    share = counts[""] / commands
    often = max(counts[limit] for limit in SPEEDS) >= OFTEN * commands
    hint = "; are unit and scale of its actions as meant?" if often else ""
    return f"{name}: {counts['']} of {commands} commands limited ({100.0 * share:.1f} %): {parts}{hint}"
