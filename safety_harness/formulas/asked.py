"""What a claim asks: a formula as the parts that "and" joins at its top, each asked of the whole run.

A part without a temporal operator is asked at every tick, as if "always" stood before it; one with
such an operator is asked once, of the first tick and what follows.  "always (a and b)" and
"whenever t then (a and b)" are the same as their two halves, so that each has a margin of its own.
"""

from __future__ import annotations

from safety_harness.exceptions import FormulaError, Place
from safety_harness.formulas.formula import (
    TEMPORAL,
    Always,
    And,
    Comparison,
    Eventually,
    Formula,
    Globally,
    Initially,
    Until,
)
from safety_harness.formulas.quantities import formula_error
from safety_harness.formulas.semantics import ticks_of
from safety_harness.formulas.signal import Signal
from safety_harness.properties.base import Unit
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.units import ANGLE, ANGULAR_SPEED, LENGTH, NUMBER, SPEED, TIME, Dimension

_UNITS = (
    (LENGTH, Unit.LENGTH),
    (ANGLE, Unit.ANGLE),
    (SPEED, Unit.SPEED),
    (ANGULAR_SPEED, Unit.ANGULAR_SPEED),
    (TIME, Unit.TIME),
    (NUMBER, Unit.COUNT),
)


def parts_of(formula: Formula) -> tuple[Formula, ...]:
    """The parts that a claim is made of, each ready to be asked; FormulaError if one has no margin."""
    parts = tuple(_asked(part) for part in _split(formula))
    for part in parts:
        dimension_of(part)
    return parts


def _split(formula: Formula) -> list[Formula]:
    """At every "and" that stands at the top, or directly in what "always" or "whenever" says there."""
    match formula:
        case And():
            return [part for member in formula.members for part in _split(member)]
        case Always(body=And() as body, span=span):
            return [part for member in body.members for part in _split(Always(member, span))]
        case Globally(trigger=trigger, response=And() as body):
            return [part for member in body.members for part in _split(Globally(trigger, member))]
        case Initially(body=And() as body):
            return [part for member in body.members for part in _split(Initially(member))]
    return [formula]


def _asked(part: Formula) -> Formula:
    return part if any(isinstance(node, TEMPORAL) for node in part.nodes()) else Always(part)


def unit_of(part: Formula) -> Unit:
    """What the margin of a part is shown in; a number for truths alone."""
    return shown_in(dimension_of(part))


def shown_in(dimension: Dimension | None) -> Unit:
    """The unit for values of a dimension."""
    return next((unit for own, unit in _UNITS if own is dimension), Unit.COUNT)


def dimension_of(formula: Formula) -> Dimension | None:
    """Of a formula's margin, None for truths alone; FormulaError where it would mix two of them.

    A trigger has no margin, and may mix.
    """
    if isinstance(formula, Comparison):
        return formula.signal.dimension
    parts = formula.parts[1:] if isinstance(formula, Globally) else formula.parts
    found: list[tuple[Dimension, Formula]] = []
    for part in parts:
        dimension = dimension_of(part)
        if dimension is not None:
            found.append((dimension, part))
    for dimension, part in found[1:]:
        if dimension is not found[0][0]:
            raise formula_error(
                f"one kind of margin in {type(formula).__name__.lower()!r}, all of them lengths, say",
                f'"{found[0][1]}" beside "{part}"',
                'let one be a trigger, which has no margin: "whenever ... then ..."',
            )
    return found[0][0] if found else None


def signals_of(formula: Formula) -> tuple[Signal, ...]:
    """Every signal that a formula reads, once, in the order of the sentence."""
    atoms = (getattr(node, "signal", None) for node in formula.nodes())
    return tuple(dict.fromkeys(signal for signal in atoms if isinstance(signal, Signal)))


def check_windows(formula: Formula, scenario: Scenario, place: Place) -> None:
    """FormulaError at ``place`` for windows that end after every run of ``scenario``, or have no tick."""
    period_s = scenario.settings.clock.control_period_s
    for node in formula.nodes():
        span = getattr(node, "span", None)
        if span is not None and ticks_of(span, period_s)[0] > ticks_of(span, period_s)[1]:
            raise FormulaError(
                place=place,
                expected=f"a window with a control tick in it (one every {period_s * 1e3:g} ms)",
                got=f'{span.begin} to {span.end} in "{formula}"',
            )
    reach = reach_ticks(formula, period_s)
    if reach > scenario.ticks:
        raise FormulaError(
            place=place,
            expected=f"windows that end within the scenario's duration, {scenario.duration_s:g} s",
            got=f'"{formula}", which looks {reach * period_s:g} s ahead',
            hint="windows within one another add up",
        )


def reach_ticks(formula: Formula, period_s: float) -> int:
    """How many ticks after the one that it is asked of its windows end."""
    span = formula.span if isinstance(formula, Always | Eventually | Until) else None
    own = ticks_of(span, period_s)[1] if span is not None else 0
    return own + max((reach_ticks(part, period_s) for part in formula.parts), default=0)
