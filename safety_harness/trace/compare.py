"""A bitwise comparison of two traces of the same scenario, which finds their first difference."""

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
    """The first record in which two traces differ, with the names of the fields that differ."""

    what: str  # "tick", "decision", "end", or "trace" where they differ in what was measured
    index: int
    time_s: float
    fields: tuple[str, ...]
    first: str
    second: str

    def __str__(self) -> str:
        where = f"first difference at {self.what} {self.index} (t = {self.time_s:.3f} s)"
        where = {"trace": "not measured alike", "end": "another end"}.get(self.what, where)
        return f"{where} in {', '.join(self.fields)}: {self.first} against {self.second}"


CLOSE = 1e-6  # tolerance, relative and in SI, for traces whose last bits may differ


def first_difference(first: Trace, second: Trace, tolerance: float = 0.0) -> TraceDifference | None:
    """Return the first difference between two traces, or None if ticks, decisions and end are the same.

    If a column was not measured in the same way in both traces, the first such column is the first
    difference. Otherwise, the first difference is the earliest record that differs in a column that both
    traces measured. At equal times a decision comes before a tick, because the tick's command follows from
    the decision.

    Args:
        first: A trace.
        second: Another trace of the same scenario.
        tolerance: The largest allowed difference of numbers, both as a relative difference and as an absolute
            difference in the SI unit. The default 0 compares bits.

    """
    for trace in (first, second):
        refuse_other_type("first_difference(first, second)", trace, Trace)
    for name in COLUMNS_OF_A_TRACE:
        a, b = first.known.column(name), second.known.column(name)
        if a != b:
            return TraceDifference("trace", 0, 0.0, (f"known.{name}",), _measured_as(a), _measured_as(b))
    first, second = as_measured(first), as_measured(second)
    compared = [
        _compare("decision", first.decisions, second.decisions, tolerance),
        _compare("tick", first.ticks, second.ticks, tolerance),
        _compare_rows("interventions", first, second, tolerance),
        _compare_rows("filtered", first, second, tolerance),
        _compare_rows("predicted", first, second, tolerance),
    ]
    if len(first.overshoot_radps) and len(second.overshoot_radps):  # earlier versions did not record it
        compared.append(_compare_rows("overshoot_radps", first, second, tolerance))
    differences = [difference for difference in compared if difference is not None]
    if not differences and first.ended != second.ended:
        return TraceDifference("end", 0, 0.0, ("ended",), str(first.ended), str(second.ended))
    return min(differences, key=lambda difference: difference.time_s, default=None)


def _compare_rows(name: str, first: Trace, second: Trace, tolerance: float) -> TraceDifference | None:
    """Return the first difference in the rows ``name``, and the time of its tick.

    The rows are those of a shield or an engine.
    """
    a, b = getattr(first, name), getattr(second, name)
    if len(a) != len(b):
        lengths = f"{len(a)} ticks", f"{len(b)} ticks"
        return TraceDifference("trace", 0, 0.0, (name,), *lengths)
    if not len(a):
        return None
    names = a.dtype.names and [field for field in a.dtype.names if field in (b.dtype.names or ())]
    pairs = [(a[field], b[field]) for field in names] if names else [(a, b)]  # as old traces have
    unlike = [~_same(x, y, tolerance).reshape(len(a), -1).all(axis=1) for x, y in pairs]
    at = np.flatnonzero(np.any(unlike, axis=0))
    if len(at) == 0:
        return None
    k = int(at[0])
    return TraceDifference("tick", k, float(first.time_s[k]), (name,), str(a[k]), str(b[k]))


def _measured_as(measurement: Measurement) -> str:
    off_by = f" within {measurement.uncertainty:g}" * (measurement.uncertainty > 0.0)
    return f"{measurement.source.value}{off_by}{f', {len(measurement.gaps)} gaps' * bool(measurement.gaps)}"


def _compare(
    kind: str, first: NDArray[np.void], second: NDArray[np.void], tolerance: float
) -> TraceDifference | None:
    shorter = min(len(first), len(second))
    names = first.dtype.names or ()
    index, fields = shorter, []
    for name in names:
        a, b = first[name][:shorter], second[name][:shorter]
        same = _same(a, b, tolerance).all(axis=tuple(range(1, a.ndim)))
        if same.all():
            continue
        # All fields that differ first at the same record belong to one difference.
        at = int(np.argmin(same))
        if at < index:
            index, fields = at, [name]
        elif at == index:
            fields.append(name)
    if fields:
        a, b = first[index], second[index]
        return TraceDifference(
            kind, index, float(a["time_s"]), tuple(fields), str(a[fields[0]]), str(b[fields[0]])
        )
    if len(first) == len(second):
        return None
    longer = first if len(first) > len(second) else second
    return TraceDifference(
        kind,
        shorter,
        float(longer[shorter]["time_s"]),
        ("length",),
        f"{len(first)} {kind}s",
        f"{len(second)} {kind}s",
    )


def _same(first: NDArray[np.generic], second: NDArray[np.generic], tolerance: float) -> NDArray[np.bool_]:
    """Return a mask of the elements that are equal in two columns.

    Without a tolerance, elements are equal if their bits are equal; with a tolerance, nearly equal numbers
    are also equal.
    """
    if tolerance > 0.0 and first.dtype == np.float64:
        return np.asarray(np.isclose(first, second, rtol=tolerance, atol=tolerance, equal_nan=True))
    return np.asarray(_bits(first) == _bits(second))


def _bits(array: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return floats as integers, so that NaN equals itself and -0 differs from 0."""
    return np.ascontiguousarray(array).view(np.uint64) if array.dtype == np.float64 else array
