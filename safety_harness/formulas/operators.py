"""The operators of formulas as Python writes them."""

from __future__ import annotations

from dataclasses import dataclass

from safety_harness.formulas.formula import Always, Eventually, Formula, Globally, Initially, formula_of
from safety_harness.formulas.span import Window, span_of


def always(formula: Formula, *, within: Window = None) -> Formula:
    """It holds at every tick from now on, or at every one of the window.

    ``within=s(2)``: from now to 2 s; ``within=(s(0.1), s(0.5))``: from 0.1 s to 0.5 s, ends included.
    """
    return Always(formula_of(formula, "always"), span_of(within))


def eventually(formula: Formula, *, within: Window = None) -> Formula:
    """It holds at one tick at least, from now on or in the window."""
    return Eventually(formula_of(formula, "eventually"), span_of(within))


def initially(formula: Formula) -> Formula:
    """It holds at the first tick of the run."""
    return Initially(formula_of(formula, "initially"))


@dataclass(frozen=True)
class Antecedent:
    """The first half of ``whenever(...).then(...)``."""

    trigger: Formula

    def then(self, response: Formula) -> Formula:
        """At every tick at which the trigger holds, ``response`` does."""
        return Globally(self.trigger, formula_of(response, "then"))


def whenever(trigger: Formula) -> Antecedent:
    """``whenever(p).then(q)``: q at every tick at which p holds; if p never does, that is no evidence."""
    return Antecedent(formula_of(trigger, "whenever"))
