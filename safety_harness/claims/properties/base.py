"""The interface of a property, which judges a Trace and gives it a verdict and a signed margin.

A margin is positive if the property holds, and negative if it is violated. The margin has a physical unit,
and the package compares it without rounding. *Inconclusive* is the verdict on a trace that is not evidence
either way. Such a trace is empty or truncated, contradicts itself, or never exercised the property. A trace
is also inconclusive if a column that the property reads has a NaN or an infinity. A violation before the end
of a truncated trace is still a violation.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property
from math import isclose, isfinite
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled
from safety_harness.base.exceptions import no_truth_value
from safety_harness.base.geometry.arrays import Array3
from safety_harness.scenario.model import Verdict
from safety_harness.trace.consistency import first_inconsistency
from safety_harness.trace.records import ENDLESS, as_numbers, columns
from safety_harness.trace.trace import Trace, once_a_trace

# A choice: far beyond the reach of any arm.
HORIZON_M = 1e3
MAY_SATURATE = "between the ticks nothing is known, as motors may saturate"
OF_HANDS = ("hand_position_in_base_m", "elbow_position_in_base_m", "hand_distance_m")


class Unit(Enum):
    """The unit for displaying a margin: its symbol, and its factor from SI."""

    LENGTH = ("mm", 1e3)
    ANGLE = ("deg", 180.0 / np.pi)
    SPEED = ("mm/s", 1e3)
    ANGULAR_SPEED = ("deg/s", 180.0 / np.pi)
    TIME = ("s", 1.0)
    ACCELERATION = ("m/s2", 1.0)
    ANGULAR_ACCELERATION = ("deg/s2", 180.0 / np.pi)
    FRACTION = ("%", 100.0)
    COUNT = ("", 1.0)

    @property
    def symbol(self) -> str:
        """Return the symbol of the unit."""
        return self.value[0]

    @property
    def per_si(self) -> float:
        """Return the number of units in one SI unit."""
        return self.value[1]

    def margin_text(self, margin: float | None) -> str:
        """Return ``margin`` (SI) as text with its sign and this unit; None and NaN become a dash."""
        if margin is None or np.isnan(margin):
            return "-"
        return shown_margin(margin * self.per_si, self.symbol)


SI_UNITS = {
    Unit.LENGTH: "m",
    Unit.ANGLE: "rad",
    Unit.SPEED: "m/s",
    Unit.ANGULAR_SPEED: "rad/s",
    Unit.TIME: "s",
    Unit.ACCELERATION: "m/s2",
    Unit.ANGULAR_ACCELERATION: "rad/s2",
    Unit.FRACTION: "1",
    Unit.COUNT: "1",
}


def shown_unit(margin: float, symbol: str) -> tuple[float, str]:
    """Return ``margin`` and its unit for display.

    Times below one second are in milliseconds.
    """
    return (margin * 1e3, "ms") if symbol == "s" and abs(margin) < 1.0 else (margin, symbol)


def shown_margin(margin: float, symbol: str) -> str:
    """Return ``margin`` as text in the unit with the symbol ``symbol``.

    An empty symbol means that the margin is a count.
    """
    margin, symbol = shown_unit(margin, symbol)
    number = f"{margin:+.1f}" if abs(margin) >= 1.0 and symbol else f"{margin:+.{3 if symbol else 9}g}"
    return f"{number} {symbol}".rstrip()


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """The result of evaluating a property on a trace.

    ``margin`` is in SI units. ``margin`` and ``worst_time_s`` are None if no margin could be computed.
    ``reason`` is a sentence about the decisive moment. ``exercised`` is the number of situations in which the
    run could have violated the property. ``parts`` has the evaluations of the property's parts, if the
    property has several parts. ``close`` is the margin below which the run is near the property's limit, as
    ``close_to`` returns it. ``applicable`` is False if the property does not apply to the controller under
    test, for example because the property is about answers and the controller has no avoider.
    """

    sentence: str
    verdict: Verdict
    unit: Unit
    margin: float | None = None
    worst_time_s: float | None = None
    reason: str
    exercised: int
    parts: tuple[Evaluation, ...] = ()
    unmeasured: tuple[str, ...] = ()
    close: float | None = None
    applicable: bool = True

    def __bool__(self) -> bool:
        raise no_truth_value(f"whether an evaluation is true, of {self.sentence}: {self.verdict.value}")

    def margin_text(self) -> str:
        """Return the margin with its sign and unit, or a dash."""
        return self.unit.margin_text(self.margin)


class Evaluations(tuple[Evaluation, ...]):
    """The evaluations of a run's claims, in the order of the claims.

    The function ``bool()`` raises an error for this object.
    """

    def __bool__(self) -> bool:
        raise no_truth_value(f"whether {len(self)} evaluations are true")


class Said(Protocol):
    """An object that can be evaluated: it has a sentence, and a unit for its margins."""

    @property
    def sentence(self) -> str:
        """Return the sentence that the catalogue and reports use."""

    @property
    def unit(self) -> Unit:
        """Return the unit of the margins."""


def close_to(prop: Said) -> float | None:
    """Return the margin (SI) below which a run is near the limit of ``prop``.

    The result is None if the property does not have one limit. A run comes near an upper limit at half of the
    limit, and near a lower limit at ten times the limit.
    """
    if hasattr(prop, "close"):
        return prop.close  # type: ignore[no-any-return]
    most = ("maximum_m", "maximum_mps", "maximum_mps2", "maximum_radps2")
    halves = (0.5 * getattr(prop, name) for name in most if hasattr(prop, name))
    minimum = getattr(prop, "minimum_m", None)
    return next(halves, None if minimum is None else 9.0 * minimum)


def far_words(close: float | None, least_margin: float | None) -> str:
    """Return a remark if no run came near the limit.

    The remark is empty if a run did so, or if the property has no limit.
    """
    far = close and least_margin is not None and least_margin > close
    return "no run came near its limit; is it in the unit that is meant?" if far else ""


FIELD = re.compile(r"\{(\w+):([^}]*)\}")
PLURAL = re.compile(r"(\{(\w+):[^}]*\} \w+)\(s\)")
PER_SI = {"mm": 1e3, "mm/s": 1e3, "m/s": 1.0, "m/s2": 1.0, "deg/s2": 180.0 / np.pi, "s": 1.0, "ms": 1e3}


class Worded(ABC):
    """A property with the wording ``wording``.

    The sentence of the property is this wording with the values of the fields. In the wording, a field is in
    braces, as in "within {within_m:mm}". The text after the colon is a unit of ``PER_SI``, "%" for a
    percentage, "1" for a number, or empty for a count. After a number or a count, "time(s)" becomes "time" if
    the value is 1, and otherwise "times".
    """

    def __init_subclass__(cls) -> None:
        """Accept ``words``, which was the name of ``wording`` in earlier releases."""
        super().__init_subclass__()
        if "words" in vars(cls) and "wording" not in vars(cls):
            cls.wording = vars(cls)["words"]  # type: ignore[method-assign]

    @property
    @abstractmethod
    def wording(self) -> str:
        """Return the sentence with the names of the fields in braces."""

    @cached_property
    def sentence(self) -> str:
        """Return the sentence with the values of the fields, as the catalogue writes it."""
        text = PLURAL.sub(lambda match: match[1] + "s" * (getattr(self, match[2]) != 1), self.wording)
        return FIELD.sub(lambda match: shown_limit(getattr(self, match[1]), match[2]), text)


def shown_limit(value: float, unit: str) -> str:
    """Return the limit ``value`` (SI) in ``unit`` as text, in the form that sentences use."""
    if unit == "1":
        return f"{value:g}"
    if unit in PER_SI:
        return f"{value * PER_SI[unit]:g} {unit}"
    return f"{value * 100.0:.12g} %" if unit == "%" else str(value)


class Property(Said, Protocol):
    """A safety property of a run."""

    def evaluate(self, trace: Trace) -> Evaluation:
        """Return the evaluation of ``trace``."""


def inconclusive(prop: Said, reason: str, *, exercised: int = 0) -> Evaluation:
    """Return an inconclusive evaluation of ``prop`` with the reason ``reason``."""
    return Evaluation(
        sentence=prop.sentence,
        verdict=Verdict.INCONCLUSIVE,
        unit=prop.unit,
        reason=reason,
        exercised=exercised,
        close=close_to(prop),
    )


def unreadable(trace: Trace, fields: Sequence[str]) -> str | None:
    """Return the reason why ``trace`` cannot be judged by its ``fields``, or None if it can be judged.

    Possible reasons: the trace is empty, it contradicts itself, or a value in ``fields`` is not finite. A
    hand's values are used only while the hand is present; while it is absent, its distance is infinite.
    """
    if len(trace.ticks) == 0:
        return "the trace is empty"
    problem = first_inconsistency(trace)
    if problem is not None:
        return f"the trace contradicts itself: {problem}"
    unreal = first_unreal(trace)
    for name in fields:
        if name in unreal:
            return f"{name} is not finite from {trace.time_s[unreal[name]]:.3f} s"
    return None


@once_a_trace
def first_unreal(trace: Trace) -> dict[str, int]:
    """Return the first tick at which each field is not finite.

    Fields that are always finite are left out.
    """
    unreal_columns = unreal(trace, dict.fromkeys(OF_HANDS, trace.ticks["hand_present"]))
    return {name: int(np.argmax(invalid)) for name, invalid in unreal_columns if invalid.any()}


def unreal(trace: Trace, there: Mapping[str, NDArray[np.bool_]]) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Yield each field that has a NaN or a value not below ENDLESS, with the ticks of such values.

    The ticks are a boolean array (n,). For a field in ``there``, only the parts of each row for which
    ``there`` (n, k) is True are examined.
    """
    for name, column in _nonfinite_fields(trace).items():
        invalid = ~(np.abs(as_numbers(trace.ticks)[:, column]) < ENDLESS)[:, None]
        if (parts := there.get(name)) is not None:
            invalid = invalid.reshape(*parts.shape, -1) & parts[..., None]
        yield name, np.asarray(invalid.any(axis=(1, 2)))


