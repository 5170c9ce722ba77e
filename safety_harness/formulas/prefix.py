"""A formula of a run that goes on: its margin if the run ended now, in bounded memory.

``semantics`` gives the margins of a whole run; here the run grows by a tick, and the margin at its first tick
is asked for again.  Below its operators without a window a formula says of tick k what windows reach
ahead of it, so many ticks at most; these are kept, and ``semantics`` judges them as they stand.  What is
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

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled
from safety_harness.formulas.formula import (
    Always,
    And,
    Comparison,
    Eventually,
    Formula,
    Globally,
    Initially,
    Not,
    Or,
    Truth,
    Until,
    reach_ticks,
)
from safety_harness.formulas.quantities import formula_error
from safety_harness.formulas.semantics import MarginBounds, Margins, margins, where_triggered

Bounds = Callable[[Comparison | Truth], tuple[float, float]]  # least and largest margin of an atom at a tick
Polynomial = NDArray[np.float64]  # (2^m,) c[S], S as the bits of the index
MOST_RECURSIONS = 4
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

    ``tree`` has the margins at the ticks that are kept, as those after the latest are unknown.  The latest
    tick and ``revisable`` ones before it may be known better later.  FormulaError as of ``refuse_endless``.
    """

    def __init__(self, formula: Formula, period_s: float, revisable: int = 1) -> None:
        refuse_endless(formula, period_s)
        self.formula = formula.body if isinstance(formula, Initially) else formula
        self.least, self.most = -np.inf, np.inf
        self.tree: Margins
        self.latest: tuple[float, float] | None = None
        self._reach, self._period_s = reach_ticks(self.formula, period_s), period_s
        self._kept_ticks = self._reach + revisable  # beside the latest, and one that is let go
        atoms = [node for node in self.formula.nodes() if isinstance(node, Comparison | Truth)]
        self._kept = {atom: np.empty((2, 2 * self._kept_ticks + 4)) for atom in atoms}
        self._kept_by_id = {id(atom): self._kept[atom] for atom in atoms}  # hashes of formulas are slow
        self._each = list(self._kept.items())
        self._begin = self._end = 0
        alone = _asks_every_tick(self.formula) and sum(map(is_endless, self.formula.nodes())) == 1
        side = _Running if alone else _Side
        self._low, self._high = side(self.formula, 1), side(self.formula, -1)

    def step(self, bounds: Bounds, revised: Sequence[Bounds] = ()) -> None:
        """The next tick: the least and largest margin there of every comparison and truth.

        ``revised`` are those of the ticks before it, the latest of them last, of which more is known now.
        ``least`` and ``most`` are what follows, and ``latest`` both of what an "always" or a "whenever" asks,
        if it is the outermost one, at the latest tick whose windows have passed.
        """
        if self._end == self._kept_ticks * 2 + 4:
            for kept in self._kept.values():
                kept[:, : self._end - self._begin] = kept[:, self._begin : self._end]
            self._begin, self._end = 0, self._end - self._begin
        self._end += 1
        self.revise([*revised, bounds])
        if self._end - self._begin - 1 > self._kept_ticks:
            self._low.forget(self.tree)
            self._high.forget(self.tree)
            self._begin += 1

    def revise(self, latest: Sequence[Bounds]) -> None:
        """More is known of the ``latest`` ticks, the last of them last; older ones than are kept stay."""
        for at, bounds in enumerate(reversed(latest), start=1):
            if self._end - at < self._begin:
                break
            for atom, kept in self._each:
                kept[0, self._end - at], kept[1, self._end - at] = bounds(atom)
        self.tree = margins(self.formula, self._bounds, self._period_s)
        self.least, self.most = self._low.now(self.tree), -self._high.now(self.tree)
        passed = self._end - self._begin - 1 - self._reach
        if passed >= 0 and _asks_every_tick(self.formula):
            self.latest = _asked(self.tree, 1, passed), -_asked(self.tree, -1, passed)

    def _bounds(self, atom: Comparison | Truth) -> MarginBounds:
        low, high = self._kept_by_id[id(atom)]
        return MarginBounds(low[self._begin : self._end], high[self._begin : self._end])


