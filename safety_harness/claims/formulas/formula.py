"""The kinds of formula, and how to write a formula in Python.

    always(hand_distance() > mm(50))
    whenever(hand_distance() < mm(300)).then(eventually(tcp_speed() < mm_per_s(100), window=ms(200)))
    repulsing().until(hand_distance() > mm(300), window=s(4))

Formulas are frozen trees that are compared by value. ``str`` returns the sentence that expresses a formula in
a scenario file. ``&`` and ``|`` join formulas, and ``~`` negates a formula; each comparison must be in
parentheses. Python's own ``and``, ``or``, ``not`` and ``a < x < b`` would evaluate the truth of a formula at
once. Only a run can decide that, so these operators raise FormulaError.

A claim is split at each "and" on the top level of its formula, and each part is about the whole run. A part
without a temporal operator applies to every tick, as if it began with "always". A part that begins with a
temporal operator applies to the first tick and the ticks after it. A part is refused as ambiguous if it
combines operands that have a temporal operator with operands that have no temporal operator. "always (a and
b)" and "whenever t then (a and b)" are also split into two parts, so that each part has its own margin.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum

from safety_harness.base.exceptions import FormulaError, Place
from safety_harness.base.renamed import renamed_parameters
from safety_harness.claims.formulas.quantities import Quantity, Span, Window, formula_error, span_of
from safety_harness.claims.properties.base import Unit
from safety_harness.claims.signals.signal import Signal
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.units import (
    ANGLE,
    ANGULAR_SPEED,
    LENGTH,
    NUMBER,
    OTHER_UNIT,
    SPEED,
    TIME,
    Dimension,
)


class Relation(Enum):
    """The relation of a value to its limit."""

    BELOW = "<"
    AT_MOST = "<="
    ABOVE = ">"
    AT_LEAST = ">="


class Formula:
    """The base class of all formulas; the only kinds of formula are the classes below."""

    def __post_init__(self) -> None:
        _refuse_what_stands_at_the_top(self)

    @property
    def parts(self) -> tuple[Formula, ...]:
        """Return the formulas that this formula directly joins."""
        return ()

    def nodes(self) -> Iterator[Formula]:
        """Yield this formula and all formulas in it, depth first."""
        yield self
        for part in self.parts:
            yield from part.nodes()

    def __and__(self, right: Formula) -> Formula:
        return conjunction(self, formula_of(right, "&"))

    def __or__(self, right: Formula) -> Formula:
        return disjunction(self, formula_of(right, "|"))

    def __invert__(self) -> Formula:
        return Not(self)

    @renamed_parameters(within="window")  # deprecated: the old name, for one release
    def until(self, right: Formula, *, window: Window = None) -> Formula:
        """Return a formula that requires this formula until ``right`` holds.

        If ``window`` is given, ``right`` must hold at a tick of the window.
        """
        return Until(self, formula_of(right, "until"), span_of(window))

    def __bool__(self) -> bool:
        raise formula_error(
            "formulas joined by &, | and ~, and comparisons of one signal with one quantity",
            f'a question whether "{self}" is true, without a run',
            'Python\'s "and", "or", "not" and "a < x < b" ask that: write (x > a) & (x < b)',
        )


@dataclass(frozen=True)
class Comparison(Formula):
    """The comparison of a signal with a limit.

    Its margin is the distance from the limit, which is positive if the comparison is true.
    """

    signal: Signal
    relation: Relation
    limit: Quantity

    def __post_init__(self) -> None:
        wanted = self.signal.dimension
        if wanted is None or self.limit.dimension is not wanted:
            expected = (
                f"{self.signal.words} beside {wanted.expected}" if wanted else "a truth without a limit"
            )
            hint = f"allowed units: {', '.join(wanted.units)}" if wanted and wanted.units else ""
            raise formula_error(expected, str(self.limit), hint)
        least, most = self.signal.limits
        if not least <= self.limit.value <= most:
            expected = f"a limit of {self.signal.words} from {least:g} to {most:.4g} {wanted.si}".rstrip()
            raise formula_error(expected, str(self.limit), OTHER_UNIT)

    def __str__(self) -> str:
        return f"{self.signal.words} {self.relation.value} {self.limit}"


@dataclass(frozen=True)
class Truth(Formula):
    """A formula that is a single true-or-false signal; its margin is inf or -inf."""

    signal: Signal

    def __str__(self) -> str:
        return self.signal.words


@dataclass(frozen=True)
class _Over(Formula):
    """An operator over one formula."""

    body: Formula

    @property
    def parts(self) -> tuple[Formula, ...]:
        """Return the one formula under the operator."""
        return (self.body,)


@dataclass(frozen=True)
class Not(_Over):
    """The requirement that the body is false; its margin is the body's margin with the opposite sign."""

    def __str__(self) -> str:
        return f"not {operand(self.body)}"


