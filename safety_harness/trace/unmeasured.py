"""Handle the unmeasured parts of a trace for code that shows, counts or repeats the trace."""

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
    """Return the ticks at which a column was measured, as a mask.

    The mask is (n,), or (n, hands) for a column of hands.
    """
    return trace.known.measured(name, trace.ticks)


def decided(trace: Trace, *names: str) -> bool:
    """Return whether the fields ``names`` of the trace's decisions were measured.

    Without names, all fields are checked.
    """
    fields = names or DECISION.names or ()
    return not trace.known.missing(f"{OF_DECISIONS}{name}" for name in fields)


def as_measured(trace: Trace) -> Trace:
    """Return the trace with every unmeasured value replaced by a blank."""
    return trace if trace.known.whole else knowing(trace, trace.known.columns)


def without_gaps(trace: Trace, names: Iterable[str]) -> Trace:
    """Return the trace with zeros in place of the values in the gaps of the columns ``names``."""
    lacking = [] if trace.known.whole else [name for name in names if trace.known.column(name).gaps]
    if not lacking:
        return trace
    ticks = trace.ticks.copy()
    for name in lacking:
        ticks[name][~measured(trace, name)] = np.zeros((), ticks[name].dtype)
    return replace(trace, ticks=ticks)


def refuse_not_simulated(trace: Trace, file: Path | None = None) -> None:
    """Raise TraceError if a trace cannot be run again because this package did not simulate it.

    Args:
        trace: The trace.
        file: The trace's file, for the error. None: the error has no file and no hint.

    """
    if trace.known.simulated:
        return
    sources = Counter(how.source.value for how in trace.known.columns.values() if how != Measurement())
    expected = "a trace that was simulated, since only that can be run again"
    hint = "" if file is None else f"safety-harness judge {file}"
    got = f"columns that are {', '.join(f'{source} ({count})' for source, count in sources.items())}"
    raise TraceError(place=Place(file=file, field="known"), expected=expected, got=got, hint=hint)


def knowing(trace: Trace, columns: Mapping[str, Measurement]) -> Trace:
    """Return ``trace`` with additional measurements.

    The entries of ``columns`` are added to the knowledge of the trace. Unmeasured values become blank. A
    blank number is NaN, a blank index is -1, and any other blank field is zero or empty.

    Raises:
        TraceError: ``Knowledge`` refuses the columns, a gap ends after the last tick, or the scenario does
            not have a gap's hand.

    """
    known = Knowledge({**trace.known.columns, **columns})
    known.refuse_gaps_beyond(trace.ticks, len(trace.scenario.hands))
    ticks, decisions = trace.ticks.copy(), trace.decisions.copy()
    for name, how in columns.items():
        records = decisions if name.startswith(OF_DECISIONS) else ticks
        values = records[name.removeprefix(OF_DECISIONS)]
        blank = np.nan if values.dtype.kind == "f" else -1 if name in _INDICES else np.zeros((), values.dtype)
        if name.startswith(OF_DECISIONS):
            values[...] = blank if how.source in NOWHERE else values
        elif how.source in NOWHERE:
            values[...] = blank
        elif how.gaps:
            values[~known.measured(name, ticks)] = blank
    return replace(trace, ticks=ticks, decisions=decisions, known=known)


_INDICES = ("decision", "hand_distance_capsule")


def until(trace: Trace, tick: int, why: str) -> Trace:
    """Return the part of the run before ``tick``.

    ``ended`` is the reason why this part ends there.
    """
    kept = trace.decisions["tick"] < tick
    columns = {
        name: replace(
            how,
            gaps=tuple(replace(g, after=min(g.after, tick)) for g in how.gaps if g.first < tick),
            closer=tuple(replace(c, after=min(c.after, tick)) for c in how.closer if c.first < tick),
        )
        for name, how in trace.known.columns.items()
    }
    return replace(
        trace,
        ticks=trace.ticks[:tick],
        decisions=trace.decisions[kept],
        decision_latency_s=trace.decision_latency_s[kept],
        ended=why,
        known=Knowledge(columns),
    )
