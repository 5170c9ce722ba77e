"""A claim while a run goes on: at every tick the verdict that ``FormulaClaim`` has on the run up to there."""

from __future__ import annotations

from functools import partial
from math import inf, isnan

from safety_harness.formulas.claim import GRAVEST
from safety_harness.formulas.formula import Formula, Globally, Initially, Until, parts_of, signals_of, unit_of
from safety_harness.formulas.parse import parse_formula
from safety_harness.formulas.prefix import Prefix
from safety_harness.formulas.quantities import formula_error
from safety_harness.formulas.signal import Signal
from safety_harness.formulas.formula import shown_in
from safety_harness.monitoring.sample import GIVEN
from safety_harness.monitoring.sensing import MEASURED, Known, Signals, margin_at
from safety_harness.properties.base import Unit
from safety_harness.scenario.model import Verdict

ASKED = (*MEASURED, *GIVEN.values())


class WatchedClaim:
    """What ``sentence`` says of a run so far; FormulaError if it cannot be told in bounded memory."""

    def __init__(self, sentence: str, period_s: float) -> None:
        formula = parse_formula(sentence)
        for signal in signals_of(formula):
            if signal not in ASKED:
                expected = f"a signal that a stream has: {', '.join(one.words for one in ASKED)}"
                raise formula_error(expected, signal.words)
        self.sentence = str(formula)
        self.parts = [WatchedPart(part, period_s) for part in parts_of(formula)]

    def step(self, now: Signals, before: Signals) -> None:
        """The next tick, as ``Sensing.step`` gives it."""
        for part in self.parts:
            part.step(now, before)

    @property
    def verdict(self) -> Verdict:
        """On the run so far, as if it ended now."""
        return _gravest([part.verdict for part in self.parts])

    @property
    def latest(self) -> Verdict:
        """Of the latest tick of which it can be told, where a claim asks every tick; else of the run so far."""
        return _gravest([part.latest for part in self.parts])

    @property
    def deciding(self) -> WatchedPart:
        """The first part with the gravest verdict."""
        return next(part for part in self.parts if part.verdict is self.verdict)


class WatchedPart:
    """One part of a claim: its ``verdict`` on the run so far, and what it says of the ``latest`` tick."""

    def __init__(self, part: Formula, period_s: float) -> None:
        self.part, self.unit = part, unit_of(part)
        self.verdict = self.latest = Verdict.INCONCLUSIVE
        self.margin: float | None = None
        self.unknown_since_s: float | None = None
        self._between, self._at_ticks = Prefix(part, period_s, 1), Prefix(part, period_s, -1)
        self._signals = signals_of(part)
        tried = set(self._signals)
        self._ends: list[Prefix] = []
        if isinstance(part, Globally):
            tried -= set(signals_of(part.trigger))
        elif isinstance(part, Until):
            self._ends = [Prefix(part.second, period_s, sign) for sign in (1, -1)]
        self._untried = tried  # yet
        self._asked = self._begun = False
        self._certain = True

    def step(self, now: Signals, before: Signals) -> None:
        """The next tick."""
        at_tick = partial(margin_at, signals=now, cell=False)
        self._at_ticks.step(at_tick)
        self._between.step(at_tick, partial(margin_at, signals=before, cell=True) if before else None)
        for prefix in self._ends:
            prefix.step(at_tick)
        self._see(now, before)
        least, most = self._between.margin, -self._at_ticks.margin
        self.verdict = _verdict(least, most)
        if self.verdict is Verdict.HOLDS and not self._exercised:
            self.verdict = Verdict.INCONCLUSIVE
        margin = most if most < 0.0 and not (self._certain and least > -inf) else least
        self.margin = margin if abs(margin) < inf else None
        self.latest = self.verdict
        if self._between.latest is not None and self._at_ticks.latest is not None:
            self.latest = _verdict(self._between.latest, -self._at_ticks.latest)

    def _see(self, now: Signals, before: Signals) -> None:
        """Is it exercised?  As ``formulas.claim`` counts it."""
        known = not any(isnan(now[signal].value) for signal in self._signals)
        if isinstance(self.part, Globally):
            self._asked = self._asked or bool((self._at_ticks.tree.parts[0].bounds.low >= 0.0).any())
        elif not (isinstance(self.part, Initially) and self._begun):
            self._asked |= known
        self._begun = True
        self._certain &= all(now[signal].certain for signal in self._signals)
        for signal in tuple(self._untried):
            if now[signal].tried or (before and before[signal].tried):
                self._untried.discard(signal)

    @property
    def _exercised(self) -> bool:
        """An "until" that ends at the first tick, or may, asks nothing."""
        if self._ends:
            least, most = self._ends
            if (least.margin if self._certain else -most.margin) >= 0.0:
                return False
        return self._asked and not self._untried

    def reason(self, now: Signals) -> str:
        """What is measured of its signals at the tick, and what keeps a verdict from being one."""
        words = ", ".join(_told(signal, now[signal]) for signal in self._signals)
        if self.verdict is Verdict.INCONCLUSIVE and -self._at_ticks.margin >= 0.0 <= self._between.margin:
            return f"never exercised yet: {words}"
        return words


def _gravest(verdicts: list[Verdict]) -> Verdict:
    return next(verdict for verdict in GRAVEST if verdict in verdicts)


def _verdict(least: float, most: float) -> Verdict:
    if most < 0.0:
        return Verdict.VIOLATED
    return Verdict.HOLDS if least >= 0.0 else Verdict.INCONCLUSIVE


def _told(signal: Signal, known: Known) -> str:
    """A signal's value in words, with its bounds if they are not it."""
    if signal.dimension is None:
        truth = {True: "", False: "not "}.get(known.value > 0.5) if known.certain else "perhaps "
        return f"{truth}{signal.words}"
    unit: Unit = shown_in(signal.dimension)
    low, high = (f"{side * unit.per_si:.4g}" for side in (known.low, known.high))
    if known.low == -inf:
        return f"{signal.words} not known"
    number = low if known.certain else f"{low} to {high}"
    return f"{signal.words} {number} {unit.symbol}".rstrip()