@dataclass(frozen=True)
class Initially(_Over):
    """The requirement that the body holds at the first tick."""

    def __str__(self) -> str:
        return f"initially {operand(self.body)}"


@dataclass(frozen=True)
class Always(_Over):
    """The requirement that the body holds at every tick of the window.

    Its margin is the least margin of the body at these ticks. Without a window, the requirement covers all
    ticks from now on.
    """

    span: Span | None = None

    def __str__(self) -> str:
        head = f"always {self.span.phrase('for')}" if self.span else "always"
        return f"{head} {operand(self.body)}"


@dataclass(frozen=True)
class Eventually(_Over):
    """The requirement that the body holds at one or more ticks of the window.

    Its margin is the largest margin of the body at these ticks. Without a window, the requirement covers all
    ticks from now on.
    """

    span: Span | None = None

    def __str__(self) -> str:
        body = operand(self.body)
        if self.span is None:  # "eventually within 1 s" is one operator
            return f"eventually ({body})" if body.startswith("within") else f"eventually {body}"
        head = self.span.phrase("within")
        return f"eventually {head} {body}" if head.startswith("from") else f"{head} {body}"


@dataclass(frozen=True)
class _Several(Formula):
    members: tuple[Formula, ...]

    @property
    def parts(self) -> tuple[Formula, ...]:
        """Return the joined formulas."""
        return self.members


@dataclass(frozen=True)
class And(_Several):
    """The requirement that all members hold; its margin is the least margin of the members."""

    def __post_init__(self) -> None:
        """Accept members of every kind, because the parts of a whole claim may also be joined by "and"."""

    def __str__(self) -> str:
        return " and ".join(joined(part) for part in self.members)


@dataclass(frozen=True)
class Or(_Several):
    """The requirement that at least one member holds; its margin is the largest margin of the members."""

    def __str__(self) -> str:
        return " or ".join(joined(part) for part in self.members)


@dataclass(frozen=True)
class Until(Formula):
    """The requirement that ``second`` holds at some tick of the window.

    Before that tick, ``first`` must hold at every tick.
    """

    first: Formula
    second: Formula
    span: Span | None = None

    @property
    def parts(self) -> tuple[Formula, ...]:
        """Return both operands: the formula that must last, and the formula that ends it."""
        return (self.first, self.second)

    def __str__(self) -> str:
        text = f"{joined(self.first)} until {joined(self.second)}"
        return f"{text} {self.span.phrase('within')}" if self.span else text


@dataclass(frozen=True)
class Globally(Formula):
    """The requirement that ``response`` holds whenever ``trigger`` does.

    The trigger has no margin of its own.
    """

    trigger: Formula
    response: Formula

    @property
    def parts(self) -> tuple[Formula, ...]:
        """Return the trigger and the response."""
        return (self.trigger, self.response)

    def __str__(self) -> str:
        response = str(self.response) if isinstance(self.response, Until) else operand(self.response)
        return f"whenever {self.trigger} then {response}"


def goal_of(part: Formula) -> Formula | None:
    """Return the formula that ``part`` requires to hold at some tick.

    The result is None if ``part`` has no such requirement.
    """
    match part:
        case Until():
            return part.second
        case Eventually() if part.span is None or part.span.begin.value <= 0.0:
            return part.body
        case Not(body=Always(span=None) as always):
            return Not(always.body)
    return None


TEMPORAL = (Always, Eventually, Until, Globally, Initially)
_JOINS = (And, Or, Until)


def operand(formula: Formula) -> str:
    """Return the text of ``formula`` as the operand of an operator.

    The text is in parentheses if ``formula`` joins several formulas.
    """
    return f"({formula})" if isinstance(formula, _JOINS) else str(formula)


def joined(formula: Formula) -> str:
    """Return the text of ``formula`` as an operand of "and", "or" or "until".

    The text is in parentheses if it would be ambiguous without them.
    """
    inner = formula
    while isinstance(inner, Not):
        inner = inner.body
    wide = isinstance(formula, _JOINS) or (isinstance(inner, TEMPORAL) and not isinstance(inner, Until))
    return f"({formula})" if wide else str(formula)


def conjunction(*formulas: Formula) -> Formula:
    """Return one formula that joins ``formulas`` with "and".

    If a formula is an "and" itself, its members are joined directly.
    """
    return And(tuple(p for part in formulas for p in (part.members if isinstance(part, And) else (part,))))


def disjunction(*formulas: Formula) -> Formula:
    """Return one formula that joins ``formulas`` with "or".

    If a formula is an "or" itself, its members are joined directly.
    """
    return Or(
        tuple(p for formula in formulas for p in (formula.members if isinstance(formula, Or) else (formula,)))
    )


def formula_of(value: object, operator: str) -> Formula:
    """Return ``value`` if it is a formula.

    Otherwise raise FormulaError, whose message contains ``operator``.
    """
    if isinstance(value, Formula):
        return value
    raise formula_error(f'a formula such as hand_distance() > mm(50) beside "{operator}"', str(value))


