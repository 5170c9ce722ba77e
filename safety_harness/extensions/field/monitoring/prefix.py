"""A formula of a run that goes on: its margin if the run ended now, in bounded memory.

``semantics`` gives the margins of a whole run.  Here the run grows by a tick, and the margin at its first
tick is computed again.  A formula with windows alone depends, at tick k, on the ticks that its windows reach.
``semantics`` judges these ticks too; older ticks are final.  An operator without a window is a recursion from
the end,

    v[k] = max(b[k], min(a[k], v[k + 1]))        always: min(a[k], v[k + 1]), eventually: max(b[k], v[k + 1])

Its margin at the first tick follows from the margin v[k] at the oldest tick in memory, and two numbers:

    v[0] = max(best, min(lasting, v[k]))         best = max over j < k of min(b[j], a[0], ..., a[j - 1])

with ``lasting`` the least of a[0] to a[k - 1].  Nothing is approximated: minima and maxima of the same
numbers are the same numbers.
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

Columns = Callable[[Comparison | Truth], tuple[int, int, int]]  # signal, low and high of an atom
Ends = tuple[float, float]  # least and largest
MOST_TICKS = 20_000  # that windows may reach ahead: each new tick looks at them again
ALWAYS: Ends = (np.inf, np.inf)  # both margins of a demand that no tick made
NEVER: Ends = (-np.inf, -np.inf)


def is_endless(formula: Formula) -> bool:
    """Return whether it is an operator without a window, which the end of the run decides."""
    own = isinstance(formula, Always | Eventually | Until) and formula.span is None
    return own or isinstance(formula, Globally)


def refuse_endless(formula: Formula, period_s: float) -> None:
    """Raise FormulaError for a formula that needs unbounded memory, or has a window without a tick."""
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
    """The ``least`` and largest (``most``) margin of ``formula`` at the first tick, so far.

    The latest tick and ``revisable`` ticks before it may be known better later.  ``latest`` are both margins
    of an outermost "always" or "whenever" at the latest tick whose windows have passed.

    Args:
        formula: The part of a claim; FormulaError as from ``refuse_endless``.
        period_s: The control period.
        revisable: The number of ticks before the latest of which more can be known later.
        columns: The signal that a comparison or truth reads, and where its low and its high stand among the
            numbers of one.

    """

    def __init__(self, formula: Formula, period_s: float, revisable: int, columns: Columns) -> None:
        refuse_endless(formula, period_s)
        self.formula = formula.body if isinstance(formula, Initially) else formula
        self.least, self.most = -np.inf, np.inf
        self.latest: Ends | None = None
        self._reach = reach_ticks(self.formula, period_s)
        self._kept_ticks = self._reach + revisable  # beside the latest, and one that is let go
        code: list[tuple[int, ...]] = []
        reading: list[tuple[float, ...]] = []
        self._whole = _Node(self.formula, period_s, columns, code, reading)
        self._code, self._limits = np.array(code, np.int64), np.array(reading)[:, 5:].copy()
        self._reading = np.array(reading)[:, :5].astype(np.int64)
        self._values = np.empty((len(code), 2, 2 * self._kept_ticks + 4))
        self._begin = self._end = 0
        self._asks = is_endless(self.formula) and isinstance(self.formula, Always | Globally)

    def see(self, seen: NDArray[np.float64], *, grown: bool) -> None:
        """Take what is known now of the latest ticks, ``seen`` (m, signals, c).

        With ``grown`` the last of them is new.
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
    """A formula with its row in the program of ``_evaluate``, and its margins at the first tick.

    Above operators without a window stand "not", "and" and "or" alone.

    Args:
        formula: The node, whose parts become nodes before it.
        period_s: The control period.
        columns: As for ``Prefix``.
        code: Rows (operator, first part, second part, window), written.
        reading: A row for each atom: its row in ``code``, the numbers that it reads, and its limit; written.

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
        for further in rows[1:-1]:  # of three and more, two by two
            code.append((operator, row, further, *NO_WINDOW))
            row = len(code) - 1
        code.append((operator, row, rows[-1], *(NO_WINDOW if span is None else span.ticks(period_s))))
        self.row: int = len(code) - 1

    def now(self, oldest: NDArray[np.float64]) -> Ends:
        """Return both ends, by the values ``oldest`` (nodes, 2) of every node."""
        if not self._over:
            return self._at_first_tick(self._ends(oldest))
        lows, highs = zip(*(part.now(oldest) for part in self.parts), strict=True)
        if isinstance(self._formula, Not):
            return -highs[0], -lows[0]
        worst = min if isinstance(self._formula, And) else max
        return worst(lows), worst(highs)

    def forget(self, oldest: NDArray[np.float64]) -> None:
        """Let the oldest tick go, whose windows have passed; ``oldest`` (nodes, 2) are its values."""
        for part in self.parts if self._over else ():
            part.forget(oldest)
        lasts, ends = self.step(oldest)
        self._best = self._at_first_tick(ends)
        self._lasting = min(self._lasting[0], lasts[0]), min(self._lasting[1], lasts[1])

    def _at_first_tick(self, later: Ends) -> Ends:
        """Return the margins at the first tick where those at the oldest tick are ``later``."""
        (low, high), (least, most), (best, best_high) = later, self._lasting, self._best
        return max(best, min(least, low)), max(best_high, min(most, high))

    def step(self, values: NDArray[np.float64]) -> tuple[Ends, Ends]:
        """Return a and b of the recursion at a tick, by the ``values`` (nodes, 2) of every node there.

        For what has windows b is the margin, which is final.
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
    """Write the margins of every node from tick ``first`` to before ``stop``, as ``semantics.margins`` does.

    A truth has limit 0.5 and an end of infinity.
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
