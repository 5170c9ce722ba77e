"""The same formula in rtamt, an implementation of temporal logic by others, in discrete time."""

from __future__ import annotations

import warnings
from functools import lru_cache
from typing import Any

from random_formulas import Run

from safety_harness.claims.formulas.formula import (
    Always,
    And,
    Comparison,
    Eventually,
    Formula,
    Globally,
    Not,
    Or,
    Until,
)
from safety_harness.claims.formulas.quantities import Span

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)  # of its parser's runtime
    import rtamt


def in_rtamt(formula: Formula) -> str:
    """In its language; one unit of its time is one sample."""
    match formula:
        case Comparison():
            return f"({formula.signal.words} {formula.relation.value} ({formula.limit.value!r}))"
        case Not():
            return f"(not {in_rtamt(formula.body)})"
        case And() | Or():
            word = " and " if isinstance(formula, And) else " or "
            return "(" + word.join(in_rtamt(part) for part in formula.members) + ")"
        case Always() | Eventually():
            word = "always" if isinstance(formula, Always) else "eventually"
            return f"({word}{window(formula.span)} {in_rtamt(formula.body)})"
        case Until():
            return f"({in_rtamt(formula.first)} until{window(formula.span)} {in_rtamt(formula.second)})"
        case Globally():
            return f"(always ({in_rtamt(formula.trigger)} -> {in_rtamt(formula.response)}))"
    raise AssertionError(formula)


def window(span: Span | None) -> str:
    if span is None:
        return ""
    return f"[{round(span.begin.value / 0.008)},{round(span.end.value / 0.008)}]"


@lru_cache(maxsize=256)
def specification(text: str) -> Any:
    spec = rtamt.StlDiscreteTimeSpecification()
    for name in "xypq":
        spec.declare_var(name, "float")
    spec.spec = text
    spec.parse()
    return spec


def robustness(text: str, run: Run) -> list[float]:
    """What rtamt says of every sample."""
    times = [float(k) for k in range(len(run["x"]))]
    data = {"time": times} | {name: list(values) for name, values in run.items()}
    return [value for _, value in specification(text).evaluate(data)]
