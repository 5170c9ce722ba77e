"""The form of a space's scenarios: a scenario with places into which drawn values are inserted.

The form also contains conditions that the values must satisfy.  To make a form, the ordinary reader reads one
scenario of each structure, with a ``TracedNumber`` for every number that varies.  A traced number acts like
an ordinary number, but records its computation and every comparison in which it was used.  Later values are
inserted at the same paths, provided that all recorded comparisons have the same results for them.  A
conversion, an array or a text cannot be recorded and raises TypeError, so that a form never contains a wrong
value.  The steps of a path are the names of dataclass fields and the indices of tuple members.
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
_Check = tuple[_Computed, bool]  # a comparison, and its required result

# The default groups of settings, in which no value is drawn.
_NEVER_DRAWN = frozenset(id(getattr(DEFAULTS, group.name)) for group in fields(DEFAULTS))


def value_at(root: object, path: Path) -> Any:
    """Return the object at ``path`` below ``root``."""
    for step in path:
        root = root[step] if isinstance(step, int) else getattr(root, step)  # type: ignore[index]
    return root


def with_value(root: T, path: Path, value: object) -> T:
    """Return a copy of ``root`` in which ``value`` is at the path ``path``.

    Every object along the path is replaced by a new object.
    """
    return form_of(root, {path: 0})([value])


def leaves(root: object, path: Path = (), *, but: Collection[int] = ()) -> list[tuple[Path, Any]]:
    """Return all values below ``root`` with their paths, in order.

    The function descends into dataclasses and tuples.  The function skips fields that are ignored in
    comparisons, such as places in files.

    Args:
        root: The object at which the search begins.
        path: The path of ``root``.
        but: The results of ``id`` for the objects that the function skips.

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
    """Return the names of the fields that take part in comparisons of the dataclass ``kind``."""
    return tuple(field.name for field in fields(kind) if field.compare)


def form_of(root: T, numbers: Mapping[Path, int]) -> Callable[[Sequence[Any]], T]:
    """Return a function of ``values`` that returns a copy of ``root``.

    In the copy, ``values[numbers[path]]`` is at each path.
    """
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


def path_text(path: Path) -> str:
    """Return a path as text, such as ``hands[0].moves[1].speed_mps``."""
    text = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in path)
    return text.removeprefix(".")


def _operator(apply: Callable[[Any, Any], Any], *, mirrored: bool = False) -> Callable[[Any, Any], Any]:
    """Return a function that implements an operator of ``TracedNumber``.

    A comparison returns a bool and is recorded, and any other operator returns a traced number.
    """

    def applied(self: TracedNumber, operand: object) -> Any:
        if not isinstance(operand, TracedNumber | float | int):
            return NotImplemented
        of_operand = operand.compute if isinstance(operand, TracedNumber) else lambda values: operand
        left, right = (of_operand, self.compute) if mirrored else (self.compute, of_operand)

        def compute(values: Values) -> Any:
            return apply(left(values), right(values))

        result = compute(self.values)
        if not isinstance(result, bool):
            return TracedNumber(compute, self.values, self.checks)
        self.checks.append((compute, result))
        return result

    return applied


class TracedNumber:
    """A number that remembers how it was computed.

    ``values`` contains the values of the current point.  The function ``compute`` calculates the number from
    these values.  All numbers of one reading share the list ``checks``, which contains all comparisons so
    far.
    """

    __array_ufunc__ = None  # numpy refuses to compute with it

    def __init__(self, compute: _Computed, values: Values, checks: list[_Check]) -> None:
        self.compute, self.values, self.checks = compute, values, checks

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
        """Return the number as a plain float, because another process does not need its computation."""
        return float, (self.compute(self.values),)


@dataclass(frozen=True, eq=False)
class Form:
    """A form for all scenarios of one structure.

    These scenarios differ only in the drawn values, the name and the seed.
    """

    checks: tuple[_Check, ...]
    places: tuple[_Computed, ...]
    fill: Callable[[Sequence[Any]], Scenario] | None

    @classmethod
    def read(cls, row: Values, read: Callable[[Sequence[TracedNumber]], Scenario]) -> Form:
        """Make a form by reading the scenario of one point.

        An InputError of the reader is not caught.  If the reader uses the numbers for more than arithmetic
        and comparisons, the resulting form fits no point.

        Args:
            row: The values of the point.
            read: A function that reads a scenario from traced numbers.

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
                places.append(leaf.compute)
            elif isinstance(leaf, np.ndarray) and leaf.dtype == object:
                return cls((), (), None)
        return cls(tuple(checks), tuple(places), form_of(scenario, numbers))

    def filled(self, row: Values, name: str, seed: int) -> Scenario | None:
        """Return the scenario of a point's values, or None if the form does not fit the values.

        If the result is None, the reader has to make or refuse the scenario.
        """
        if self.fill is None or not all(compute(row) is answer for compute, answer in self.checks):
            return None
        numbers = [compute(row) for compute in self.places]
        return self.fill([*numbers, name, seed]) if all(map(isfinite, numbers)) else None
