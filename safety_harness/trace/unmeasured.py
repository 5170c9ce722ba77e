"""Where a trace was not measured, for whoever shows, counts or repeats it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import Place, TraceError
from safety_harness.trace.known import NOWHERE, OF_DECISIONS, Knowledge, Measurement
from safety_harness.trace.records import DECISION
from safety_harness.trace.trace import Trace


def measured(trace: Trace, name: str) -> NDArray[np.bool_]:
    """(n,) the ticks at which a column was measured, of each hand (n, hands) if it is one of hands."""
    return trace.known.measured(name, trace.ticks)


def decided(trace: Trace, *names: str) -> bool:
    """Were these fields of its decisions measured, or all of them if none is named?"""
    fields = names or DECISION.names or ()
    return not trace.known.missing(f"{OF_DECISIONS}{name}" for name in fields)


def as_measured(trace: Trace) -> Trace:
    """The same with blanks for what was not measured, whatever is stored there."""
    return trace if trace.known.whole else knowing(trace, trace.known.columns)


def without_gaps(trace: Trace, names: Iterable[str]) -> Trace:
    """The same with zeros in the gaps of the columns ``names``, so nothing there is wrong."""
    lacking = [] if trace.known.whole else [name for name in names if trace.known.of(name).gaps]
    if not lacking:
        return trace
    ticks = trace.ticks.copy()
    for name in lacking:
        ticks[name][~measured(trace, name)] = np.zeros((), ticks[name].dtype)
    return replace(trace, ticks=ticks)


def refuse_not_simulated(trace: Trace, file: Path | None = None) -> None:
    """TraceError, naming ``file``, for a trace that cannot be run again, as no run of ours gave it."""
    if trace.known.simulated:
        return
    sources = Counter(one.source.value for one in trace.known.columns.values() if one != Measurement())
    expected = "a trace that was simulated, since only that can be run again"
    hint = "" if file is None else f"safety-harness judge {file}"
    got = f"columns that are {', '.join(f'{source} ({count})' for source, count in sources.items())}"
    raise TraceError(place=Place(file=file, field="known"), expected=expected, got=got, hint=hint)


def knowing(trace: Trace, columns: Mapping[str, Measurement]) -> Trace:
    """``trace`` with this known of ``columns``, beside what is known of others; what is not is blanked.

    Numbers become NaN, indices -1, everything else zero or empty.  TraceError as for ``Knowledge`` and for
    gaps beyond the last tick or of a hand that the scenario has not.
    """
    known = Knowledge({**trace.known.columns, **columns})
    known.refuse_gaps_beyond(trace.ticks, len(trace.scenario.hands))
    ticks, decisions = trace.ticks.copy(), trace.decisions.copy()
    for name, one in columns.items():
        records = decisions if name.startswith(OF_DECISIONS) else ticks
        values = records[name.removeprefix(OF_DECISIONS)]
        blank = np.nan if values.dtype.kind == "f" else -1 if name in _INDICES else np.zeros((), values.dtype)
        if name.startswith(OF_DECISIONS):
            values[...] = blank if one.source in NOWHERE else values
        elif one.source in NOWHERE:
            values[...] = blank
        elif one.gaps:
            values[~known.measured(name, ticks)] = blank
    return replace(trace, ticks=ticks, decisions=decisions, known=known)


_INDICES = ("decision", "hand_distance_capsule")


def until(trace: Trace, tick: int, why: str) -> Trace:
    """The run before ``tick``, cut short for the reason ``why``."""
    before = trace.decisions["tick"] < tick
    columns = {
        name: replace(
            one,
            gaps=tuple(replace(g, after=min(g.after, tick)) for g in one.gaps if g.first < tick),
            closer=tuple(replace(c, after=min(c.after, tick)) for c in one.closer if c.first < tick),
        )
        for name, one in trace.known.columns.items()
    }
    return replace(
        trace,
        ticks=trace.ticks[:tick],
        decisions=trace.decisions[before],
        decision_latency_s=trace.decision_latency_s[before],
        ended=why,
        known=Knowledge(columns),
    )
