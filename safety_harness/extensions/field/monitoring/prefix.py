"""A formula of a run that goes on: its margin if the run ended now, in bounded memory.

``semantics`` gives the margins of a whole run; here the run grows by a tick, and the margin at its first tick
is asked for again.  Below its operators without a window a formula says of tick k what windows reach
ahead of it, so many ticks at most; these are kept, and judged as ``semantics`` does.  What is
older is final.  Each operator without a window is a recursion from the end,

    v[k] = max(b[k], min(a[k], v[k + 1]))        always: min(a[k], v[k + 1]), eventually: max(b[k], v[k + 1])

a monotone function, of minima and maxima, of the values v of all such operators one tick later.  So the
margin at the first tick is one of those at the oldest tick that is kept, in the normal form

    p(v) = max over subsets S of min(c[S], min of v[i] for i in S)

of 2^m numbers, m the number of such operators: forgetting a tick puts its recursion into p.  Nothing is
approximated: minima and maxima of the same numbers are the same numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import reduce
from typing import NamedTuple

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
    Or,
    Relation,
    Truth,
    Until,
    reach_ticks,
)
from safety_harness.claims.formulas.quantities import formula_error
from safety_harness.claims.formulas.semantics import LEAST, least_from_here, least_in_window, until_from_here

Bounds = Callable[[Comparison | Truth], tuple[float, float]]  # least and largest margin of an atom at a tick
Columns = Callable[[Comparison | Truth], tuple[int, int, int]]  # signal, low and high of an atom
Polynomial = NDArray[np.float64]  # (2^m,) c[S], S as the bits of the index
MOST_RECURSIONS = 4
OPERATORS = (Comparison, Truth, Not, And, Or, Always, Eventually, Until, Globally)
NOT, AND, OR, ALWAYS, EVENTUALLY, UNTIL, GLOBALLY = range(2, 9)
NOTHING_SEEN = np.empty((0, 1, 2))
MOST_TICKS = 20_000  # that windows may reach ahead: each new tick looks at them again


def is_endless(formula: Formula) -> bool:
    """Is it an operator without a window, which the end of the run decides?"""
    own = isinstance(formula, Always | Eventually | Until) and formula.span is None
    return own or isinstance(formula, Globally)


def refuse_endless(formula: Formula, period_s: float) -> None:
    """FormulaError with the reason: more memory than is set aside, or a window without a tick."""
    for node in formula.nodes():
        span = getattr(node, "span", None)
        if span is not None and span.ticks(period_s)[0] > span.ticks(period_s)[1]:
            expected = f"a window with a control tick in it (one every {period_s * 1e3:g} ms)"
            raise formula_error(expected, f'{span.begin} to {span.end} in "{node}"')
        below = node.trigger if isinstance(node, Globally) else node
        if span is None and below is node:
            continue
        if (inner := next(filter(is_endless, below.nodes()), None)) is not None:
            raise formula_error(
                "while a run goes on, windows and triggers of what is known once its own windows have passed",
                f'"{inner}", which only the end of the run decides, within "{node}"',
                "give it a window, or let it stand outside",
            )
    if (count := sum(map(is_endless, formula.nodes()))) > MOST_RECURSIONS:
        expected = f"at most {MOST_RECURSIONS} operators without a window in one part of a claim"
        raise formula_error(
            f"{expected}, as each doubles what has to be remembered", f'{count} in "{formula}"'
        )
    if (reach := reach_ticks(formula, period_s)) > MOST_TICKS:
        expected = (
            f"windows that reach at most {MOST_TICKS * period_s:g} s ahead, as all of that is remembered"
        )
        raise formula_error(expected, f'{reach * period_s:g} s in "{formula}"')


class Prefix:
    """The ``least`` and largest (``most``) margin of ``formula`` at the first tick, so far.

    The latest tick and ``revisable`` ones before it may be known better later.  Ticks are told of with
    ``step``, or with ``see``: then ``columns`` say of a comparison or truth which signal it reads, and where
    its low and its high stand among the numbers of one.  FormulaError as of ``refuse_endless``.
    """

    def __init__(
        self, formula: Formula, period_s: float, revisable: int = 1, columns: Columns | None = None
    ) -> None:
        refuse_endless(formula, period_s)
        self.formula = formula.body if isinstance(formula, Initially) else formula
        self.least, self.most = -np.inf, np.inf
        self.latest: tuple[float, float] | None = None
        self._reach = reach_ticks(self.formula, period_s)
        self._kept_ticks = self._reach + revisable  # beside the latest, and one that is let go
        self._program = _Program(self.formula, period_s, columns)
        # a row for each node, and one for what an outermost "always" or "whenever" asks at each tick
        self._values = np.empty((len(self._program.code) + 1, 2, 2 * self._kept_ticks + 4))
        self._begin = self._end = 0
        self._asks = _asks_every_tick(self.formula)
        self._earlier = np.inf, np.inf  # the least of what it asked at ticks that are gone
        self._sides: tuple[_Side, _Side] | None = None
        if not self._asks or sum(map(is_endless, self.formula.nodes())) > 1:
            self._sides = _Side(self.formula, 1), _Side(self.formula, -1)

    def step(self, bounds: Bounds, revised: Sequence[Bounds] = ()) -> None:
        """The next tick: the least and largest margin there of every comparison and truth.

        ``revised`` are those of the ticks before it, the latest of them last, of which more is known now.
        ``least`` and ``most`` are what follows, and ``latest`` both of what an "always" or a "whenever" asks,
        if it is the outermost one, at the latest tick whose windows have passed.
        """
        self._grow()
        for at, own in enumerate((bounds, *reversed(revised)), start=1):
            if self._end - at < self._begin:
                break
            for index, atom in self._program.atoms:
                self._values[index, :, self._end - at] = own(atom)
        self._judge(NOTHING_SEEN)
        self._let_go()

    def see(self, seen: NDArray[np.float64], *, grown: bool) -> None:
        """More is known of the latest ticks, ``seen`` (m, signals, c); with ``grown`` the last one is new."""
        if grown:
            self._grow()
        self._judge(seen)
        if grown:
            self._let_go()

    @property
    def triggered(self) -> bool:
        """Of a "whenever": did it certainly begin to hold at one of the ticks that are kept?"""
        return bool((self._values[self._program.first(-1), 0, self._begin : self._end] >= 0.0).any())

    def _grow(self) -> None:
        if self._end == self._kept_ticks * 2 + 4:
            kept = self._end - self._begin
            self._values[:, :, :kept] = self._values[:, :, self._begin : self._end].copy()
            self._begin, self._end = 0, kept
        self._end += 1

    def _judge(self, seen: NDArray[np.float64]) -> None:
        own, begin, end = self._program, self._begin, self._end
        _evaluate(own.code, own.reading, own.limits, seen, self._values, begin, end)
        if self._sides is None:
            least, most = self._values[-2, :, begin].tolist()
            self.least, self.most = min(self._earlier[0], least), min(self._earlier[1], most)
        else:
            low, high = self._sides
            self.least, self.most = low.now(self._tree), -high.now(self._tree)
        if self._asks and begin + self._reach < end:
            low, high = self._values[-1, :, end - 1 - self._reach].tolist()
            self.latest = low, high

    def _let_go(self) -> None:
        if self._end - self._begin - 1 > self._kept_ticks:
            if self._sides is None:
                low, high = self._values[-1, :, self._begin].tolist()
                self._earlier = min(self._earlier[0], low), min(self._earlier[1], high)
            else:
                for side in self._sides:
                    side.forget(self._tree)
            self._begin += 1

    @property
    def _tree(self) -> Stands:
        return Stands(self._program, self._values, len(self._program.code) - 1, self._begin)


class _Program:
    """A formula as numbers, for ``_evaluate``: its nodes (k, 5), each after its parts, the whole one last.

    ``reading`` (a, 5) are its atoms by their nodes, their signals and the columns of these, with their
    ``limits`` (a, 2).
    """

    def __init__(self, formula: Formula, period_s: float, columns: Columns | None) -> None:
        self.formulas: list[Formula] = []
        self.atoms: list[tuple[int, Comparison | Truth]] = []
        self.parts: list[tuple[int, ...]] = []
        rows: list[tuple[int, int, int, int, int]] = []
        self._add(formula, period_s, rows)
        self.code = np.array(rows, np.int64)
        read = [(index, *self._read(atom, columns)) for index, atom in self.atoms if columns is not None]
        self.reading = np.array([row[:5] for row in read], np.int64).reshape(-1, 5)
        self.limits = np.array([row[5:] for row in read], np.float64).reshape(-1, 2)

    def first(self, index: int) -> int:
        """The first part of a node."""
        return self.parts[index][0]

    def _add(self, formula: Formula, period_s: float, rows: list[tuple[int, int, int, int, int]]) -> int:
        parts = [self._add(part, period_s, rows) for part in formula.parts]
        span = getattr(formula, "span", None)
        begin, end = (-1, -1) if span is None else span.ticks(period_s)
        operator = OPERATORS.index(type(formula))
        if isinstance(formula, Comparison | Truth):
            self.atoms.append((len(rows), formula))
        one = parts[0] if parts else -1
        for other in parts[1:-1]:  # of three and more, two by two
            rows.append((operator, one, other, -1, -1))
            self.formulas.append(formula)
            self.parts.append((one, other))
            one = len(rows) - 1
        rows.append((operator, one, parts[-1] if parts else -1, begin, end))
        self.formulas.append(formula)
        self.parts.append(tuple(parts))
        return len(rows) - 1

    @staticmethod
    def _read(atom: Comparison | Truth, columns: Columns) -> tuple[float, ...]:
        signal, low, high = columns(atom)
        if isinstance(atom, Truth):
            return signal, 1, low, high, 0.5, np.inf
        above = atom.relation in (Relation.ABOVE, Relation.AT_LEAST)
        at_limit = -LEAST if atom.relation in (Relation.ABOVE, Relation.BELOW) else LEAST
        return signal, above, low, high, atom.limit.value, at_limit


class Stands(NamedTuple):
    """A node's margins at the ticks that are kept."""

    program: _Program
    values: NDArray[np.float64]  # (k, 2, room)
    node: int
    begin: int

    @property
    def formula(self) -> Formula:
        """Whose they are."""
        return self.program.formulas[self.node]

    @property
    def parts(self) -> tuple[Stands, ...]:
        """Those of its parts."""
        return tuple(self._replace(node=part) for part in self.program.parts[self.node])

    def at(self, tick: int, side: int) -> float:
        """The low (side 0) or the high (1) at a tick, counted from the oldest."""
        return float(self.values[self.node, side, self.begin + tick])


