"""A claim while a run goes on: at every tick the verdict that ``FormulaClaim`` has on the run up to there."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import partial
from math import inf, isnan

from safety_harness.formulas.claim import GRAVEST
from safety_harness.formulas.formula import (
    Comparison,
    Formula,
    Globally,
    Initially,
    Not,
    Truth,
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
from safety_harness.monitoring.sensing import Known, Signals, TickSeen, margin_at
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

    def see(self, moments: Sequence[TickSeen], *, grown: bool) -> None:
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
        ways = _ways(part)
        single = all(len(one) == 1 for one in ways.values())
        atoms = [node for node in part.nodes() if isinstance(node, Comparison | Truth)]
        self._rising = {id(atom) for atom in atoms if 1 in ways[atom]}
        self._least = Prefix(part, period_s, revisable)
        self._most = self._least if single else Prefix(part, period_s, revisable)
        self._end = Prefix(part.second, period_s, revisable) if isinstance(part, Until) else None
        self._signals = signals_of(part)
        self._untried = set(self._signals)  # yet
        if isinstance(part, Globally):
            self._untried -= set(signals_of(part.trigger))
        self._asked = False

    def see(self, moments: Sequence[TickSeen], *, grown: bool) -> None:
        """As ``WatchedClaim.see``."""
        signals = [moment.signals for moment in moments]
        at_ticks = [partial(self._margin, one, (False, False)) for one in signals]
        asked = [(self._least, [partial(self._margin, one, (True, True)) for one in signals])]
        if self._most is self._least:
            asked = [(self._least, [partial(self._margin, one, (True, False)) for one in signals])]
        else:
            asked.append((self._most, at_ticks))
        if self._end is not None:
            asked.append((self._end, at_ticks))
        for prefix, bounds in asked:
            if grown:
                prefix.step(bounds[-1], bounds[:-1])
            else:
                prefix.revise(bounds)
        for moment in moments:
            self._exercise(moment)
        if isinstance(self.part, Globally):
            self._asked |= bool((self._most.tree.parts[0].bounds.low >= 0.0).any())
        least, most = self._least.least, self._most.most
        self.verdict = _verdict(least, most)
        if self.verdict is Verdict.HOLDS and not self.exercised:
            self.verdict = Verdict.INCONCLUSIVE
        margin = most if most < 0.0 else least
        self.margin = margin if abs(margin) < inf else None
        self.latest = self.verdict
        if self._least.latest is not None and self._most.latest is not None:
            self.latest = _verdict(self._least.latest[0], self._most.latest[1])

    def _margin(
        self, signals: Signals, cells: tuple[bool, bool], atom: Comparison | Truth
    ) -> tuple[float, float]:
        """A comparison's least and largest margin, as the formula's least and largest are asked of ``cells``.

        A formula's least margin is of what may be from tick to tick, its largest of the ticks alone; the low
        of a comparison decides the one, or the other if it stands below a "not" or in a trigger.
        """
        low, high = cells if id(atom) in self._rising else cells[::-1]
        if low is high:
            return margin_at(atom, signals, cell=low)
        return margin_at(atom, signals, cell=low)[0], margin_at(atom, signals, cell=high)[1]

    def _exercise(self, moment: TickSeen) -> None:
        """As ``formulas.claim`` counts it."""
        if not isinstance(self.part, Globally | Initially) or (
            isinstance(self.part, Initially) and moment.tick == 0
        ):
            self._asked |= not any(isnan(moment.signals[signal].value) for signal in self._signals)
        self._untried -= {signal for signal in self._untried if moment.signals[signal].tried}

    @property
    def exercised(self) -> bool:
        """An "until" that may end at the first tick asks nothing."""
        if self._end is not None and self._end.most >= 0.0:
            return False
        return self._asked and not self._untried

    def reason(self, now: Signals) -> str:
        """What is measured of its signals at the latest tick, and what keeps a verdict from being one."""
        words = ", ".join(_told(signal, now[signal]) for signal in self._signals)
        if self.verdict is Verdict.INCONCLUSIVE and self._least.least >= 0.0:
            return f"never exercised yet: {words}"
        return words


def _ways(formula: Formula, sign: int = 1) -> dict[Comparison | Truth, set[int]]:
    """Of each comparison whether the formula's margin rises with its own (1), falls (-1), or both.

    Of a trigger the other bound counts, which is as if it fell.
    """
    if isinstance(formula, Comparison | Truth):
        return {formula: {sign}}
    found: dict[Comparison | Truth, set[int]] = {}
    for part in formula.parts:
        turned = isinstance(formula, Not) or (isinstance(formula, Globally) and part is formula.trigger)
        for atom, ways in _ways(part, -sign if turned else sign).items():
            found.setdefault(atom, set()).update(ways)
    return found


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
