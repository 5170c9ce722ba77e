"""Two traces of the same scenario, bit by bit: identical, or where they first differ."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.exceptions import refuse_other_type
from safety_harness.trace.trace import Trace


@dataclass(frozen=True)
class TraceDifference:
    """The first record in which two traces differ, and the fields that do."""

    what: str  # "tick" or "decision"
    index: int
    time_s: float
    fields: tuple[str, ...]
    first: str
    second: str

    def __str__(self) -> str:
        return (
            f"first difference at {self.what} {self.index} (t = {self.time_s:.3f} s) in "
            f"{', '.join(self.fields)}: {self.first} against {self.second}"
        )


def first_difference(first: Trace, second: Trace) -> TraceDifference | None:
    """None if ticks and decisions are the same bits; else the earliest differing record.

    Of a decision and a tick at the same time it is the decision, which the tick's command follows.
    """
    for trace in (first, second):
        refuse_other_type("first_difference(first, second)", trace, Trace)
    found = [
        _compare("decision", first.decisions, second.decisions),
        _compare("tick", first.ticks, second.ticks),
    ]
    differences = [difference for difference in found if difference is not None]
    return min(differences, key=lambda difference: difference.time_s, default=None)


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
