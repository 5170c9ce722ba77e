"""What of a trace was measured, by what, and how well: a log is seldom as whole as a simulated run.

A column is a field of the ticks, by its name, or one of the decisions, as ``decision.outcome``.  What nobody
measured is stored as NaN, zero or -1, and must not be read: claims on it are inconclusive.
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

from safety_harness.base.exceptions import Place, TraceError
from safety_harness.trace.records import DECISION, TICK

OF_DECISIONS = "decision."
TICK_COLUMNS = tuple(name for name in TICK.names or () if name != "time_s")  # which every trace has
COLUMNS_OF_A_TRACE = TICK_COLUMNS + tuple(f"{OF_DECISIONS}{name}" for name in DECISION.names or ())
PER_HAND = tuple(name for name in TICK_COLUMNS if name.startswith(("hand_", "elbow_")))
PRESENCE = "hand_present"
UNMEASURED = "what follows was not measured"  # the end of a part of a run


class Source(Enum):
    """By what a column was measured."""

    SIMULATED = "simulated truth"
    SENSOR = "sensor"
    LOG = "log"
    DERIVED = "derived"
    NONE = "not measured"
    UNREPORTED = "not reported"  # of a simulated run: the controller does not say


NOWHERE = (Source.NONE, Source.UNREPORTED)


@dataclass(frozen=True, kw_only=True)
class Gap:
    """Ticks from ``first`` to the one before ``after`` in which a column was not measured.

    Of one ``hand``, counted from 0, or of all that the column holds.  A gap of ``hand_present`` says that a
    hand is not known to be absent.  Of a mode it was ``either`` of these, at each of the ticks; none: any.
    """

    first: int
    after: int
    hand: int | None = None
    either: tuple[int, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Closer:
    """Ticks from ``first`` to the one before ``after`` in which a column is known more closely."""

    first: int
    after: int
    uncertainty: float


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """How a column was measured.

    Every stored number is within ``uncertainty`` (in the column's own SI unit) of the true one, a position or
    that of a pose by its distance, but in ``gaps``; it is within less where it is ``closer``, and from one
    tick to the next within the larger of theirs.  ``at_most_per_s``: the true one changes no faster.
    One that is ``Source.NONE`` was not measured at all, and so it is with one that the controller of a
    simulated run does not report.  A derived one is as uncertain as what it was derived from makes it.
    """

    source: Source = Source.SIMULATED
    uncertainty: float = 0.0
    gaps: tuple[Gap, ...] = ()
    closer: tuple[Closer, ...] = ()
    at_most_per_s: float | None = None

    @property
    def limited(self) -> bool:
        """Is anything in it unknown or uncertain?"""
        return self.source in NOWHERE or self.uncertainty > 0.0 or bool(self.gaps)


NOT_MEASURED = Measurement(source=Source.NONE)
NOT_REPORTED = Measurement(source=Source.UNREPORTED)


@dataclass(frozen=True)
class Knowledge:
    """What is known of each column; those that are not named were simulated, and are exact.

    TraceError names a column that no trace has, an uncertainty that is no finite number of at least zero or
    is one of whole numbers, and a gap without ticks or of a hand that the column does not hold.
    """

    columns: Mapping[str, Measurement] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", MappingProxyType(dict(self.columns)))
        for name, one in self.columns.items():
            _refuse_impossible(name, one)

    def __reduce__(self) -> tuple[type[Knowledge], tuple[dict[str, Measurement]]]:
        return Knowledge, (dict(self.columns),)

    @cached_property
    def whole(self) -> bool:
        """Is every column known exactly at every tick?"""
        return not any(one.limited for one in self.columns.values())

    @property
    def simulated(self) -> bool:
        """Was all of it simulated, so that it can be run again?"""
        return all(
            one == NOT_REPORTED or (one.source is Source.SIMULATED and not one.limited)
            for one in self.columns.values()
        )

    @property
    def recorded(self) -> bool:
        """Was any of it read from a log?"""
        return any(one.source is Source.LOG for one in self.columns.values())

    def of(self, name: str) -> Measurement:
        """Of one column."""
        return self.columns.get(name, _SIMULATED)

    def within(self, name: str, count: int) -> NDArray[np.float64]:
        """(count,) the uncertainty of one column at each tick, in its SI unit."""
        one = self.of(name)
        found = np.full(count, one.uncertainty)
        for span in one.closer:
            found[span.first : span.after] = span.uncertainty
        return found

    def missing(self, names: Iterable[str]) -> tuple[str, ...]:
        """Those of ``names`` that were not measured at all."""
        if not self.columns:
            return ()
        return tuple(name for name in names if self.of(name).source in NOWHERE)

    def unreported(self, names: Iterable[str]) -> bool:
        """Are all of ``names`` what the controller of a simulated run does not say?"""
        return all(self.of(name).source is Source.UNREPORTED for name in names)

    def uncertain(self, names: Iterable[str]) -> tuple[str, ...]:
        """Those of ``names`` that are known to within some uncertainty only."""
        return tuple(name for name in names if self.of(name).uncertainty > 0.0)

    def first_gap(self, names: Iterable[str]) -> Gap | None:
        """The gap of any of ``names`` that begins first."""
        gaps = [gap for name in names for gap in self.of(name).gaps]
        return min(gaps, key=lambda gap: gap.first, default=None)

    def measured(self, name: str, ticks: NDArray[np.void]) -> NDArray[np.bool_]:
        """(n,), or (n, hands) of a column of hands: at which of ``ticks`` (n,) it was measured."""
        shape = (len(ticks), *ticks.dtype[name].shape[: name in PER_HAND])
        found = np.full(shape, self.of(name).source not in NOWHERE)
        for gap in self.of(name).gaps:
            found[gap.first : gap.after, ... if gap.hand is None else gap.hand] = False
        return found

    def refuse_gaps_beyond(self, ticks: NDArray[np.void], hands: int) -> None:
        """TraceError for a gap that ends after the last of ``ticks``, or of a hand that is none of ``hands``.

        Only of ``hand_present`` for which there is room: another hand may be there.
        """
        count, (room,) = len(ticks), ticks.dtype[PRESENCE].shape
        for name, one in self.columns.items():
            most = room if name == PRESENCE else hands
            for gap in one.gaps:
                if gap.after > count or (gap.hand is not None and gap.hand >= most):
                    expected = f"gaps within {count} ticks, of all hands or one of {most}, counted from 0"
                    raise TraceError(place=Place(field=f"known.{name}"), expected=expected, got=str(gap))
            for span in one.closer:
                if span.after > count:
                    expected = f"spans within {count} ticks"
                    raise TraceError(place=Place(field=f"known.{name}"), expected=expected, got=str(span))


_SIMULATED = Measurement()
WHOLLY_KNOWN = Knowledge()


def _refuse_impossible(name: str, one: Measurement) -> None:
    def refuse(expected: str, got: str) -> TraceError:
        return TraceError(place=Place(field=f"known.{name}"), expected=expected, got=got)

    if name not in COLUMNS_OF_A_TRACE:
        raise refuse("the name of a column of ticks or decisions", name)
    whole = (DECISION[name.removeprefix(OF_DECISIONS)] if name.startswith(OF_DECISIONS) else TICK[name]).base
    if not (isfinite(one.uncertainty) and one.uncertainty >= 0.0):
        raise refuse("an uncertainty of at least 0", repr(one.uncertainty))
    if one.uncertainty > 0.0 and whole.kind != "f":
        raise refuse("no uncertainty, as the column has no real numbers", repr(one.uncertainty))
    for span in one.closer:
        if not (0 <= span.first < span.after and 0.0 <= span.uncertainty <= one.uncertainty):
            raise refuse(
                f"spans of ticks in which it is known within less than {one.uncertainty:g}", str(span)
            )
    if one.at_most_per_s is not None and not 0.0 <= one.at_most_per_s < inf:
        raise refuse("a finite rate of at least 0", repr(one.at_most_per_s))
    for gap in one.gaps:
        if not 0 <= gap.first < gap.after or name.startswith(OF_DECISIONS):
            raise refuse("gaps of ticks, each from one to a later one", str(gap))
        if gap.hand is not None and (gap.hand < 0 or name not in PER_HAND):
            raise refuse("gaps of one hand, counted from 0, only in columns of hands", str(gap))
        if gap.either and name != "mode":
            raise refuse("gaps in which it was either of some, only of the mode", str(gap))


LEVELS = 1.1  # an uncertainty by tick is rounded up to the next of a geometric series, for few spans


def measurement(
    source: Source, within: NDArray[np.float64], gaps: Iterable[Gap] = (), at_most_per_s: float | None = None
) -> Measurement:
    """That of a column which is known to ``within`` (n,) at each tick, in its SI unit; zeros are as good."""
    most, closer = float(within.max(initial=0.0)), []
    if most > 0.0:
        steps = np.floor(np.log(most / np.clip(within, most * 1e-6, most)) / np.log(LEVELS) + 1e-9)
        ends = (np.flatnonzero(np.diff(steps)) + 1).tolist()
        for first, after in zip([0, *ends], [*ends, len(within)], strict=True):
            if steps[first] > 0.0:
                closer.append(Closer(first=first, after=after, uncertainty=float(within[first:after].max())))
    gaps, spans = tuple(gaps), tuple(closer)
    return Measurement(source=source, uncertainty=most, gaps=gaps, closer=spans, at_most_per_s=at_most_per_s)
