"""Find the quantities in the inputs and outputs of an ONNX file.

The harness identifies these quantities by its own names or by a layout. Exporters choose their own names,
such as ``input``, ``float_input``, ``X`` or ``obs``. In a scenario and on the command line, a layout follows
the file's name: ``mine.onnx:X=hand,tcp,Y=position``. The text after ``NAME=`` lists the quantities in the
tensor NAME, in the order of its columns. The harness ignores an output with the quantity ``unused``.
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
ANY = 0  # stands for an axis of any size, and for the width of a quantity with such an axis
MOST_FREE, MOST_WAYS, MOST_TRIED = 6, 3, 1000  # quantities laid out by shape, layouts proposed and tried


@dataclass(frozen=True)
class NamedQuantity:
    """A quantity in a tensor.

    ``sizes`` are the quantity's axes after the first axis, or None if any axes are possible. ``types`` are
    numpy's names of the types that the quantity may have. If ``in_chunks`` is True, a tensor of such
    quantities may have k rows, shape (1, k, columns).
    """

    sizes: tuple[int, ...] | None
    types: tuple[str, ...]
    in_chunks: bool = False


Quantities = Mapping[str, NamedQuantity]
Layout = Mapping[str, tuple[str, ...]]  # the quantities in each tensor


@dataclass(frozen=True)
class Tensor:
    """An input or output of a file, with the names of its quantities."""

    name: str
    holds: tuple[str, ...]
    dtype: str
    axes: int

    def packed(self, arrays: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
        """Return the tensor's value, composed of the ``arrays`` (1, ...) for the tensor's quantities."""
        value, *more = (arrays[name] for name in self.holds)
        if more or self.axes == 2 != value.ndim:
            value = np.concatenate([array.reshape(1, -1) for array in (value, *more)], axis=1)
        return value.astype(self.dtype, copy=False)

    def split(self, value: NDArray[Any], widths: Mapping[str, int]) -> Iterator[tuple[str, NDArray[Any]]]:
        """Yield each quantity with its columns of ``value`` (1, m).

        The last quantity gets all remaining columns.
        """
        ends = np.cumsum([widths[name] for name in self.holds[:-1]], dtype=int)
        yield from zip(self.holds, np.split(value, ends, axis=-1) if len(ends) else [value], strict=True)


def dtype_of(tensor: Any) -> str:
    """Return numpy's name for the type of a tensor, or onnxruntime's name if numpy lacks the type."""
    kind = str(tensor.type).removeprefix("tensor(").removesuffix(")")
    return {"float": "float32", "double": "float64"}.get(kind, kind)


def layout_of(text: str) -> dict[str, tuple[str, ...]]:
    """Return the quantities in each tensor according to the layout ``text``.

    The function replaces short names of quantities by long names.
    """
    layout: dict[str, tuple[str, ...]] = {}
    name = ""
    for part in map(str.strip, text.split(",")) if text else ():
        given_name, equals, quantity = part.rpartition("=")
        name = given_name if equals else name
        layout[name] = (*layout.get(name, ()), SHORT.get(quantity, quantity))
    return layout


def laid_out(
    path: Path, session: Any, layout: Layout, takes: Quantities, gives: Quantities, required: set[str]
) -> list[list[Tensor]]:
    """Return the inputs of a file, and the outputs that the harness uses.

    Args:
        path: The file, for errors.
        session: The session of the file in onnxruntime.
        layout: The quantities in each tensor that does not have a name of the harness.
        takes: All quantities that inputs may contain.
        gives: All quantities that outputs may contain.
        required: The quantities that the file must contain.

    Raises:
        ModelError: A tensor has an unknown name, or a wrong type or shape. For unknown names, the error lists
            all of them, the available quantities, and the layouts that fit the shapes.

    """
    inputs, given = session.get_inputs(), session.get_outputs()
    own = {**SHORT, **{name: name for name in (*takes, *gives)}}
    held = {arg.name: layout.get(arg.name, (own.get(arg.name, arg.name),)) for arg in (*inputs, *given)}
    sides = ((inputs, takes), ([arg for arg in given if held[arg.name] != (UNUSED,)], gives))
    used = [name for some, _ in sides for arg in some for name in held[arg.name]]
    unknown = [(arg, known) for some, known in sides for arg in some if not known.keys() >= {*held[arg.name]}]
    refused = [name for name in layout if name not in held] + [arg.name for arg, _ in unknown]
    refused += [name for name in dict.fromkeys(used) if used.count(name) > 1]
    missing = required - {*used}
    if refused or missing:
        free = [(arg, {name: known[name] for name in known if name not in used}) for arg, known in unknown]
        fits = [f"{path.name}:{fit}" for fit in _layouts(free, missing, {arg.name for arg in given})]
        hint = f"its shapes fit {' or '.join(fits)}: if its columns have this order, name it so"
        if not (unknown and 0 < len(fits) <= MOST_WAYS):
            hint = f"a layout says what each holds: {path.name}:NAME=QUANTITY,QUANTITY,NAME=QUANTITY"
        wanted = [", ".join(f"{name} {_shape([arg])}" for name, arg in known.items()) for _, known in sides]
        there = [
            ", ".join(f"{arg.name} {dtype_of(arg)} {arg.shape}" for arg in some) for some in (inputs, given)
        ]
        expected, got = (f"inputs {arg}; outputs {second}" for arg, second in (wanted, there))
        refuse(path, ", ".join(refused or sorted(missing)), expected, got, hint)
    for arg in inputs:
        if not _fits(arg.shape, wants := [takes[name] for name in held[arg.name]]):
            refuse(path, arg.name, f"a shape of {_shape(wants)}", str(arg.shape))
    return [[_tensor(path, arg, held[arg.name], known) for arg in some] for some, known in sides]


def _tensor(path: Path, tensor: Any, holds: tuple[str, ...], known: Quantities) -> Tensor:
    """Return an input or output with its quantities ``holds``.

    Raise ``ModelError`` if its type does not suit the quantities.
    """
    for name in holds:
        if dtype_of(tensor) not in known[name].types:
            refuse(path, tensor.name, " or ".join(known[name].types), tensor.type)
    return Tensor(tensor.name, holds, dtype_of(tensor), len(tensor.shape))


def _rests(quantities: Sequence[NamedQuantity]) -> list[tuple[int, ...]]:
    """Return all possible shapes, without the first axis, of a tensor with ``quantities``.

    A single quantity may keep its own axes. Several quantities form adjacent columns.
    """
    widths = [ANY if quantity.sizes is None else prod(quantity.sizes) for quantity in quantities]
    columns = (ANY if ANY in widths else sum(widths),)
    own: list[tuple[int, ...]] = [quantities[0].sizes or (), columns] if len(quantities) == 1 else [columns]
    return [*own, (ANY, *columns)] if all(quantity.in_chunks for quantity in quantities) else own


def _shape(quantities: Sequence[NamedQuantity]) -> list[int | str]:
    """Return the shape of a tensor with ``quantities``, for the text of an error."""
    return ["1 or n", *(size or "k" for size in _rests(quantities)[0])]


def _fits(shape: Sequence[int | str | None], quantities: Sequence[NamedQuantity]) -> bool:
    """Return whether a tensor with ``quantities`` may have this ``shape``.

    The first axis must have the size one, or no fixed size.
    """
    return quantities[0].sizes is None or any(
        len(shape) == 1 + len(rest)
        and all(a == b or b == ANY or not isinstance(a, int) for a, b in zip(shape, (1, *rest), strict=True))
        for rest in _rests(quantities)
    )


def _layouts(free: Sequence[tuple[Any, Quantities]], missing: set[str], outputs: set[str]) -> Iterator[str]:
    """Yield the layouts that fit the shapes of the ``free`` tensors.

    Each tensor comes with its possible quantities. Every layout contains all ``missing`` quantities. If an
    output suits no quantity, the layout marks this output as unused, unless it is the file's only output.
    """
    short, choices = {name: short_name for short_name, name in SHORT.items()}, []
    for tensor, known in free:
        most = len(known) if len(known) <= MOST_FREE else 0
        every = [names for n in range(most) for names in combinations(known, n + 1)]
        fitting = [names for names in every if all(dtype_of(tensor) in known[name].types for name in names)]
        fitting = [names for names in fitting if _fits(tensor.shape, [known[name] for name in names])]
        choices.append(fitting or [(UNUSED,)][: int(tensor.name in outputs and len(outputs) > 1)])
    for layout in islice(product(*choices), MOST_TRIED):
        laid = [name for names in layout for name in names if name != UNUSED]
        if len({*laid}) == len(laid) and missing <= {*laid}:
            texts = (",".join(short.get(name, name) for name in names) for names in layout)
            yield ",".join(f"{tensor.name}={text}" for (tensor, _), text in zip(free, texts, strict=True))
