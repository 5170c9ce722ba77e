"""Random formulas over made-up signals, and a judge of them written from the definition alone."""

from __future__ import annotations

from functools import cache
from math import inf, isnan, nan

import numpy as np
from hypothesis import strategies as st

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
    conjunction,
    disjunction,
)
from safety_harness.claims.formulas.language import mm, ms
from safety_harness.claims.formulas.measures import Flag, Measure
from safety_harness.claims.formulas.quantities import Span
from safety_harness.claims.formulas.semantics import (
    LEAST,
    MarginBounds,
    Margins,
    comparison_bounds,
    margins,
    truth_bounds,
)
from safety_harness.claims.signals.signal import Interpolation, Sampled
from safety_harness.scenario.units import LENGTH
from safety_harness.trace.trace import Trace

PERIOD_S = 0.008
Run = dict[str, list[float]]  # a list of values for each signal, NaN where one is not known


def never(trace: Trace) -> Sampled:
    raise AssertionError("these signals have no traces")


X, Y = (
    Measure(
        words=words,
        dimension=LENGTH,
        meaning="-",
        between=Interpolation.HELD,
        sample=never,
        reads=(),
        lowest=-1.0,
    )
    for words in ("x", "y")
)
P, Q = (Flag(words=words, meaning="-", sample=never, reads=()) for words in ("p", "q"))

millimetres = st.integers(-3, 3)
relations = st.sampled_from(list(Relation))
comparisons = st.builds(
    lambda signal, relation, limit: Comparison(signal, relation, mm(limit)),
    st.sampled_from([X, Y]),
    relations,
    millimetres,
)
truths = st.sampled_from([Truth(P), Truth(Q)])
spans = st.none() | st.builds(
    lambda begin, longer: Span(ms(8 * begin), ms(8 * (begin + longer))), st.integers(0, 3), st.integers(1, 4)
)


def formulas(atoms: st.SearchStrategy[Formula]) -> st.SearchStrategy[Formula]:
    """Every operator that can stand anywhere, over ``atoms``."""
    return st.recursive(
        atoms,
        lambda inner: (
            st.builds(Not, inner)
            | st.builds(conjunction, inner, inner)
            | st.builds(disjunction, inner, inner)
            | st.builds(Always, inner, spans)
            | st.builds(Eventually, inner, spans)
            | st.builds(Until, inner, inner, spans)
        ),
        max_leaves=5,
    )


def runs(least: int = 1, most: int = 12, *, gaps: bool = True) -> st.SearchStrategy[Run]:
    """Signals of one length; values meet the limits often, and are unknown now and then."""
    value = st.sampled_from([0.001 * k for k in range(-4, 5)])
    flag = st.sampled_from([0.0, 1.0])
    if gaps:
        value, flag = value | st.just(nan), flag | st.just(nan)
    return st.integers(least, most).flatmap(
        lambda n: st.fixed_dictionaries(
            {name: st.lists(value, min_size=n, max_size=n) for name in "xy"}
            | {name: st.lists(flag, min_size=n, max_size=n) for name in "pq"}
        )
    )


def bounds_of(atom: Comparison | Truth, run: Run) -> MarginBounds:
    values = np.array(run[atom.signal.words])
    return truth_bounds(values) if isinstance(atom, Truth) else comparison_bounds(atom, values, values)


def margins_of(formula: Formula, run: Run) -> Margins:
    return margins(formula, lambda atom: bounds_of(atom, run), PERIOD_S)


def by_definition(formula: Formula, run: Run) -> list[tuple[float, float]]:
    """(least, largest) possible margin at every tick: one tick after the other, one sum after the other."""
    n = len(run["x"])

    @cache
    def at(node: Formula, k: int) -> tuple[float, float]:
        if k >= n:
            return -inf, inf
        match node:
            case Comparison():
                value, limit = run[node.signal.words][k], node.limit.value
                if isnan(value):
                    return -inf, inf
                margin = value - limit if node.relation.value[0] == ">" else limit - value
                if margin == 0.0:
                    margin = LEAST if "=" in node.relation.value else -LEAST
                return margin, margin
            case Truth():
                value = run[node.signal.words][k]
                return (-inf, inf) if isnan(value) else (inf, inf) if value else (-inf, -inf)
            case Not():
                low, high = at(node.body, k)
                return -high, -low
            case And():
                return least([at(part, k) for part in node.members])
            case Or():
                return most([at(part, k) for part in node.members])
            case Always():
                return least([at(node.body, j) for j in window(node.span, k)])
            case Eventually():
                return most([at(node.body, j) for j in window(node.span, k)])
            case Until():
                ways = []
                for j in window(node.span, k):
                    before = [at(node.first, i) for i in range(k, j)]
                    ways.append(least([at(node.second, j), *before]))
                return most(ways)
            case Globally():
                answers = [(at(node.trigger, j), at(node.response, j)) for j in range(k, n)]
                return least([asked(*answer) for answer in answers])
            case Initially():
                return at(node.body, k)
        raise AssertionError(node)

    def asked(trigger: tuple[float, float], response: tuple[float, float]) -> tuple[float, float]:
        if trigger[0] > 0.0:
            return response
        return (inf, inf) if trigger[1] < 0.0 else (response[0], inf)

    def window(span: Span | None, k: int) -> range:
        if span is None:
            return range(k, n)
        return range(k + round(span.begin.value / PERIOD_S), k + round(span.end.value / PERIOD_S) + 1)

    def least(pairs: list[tuple[float, float]]) -> tuple[float, float]:
        return min(low for low, _ in pairs), min(high for _, high in pairs)

    def most(pairs: list[tuple[float, float]]) -> tuple[float, float]:
        return max(low for low, _ in pairs), max(high for _, high in pairs)

    return [at(formula, k) for k in range(n)]
