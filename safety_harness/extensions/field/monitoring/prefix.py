"""The margin of a formula at the first tick of a run that still grows, in bounded memory.

``semantics`` computes the margins of a complete run.  Here the run grows by one tick at a time, and the code
computes the margin again as if the run ended there.  If every operator has a window, the margin at tick k
depends only on the ticks that the windows reach.  ``semantics`` evaluates these ticks; older ticks are final.
The margin v of an operator without a window follows from the margins a and b of its parts, tick by tick from
the end of the run:

    v[k] = max(b[k], min(a[k], v[k + 1]))        always: min(a[k], v[k + 1]), eventually: max(b[k], v[k + 1])

The margin at the first tick follows from the margin v[k] at the oldest tick k in memory, and two numbers:

    v[0] = max(best, min(lasting, v[k]))         best = max over j < k of min(b[j], a[0], ..., a[j - 1])

where ``lasting`` is the least of a[0] to a[k - 1].  The result is exact, since it has the minima and maxima
of the same numbers as in ``semantics``.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled
from safety_harness.claims.formulas.formula import (
    Always,
    And,
    Comparison,
    Eventually,
    Formula,
    Globally,
    Initially,
    Not,
    Relation,
    Truth,
    Until,
    reach_ticks,
)
from safety_harness.claims.formulas.quantities import formula_error
from safety_harness.claims.formulas.semantics import LEAST, NO_WINDOW, NOT, OPERATORS, operate

Columns = Callable[[Comparison | Truth], tuple[int, int, int]]  # its signal, and columns of its bounds
Ends = tuple[float, float]  # least and largest
MOST_TICKS = 20_000  # the farthest that windows may reach, since each new tick evaluates these ticks again
ALWAYS: Ends = (np.inf, np.inf)  # both margins where no tick demands anything
NEVER: Ends = (-np.inf, -np.inf)


def is_endless(formula: Formula) -> bool:
    """Return whether ``formula`` is an operator without a window, so that the end of the run decides it."""
    own = isinstance(formula, Always | Eventually | Until) and formula.span is None
    return own or isinstance(formula, Globally)


def refuse_endless(formula: Formula, period_s: float) -> None:
    """Raise FormulaError if ``formula`` needs unbounded memory, or has a window without a tick."""
    for node in formula.nodes():
        span = getattr(node, "span", None)
        if span is not None and span.ticks(period_s)[0] > span.ticks(period_s)[1]:
            expected = f"a window with a control tick in it (one every {period_s * 1e3:g} ms)"
            raise formula_error(expected, f'{span.begin} to {span.end} in "{node}"')
        if span is None and not is_endless(node):
            continue
        inner = next((own for own in node.nodes() if own is not node and is_endless(own)), None)
        if inner is not None:
            raise formula_error(
                "while a run goes on, operators over what is known once its own windows have passed",
                f'"{inner}", which only the end of the run decides, within "{node}"',
                "give it a window, or let it stand outside",
            )
    if (reach := reach_ticks(formula, period_s)) > MOST_TICKS:
        expected = (
            f"windows that reach at most {MOST_TICKS * period_s:g} s ahead, as all of that is remembered"
        )
        raise formula_error(expected, f'{reach * period_s:g} s in "{formula}"')


class Prefix:
    """The ``least`` and largest (``most``) possible margin of ``formula`` at the run's first tick.

    Later samples may narrow the bounds of signals at the latest tick and at ``revisable`` ticks before it.
    If the outermost operator is "always" or "whenever", ``latest`` has the margins of its demand. They are
    the margins at the latest tick whose windows have passed.

    Args:
        formula: The part of a claim.  ``refuse_endless`` raises FormulaError for some formulas.
        period_s: The control period.
        revisable: The number of ticks before the latest whose bounds later samples may narrow.
        columns: Returns for a comparison or truth the index of its signal, and the columns of ``seen`` with
            the low and the high bound.

    """

    def __init__(self, formula: Formula, period_s: float, revisable: int, columns: Columns) -> None:
        refuse_endless(formula, period_s)
        self.formula = formula.body if isinstance(formula, Initially) else formula
        self.least, self.most = -np.inf, np.inf
        self.latest: Ends | None = None
        self._reach = reach_ticks(self.formula, period_s)
        self._kept_ticks = self._reach + revisable  # besides the latest tick, and one that is to be forgotten
        code: list[tuple[int, ...]] = []
        reading: list[tuple[float, ...]] = []
        self._whole = _Node(self.formula, period_s, columns, code, reading)
        self._code, self._limits = np.array(code, np.int64), np.array(reading)[:, 5:].copy()
        self._reading = np.array(reading)[:, :5].astype(np.int64)
        self._values = np.empty((len(code), 2, 2 * self._kept_ticks + 4))
        self._begin = self._end = 0
        self._asks = is_endless(self.formula) and isinstance(self.formula, Always | Globally)

    def see(self, seen: NDArray[np.float64], *, grown: bool) -> None:
        """Update the margins by the present bounds ``seen`` (m, signals, c) of signals at the latest m ticks.

        ``grown`` states that the last of these ticks is new.
        """
        if grown and self._end == self._kept_ticks * 2 + 4:
            kept = self._end - self._begin
            self._values[:, :, :kept] = self._values[:, :, self._begin : self._end].copy()
            self._begin, self._end = 0, kept
        self._end += grown
        begin, end = self._begin, self._end
        _evaluate(self._code, self._reading, self._limits, seen, self._values, begin, end)
        self.least, self.most = self._whole.now(self._values[:, :, begin])
        if self._asks and begin + self._reach < end:
            self.latest, _ = self._whole.step(self._values[:, :, end - 1 - self._reach])
        if grown and end - begin - 1 > self._kept_ticks:
            self._whole.forget(self._values[:, :, begin])
            self._begin += 1

    @property
    def triggered(self) -> bool:
        """Return whether the trigger of a "whenever" certainly held at a tick in memory."""
        trigger = self._whole.parts[0].row
        return bool((self._values[trigger, 0, self._begin : self._end] >= 0.0).any())


class _Node:
    """A node of a formula, with its row in the program of ``_evaluate`` and its margins at the first tick.

    Only "not", "and" and "or" may contain an operator without a window.

    Args:
        formula: The formula of the node; its parts become nodes first.
        period_s: The control period.
        columns: As for ``Prefix``.
        code: Rows (operator, first part, second part, window), to which the node appends its own.
        reading: Rows (row in ``code``, numbers to read, limit) of atoms, to which an atom appends its own.

    """

    def __init__(
        self,
        formula: Formula,
        period_s: float,
        columns: Columns,
        code: list[tuple[int, ...]],
        reading: list[tuple[float, ...]],
    ) -> None:
        self.parts = [_Node(part, period_s, columns, code, reading) for part in formula.parts]
        self._formula, span = formula, getattr(formula, "span", None)
        self._endless = is_endless(formula)
        self._over = not self._endless and any(map(is_endless, formula.nodes()))
        self._best, self._lasting = (-np.inf, -np.inf), (np.inf, np.inf)
        if isinstance(formula, Comparison | Truth):
            reading.append((len(code), *_reading(formula, columns)))
        operator, rows = OPERATORS.index(type(formula)), [part.row for part in self.parts] or [0]
        row = rows[0]
        for further in rows[1:-1]:  # an operator with three parts or more joins them two by two
            code.append((operator, row, further, *NO_WINDOW))
            row = len(code) - 1
        code.append((operator, row, rows[-1], *(NO_WINDOW if span is None else span.ticks(period_s))))
        self.row: int = len(code) - 1

    def now(self, oldest: NDArray[np.float64]) -> Ends:
        """Return both margins at the first tick, from every node's margins ``oldest`` at the oldest tick."""
        if not self._over:
            return self._at_first_tick(self._ends(oldest))
        lows, highs = zip(*(part.now(oldest) for part in self.parts), strict=True)
        if isinstance(self._formula, Not):
            return -highs[0], -lows[0]
        worst = min if isinstance(self._formula, And) else max
        return worst(lows), worst(highs)

    def forget(self, oldest: NDArray[np.float64]) -> None:
        """Keep the effect of the oldest tick, with margins ``oldest`` (nodes, 2), and forget this tick."""
        for part in self.parts if self._over else ():
            part.forget(oldest)
        lasts, ends = self.step(oldest)
        self._best = self._at_first_tick(ends)
        self._lasting = min(self._lasting[0], lasts[0]), min(self._lasting[1], lasts[1])

    def _at_first_tick(self, later: Ends) -> Ends:
        """Return the margins at the first tick, if the margins at the oldest tick are ``later``."""
        (low, high), (least, most), (best, best_high) = later, self._lasting, self._best
        return max(best, min(least, low)), max(best_high, min(most, high))

    def step(self, values: NDArray[np.float64]) -> tuple[Ends, Ends]:
        """Return a and b of the recursion at a tick, where the nodes have the margins ``values`` (nodes, 2).

        For a formula whose operators all have windows, b is its margin, which is final.
        """
        if not self._endless:
            return NEVER, self._ends(values)
        parts = [part._ends(values) for part in self.parts]
        if isinstance(self._formula, Always):
            return parts[0], NEVER
        if isinstance(self._formula, Eventually):
            return ALWAYS, parts[0]
        if isinstance(self._formula, Until):
            return parts[0], parts[1]
        (least, most), (low, high) = parts  # of a trigger, and of its demand
        return (np.inf if most < 0.0 else low, high if least >= 0.0 else np.inf), NEVER

    def _ends(self, values: NDArray[np.float64]) -> Ends:
        low, high = values[self.row].tolist()
        return low, high


