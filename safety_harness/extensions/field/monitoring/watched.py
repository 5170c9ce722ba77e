"""Judge claims on a run that still continues.

After each tick, the verdict is the same as the verdict of ``FormulaClaim`` on the run up to this tick.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from math import inf, isnan

import numpy as np
from numpy.typing import NDArray

from safety_harness.claims.formulas.claim import WORST_FIRST, near_of
from safety_harness.claims.formulas.formula import (
    Comparison,
    Formula,
    Globally,
    Initially,
    Not,
    Relation,
    Truth,
    goal_of,
    parts_of,
    reach_ticks,
    shown_in,
    signals_of,
    unit_of,
)
from safety_harness.claims.formulas.parse import parse_formula
from safety_harness.claims.formulas.quantities import formula_error
from safety_harness.claims.formulas.signals import hand_distance, nearest_hand_to_tcp
from safety_harness.claims.properties.base import Unit
from safety_harness.claims.properties.catalogue import CATALOGUE, entry_claimed
from safety_harness.claims.signals.signal import Signal
from safety_harness.extensions.field.monitoring.prefix import Prefix, is_endless
from safety_harness.extensions.field.monitoring.sensing import (
    CELL_HIGH,
    CELL_LOW,
    EXERCISED,
    HIGH,
    LOW,
    MEASURED,
    VALUE,
    Values,
)
from safety_harness.scenario.model import Verdict

AT_TICK, CELL = 0, 1


def watched_formula(sentence: str) -> Formula:
    """Return the formula of a claim.

    The ``sentence`` is a formula itself, or a sentence of the catalogue that has a formula. Raise
    FormulaError if a sentence of the catalogue has no formula.
    """
    if (claimed := entry_claimed(sentence)) is None:
        return parse_formula(sentence)
    entry, match = claimed
    if entry.formula:
        return parse_formula(entry.formula.format(match[1]))
    known = " and ".join(f'"{entry.example}"' for entry in CATALOGUE if entry.formula)
    expected = f"a formula, or a sentence of the catalogue that is one, as {known} are"
    raise formula_error(expected, f'"{sentence}", which looks at a whole run', "judge tells it of the log")


class WatchedClaim:
    """A claim that is judged on the run up to the latest tick.

    The constructor raises FormulaError if ``sentence`` has a signal outside ``known``, or if it needs
    unbounded memory.
    """

    def __init__(self, sentence: str, known: Collection[Signal], period_s: float, revisable: int) -> None:
        formula = watched_formula(sentence)
        for signal in signals_of(formula):
            if signal not in known:
                expected = f"a signal that this stream has: {', '.join(signal.words for signal in known)}"
                raise formula_error(expected, signal.words)
        self.sentence = sentence
        self.parts = [WatchedPart(part, period_s, revisable) for part in parts_of(formula)]
        self.single = len(self.parts) == 1

    def see(self, seen: Values, first: int, *, grown: bool) -> None:
        """Update the verdicts with the signals ``seen`` (m, signals, 6) of m ticks from tick ``first`` on.

        ``grown`` is True if the last of these ticks has not been judged before.
        """
        for part in self.parts:
            part.see(seen, first, grown=grown)

    @property
    def verdict(self) -> Verdict:
        """Return the verdict on the run so far, as if it ended now."""
        first = self.parts[0]
        return first.verdict if self.single else _worst([part.verdict for part in self.parts])

    @property
    def latest(self) -> Verdict:
        """Return the verdict at the latest decided tick.

        If the claim is not about every tick, return the verdict on the run.
        """
        first = self.parts[0]
        return first.latest if self.single else _worst([part.latest for part in self.parts])

    @property
    def deciding(self) -> WatchedPart:
        """Return the part that has the worst verdict; if several parts have it, return the first of them."""
        return next(part for part in self.parts if part.verdict is self.verdict)


class WatchedPart:
    """A part of a claim, with its ``verdict`` on the run so far, and its verdict at one tick (``latest``).

    ``margin`` is the least possible margin of the run. If the part is violated, it is the largest possible
    margin instead. If the margin is infinite, ``margin`` is None.
    """

    def __init__(self, part: Formula, period_s: float, revisable: int) -> None:
        self.part, self.unit = part, unit_of(part)
        self.verdict = self.latest = Verdict.INCONCLUSIVE
        self.margin: float | None = None
        directions = _directions(part)
        single = all(len(signs) == 1 for signs in directions.values())
        rising = {atom for atom in directions if 1 in directions[atom]}

        def prefix(formula: Formula, least: int, most: int) -> Prefix:
            """Return a Prefix that computes the margins of ``formula`` from the bounds at ticks or in cells.

            A cell is the time from one tick to the next. For the least margin of ``formula``, the Prefix uses
            the lower bound of a comparison's margin. Inside a "not" or a trigger, it uses the upper bound
            instead.
            """

            def columns(atom: Comparison | Truth) -> tuple[int, int, int]:
                low, high = (least, most) if atom in rising else (most, least)
                if isinstance(atom, Comparison) and atom.relation in (Relation.BELOW, Relation.AT_MOST):
                    low, high = high, low
                return MEASURED.index(atom.signal), (LOW, CELL_LOW)[low], (HIGH, CELL_HIGH)[high]

            return Prefix(formula, period_s, revisable, columns)

        self._least = prefix(part, CELL, AT_TICK if single else CELL)
        self._most = self._least if single else prefix(part, AT_TICK, AT_TICK)
        goal = goal_of(part)
        self._end = None if goal is None else prefix(goal, AT_TICK, AT_TICK)
        nodes = dict.fromkeys((self._least, self._most, self._end))
        self._prefixes = [prefix for prefix in nodes if prefix is not None]
        self._signals = signals_of(part)
        self._read = [MEASURED.index(signal) for signal in self._signals]
        triggers = signals_of(part.trigger) if isinstance(part, Globally) else ()
        self._untried = {
            k for k, signal in zip(self._read, self._signals, strict=True) if signal not in triggers
        }
        self._asked = False
        of_hands = (hand_distance, nearest_hand_to_tcp)
        near_m = (near_of(part, signal) if signal in of_hands else -inf for signal in self._signals)
        self._near_m = dict(zip(self._read, near_m, strict=True))
        span = getattr(part, "span", None)
        self._begin = span.ticks(period_s)[0] if span is not None else 0
        self._last = inf if any(map(is_endless, part.nodes())) else reach_ticks(part, period_s)

    def see(self, seen: Values, first: int, *, grown: bool) -> None:
        """Update the verdicts by ``seen`` (m, signals, 6), as ``WatchedClaim.see`` does."""
        for prefix in self._prefixes:
            prefix.see(seen, grown=grown)
        self._exercise(seen, first)
        least, most = self._least.least, self._most.most
        self.verdict = _verdict(least, most)
        if self.verdict is Verdict.HOLDS and not self.exercised:
            self.verdict = Verdict.INCONCLUSIVE
        margin = most if most < 0.0 else least
        self.margin = margin if abs(margin) < inf else None
        self.latest = self.verdict
        if self._least.latest is not None and self._most.latest is not None:
            self.latest = _verdict(self._least.latest[0], self._most.latest[1])

    def _exercise(self, seen: Values, first: int) -> None:
        """Record which signals exercise the part, by the rules of ``claims.formulas.claim``."""
        if not self._asked and isinstance(self.part, Globally):
            self._asked = self._most.triggered
        elif not self._asked and (first == 0 or not isinstance(self.part, Initially)):
            judged = seen[:1] if isinstance(self.part, Initially) else seen
            self._asked = not bool(np.isnan(judged[:, self._read, VALUE]).any(axis=1).all())
        ticks = first + np.arange(len(seen))
        own = seen[(ticks >= self._begin) & (ticks <= self._last)]
        if self._untried and (not isinstance(self.part, Globally) or self._most.triggered):
            self._untried -= {k for k in self._untried if self._tries(own[:, k], self._near_m[k]).any()}

    @staticmethod
    def _tries(own: Values, near_m: float) -> NDArray[np.bool_]:
        """Return whether ``own`` (m, 6) exercises a claim or is below ``near_m`` at each tick, shape (m,)."""
        tries: NDArray[np.bool_] = (own[:, EXERCISED] > 0.0) | (
            ~np.isnan(own[:, VALUE]) & (own[:, HIGH] < near_m)
        )
        return tries

    @property
    def exercised(self) -> bool:
        """Return whether the run exercised the part.

        The result is False if the goal of the part may have been true already at the first tick.
        """
        if self._end is not None and self._end.most >= 0.0:
            return False
        return self._asked and not self._untried

    def reason(self, now: Values) -> str:
        """Return the signals ``now`` (signals, 6) as text.

        If the run has never exercised the part, the text says so.
        """
        values = ", ".join(
            _value_text(signal, now[k]) for k, signal in zip(self._read, self._signals, strict=True)
        )
        if self.verdict is Verdict.INCONCLUSIVE and self._least.least >= 0.0:
            return f"never exercised yet: {values}"
        return values


def _directions(formula: Formula, sign: int = 1) -> dict[Comparison | Truth, set[int]]:
    """Return for each comparison whether the formula's margin rises or falls with the comparison's margin.

    The sign 1 means that the formula's margin rises, and -1 that it falls. A trigger has the sign -1, because
    the formula's least margin depends on the trigger's largest margin.
    """
    if isinstance(formula, Comparison | Truth):
        return {formula: {sign}}
    directions: dict[Comparison | Truth, set[int]] = {}
    for part in formula.parts:
        turned = isinstance(formula, Not) or (isinstance(formula, Globally) and part is formula.trigger)
        for atom, signs in _directions(part, -sign if turned else sign).items():
            directions.setdefault(atom, set()).update(signs)
    return directions


def _worst(verdicts: Sequence[Verdict]) -> Verdict:
    return next(verdict for verdict in WORST_FIRST if verdict in verdicts)


def _verdict(least: float, most: float) -> Verdict:
    if most < 0.0:
        return Verdict.VIOLATED
    return Verdict.HOLDS if least >= 0.0 else Verdict.INCONCLUSIVE


def _value_text(signal: Signal, known: Values) -> str:
    """Return the text of a signal's value, which has both bounds in ``known`` (6,) if they differ."""
    if known[LOW] == -inf or isnan(known[VALUE]):
        return f"{signal.words} not known"
    unit: Unit = shown_in(signal.dimension)
    low, high = (f"{float(side) * unit.per_si:.4g}" for side in known[[LOW, HIGH]])
    return f"{signal.words} {low if low == high else f'{low} to {high}'} {unit.symbol}".rstrip()
