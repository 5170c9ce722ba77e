"""What each input and output of an ONNX file holds: a quantity of ours by its name, or what a layout says.

Exporters choose names (``input``, ``float_input``, ``X``, ``obs``).  A layout stands behind the file, in a
scenario and on the command line alike: ``mine.onnx:X=hand,tcp,Y=position``.  What follows ``NAME=`` are the
quantities in that tensor, in the order of its columns; an output that is ``unused`` is not read.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, islice, product
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.cell.avoidance.model_file import refuse

HAND, TCP, SEED, MASKS = "hand_position_in_base_m", "tcp_position_in_base_m", "seed", "masks"
POSITION, SPREAD, UNUSED = "position_in_base_m", "spread_m", "unused"
SHORT = {"hand": HAND, "tcp": TCP, "position": POSITION, "spread": SPREAD}
FLOATS = ("float16", "float32", "float64")
ANY = 0  # size of an axis, and so width of what has one
MOST_FREE, MOST_WAYS, MOST_TRIED = 6, 3, 1000  # quantities laid out by shape, layouts proposed and tried


@dataclass(frozen=True)
class NamedQuantity:
    """``sizes`` of its axes after the first (None: any axes), and its numbers' types as numpy names them."""

    sizes: tuple[int, ...] | None
    types: tuple[str, ...]


Quantities = Mapping[str, NamedQuantity]
Layout = Mapping[str, tuple[str, ...]]  # the quantities in each tensor