def _refuse_what_stands_at_the_top(formula: Formula) -> None:
    """Raise FormulaError if a part is no formula, or has an operator that only a whole claim may have."""
    operator = type(formula).__name__.lower()
    for part in formula.parts:
        for node in formula_of(part, operator).nodes():
            if isinstance(node, Globally | Initially):
                begins = type(node).__name__.lower()
                raise formula_error(
                    f'"{begins}" at the beginning of a claim, or of a part that "and" joins to others',
                    f'"{node}" within "{operator}"',
                    "it is asked of the whole run already",
                )


_UNITS = (
    (LENGTH, Unit.LENGTH),
    (ANGLE, Unit.ANGLE),
    (SPEED, Unit.SPEED),
    (ANGULAR_SPEED, Unit.ANGULAR_SPEED),
    (TIME, Unit.TIME),
    (NUMBER, Unit.COUNT),
)


def parts_of(formula: Formula) -> tuple[Formula, ...]:
    """Return the parts of a claim, each with a temporal operator.

    Raise FormulaError if a part mixes dimensions, or if a temporal operator covers only some operands of a
    part.
    """
    parts = tuple(_with_time(part) for part in _split(formula))
    for part in parts:
        dimension_of(part)
    return parts


def _split(formula: Formula) -> list[Formula]:
    """Return the parts of ``formula``, split at each "and" at its top or directly below its top operator."""
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


def _with_time(part: Formula) -> Formula:
    """Return ``part``, and put "always" in front of it if it has no temporal operator.

    Raise FormulaError if some of its comparisons are under a temporal operator and others are not.
    """
    if not any(isinstance(node, TEMPORAL) for node in part.nodes()):
        return Always(part)
    if (bare := next(_of_no_time(part), None)) is not None:
        raise formula_error(
            f'"always ({part})" or "initially ({part})", which say when "{bare}" is asked',
            f'"{part}", where a temporal word stands beside what has none',
            "in Python: always(...) or initially(...) around the whole",
        )
    return part


def _of_no_time(formula: Formula) -> Iterator[Formula]:
    """Yield each Comparison and Truth that is not under a temporal operator."""
    if isinstance(formula, Comparison | Truth):
        yield formula
    elif not isinstance(formula, TEMPORAL):
        for part in formula.parts:
            yield from _of_no_time(part)


def unit_of(part: Formula) -> Unit:
    """Return the unit of a part's margin.

    The unit is a count if all signals of the part are true or false.
    """
    return shown_in(dimension_of(part))


def shown_in(dimension: Dimension | None) -> Unit:
    """Return the unit for displaying values of ``dimension``."""
    return next((unit for own, unit in _UNITS if own is dimension), Unit.COUNT)


def dimension_of(formula: Formula) -> Dimension | None:
    """Return the dimension of a formula's margin, or None if all its signals are true or false.

    Raise FormulaError if the formula mixes dimensions. A trigger has no margin, so it may mix dimensions.
    """
    if isinstance(formula, Comparison):
        return formula.signal.dimension
    parts = formula.parts[1:] if isinstance(formula, Globally) else formula.parts
    dimensions: list[tuple[Dimension, Formula]] = []
    for part in parts:
        dimension = dimension_of(part)
        if dimension is not None:
            dimensions.append((dimension, part))
    for dimension, part in dimensions[1:]:
        if dimension is not dimensions[0][0]:
            raise formula_error(
                f"one kind of margin in {type(formula).__name__.lower()!r}, all of them lengths, say",
                f'"{dimensions[0][1]}" beside "{part}"',
                'let one be a trigger, which has no margin: "whenever ... then ..."',
            )
    return dimensions[0][0] if dimensions else None


def signals_of(formula: Formula) -> tuple[Signal, ...]:
    """Return every signal that a formula reads, without repetitions, in the order of the sentence."""
    atoms = (node for node in formula.nodes() if isinstance(node, Comparison | Truth))
    return tuple(dict.fromkeys(atom.signal for atom in atoms))


def check_windows(formula: Formula, scenario: Scenario, place: Place) -> None:
    """Raise FormulaError at ``place`` if a window has no tick, or ends after a run of ``scenario``."""
    period_s = scenario.settings.clock.control_period_s
    for node in formula.nodes():
        span = getattr(node, "span", None)
        if span is not None and span.ticks(period_s)[0] > span.ticks(period_s)[1]:
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
    """Return the number of ticks that ``formula`` looks ahead.

    This is the largest sum of the ends of nested windows.
    """
    span = formula.span if isinstance(formula, Always | Eventually | Until) else None
    own = span.ticks(period_s)[1] if span is not None else 0
    return own + max((reach_ticks(part, period_s) for part in formula.parts), default=0)