def _asks_every_tick(formula: Formula) -> bool:
    return isinstance(formula, Globally) or (isinstance(formula, Always) and formula.span is None)


class _Side:
    """The least margin of a formula at the first tick, or of its negation (``sign`` -1).

    By the polynomial of the operators without a window.
    """

    def __init__(self, formula: Formula, sign: int) -> None:
        self._sign = sign
        self._variables = {key: i for i, key in enumerate(dict.fromkeys(_endless(formula, sign)))}
        self._earlier: Polynomial | None = None  # the formula at the first tick, by what is kept

    def now(self, tree: Stands) -> float:
        """By the ticks that are kept, and those before them."""
        if self._earlier is None:
            return _of(tree, self._sign, 0)
        values = np.empty(len(self._variables))
        for node, sign in _endless_in(tree, self._sign):
            values[self._variables[id(node.formula), sign]] = _of(node, sign, 0)
        return float(_value(self._earlier, values))

    def forget(self, tree: Stands) -> None:
        """Let the oldest tick that is kept go, whose windows have passed."""
        if self._earlier is None:
            self._earlier = self._by_the_next(tree, self._sign)
        else:
            steps = np.empty((len(self._variables), len(self._earlier)))
            for node, sign in _endless_in(tree, self._sign):
                steps[self._variables[id(node.formula), sign]] = self._by_the_next(node, sign)
            self._earlier = _substituted(self._earlier, steps)

    def _by_the_next(self, tree: Stands, sign: int) -> Polynomial:
        """The least margin of ``tree`` (or its negation) at the oldest tick, by those at the next."""
        formula, parts = tree.formula, tree.parts
        if not any(True for _ in _endless_in(tree, sign)):
            return self._constant(_of(tree, sign, 0))
        if isinstance(formula, Not):
            return self._by_the_next(parts[0], -sign)
        body = self._by_the_next(parts[-1], sign)
        if isinstance(formula, Globally) and not _triggered(parts[0], sign, 0):
            body = self._constant(sign * np.inf)
        least = isinstance(formula, And | Always | Globally) == (sign > 0)
        both, either = (_least, np.maximum) if least else (np.maximum, _least)
        if isinstance(formula, And | Or):
            return reduce(both, (self._by_the_next(part, sign) for part in parts))
        later = np.full(len(body), -np.inf)
        later[1 << self._variables[id(formula), sign]] = np.inf
        if isinstance(formula, Until):
            later = either(later, self._by_the_next(parts[0], sign))
        return both(body, later)

    def _constant(self, value: float) -> Polynomial:
        found = np.full(1 << len(self._variables), -np.inf)
        found[0] = value
        return found