@dataclass(frozen=True)
class Tensor:
    """An input or output of a file, and the quantities in it."""

    name: str
    holds: tuple[str, ...]
    dtype: str
    axes: int

    def packed(self, arrays: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
        """Return its value, made of the ``arrays`` (1, ...) of its quantities."""
        value, *more = (arrays[name] for name in self.holds)
        if more or self.axes == 2 != value.ndim:
            value = np.concatenate([one.reshape(1, -1) for one in (value, *more)], axis=1)
        return value.astype(self.dtype, copy=False)

    def split(self, value: NDArray[Any], widths: Mapping[str, int]) -> Iterator[tuple[str, NDArray[Any]]]:
        """Yield its quantities and their columns of ``value`` (1, m), the last of them whatever is left."""
        ends = np.cumsum([widths[name] for name in self.holds[:-1]], dtype=int)
        yield from zip(self.holds, np.split(value, ends, axis=-1) if len(ends) else [value], strict=True)


def dtype_of(one: Any) -> str:
    """Return numpy's name for the type of an input or output of a session, or onnxruntime's own."""
    kind = str(one.type).removeprefix("tensor(").removesuffix(")")
    return {"float": "float32", "double": "float64"}.get(kind, kind)


def layout_of(text: str) -> dict[str, tuple[str, ...]]:
    """Parse a layout to the quantities in each tensor; short names stand for long ones."""
    found: dict[str, tuple[str, ...]] = {}
    name = ""
    for word in map(str.strip, text.split(",")) if text else ():
        before, equals, quantity = word.rpartition("=")
        name = before if equals else name
        found[name] = (*found.get(name, ()), SHORT.get(quantity, quantity))
    return found


def laid_out(
    path: Path, session: Any, layout: Layout, takes: Quantities, gives: Quantities, required: set[str]
) -> list[list[Tensor]]:
    """Return the inputs, and the outputs but those unused, of the file ``path`` in a ``session``.

    ``takes`` and ``gives`` are all quantities that inputs and outputs may hold, of which ``required`` have to
    be there.  Raise one ModelError for all names that mean nothing, with what there is and the layouts that
    fit its shapes; else for the first tensor of another type, or input of another shape.
    """
    inputs, given = session.get_inputs(), session.get_outputs()
    own = {**SHORT, **{name: name for name in (*takes, *gives)}}
    held = {one.name: layout.get(one.name, (own.get(one.name, one.name),)) for one in (*inputs, *given)}
    sides = ((inputs, takes), ([one for one in given if held[one.name] != (UNUSED,)], gives))
    used = [name for some, _ in sides for one in some for name in held[one.name]]
    unknown = [(one, known) for some, known in sides for one in some if not known.keys() >= {*held[one.name]}]
    wrong = [name for name in layout if name not in held] + [one.name for one, _ in unknown]
    wrong += [name for name in dict.fromkeys(used) if used.count(name) > 1]
    missing = required - {*used}
    if wrong or missing:
        free = [(one, {name: known[name] for name in known if name not in used}) for one, known in unknown]
        ways = [f"{path.name}:{way}" for way in _ways(free, missing, {one.name for one in given})]
        hint = f"its shapes fit {' or '.join(ways)}: if its columns have this order, name it so"
        if not (unknown and 0 < len(ways) <= MOST_WAYS):
            hint = f"a layout says what each holds: {path.name}:NAME=QUANTITY,QUANTITY,NAME=QUANTITY"
        wanted = [", ".join(f"{name} {_shape([one])}" for name, one in known.items()) for _, known in sides]
        there = [
            ", ".join(f"{one.name} {dtype_of(one)} {one.shape}" for one in some) for some in (inputs, given)
        ]
        expected, got = (f"inputs {one}; outputs {other}" for one, other in (wanted, there))
        refuse(path, ", ".join(wrong or sorted(missing)), expected, got, hint)
    for one in inputs:
        if not _fits(one.shape, wants := [takes[name] for name in held[one.name]]):
            refuse(path, one.name, f"a shape of {_shape(wants)}", str(one.shape))
    return [[_tensor(path, one, held[one.name], known) for one in some] for some, known in sides]


def _tensor(path: Path, one: Any, holds: tuple[str, ...], known: Quantities) -> Tensor:
    for name in holds:
        if dtype_of(one) not in known[name].types:
            refuse(path, one.name, " or ".join(known[name].types), one.type)
    return Tensor(one.name, holds, dtype_of(one), len(one.shape))


def _rests(quantities: Sequence[NamedQuantity]) -> list[tuple[int, ...]]:
    """The axes after the first of what holds all of them: those of one alone, or the columns of all."""
    widths = [ANY if one.sizes is None else prod(one.sizes) for one in quantities]
    columns = (ANY if ANY in widths else sum(widths),)
    return [quantities[0].sizes or (), columns] if len(quantities) == 1 else [columns]


def _shape(quantities: Sequence[NamedQuantity]) -> list[int | str]:
    return ["1 or n", *(size or "k" for size in _rests(quantities)[0])]


def _fits(shape: Sequence[int | str | None], quantities: Sequence[NamedQuantity]) -> bool:
    """One row or any number of them, and such axes."""
    return quantities[0].sizes is None or any(
        len(shape) == 1 + len(rest)
        and all(a == b or b == ANY or not isinstance(a, int) for a, b in zip(shape, (1, *rest), strict=True))
        for rest in _rests(quantities)
    )


def _ways(free: Sequence[tuple[Any, Quantities]], missing: set[str], outputs: set[str]) -> Iterator[str]:
    """Yield the layouts of tensors by their shapes, each with the quantities that are ``free`` for it.

    All that are ``missing`` are among them; an output that nothing fits is unused.
    """
    short, choices = {name: word for word, name in SHORT.items()}, []
    for one, known in free:
        most = len(known) if len(known) <= MOST_FREE else 0
        every = [names for n in range(most) for names in combinations(known, n + 1)]
        fitting = [names for names in every if all(dtype_of(one) in known[name].types for name in names)]
        fitting = [names for names in fitting if _fits(one.shape, [known[name] for name in names])]
        choices.append(fitting or [(UNUSED,)][: int(one.name in outputs)])
    for way in islice(product(*choices), MOST_TRIED):
        laid = [name for names in way for name in names if name != UNUSED]
        if len({*laid}) == len(laid) and missing <= {*laid}:
            words = (",".join(short.get(name, name) for name in names) for names in way)
            yield ",".join(f"{one.name}={text}" for (one, _), text in zip(free, words, strict=True))