@once_a_trace
def _nonfinite_fields(trace: Trace) -> dict[str, slice]:
    """Return each field that has a NaN or a value not below ENDLESS, with its columns in ``as_numbers``."""
    counts = _endless(as_numbers(trace.ticks)).tolist()
    return {name: column for name, column in columns(trace.ticks.dtype).items() if any(counts[column])}


@compiled
def _endless(rows: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the number of endless values in each column of ``rows`` (n, c), shape (c,).

    A value is endless if it is not below ENDLESS.
    """
    columns = np.zeros(rows.shape[1], np.int64)
    for k in range(rows.shape[0]):
        for column in range(rows.shape[1]):
            columns[column] += not abs(rows[k, column]) < ENDLESS
    return columns


def is_somewhere(position_in_base_m: Array3) -> bool:
    """Return whether a decision's position is finite, and its coordinates are below HORIZON_M."""
    return bool(np.all(np.abs(position_in_base_m) < HORIZON_M))  # of a NaN it is false


def begins_at(state: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the ticks at which ``state`` (n,) becomes True, shape (n,).

    The first tick is included if ``state`` is True there.
    """
    begins = state.copy()
    begins[1:] &= ~state[:-1]
    return begins


def runs_of(state: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first tick of each stretch where ``state`` (n,) is True, and the first tick after it.

    Both results have the shape (k,).
    """
    padded = np.zeros(len(state) + 2, np.int8)
    padded[1:-1] = state
    change = padded[1:] - padded[:-1]
    return np.flatnonzero(change == 1), np.flatnonzero(change == -1)


def times_begun(state: NDArray[np.bool_]) -> int:
    """Return how often ``state`` (n,) becomes True."""
    return int(np.count_nonzero(begins_at(state)))


def time_left_s(trace: Trace, limit_s: float, ticks: int) -> float:
    """Return ``limit_s`` minus the duration of ``ticks`` control periods.

    The result is 0.0 if the two times differ only by rounding. For example, a limit of 24 ms equals three
    periods of 8 ms, although the floats differ. The allowed difference of 4 units in the last place exceeds
    the rounding of limit, period and product.
    """
    took_s = ticks * trace.scenario.settings.clock.control_period_s
    return 0.0 if isclose(limit_s, took_s, rel_tol=2.0**-51) else limit_s - took_s


def judged(
    prop: Property,
    trace: Trace,
    margin: float,
    worst_time_s: float,
    reason: str,
    exercised: int,
    lacked: Callable[[], str] | None = None,
    *,
    revocable: bool = False,
    most: float | None = None,
    unsure: str = "it holds at the ticks, perhaps not between them",
) -> Evaluation:
    """Return the evaluation of ``prop`` with the margin ``margin``.

    The evaluation is inconclusive if the run is not evidence. A negative margin is a violation. Otherwise the
    verdict is inconclusive if the property was never exercised, or the run was cut short. A margin that is
    not finite cannot come from a real run, so it is not evidence.

    Args:
        prop: The property.
        trace: The run.
        margin: The margin (SI), or its lower bound if ``most`` is given.
        worst_time_s: The time at which the margin occurs.
        reason: A text about the moment that decided the verdict.
        exercised: The number of occasions that exercised the property.
        lacked: A function that returns a text on the event that would have exercised the property. None means
            that ``reason`` serves as this text.
        revocable: Whether later ticks could undo a violation. In this case, a run that was cut short has no
            violation.
        most: The upper bound of the margin. The property is violated only if both bounds are negative.
        unsure: A text that says why the two bounds differ.

    """
    if most is not None and margin < 0.0:
        if most >= 0.0:
            ends = f"between {prop.unit.margin_text(margin)} and {prop.unit.margin_text(most)}"
            why = f"{unsure}: {ends} ({reason})"
            if not isfinite(margin):
                why = f"{MAY_SATURATE}; at the ticks {prop.unit.margin_text(most)} ({reason})"
            result = inconclusive(prop, why, exercised=exercised)
            return (
                result if not isfinite(margin) else replace(result, margin=margin, worst_time_s=worst_time_s)
            )
        margin = max(margin, most) if not isfinite(margin) else margin
    if not isfinite(margin):
        return inconclusive(prop, f"the margin is not finite ({margin})", exercised=exercised)
    verdict = Verdict.HOLDS
    # A violation stays one if the run is cut short, unless later ticks could revoke it.
    if margin < 0.0 and (trace.complete or not revocable):
        verdict = Verdict.VIOLATED
    elif exercised == 0:
        verdict, reason = Verdict.INCONCLUSIVE, f"never exercised: {lacked() if lacked else reason}"
    elif not trace.complete:
        verdict, reason = Verdict.INCONCLUSIVE, f"the run was cut short ({trace.ended}): {reason}"
    return Evaluation(
        sentence=prop.sentence,
        verdict=verdict,
        unit=prop.unit,
        margin=float(margin),
        worst_time_s=float(worst_time_s),
        reason=reason,
        exercised=exercised,
        close=close_to(prop),
    )
