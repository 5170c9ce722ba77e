"""A claim while a run goes on: at every tick the verdict that ``FormulaClaim`` has on the run up to there."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import partial
from math import inf, isnan

from safety_harness.formulas.claim import GRAVEST
from safety_harness.formulas.formula import (
    Formula,
    Globally,
    Initially,
    Until,
    parts_of,
    shown_in,
    signals_of,
    unit_of,
)
from safety_harness.formulas.parse import parse_formula
from safety_harness.formulas.prefix import Prefix
from safety_harness.formulas.quantities import formula_error
from safety_harness.formulas.signal import Signal
from safety_harness.monitoring.sensing import Known, Moment, Signals, margin_at
from safety_harness.properties.base import Unit
from safety_harness.scenario.model import Verdict


class WatchedClaim:
    """What ``sentence`` says of a run so far, of which it asks signals in ``known``.

    FormulaError for one of others, or that cannot be told in bounded memory.
    """

    def __init__(self, sentence: str, known: Collection[Signal], period_s: float, revisable: int) -> None:
        formula = parse_formula(sentence)
        for signal in signals_of(formula):
            if signal not in known:
                expected = f"a signal that this stream has: {', '.join(one.words for one in known)}"
                raise formula_error(expected, signal.words)
        self.sentence = str(formula)
        self.parts = [WatchedPart(part, period_s, revisable) for part in parts_of(formula)]

    def see(self, moments: Sequence[Moment], *, grown: bool) -> None:
        """Of the latest ticks, the last of them last, more is known now; with ``grown`` that one is new."""
        for part in self.parts:
            part.see(moments, grown=grown)

    @property
    def verdict(self) -> Verdict:
        """On the run so far, as if it ended now."""
        return _gravest([part.verdict for part in self.parts])

    @property
    def latest(self) -> Verdict:
        """Of the latest tick that can be told, where a claim asks every tick; else of the run so far."""
        return _gravest([part.latest for part in self.parts])

    @property
    def deciding(self) -> WatchedPart:
        """The first part with the gravest verdict."""
        return next(part for part in self.parts if part.verdict is self.verdict)


class WatchedPart:
    """One part of a claim: its ``verdict`` on the run so far, and what it says of the ``latest`` tick.

    ``margin`` is the least of all that may have been, or of one that is violated the largest; None for no
    finite number.
    """

    def __init__(self, part: Formula, period_s: float, revisable: int) -> None:
        self.part, self.unit = part, unit_of(part)
        self.verdict = self.latest = Verdict.INCONCLUSIVE
        self.margin: float | None = None
        self._between, self._at_ticks = (Prefix(part, period_s, sign, revisable) for sign in (1, -1))
        self._end = Prefix(part.second, period_s, -1, revisable) if isinstance(part, Until) else None
        self._signals = signals_of(part)
        self._untried = set(self._signals)  # yet
        if isinstance(part, Globally):
            self._untried -= set(signals_of(part.trigger))
        self._asked = False

    def see(self, moments: Sequence[Moment], *, grown: bool) -> None:
        """As ``WatchedClaim.see``."""
        at_ticks = [partial(margin_at, signals=one.signals, cell=False) for one in moments]
        between = [partial(margin_at, signals=one.signals, cell=True) for one in moments]
        for prefix, bounds in ((self._between, between), (self._at_ticks, at_ticks), (self._end, at_ticks)):
            if prefix is not None and grown:
                prefix.step(bounds[-1], bounds[:-1])
            elif prefix is not None:
                prefix.revise(bounds)
        for moment in moments:
            self._exercise(moment)
        if isinstance(self.part, Globally):
            self._asked |= bool((self._at_ticks.tree.parts[0].bounds.low >= 0.0).any())
        least, most = self._between.margin, -self._at_ticks.margin
        self.verdict = _verdict(least, most)
        if self.verdict is Verdict.HOLDS and not self.exercised:
            self.verdict = Verdict.INCONCLUSIVE
        margin = most if most < 0.0 else least
        self.margin = margin if abs(margin) < inf else None
        self.latest = self.verdict
        if self._between.latest is not None and self._at_ticks.latest is not None:
            self.latest = _verdict(self._between.latest, -self._at_ticks.latest)

    def _exercise(self, moment: Moment) -> None:
        """As ``formulas.claim`` counts it."""
        if not isinstance(self.part, Globally | Initially) or (
            isinstance(self.part, Initially) and moment.tick == 0
        ):
            self._asked |= not any(isnan(moment.signals[signal].value) for signal in self._signals)
        self._untried -= {signal for signal in self._untried if moment.signals[signal].tried}

    @property
    def exercised(self) -> bool:
        """An "until" that may end at the first tick asks nothing."""
        if self._end is not None and -self._end.margin >= 0.0:
            return False
        return self._asked and not self._untried

    def reason(self, now: Signals) -> str:
        """What is measured of its signals at the latest tick, and what keeps a verdict from being one."""
        words = ", ".join(_told(signal, now[signal]) for signal in self._signals)
        if self.verdict is Verdict.INCONCLUSIVE and self._between.margin >= 0.0:
            return f"never exercised yet: {words}"
        return words


def _gravest(verdicts: Sequence[Verdict]) -> Verdict:
    return next(verdict for verdict in GRAVEST if verdict in verdicts)


def _verdict(least: float, most: float) -> Verdict:
    if most < 0.0:
        return Verdict.VIOLATED
    return Verdict.HOLDS if least >= 0.0 else Verdict.INCONCLUSIVE


def _told(signal: Signal, known: Known) -> str:
    """A signal's value in words, with its bounds if they are not it."""
    if known.low == -inf or isnan(known.value):
        return f"{signal.words} not known"
    unit: Unit = shown_in(signal.dimension)
    low, high = (f"{side * unit.per_si:.4g}" for side in (known.low, known.high))
    return f"{signal.words} {low if low == high else f'{low} to {high}'} {unit.symbol}".rstrip()
