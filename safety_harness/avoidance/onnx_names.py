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

from safety_harness.avoidance.model_file import refuse

HAND, TCP, SEED, MASKS = "hand_position_in_base_m", "tcp_position_in_base_m", "seed", "masks"
POSITION, SPREAD, UNUSED = "position_in_base_m", "spread_m", "unused"
SHORT = {"hand": HAND, "tcp": TCP, "position": POSITION, "spread": SPREAD}
FLOATS = {"tensor(float)": "float32", "tensor(double)": "float64", "tensor(float16)": "float16"}
ANY = 0  # size of an axis, and so width of what has one
MOST_FREE, MOST_WAYS, MOST_TRIED = 6, 3, 1000  # quantities laid out by shape, layouts proposed and tried


@dataclass(frozen=True)
class Quantity:
    """``sizes`` of its axes after the first (None: any axes), and the types of onnxruntime with numpy's."""

    sizes: tuple[int, ...] | None
    types: Mapping[str, str]

    @property
    def width(self) -> int:
        """How many numbers a row of it has."""
        return ANY if self.sizes is None else prod(self.sizes)


Quantities = Mapping[str, Quantity]
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


def layout_of(text: str) -> dict[str, tuple[str, ...]]:
    """Parse a layout to the quantities in each tensor; short names stand for long ones."""
    found: dict[str, tuple[str, ...]] = {}
    name = ""
    for word in text.split(",") if text else ():
        before, equals, quantity = word.rpartition("=")
        name = before if equals else name
        found[name] = (*found.get(name, ()), SHORT.get(quantity, quantity))
    return found


def laid_out(
    path: Path, session: Any, layout: Layout, takes: Quantities, gives: Quantities, required: set[str]
) -> tuple[list[Tensor], list[Tensor]]:
    """Return the inputs, and the outputs but those unused, of the file ``path`` in a ``session``.

    ``takes`` and ``gives`` are all quantities that inputs and outputs may hold, of which ``required`` have to
    be there.  Raise one ModelError for all names that mean nothing, with what there is and the layouts that
    fit its shapes; else for the first tensor of another type, or input of another shape.
    """
    inputs, given = session.get_inputs(), session.get_outputs()
    held = {one.name: layout.get(one.name, (one.name,)) for one in (*inputs, *given)}
    outputs = [one for one in given if held[one.name] != (UNUSED,)]
    sides = ((inputs, takes), (outputs, gives))
    unknown = [[one for one in some if not known.keys() >= {*held[one.name]}] for some, known in sides]
    used = [name for some, _ in sides for one in some for name in held[one.name]]
    wrong = [name for name in layout if name not in held] + [one.name for some in unknown for one in some]
    wrong += [name for name in dict.fromkeys(used) if used.count(name) > 1]
    missing = required - {*used}
    if wrong or missing:
        free = [{name: known[name] for name in known if name not in used} for _, known in sides]
        ways = product(
            _ways(unknown[0], free[0], [], missing), _ways(unknown[1], free[1], [(UNUSED,)], missing)
        )
        texts = [f"{path.name}:{','.join((*one, *other))}" for one, other in ways]
        hint = f"its shapes fit {' or '.join(texts)}: if its columns have this order, name it so"
        if not 0 < len(texts) <= MOST_WAYS or not any(unknown):
            hint = f"a layout says what each holds: {path.name}:NAME=QUANTITY,QUANTITY,NAME=QUANTITY"
        wanted = [", ".join(f"{name} {_shape(one)}" for name, one in known.items()) for _, known in sides]
        there = [", ".join(f"{one.name} {one.type} {one.shape}" for one in some) for some in (inputs, given)]
        expected, got = (f"inputs {one}; outputs {other}" for one, other in (wanted, there))
        refuse(path, ", ".join(wrong or sorted(missing)), expected, got, hint)
    return (
        [_tensor(path, one, held[one.name], takes, shaped=True) for one in inputs],
        [_tensor(path, one, held[one.name], gives, shaped=False) for one in outputs],
    )


def _tensor(path: Path, one: Any, holds: tuple[str, ...], known: Quantities, *, shaped: bool) -> Tensor:
    quantities = [known[name] for name in holds]
    for quantity in quantities:
        if one.type not in quantity.types:
            refuse(path, one.name, " or ".join(quantity.types.values()), one.type)
    if shaped and not _fits(one.shape, quantities):
        refuse(path, one.name, f"a shape of {_shape(*quantities)}", str(one.shape))
    return Tensor(one.name, holds, quantities[0].types[one.type], len(one.shape))


def _columns(quantities: Sequence[Quantity]) -> tuple[int, ...]:
    """The one axis after the first of what holds all of them in columns."""
    widths = [one.width for one in quantities]
    return (ANY if ANY in widths else sum(widths),)


def _shape(*quantities: Quantity) -> list[int | str]:
    """What holds them takes, in words: the axes of one, the columns of several."""
    sizes = quantities[0].sizes or () if len(quantities) == 1 else _columns(quantities)
    return ["1 or n", *(size or "k" for size in sizes)]


def _fits(shape: Sequence[int | str | None], quantities: Sequence[Quantity]) -> bool:
    """One row or any number of them, then the axes of one quantity, or the columns of all."""
    own = quantities[0].sizes if len(quantities) == 1 else _columns(quantities)
    return own is None or any(
        len(shape) == 1 + len(rest)
        and all(a == b or b == ANY or not isinstance(a, int) for a, b in zip(shape, (1, *rest), strict=True))
        for rest in (own, _columns(quantities))
    )


def _ways(
    tensors: Sequence[Any], free: Quantities, spare: list[tuple[str, ...]], missing: set[str]
) -> Iterator[list[str]]:
    """Yield the layouts of the ``free`` quantities that fit the shapes, all of the ``missing`` among them.

    ``spare``: what a tensor may hold that none of them fits.
    """
    some = range(1, len(free) + 1 if len(free) <= MOST_FREE else 1)
    every = [(names, [free[name] for name in names]) for n in some for names in combinations(free, n)]
    choices = [
        [names for names, own in every if all(one.type in q.types for q in own) and _fits(one.shape, own)]
        or spare
        for one in tensors
    ]
    short = {name: word for word, name in SHORT.items()}
    for way in islice(product(*choices), MOST_TRIED):
        laid = [name for names in way for name in names if name != UNUSED]
        if len({*laid}) == len(laid) and missing & free.keys() <= {*laid}:
            words = [",".join(short.get(name, name) for name in names) for names in way]
            yield [f"{one.name}={text}" for one, text in zip(tensors, words, strict=True)]
