"""Compute the margin of a formula at the first tick of a run that still continues.

The computation needs only bounded memory. ``semantics`` computes the margins of a complete run. Here the run
grows tick by tick, and after each tick the margin is computed as if the run ended at this tick. If every
operator has a window, the margin at tick k depends only on the ticks that the windows reach. ``semantics``
evaluates these ticks; older ticks are final. Let a and b be the margins of the parts of an operator without a
window. The margin v of the operator follows from them recursively, from the end of the run backwards:

    v[k] = max(b[k], min(a[k], v[k + 1]))        always: min(a[k], v[k + 1]), eventually: max(b[k], v[k + 1])

Let k be the oldest tick in memory. The margin at the first tick follows from v[k] and two numbers:

    v[0] = max(best, min(lasting, v[k]))         best = max over j < k of min(b[j], a[0], ..., a[j - 1])

Here, ``lasting`` is the minimum of a[0] to a[k - 1]. The result is exact, because it consists of minima and
maxima of the same numbers as in ``semantics``.
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
    """Return True if ``formula`` is an operator without a window.

    The value of such a formula may remain open until the end of the run.
    """
    own = isinstance(formula, Always | Eventually | Until) and formula.span is None
    return own or isinstance(formula, Globally)


def refuse_endless(formula: Formula, period_s: float) -> None:
    """Raise FormulaError if ``formula`` needs too much memory, or has a window that contains no tick."""
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
    """The range of possible margins of ``formula`` at the first tick of a run: ``least`` to ``most``.

    The bounds of signals are not final at the latest tick and at the ``revisable`` ticks before it, because
    later samples may narrow them. If the outermost operator is "always" or "whenever", ``latest`` contains
    the margins of the demand of this operator. They are for the latest tick whose windows are already
    complete.

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
        # Twice the ticks in memory, so that ``see`` moves the margins only when the buffer is full.
        self._values = np.empty((len(code), 2, 2 * self._kept_ticks + 4))
        self._begin = self._end = 0
        self._asks = is_endless(self.formula) and isinstance(self.formula, Always | Globally)

    def see(self, seen: NDArray[np.float64], *, grown: bool) -> None:
        """Update the margins with the bounds ``seen`` (m, signals, c) of signals at the latest m ticks.

        ``grown`` is True if the last of these ticks is new.
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
        # Later samples cannot change this tick any more.
        if grown and end - begin - 1 > self._kept_ticks:
            self._whole.forget(self._values[:, :, begin])
            self._begin += 1

    @property
    def triggered(self) -> bool:
        """Return True if the trigger of a "whenever" was certainly true at one of the ticks in memory."""
        trigger = self._whole.parts[0].row
        return bool((self._values[trigger, 0, self._begin : self._end] >= 0.0).any())


class _Node:
    """A node of a formula.

    The node has a row in the program that ``_evaluate`` runs, and it stores its margins at the first tick.
    Only "not", "and" and "or" may contain an operator without a window.

    Args:
        formula: The formula of the node; its parts become nodes first.
        period_s: The control period.
        columns: As for ``Prefix``.
        code: The rows (operator, first part, second part, window) of the program; the node appends its own
            row.
        reading: The rows for atoms. A row contains the row in ``code``, the numbers to read, and the limit.
            An atom appends its own row.

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
        """Return both margins at the first tick.

        ``oldest`` has the margins of all nodes at the oldest tick in memory.
        """
        if not self._over:
            return self._at_first_tick(self._ends(oldest))
        lows, highs = zip(*(part.now(oldest) for part in self.parts), strict=True)
        if isinstance(self._formula, Not):
            return -highs[0], -lows[0]
        worst = min if isinstance(self._formula, And) else max
        return worst(lows), worst(highs)

    def forget(self, oldest: NDArray[np.float64]) -> None:
        """Forget the oldest tick, whose margins are ``oldest`` (nodes, 2).

        Their effect on later results is retained.
        """
        for part in self.parts if self._over else ():
            part.forget(oldest)
        lasts, ends = self.step(oldest)
        self._best = self._at_first_tick(ends)
        self._lasting = min(self._lasting[0], lasts[0]), min(self._lasting[1], lasts[1])

    def _at_first_tick(self, later: Ends) -> Ends:
        """Return the margins at the first tick; ``later`` has the margins at the oldest tick."""
        (low, high), (least, most), (best, best_high) = later, self._lasting, self._best
        return max(best, min(least, low)), max(best_high, min(most, high))

    def step(self, values: NDArray[np.float64]) -> tuple[Ends, Ends]:
        """Return a and b of the recursion at a tick.

        The margins of the nodes at this tick are ``values`` (nodes, 2). If all operators of the formula have
        windows, there is no recursion, and b is the final margin of the formula.
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
    """Return a row of the program that ``_evaluate`` runs.

    Its entries are the signal, the relation, low, high, the limit, and the margin at the limit.
    """
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
    """Write the margins of all nodes at the ticks ``first`` to ``stop`` - 1, as ``semantics.margins`` does.

    For a boolean signal, the limit is 0.5, and the margins are infinite.
    """
    count = seen.shape[0]
    for a in range(reading.shape[0]):
        node, signal, above, low, high = reading[a]
        for k in range(max(count - (stop - first), 0), count):
            least, most = seen[k, signal, low] - limits[a, 0], seen[k, signal, high] - limits[a, 0]
            if not above:
                least, most = limits[a, 0] - seen[k, signal, high], limits[a, 0] - seen[k, signal, low]
            # True and false have no distance from the limit, so their margins are infinite.
            if limits[a, 1] == np.inf:
                least, most = np.copysign(np.inf, least), np.copysign(np.inf, most)
            # At the limit itself, the relation decides: < and > are violated there, <= and >= are not.
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