def _reading(atom: Comparison | Truth, columns: Columns) -> tuple[float, ...]:
    """Return what ``_evaluate`` reads: signal, relation, low, high, limit, and the margin at the limit."""
    signal, low, high = columns(atom)
    if isinstance(atom, Truth):
        return signal, 1, low, high, 0.5, np.inf
    above = atom.relation in (Relation.ABOVE, Relation.AT_LEAST)
    at_limit = -LEAST if atom.relation in (Relation.ABOVE, Relation.BELOW) else LEAST
    return signal, above, low, high, atom.limit.value, at_limit


@compiled
def _evaluate(
    code: NDArray[np.int64],  # (k, 5)
    reading: NDArray[np.int64],  # (a, 5)
    limits: NDArray[np.float64],  # (a, 2)
    seen: NDArray[np.float64],  # (m, signals, c) of the latest ticks
    values: NDArray[np.float64],  # (k, 2, ticks), written
    first: int,
    stop: int,
) -> None:
    """Write every node's margins at the ticks ``first`` to ``stop`` - 1, as ``semantics.margins`` does.

    A truth has the limit 0.5, and its margins are infinite.
    """
    count = seen.shape[0]
    for a in range(reading.shape[0]):
        node, signal, above, low, high = reading[a]
        for k in range(max(count - (stop - first), 0), count):
            least, most = seen[k, signal, low] - limits[a, 0], seen[k, signal, high] - limits[a, 0]
            if not above:
                least, most = limits[a, 0] - seen[k, signal, high], limits[a, 0] - seen[k, signal, low]
            if limits[a, 1] == np.inf:
                least, most = np.copysign(np.inf, least), np.copysign(np.inf, most)
            values[node, 0, stop - count + k] = least if least != 0.0 else limits[a, 1]
            values[node, 1, stop - count + k] = most if most != 0.0 else limits[a, 1]
    for i in range(code.shape[0]):
        operator, first_part, second_part, begin, end = code[i]
        if operator >= NOT:
            values[i, 0, first:stop], values[i, 1, first:stop] = operate(
                operator,
                begin,
                end,
                values[first_part, 0, first:stop],
                values[first_part, 1, first:stop],
                values[second_part, 0, first:stop],
                values[second_part, 1, first:stop],
            )
