"""Values within frozen objects by their path: dataclass fields by name, members of tuples by number."""

from __future__ import annotations

from dataclasses import is_dataclass, replace
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
    if not path:
        return value  # type: ignore[return-value]
    step, rest = path[0], path[1:]
    found: Any
    if isinstance(step, int):
        members = list(root)  # type: ignore[call-overload]
        members[step] = with_value(members[step], rest, value)
        found = type(root)(members)  # type: ignore[call-arg]
    else:
        assert is_dataclass(root)
        found = replace(root, **{step: with_value(getattr(root, step), rest, value)})  # type: ignore[type-var]
    return found  # type: ignore[no-any-return]


def words(path: Path) -> str:
    """``hands[0].moves[1].speed_mps``."""
    text = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in path)
    return text.removeprefix(".")
