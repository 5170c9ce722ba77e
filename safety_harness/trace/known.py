"""The measured columns of a trace, with the source and the uncertainty of each column.

A log seldom has all columns of a simulated run. A column is either a field of the ticks or a field of the
decisions; for a field of the decisions, the name has a prefix, as in ``decision.outcome``. An unmeasured
value is stored as NaN, zero or -1. No code may read such a value, so claims that need it are inconclusive.
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
    """A range of ticks in which a column was not measured.

    It begins at ``first`` and ends before ``after``. A gap concerns one ``hand``, counted from 0. If ``hand``
    is None, the gap concerns all hands of the column. A gap of ``hand_present`` means that a hand may or may
    not be present. A gap of the column ``mode`` may list modes in ``either``. At each tick of the gap, the
    mode was one of these. An empty ``either`` means any mode.
    """

    first: int
    after: int
    hand: int | None = None
    either: tuple[int, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Closer:
    """A range of ticks in which a column has a smaller uncertainty.

    It begins at ``first`` and ends before ``after``.
    """

    first: int
    after: int
    uncertainty: float


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """The source and the uncertainty of a column.

    Outside the ``gaps``, every stored number is within ``uncertainty`` of the true number, in the column's
    own SI unit. For a position, or the position of a pose, the uncertainty is a distance. In the spans
    ``closer``, the uncertainty is smaller. Between two ticks, the larger of the uncertainties at these ticks
    applies. ``at_most_per_s`` bounds the rate of change of the true number. A column with the source
    ``Source.NONE`` was not measured at all. The source ``Source.UNREPORTED`` means that the controller of a
    simulated run does not report the column. The uncertainty of a derived column follows from its inputs.
    """

    source: Source = Source.SIMULATED
    uncertainty: float = 0.0
    gaps: tuple[Gap, ...] = ()
    closer: tuple[Closer, ...] = ()
    at_most_per_s: float | None = None

    @property
    def limited(self) -> bool:
        """Whether any part of the column is unknown or uncertain."""
        return self.source in NOWHERE or self.uncertainty > 0.0 or bool(self.gaps)


NOT_MEASURED = Measurement(source=Source.NONE)
NOT_REPORTED = Measurement(source=Source.UNREPORTED)


@dataclass(frozen=True)
class Knowledge:
    """The measurement of each column; a column without an entry was simulated, and is exact.

    Raises:
        TraceError: A column is in no trace. Or an uncertainty is not a finite number of at least zero, or
            belongs to whole numbers. Or a gap has no ticks, or concerns a hand that the column does not hold.

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
        """Whether every column is known exactly at every tick."""
        return not any(measurement.limited for measurement in self.columns.values())

    @property
    def simulated(self) -> bool:
        """Whether all columns were simulated, so that the run can be repeated."""
        return all(
            known == NOT_REPORTED or (known.source is Source.SIMULATED and not known.limited)
            for known in self.columns.values()
        )

    @property
    def recorded(self) -> bool:
        """Whether any column was read from a log."""
        return any(measurement.source is Source.LOG for measurement in self.columns.values())

    def column(self, name: str) -> Measurement:
        """Return the measurement of one column."""
        return self.columns.get(name, _SIMULATED)

    def uncertainty_of(self, name: str, count: int) -> NDArray[np.float64]:
        """Return the uncertainty of one column at each tick, in its SI unit, shape (count,)."""
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
        """Return whether the controller of a simulated run reports no column in ``names``."""
        return all(self.column(name).source is Source.UNREPORTED for name in names)

    def uncertain(self, names: Iterable[str]) -> tuple[str, ...]:
        """Return the columns among ``names`` that have an uncertainty."""
        return tuple(name for name in names if self.column(name).uncertainty > 0.0)

    def first_gap(self, names: Iterable[str]) -> Gap | None:
        """Return the earliest gap in any of the columns ``names``, or None."""
        gaps = [gap for name in names for gap in self.column(name).gaps]
        return min(gaps, key=lambda gap: gap.first, default=None)

    def measured(self, name: str, ticks: NDArray[np.void]) -> NDArray[np.bool_]:
        """Return a mask of the ticks at which a column was measured.

        Args:
            name: The column.
            ticks: The ticks (n,) of the trace.

        Returns:
            True where the column was measured: (n,), or (n, hands) for a column of hands.

        """
        shape = (len(ticks), *ticks.dtype[name].shape[: name in PER_HAND])
        mask = np.full(shape, self.column(name).source not in NOWHERE)
        for gap in self.column(name).gaps:
            mask[gap.first : gap.after, ... if gap.hand is None else gap.hand] = False
        return mask

    def refuse_gaps_beyond(self, ticks: NDArray[np.void], hands: int) -> None:
        """Raise TraceError if a gap or span ends after the last of ``ticks``.

        The error is also raised if the hand of a gap does not exist. The scenario has ``hands`` hands. A gap
        of ``hand_present`` may refer to any hand slot of a tick, because a hand that is not in the scenario
        may be present.
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


LEVELS = 1.1  # the ratio of the levels to which uncertainties are rounded up, for few spans


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
        # Levels below the largest uncertainty, by powers of LEVELS. The lowest is a millionth of it, since
        # the logarithm of 0 is infinite.
        steps = np.floor(log(most / np.clip(off_by, most * 1e-6, most)) / log(LEVELS) + 1e-9)
        ends = (np.flatnonzero(np.diff(steps)) + 1).tolist()
        for first, end in zip([0, *ends], [*ends, len(off_by)], strict=True):
            if steps[first] > 0.0:
                closer.append(Closer(first=first, after=end, uncertainty=float(off_by[first:end].max())))
    gaps, spans = tuple(gaps), tuple(closer)
    return Measurement(source=source, uncertainty=most, gaps=gaps, closer=spans, at_most_per_s=at_most_per_s)
