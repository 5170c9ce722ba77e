"""The measured columns of a trace, with sources and uncertainties.

A log seldom has all columns of a simulated run. A column is a field of the ticks, by its name, or a field of
the decisions, as ``decision.outcome``. An unmeasured value is stored as NaN, zero or -1. No code may read it:
claims on it are inconclusive.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from math import inf, isfinite
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import log
from safety_harness.base.exceptions import Place, TraceError
from safety_harness.trace.records import DECISION, TICK

OF_DECISIONS = "decision."
TICK_COLUMNS = tuple(name for name in TICK.names or () if name != "time_s")  # which every trace has
COLUMNS_OF_A_TRACE = TICK_COLUMNS + tuple(f"{OF_DECISIONS}{name}" for name in DECISION.names or ())
PER_HAND = tuple(name for name in TICK_COLUMNS if name.startswith(("hand_", "elbow_")))
PRESENCE = "hand_present"
UNMEASURED = "what follows was not measured"  # the end of a part of a run


class Source(Enum):
    """The source of a column's values."""

    SIMULATED = "simulated truth"
    SENSOR = "sensor"
    LOG = "log"
    DERIVED = "derived"
    NONE = "not measured"
    UNREPORTED = "not reported"  # of a simulated run: the controller does not say


NOWHERE = (Source.NONE, Source.UNREPORTED)