def _endless(formula: Formula, sign: int) -> Iterator[tuple[int, int]]:
    """Which operators without a window there are, each with the sign that it is asked with."""
    if is_endless(formula):
        yield id(formula), sign
    for part in formula.parts:
        yield from _endless(part, -sign if isinstance(formula, Not) else sign)


def _endless_in(tree: Stands, sign: int) -> Iterator[tuple[Stands, int]]:
    """The same with their margins."""
    if is_endless(tree.formula):
        yield tree, sign
    for part in tree.parts:
        yield from _endless_in(part, -sign if isinstance(tree.formula, Not) else sign)


def _triggered(trigger: Stands, sign: int, tick: int) -> bool:
    """Is a response asked, as ``where_triggered`` says?"""
    return trigger.at(tick, 1) >= 0.0 if sign > 0 else trigger.at(tick, 0) >= 0.0


def _of(tree: Stands, sign: int, tick: int) -> float:
    return tree.at(tick, 0) if sign > 0 else -tree.at(tick, 1)


@compiled
def _evaluate(
    code: NDArray[np.int64],  # (k, 5)
    reading: NDArray[np.int64],  # (a, 5)
    limits: NDArray[np.float64],  # (a, 2)
    seen: NDArray[np.float64],  # (m, signals, c) of the latest ticks
    values: NDArray[np.float64],  # (k + 1, 2, room), written
    first: int,
    after: int,
) -> None:
    """The margins of every node from tick ``first`` to before ``after``, as ``semantics.margins`` has them.

    A truth has limit 0.5 and an end of infinity.  The last row is what is asked at each tick, if the whole is
    an "always" or a "whenever".
    """
    told = seen.shape[0]
    for a in range(reading.shape[0]):
        node, signal, above, low, high = reading[a]
        for k in range(max(told - (after - first), 0), told):
            least, most = seen[k, signal, low] - limits[a, 0], seen[k, signal, high] - limits[a, 0]
            if not above:
                least, most = limits[a, 0] - seen[k, signal, high], limits[a, 0] - seen[k, signal, low]
            if limits[a, 1] == np.inf:
                least, most = np.copysign(np.inf, least), np.copysign(np.inf, most)
            values[node, 0, after - told + k] = least if least != 0.0 else limits[a, 1]
            values[node, 1, after - told + k] = most if most != 0.0 else limits[a, 1]
    for i in range(code.shape[0]):
        operator, one, other, begin, end = code[i]
        for side in range(2):
            beyond = -np.inf if side == 0 else np.inf
            out, x, y = (
                values[i, side, first:after],
                values[one, side, first:after],
                values[other, side, first:after],
            )
            if operator == NOT:
                out[:] = -values[one, 1 - side, first:after]
            elif operator == AND:
                out[:] = np.minimum(x, y)
            elif operator == OR:
                out[:] = np.maximum(x, y)
            elif operator == ALWAYS:
                if i + 1 == code.shape[0]:
                    values[i + 1, side, first:after] = x
                out[:] = least_from_here(x) if begin < 0 else least_in_window(x, begin, end, beyond)
            elif operator == EVENTUALLY:
                out[:] = -(least_from_here(-x) if begin < 0 else least_in_window(-x, begin, end, -beyond))
            elif operator == UNTIL:
                out[:] = until_from_here(x, y, -np.inf if begin < 0 else beyond)
                if begin >= 0:
                    comes = -least_in_window(-y, begin, end, -beyond)
                    if begin > 0:
                        lasting = out.copy()
                        out[:] = beyond
                        out[: max(after - first - begin, 0)] = lasting[begin:]
                        out[:] = np.minimum(out, least_in_window(x, 0, begin - 1, beyond))
                    out[:] = np.minimum(out, comes)
            elif operator == GLOBALLY:
                asked = values[i + 1, side, first:after]
                asked[:] = y
                for k in range(after - first):
                    low, high = values[one, 0, first + k], values[one, 1, first + k]
                    if (side == 0 and high < 0.0) or (side == 1 and not low >= 0.0):
                        asked[k] = np.inf
                out[:] = least_from_here(asked)