def _asks_every_tick(formula: Formula) -> bool:
    return isinstance(formula, Globally) or (isinstance(formula, Always) and formula.span is None)


class _Running:
    """The least margin of a formula at the first tick, or of its negation (``sign`` -1).

    Of an "always" or a "whenever" that is the only operator without a window: that of all ticks so far.
    """

    def __init__(self, formula: Formula, sign: int) -> None:
        self._sign, self._gravest = sign, min if sign > 0 else max
        self._earlier = sign * np.inf

    def now(self, tree: Margins) -> float:
        """By the ticks that are kept, and those before them."""
        return self._gravest(self._earlier, _of(tree, self._sign, 0))

    def forget(self, tree: Margins) -> None:
        """Let the oldest tick that is kept go, whose windows have passed."""
        self._earlier = self._gravest(self._earlier, _asked(tree, self._sign, 0))


class _Side:
    """The same of any formula: by the polynomial of the operators without a window."""

    def __init__(self, formula: Formula, sign: int) -> None:
        self._sign = sign
        self._variables = {key: i for i, key in enumerate(dict.fromkeys(_endless(formula, sign)))}
        self._earlier: Polynomial | None = None  # the formula at the first tick, by what is kept

    def now(self, tree: Margins) -> float:
        """By the ticks that are kept, and those before them."""
        if self._earlier is None:
            return _of(tree, self._sign, 0)
        values = np.empty(len(self._variables))
        for node, sign in _endless_in(tree, self._sign):
            values[self._variables[id(node.formula), sign]] = _of(node, sign, 0)
        return float(_value(self._earlier, values))

    def forget(self, tree: Margins) -> None:
        """Let the oldest tick that is kept go, whose windows have passed."""
        if self._earlier is None:
            self._earlier = self._by_the_next(tree, self._sign)
        else:
            steps = np.empty((len(self._variables), len(self._earlier)))
            for node, sign in _endless_in(tree, self._sign):
                steps[self._variables[id(node.formula), sign]] = self._by_the_next(node, sign)
            self._earlier = _substituted(self._earlier, steps)

    def _by_the_next(self, tree: Margins, sign: int) -> Polynomial:
        """The least margin of ``tree`` (or its negation) at the oldest tick, by those at the next."""
        formula, parts = tree.formula, tree.parts
        if not any(True for _ in _endless_in(tree, sign)):
            return self._constant(_of(tree, sign, 0))
        if isinstance(formula, Not):
            return self._by_the_next(parts[0], -sign)
        body = self._by_the_next(parts[-1], sign)
        if isinstance(formula, Globally):
            trigger = parts[0].bounds
            if trigger.high[0] < 0.0 if sign > 0 else not trigger.low[0] >= 0.0:
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


def _endless_in(tree: Margins, sign: int) -> Iterator[tuple[Margins, int]]:
    """The same with their margins."""
    if is_endless(tree.formula):
        yield tree, sign
    for part in tree.parts:
        yield from _endless_in(part, -sign if isinstance(tree.formula, Not) else sign)


def _of(tree: Margins, sign: int, tick: int) -> float:
    return float(tree.bounds.low[tick] if sign > 0 else -tree.bounds.high[tick])


def _asked(tree: Margins, sign: int, tick: int) -> float:
    """What an "always" or a "whenever" that stands outermost asks at a tick."""
    if isinstance(tree.formula, Globally):
        bounds = where_triggered(tree.parts[0].bounds, tree.parts[1].bounds)
        return float(bounds.low[tick] if sign > 0 else -bounds.high[tick])
    return _of(tree.parts[0], sign, tick)


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
