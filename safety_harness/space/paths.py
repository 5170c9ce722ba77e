"""Values within frozen objects by their path: dataclass fields by name, members of tuples by number."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import lru_cache
from operator import itemgetter
from typing import Any, TypeVar

Path = tuple[str | int, ...]
T = TypeVar("T")


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