@compiled
def _least(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """The normal form of the least of two: min and max distribute over each other.

    ``first`` and ``second`` (2^m,).
    """
    found = np.full(first.shape[0], -np.inf)
    for i in range(first.shape[0]):
        if first[i] > -np.inf:
            for j in range(second.shape[0]):
                found[i | j] = max(found[i | j], min(first[i], second[j]))
    return found


@compiled
def _substituted(whole: NDArray[np.float64], steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """``whole`` (2^m,) with ``steps`` (m, 2^m) in place of its values: ``steps[i]`` of the i-th."""
    found = np.full(whole.shape[0], -np.inf)
    for chosen in range(whole.shape[0]):
        if whole[chosen] == -np.inf:
            continue
        term = np.full(whole.shape[0], -np.inf)
        term[0] = whole[chosen]
        for i in range(steps.shape[0]):
            if chosen >> i & 1:
                term = _least(term, steps[i])
        found = np.maximum(found, term)
    return found


@compiled
def _value(whole: NDArray[np.float64], values: NDArray[np.float64]) -> float:
    """``whole`` (2^m,) at ``values`` (m,)."""
    found = -np.inf
    for chosen in range(whole.shape[0]):
        term = whole[chosen]
        for i in range(values.shape[0]):
            if chosen >> i & 1:
                term = min(term, values[i])
        found = max(found, term)
    return found
