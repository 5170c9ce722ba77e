"""Two traces of the same scenario, bit by bit: identical, or where they first differ."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import refuse_other_type
from safety_harness.trace.known import COLUMNS_OF_A_TRACE, Measurement
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import as_measured


@dataclass(frozen=True)
class TraceDifference:
    """The first record in which two traces differ, and the fields that do."""

    what: str  # "tick", "decision", or "trace" where they differ in what was measured
    index: int
    time_s: float
    fields: tuple[str, ...]
    first: str
    second: str

    def __str__(self) -> str:
        where = f"first difference at {self.what} {self.index} (t = {self.time_s:.3f} s)"
        where = "not measured alike" if self.what == "trace" else where
        return f"{where} in {', '.join(self.fields)}: {self.first} against {self.second}"


def first_difference(first: Trace, second: Trace) -> TraceDifference | None:
    """None if of ticks and decisions the same was measured, and is the same bits; else where they differ.

    That is a column that was not measured alike, or the earliest record that differs in what was measured
    of both: of the rest nothing is said.  Of a decision and a tick at the same time it is the decision,
    which the tick's command follows.
    """
    for trace in (first, second):
        refuse_other_type("first_difference(first, second)", trace, Trace)
    for name in COLUMNS_OF_A_TRACE:
        one, other = first.known.of(name), second.known.of(name)
        if one != other:
            return TraceDifference("trace", 0, 0.0, (f"known.{name}",), _told(one), _told(other))
    first, second = as_measured(first), as_measured(second)
    found = [
        _compare("decision", first.decisions, second.decisions),
        _compare("tick", first.ticks, second.ticks),
        _compare_rows("interventions", first, second),
    ]
    if len(first.overshoot_radps) and len(second.overshoot_radps):  # earlier versions did not record it
        found.append(_compare_rows("overshoot_radps", first, second))
    differences = [difference for difference in found if difference is not None]
    return min(differences, key=lambda difference: difference.time_s, default=None)


def _compare_rows(name: str, first: Trace, second: Trace) -> TraceDifference | None:
    """Of what their shields, or the sub-steps of an engine, did, with the times of the ticks."""
    one, other = getattr(first, name), getattr(second, name)
    if len(one) != len(other):
        lengths = f"{len(one)} ticks", f"{len(other)} ticks"
        return TraceDifference("trace", 0, 0.0, (name,), *lengths)
    if not len(one):
        return None
    names = one.dtype.names and [field for field in one.dtype.names if field in (other.dtype.names or ())]
    pairs = [(one[field], other[field]) for field in names] if names else [(one, other)]  # as old traces have
    unlike = [(_bits(a) != _bits(b)).reshape(len(one), -1).any(axis=1) for a, b in pairs]
    at = np.flatnonzero(np.any(unlike, axis=0))
    if len(at) == 0:
        return None
    k = int(at[0])
    return TraceDifference("tick", k, float(first.time_s[k]), (name,), str(one[k]), str(other[k]))


def _told(one: Measurement) -> str:
    within = f" within {one.uncertainty:g}" * (one.uncertainty > 0.0)
    return f"{one.source.value}{within}{f', {len(one.gaps)} gaps' * bool(one.gaps)}"


def _compare(what: str, first: NDArray[np.void], second: NDArray[np.void]) -> TraceDifference | None:
    shorter = min(len(first), len(second))
    names = first.dtype.names or ()
    index, fields = shorter, []
    for name in names:
        a, b = first[name][:shorter], second[name][:shorter]
        same = (_bits(a) == _bits(b)).all(axis=tuple(range(1, a.ndim)))
        if same.all():
            continue
        at = int(np.argmin(same))
        if at < index:
            index, fields = at, [name]
        elif at == index:
            fields.append(name)
    if fields:
        a, b = first[index], second[index]
        return TraceDifference(
            what, index, float(a["time_s"]), tuple(fields), str(a[fields[0]]), str(b[fields[0]])
        )
    if len(first) == len(second):
        return None
    longer = first if len(first) > len(second) else second
    return TraceDifference(
        what,
        shorter,
        float(longer[shorter]["time_s"]),
        ("length",),
        f"{len(first)} {what}s",
        f"{len(second)} {what}s",
    )


def _bits(array: NDArray[np.generic]) -> NDArray[np.generic]:
    """Floats as integers, so that NaN equals itself and -0 differs from 0."""
    return np.ascontiguousarray(array).view(np.uint64) if array.dtype == np.float64 else array