@dataclass(frozen=True, kw_only=True)
class Gap:
    """Ticks from ``first`` to the tick before ``after`` in which a column was not measured.

    It concerns one ``hand``, counted from 0, or with None all hands of the column. A gap of ``hand_present``
    means that a hand may be there. A gap of a mode may list the modes in ``either``: the mode was one of
    these at each of the ticks. An empty ``either`` means any mode.
    """

    first: int
    after: int
    hand: int | None = None
    either: tuple[int, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Closer:
    """Ticks from ``first`` to the tick before ``after`` in which a column has a smaller uncertainty."""

    first: int
    after: int
    uncertainty: float


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """The source and the uncertainty of a column.

    Outside the ``gaps``, every stored number is within ``uncertainty`` of the true number, in the column's
    own SI unit. For a position, or the position of a pose, this is a distance. ``closer`` spans have a
    smaller uncertainty. Between two ticks the larger uncertainty of the two holds. ``at_most_per_s`` bounds
    the rate of change of the true number. ``Source.NONE`` was not measured at all; ``Source.UNREPORTED`` is a
    column that the controller of a simulated run does not report. A derived column has the uncertainty that
    follows from its inputs.
    """

    source: Source = Source.SIMULATED
    uncertainty: float = 0.0
    gaps: tuple[Gap, ...] = ()
    closer: tuple[Closer, ...] = ()
    at_most_per_s: float | None = None

    @property
    def limited(self) -> bool:
        """Is any part of it unknown or uncertain?"""
        return self.source in NOWHERE or self.uncertainty > 0.0 or bool(self.gaps)


NOT_MEASURED = Measurement(source=Source.NONE)
NOT_REPORTED = Measurement(source=Source.UNREPORTED)


@dataclass(frozen=True)
class Knowledge:
    """The measurement of each column; a column without an entry was simulated, and is exact.

    Raises:
        TraceError: A column that no trace has; an uncertainty that is not a finite number of at least zero,
            or that belongs to whole numbers; a gap without ticks, or of a hand that the column does not hold.

    """

    columns: Mapping[str, Measurement] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", MappingProxyType(dict(self.columns)))
        for name, measurement in self.columns.items():
            _refuse_impossible(name, measurement)

    def __reduce__(self) -> tuple[type[Knowledge], tuple[dict[str, Measurement]]]:
        return Knowledge, (dict(self.columns),)

    @cached_property
    def whole(self) -> bool:
        """Is every column known exactly at every tick?"""
        return not any(measurement.limited for measurement in self.columns.values())

    @property
    def simulated(self) -> bool:
        """Was all of it simulated, so that it can be run again?"""
        return all(
            known == NOT_REPORTED or (known.source is Source.SIMULATED and not known.limited)
            for known in self.columns.values()
        )

    @property
    def recorded(self) -> bool:
        """Was any of it read from a log?"""
        return any(measurement.source is Source.LOG for measurement in self.columns.values())

    def column(self, name: str) -> Measurement:
        """Return the measurement of one column."""
        return self.columns.get(name, _SIMULATED)

    def uncertainty_of(self, name: str, count: int) -> NDArray[np.float64]:
        """Return (count,) the uncertainty of one column at each tick, in its SI unit."""
        measurement = self.column(name)
        uncertainty = np.full(count, measurement.uncertainty)
        for span in measurement.closer:
            uncertainty[span.first : span.after] = span.uncertainty
        return uncertainty

    def missing(self, names: Iterable[str]) -> tuple[str, ...]:
        """Return the columns among ``names`` that were not measured at all."""
        if not self.columns:
            return ()
        return tuple(name for name in names if self.column(name).source in NOWHERE)

    def unreported(self, names: Iterable[str]) -> bool:
        """Are all of ``names`` columns that the controller of a simulated run does not report?"""
        return all(self.column(name).source is Source.UNREPORTED for name in names)

    def uncertain(self, names: Iterable[str]) -> tuple[str, ...]:
        """Return the columns among ``names`` that have an uncertainty."""
        return tuple(name for name in names if self.column(name).uncertainty > 0.0)

    def first_gap(self, names: Iterable[str]) -> Gap | None:
        """Return the gap of any of ``names`` that begins first."""
        gaps = [gap for name in names for gap in self.column(name).gaps]
        return min(gaps, key=lambda gap: gap.first, default=None)

    def measured(self, name: str, ticks: NDArray[np.void]) -> NDArray[np.bool_]:
        """Return where a column was measured, at each of ``ticks`` (n,).

        Args:
            name: The column.
            ticks: The ticks (n,) of the trace.

        Returns:
            True where it was measured: (n,), or (n, hands) for a column of hands.

        """
        shape = (len(ticks), *ticks.dtype[name].shape[: name in PER_HAND])
        mask = np.full(shape, self.column(name).source not in NOWHERE)
        for gap in self.column(name).gaps:
            mask[gap.first : gap.after, ... if gap.hand is None else gap.hand] = False
        return mask

    def refuse_gaps_beyond(self, ticks: NDArray[np.void], hands: int) -> None:
        """Raise TraceError for a gap that ends after the last of ``ticks``, or for a hand above ``hands``.

        Only ``hand_present`` may have gaps of more hands, up to the room in a tick: another hand may be
        there.
        """
        count, (slots,) = len(ticks), ticks.dtype[PRESENCE].shape
        for name, measurement in self.columns.items():
            most = slots if name == PRESENCE else hands
            for gap in measurement.gaps:
                if gap.after > count or (gap.hand is not None and gap.hand >= most):
                    expected = f"gaps within {count} ticks, of all hands or one of {most}, counted from 0"
                    raise TraceError(place=Place(field=f"known.{name}"), expected=expected, got=str(gap))
            for span in measurement.closer:
                if span.after > count:
                    expected = f"spans within {count} ticks"
                    raise TraceError(place=Place(field=f"known.{name}"), expected=expected, got=str(span))


_SIMULATED = Measurement()
WHOLLY_KNOWN = Knowledge()


def _refuse_impossible(name: str, measurement: Measurement) -> None:
    def refuse(expected: str, got: str) -> TraceError:
        return TraceError(place=Place(field=f"known.{name}"), expected=expected, got=got)

    if name not in COLUMNS_OF_A_TRACE:
        raise refuse("the name of a column of ticks or decisions", name)
    whole = (DECISION[name.removeprefix(OF_DECISIONS)] if name.startswith(OF_DECISIONS) else TICK[name]).base
    if not (isfinite(measurement.uncertainty) and measurement.uncertainty >= 0.0):
        raise refuse("an uncertainty of at least 0", repr(measurement.uncertainty))
    if measurement.uncertainty > 0.0 and whole.kind != "f":
        raise refuse("no uncertainty, as the column has no real numbers", repr(measurement.uncertainty))
    for span in measurement.closer:
        if not (0 <= span.first < span.after and 0.0 <= span.uncertainty <= measurement.uncertainty):
            raise refuse(
                f"spans of ticks in which it is known within less than {measurement.uncertainty:g}", str(span)
            )
    if measurement.at_most_per_s is not None and not 0.0 <= measurement.at_most_per_s < inf:
        raise refuse("a finite rate of at least 0", repr(measurement.at_most_per_s))
    for gap in measurement.gaps:
        if not 0 <= gap.first < gap.after or name.startswith(OF_DECISIONS):
            raise refuse("gaps of ticks, each from one to a later one", str(gap))
        if gap.hand is not None and (gap.hand < 0 or name not in PER_HAND):
            raise refuse("gaps of one hand, counted from 0, only in columns of hands", str(gap))
        if gap.either and name != "mode":
            raise refuse("gaps in which it was either of some, only of the mode", str(gap))


LEVELS = 1.1  # an uncertainty by tick is rounded up to the next of a geometric series, for few spans


def measurement(
    source: Source, off_by: NDArray[np.float64], gaps: Iterable[Gap] = (), at_most_per_s: float | None = None
) -> Measurement:
    """Return the measurement of a column with a different uncertainty at each tick.

    Args:
        source: The source of the column.
        off_by: The uncertainty (n,) at each tick, in the column's SI unit; it may be 0.
        gaps: The ticks at which the column was not measured.
        at_most_per_s: The largest rate of change of the true number. None: no bound.

    """
    most, closer = float(off_by.max(initial=0.0)), []
    if most > 0.0:
        steps = np.floor(log(most / np.clip(off_by, most * 1e-6, most)) / log(LEVELS) + 1e-9)
        ends = (np.flatnonzero(np.diff(steps)) + 1).tolist()
        for first, end in zip([0, *ends], [*ends, len(off_by)], strict=True):
            if steps[first] > 0.0:
                closer.append(Closer(first=first, after=end, uncertainty=float(off_by[first:end].max())))
    gaps, spans = tuple(gaps), tuple(closer)
    return Measurement(source=source, uncertainty=most, gaps=gaps, closer=spans, at_most_per_s=at_most_per_s)
