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
AS_MEANT = "are unit and scale of its actions as meant?"
OFTEN = 0.15  # a share of commands at a limit of speed from which the scale of the actions is in doubt


def limited_commands(trace: Trace) -> Counter[str] | None:
    """Return the number of commands that each limit changed, with the limit's name as the key.

    The result is None if the trace does not have limits. The key "" counts the commands that any limit
    changed. Commands of a protective stop are not counted.
    """
    if trace.known.missing(["limits"]):
        return None
    flags = trace.ticks["limits"][_moving(trace)]
    counts = Counter({name: int(((flags & int(limit)) != 0).sum()) for limit, name in LIMIT_NAMES.items()})
    counts[""] = int(((flags & sum(map(int, LIMIT_NAMES))) != 0).sum())
    return counts


def _moving(trace: Trace) -> NDArray[np.bool_]:
    """Return the ticks at which no protective stop brakes the arm, as a mask (n,)."""
    return np.asarray(trace.ticks["mode"] != int(Mode.PROTECTIVE_STOP))


def limited_data(trace: Trace) -> dict[str, Any] | None:
    """Return the number of ``commands``, the number of ``limited`` commands, and the number for each limit.

    The result is None if the trace does not have limits.
    """
    counts = limited_commands(trace)
    if counts is None:
        return None
    by_limit = {name: counts[name] for name in LIMIT_NAMES.values() if counts[name]}
    if trace.scenario.safety_filter:
        by_limit[BY_FILTER] = int(changed_by_filter(trace).sum())
    return {"commands": int(_moving(trace).sum()), "limited": counts[""], "by_limit": by_limit}


class LimitTally:
    """Counts of limited commands.

    For each user's controller, the object counts the commands that limits changed. For each safety filter,
    the object counts the commands that the filter changed. The visual servo is left out, because it relies on
    the limit of the TCP's speed.
    """

    def __init__(self) -> None:
        self._commands: Counter[str] = Counter()
        self._limited: dict[str, Counter[str]] = {}
        self._changed: dict[str, NDArray[np.int64]] = {}

    def add(self, trace: Trace) -> None:
        """Count the commands of a run."""
        part = trace.system.safety_filter
        if part is not None and not trace.known.missing(["limits"]):
            own = np.array([changed_by_filter(trace).sum(), len(trace.ticks), overridden_stops(trace)])
            self._changed[part.name] = self._changed.get(part.name, np.zeros(3, np.int64)) + own
        counts = limited_commands(trace) if trace.scenario.driven else None
        if counts is not None:
            name = trace.system.controller.name
            self._commands[name] += int(_moving(trace).sum())
            self._limited.setdefault(name, Counter()).update(counts)

    @property
    def lines(self) -> list[str]:
        """The lines on each controller with limited commands and on each filter.

        A controller's line has a hint if many of its commands were limited.
        """
        limited = [_line(name, n, self._commands[name]) for name, n in self._limited.items() if n[""]]
        return limited + [
            f"{BY_FILTER} {name}: changed {count:,} of {of_all:,} commands ({share_words(count, of_all)})"
            + (f", and overrode {stops:,} protective stops of the controller" if stops else "")
            for name, (count, of_all, stops) in ((name, row.tolist()) for name, row in self._changed.items())
        ]


def limit_lines(traces: Iterable[Trace]) -> list[str]:
    """Return the lines of ``LimitTally`` for the runs."""
    tally = LimitTally()
    for trace in traces:
        tally.add(trace)
    return tally.lines


def overridden_stops(trace: Trace) -> int:
    """Return at how many ticks the safety filter overrode a protective stop of the controller."""
    return int(np.count_nonzero(changed_by_filter(trace) & trace.filtered["wanted_stop"]))


def changed_by_filter(trace: Trace) -> NDArray[np.bool_]:
    """Return the ticks at which the safety filter changed the command, as a mask (n,)."""
    return np.asarray(trace.ticks["limits"] & int(Limit.SAFETY_FILTER) != 0)


def _line(name: str, counts: Counter[str], commands: int) -> str:
    parts = ", ".join(f"{limit} {count}" for limit, count in counts.most_common() if limit and count)
    share = counts[""] / commands
    often = max(counts[limit] for limit in SPEEDS) >= OFTEN * commands
    hint = f"; {AS_MEANT}" if often else ""
    return f"{name}: {counts['']} of {commands} commands limited ({100.0 * share:.1f} %): {parts}{hint}"
