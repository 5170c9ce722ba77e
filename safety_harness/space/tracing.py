"""Where the drawn values of a space end up in its scenario, and what has to hold of them.

A scenario is read once for each structure, with a ``TracedNumber`` in place of every number that varies.
That goes through the ordinary reader like the number that it has; it remembers how it was computed, and every
comparison that it was part of.  Other values are then filled in at the same paths, as long as they answer all
these comparisons alike.  What cannot be remembered (a conversion, an array, a text) is a TypeError, so that
nothing is ever filled in wrongly.  A path leads through dataclass fields by name, through members of tuples
by number.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import lru_cache
from math import isfinite
from operator import itemgetter
from typing import Any, TypeVar

import numpy as np

from safety_harness.base.settings import DEFAULTS
from safety_harness.scenario.model import Scenario

Path = tuple[str | int, ...]
T = TypeVar("T")
Values = Sequence[float]
_Computed = Callable[[Values], Any]  # from a point's values
_Check = tuple[_Computed, bool]  # a comparison, and how it has to come out

# The groups of settings as they are by default.
_NEVER_DRAWN = frozenset(id(getattr(DEFAULTS, one.name)) for one in fields(DEFAULTS))


def value_at(root: object, path: Path) -> Any:
    """What lies at ``path`` below ``root``."""
    for step in path:
        root = root[step] if isinstance(step, int) else getattr(root, step)  # type: ignore[index]
    return root


def with_value(root: T, path: Path, value: object) -> T:
    """``root`` with ``value`` at ``path``, and everything on the way made anew."""
    return form_of(root, {path: 0})([value])


def leaves(root: object, path: Path = (), *, but: Collection[int] = ()) -> list[tuple[Path, Any]]:
    """Everything below ``root`` that is neither a dataclass nor a tuple, with its path, in their order.

    Fields that do not count in a comparison (places in files) are left out, and objects with an ``id`` in
    ``but``.
    """
    if id(root) in but:
        return []
    kind: Any = type(root)
    if not isinstance(root, tuple) and not is_dataclass(kind):
        return [(path, root)]
    steps: Iterable[str | int] = range(len(root)) if isinstance(root, tuple) else _compared(kind)
    return [leaf for step in steps for leaf in leaves(value_at(root, (step,)), (*path, step), but=but)]


@lru_cache
def _compared(kind: Any) -> tuple[str, ...]:
    return tuple(field.name for field in fields(kind) if field.compare)


def form_of(root: T, numbers: Mapping[Path, int]) -> Callable[[Sequence[Any]], T]:
    """``root`` as a function of values: with ``values[numbers[path]]`` at each path, and else as it is."""
    if () in numbers:
        return itemgetter(numbers[()])
    below: dict[Any, dict[Path, int]] = {}
    for (step, *rest), number in numbers.items():
        below.setdefault(step, {})[tuple(rest)] = number
    parts = [(step, form_of(value_at(root, (step,)), inner)) for step, inner in below.items()]
    kind: Any = type(root)
    if isinstance(root, tuple):

        def filled(values: Sequence[Any]) -> T:
            members = list(root)
            for step, part in parts:
                members[step] = part(values)
            return kind(members)  # type: ignore[no-any-return]

        return filled
    fixed = {field.name: getattr(root, field.name) for field in fields(kind) if field.init}
    return lambda values: kind(**fixed | {step: part(values) for step, part in parts})


def words(path: Path) -> str:
    """``hands[0].moves[1].speed_mps``."""
    text = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in path)
    return text.removeprefix(".")


def _operator(apply: Callable[[Any, Any], Any], *, mirrored: bool = False) -> Callable[[Any, Any], Any]:
    """An operator of ``TracedNumber``: a bool for a comparison, which is noted down, else another one."""

    def applied(self: TracedNumber, other: object) -> Any:
        if not isinstance(other, TracedNumber | float | int):
            return NotImplemented
        of_other = other.of if isinstance(other, TracedNumber) else lambda values: other
        left, right = (of_other, self.of) if mirrored else (self.of, of_other)

        def of(values: Values) -> Any:
            return apply(left(values), right(values))

        result = of(self.values)
        if not isinstance(result, bool):
            return TracedNumber(of, self.values, self.checks)
        self.checks.append((of, result))
        return result

    return applied


class TracedNumber:
    """A number that ``of`` computes from a point's values; ``values`` are those of the point being read.

    All numbers of a reading share their ``checks``: every comparison so far.
    """

    __array_ufunc__ = None  # numpy makes nothing of it

    def __init__(self, of: _Computed, values: Values, checks: list[_Check]) -> None:
        self.of, self.values, self.checks = of, values, checks

    __add__, __radd__ = _operator(operator.add), _operator(operator.add, mirrored=True)
    __sub__, __rsub__ = _operator(operator.sub), _operator(operator.sub, mirrored=True)
    __mul__, __rmul__ = _operator(operator.mul), _operator(operator.mul, mirrored=True)
    __truediv__, __rtruediv__ = _operator(operator.truediv), _operator(operator.truediv, mirrored=True)
    __lt__, __le__ = _operator(operator.lt), _operator(operator.le)
    __gt__, __ge__ = _operator(operator.gt), _operator(operator.ge)
    __eq__, __ne__ = _operator(operator.eq), _operator(operator.ne)
    __hash__ = None  # type: ignore[assignment]

    def __bool__(self) -> bool:
        return bool(self != 0.0)

    def __str__(self) -> str:
        raise TypeError("the text of a traced number cannot be filled in")

    __repr__ = __str__

    def __reduce__(self) -> tuple[type[float], tuple[float]]:
        """In another process it is the number that it has."""
        return float, (self.of(self.values),)


@dataclass(frozen=True, eq=False)
class Form:
    """A scenario to fill in: all those of one structure, which differ in values, name and seed."""

    checks: tuple[_Check, ...]
    places: tuple[_Computed, ...]
    fill: Callable[[Sequence[Any]], Scenario] | None

    @classmethod
    def read(cls, row: Values, read: Callable[[Sequence[TracedNumber]], Scenario]) -> Form:
        """From one point's values; InputError as the reader's.

        Where the reader does more with the numbers than arithmetic, the form fits no point.
        """
        checks: list[_Check] = []
        traced = [TracedNumber(itemgetter(column), row, checks) for column in range(len(row))]
        try:
            scenario = read(traced)
        except TypeError:
            return cls((), (), None)
        numbers: dict[Path, int] = {("name",): -2, ("seed",): -1}
        places: list[_Computed] = []
        for path, leaf in leaves(scenario, but=_NEVER_DRAWN):
            if isinstance(leaf, TracedNumber):
                numbers[path] = len(places)
                places.append(leaf.of)
            elif isinstance(leaf, np.ndarray) and leaf.dtype == object:
                return cls((), (), None)
        return cls(tuple(checks), tuple(places), form_of(scenario, numbers))

    def filled(self, row: Values, name: str, seed: int) -> Scenario | None:
        """The scenario of a point's values; None where only the reader can make it, or refuse it."""
        if self.fill is None or not all(of(row) is answer for of, answer in self.checks):
            return None
        found = [of(row) for of in self.places]
        return self.fill([*found, name, seed]) if all(map(isfinite, found)) else None
