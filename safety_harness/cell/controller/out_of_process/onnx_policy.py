"""Run a policy in an ONNX file as a controller, in a process of its own.

Inputs and outputs have the following names, or other names that a layout explains (``onnx_names``).

Inputs Any arrays that ``arrays.observed`` returns, with the same names and with a first axis of size 1.
    ``image``: (1, height, width, 3), the pixels of the last image. NAME, if there is an output ``next_NAME``:
    the policy's memory. The memory is zero at first, and then equals this output at the previous tick.
    Outputs tcp_velocity_mps (1, 3), tcp_angular_velocity_radps (1, 3), joint_velocity_radps (1, n): as in
    ``Move``. These outputs may also contain chunks of k successive actions, with the shapes (1, k, 3) and (1,
    k, n). stop (1,), optional: a number greater than one half means a protective stop in place of all these
    actions. Metadata name, optional: the policy's name in place of the file's name. ticks, optional: the
    duration of each action in ticks, 1 by default. horizon, only for chunks: the number of actions of a chunk
    that run before the next answer. training, optional: the training data, which only evidence reports read.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import ControllerError, on_one_line
from safety_harness.base.settings import Settings
from safety_harness.cell.avoidance.model_file import refuse
from safety_harness.cell.avoidance.onnx_file import OnnxFile
from safety_harness.cell.avoidance.onnx_names import ANY, FLOATS, NamedQuantity, dtype_of
from safety_harness.cell.controller.answers import columns_of
from safety_harness.cell.controller.arrays import Arrays, observed
from safety_harness.seams.contract import IMAGE, SIGHTS, Action, DrivenArm, Move, Seen, Start, Stop
from safety_harness.seams.rows import seen_dtype

MOVES = ("tcp_velocity_mps", "tcp_angular_velocity_radps", "joint_velocity_radps")
STOP, NEXT, NAME, TICKS, HORIZON = "stop", "next_", "name", "ticks", "horizon"
# A choice: the largest number of ticks that a file may declare.
MOST_TICKS = 1000
TYPES = (*FLOATS, "int8", "int64", "uint8", "bool")
GIVEN = {name: NamedQuantity((ANY if name == MOVES[2] else 3,), TYPES, in_chunks=True) for name in MOVES}
GIVEN |= {STOP: NamedQuantity((), TYPES)}


class OnnxPolicy:
    """A policy in an ONNX file.

    The file runs on one thread of the CPU in a fixed order of operations.
    """

    reports = ()

    def __init__(self, path: Path, data: bytes, layout: str = "") -> None:
        """Load and check the file.

        Raise ``ModelError`` if the file is not a policy. If an input or output does not have a name of the
        harness, ``layout`` states its quantities (``onnx_names``).
        """
        self._file = file = OnnxFile(path, data, layout)
        own, session = file.metadata, file.session
        name = on_one_line(own.get(NAME, f"ONNX policy {path.name}"))
        self.name = f"{name}:{layout}" if layout else name
        self._hold = _count(path, TICKS, own.get(TICKS, "1"))
        self._horizon = _count(path, HORIZON, own[HORIZON]) if HORIZON in own else None
        given = {name for arg in session.get_outputs() for name in file.layout.get(arg.name, (arg.name,))}
        carried = [arg for arg in session.get_inputs() if NEXT + arg.name in given]
        states = {arg.name: NamedQuantity(None, TYPES) for arg in carried}
        takes = {name: kind for name, (_, kind) in _KNOWN.items()} | states
        gives = GIVEN | {NEXT + name: kind for name, kind in states.items()}
        file.lay_out(takes, gives, set())
        if not any(name in MOVES for name in given):
            refuse(path, None, f"an output of: {', '.join(MOVES)}", f"the outputs {', '.join(given)}")
        self._states = {arg.name: _zeros(path, arg) for arg in carried}
        sights = {_KNOWN[name][0] for arg in file.inputs for name in arg.holds if name not in states}
        self.sees = tuple(sight.word for sight in SIGHTS if sight.word in sights)
        self._state: dict[str, NDArray[Any]] = {}
        self._joints = 0
        self._actions: list[Action] = []  # still to be carried out

    @property
    def acts_per_answer(self) -> int:
        """The number of successive calls of ``act`` that use the same answer of the file."""
        return self._hold * (self._horizon or 1)

    def reset(self, *, settings: Settings, arm: DrivenArm, start: Start, seed: int) -> None:
        """Begin an episode, and set the policy's memory to zeros."""
        self._joints, self._actions = len(arm.joint_names), []
        self._state = self._states

    def another(self) -> OnnxPolicy:
        """Return a second policy from the same file, for an episode in another lane."""
        return copy(self)

    def act(self, seen: Seen) -> Action:
        """Return the policy's action.

        The method runs the file only when the actions of its last answer are used up.
        """
        if not self._actions:
            self._actions = [action for action in self._answer(seen) for _ in range(self._hold)]
        return self._actions.pop(0)

    def _answer(self, seen: Seen) -> list[Action]:
        """Run the file on ``seen``, store the policy's next memory, and return the actions to execute."""
        widths = dict.fromkeys(MOVES, 3) | {MOVES[2]: self._joints, STOP: 1}
        outputs = self._file.answers(self._observed(seen), widths)
        self._state = {name: outputs[NEXT + name] for name in self._states}
        count = self._horizon or 1
        if STOP in outputs:
            if outputs[STOP].size != 1:
                raise ControllerError(f"the output {STOP} has the shape {outputs[STOP].shape}; expected (1,)")
            if not float(outputs[STOP].reshape(-1)[0]) <= 0.5:
                return [Stop()] * count
        moves = {name: self._rows(name, outputs[name], widths[name]) for name in MOVES if name in outputs}
        return [Move(**{name: rows[k] for name, rows in moves.items()}) for k in range(count)]

    def _rows(self, name: str, value: NDArray[Any], width: int) -> NDArray[np.float64]:
        """Return the actions in an output, shape (k, width).

        Raise ``ControllerError`` if the output has another shape.
        """
        least = self._horizon or 0
        axes = (1, width) if not least else (1, max(least, *value.shape[1:2]), width)
        if value.shape != axes:
            expected = f"(1, {width}), or a chunk (1, k, {width}) with the metadata {HORIZON}"
            if least:
                expected = f"(1, k, {width}) with k of at least {least}, the metadata {HORIZON}"
            raise ControllerError(f"the output {name} has the shape {value.shape}; expected {expected}")
        return np.asarray(value[0] if least else value, np.float64)

    def _observed(self, seen: Seen) -> Arrays:
        """Return the inputs of the file, which consist of quantities in ``seen`` and the policy's memory."""
        own = seen.__dict__
        arrays = columns_of(own["_row"][None], seen.period_s, own["_makers"])
        if IMAGE in self.sees:
            arrays[IMAGE] = seen.image.pixels[None]
        return arrays | self._state


def _known() -> Iterator[tuple[str, tuple[str, NamedQuantity]]]:
    """Yield each array's name, with the word of the visible quantity and with the array's axes.

    The axes of hands and joints have no fixed size.
    """
    yield IMAGE, (IMAGE, NamedQuantity((ANY, ANY, 3), TYPES))
    for sight_word in (sight.word for sight in SIGHTS if sight.word != IMAGE):
        few, more = (observed(np.zeros(1, seen_dtype(n, n)), (sight_word,)) for n in (1, 2))
        for name in few:
            pairs = zip(few[name].shape[1:], more[name].shape[1:], strict=True)
            yield name, (sight_word, NamedQuantity(tuple(a if a == b else ANY for a, b in pairs), TYPES))


_KNOWN = dict(_known())


def _zeros(path: Path, tensor: Any) -> NDArray[Any]:
    """Return zeros as the first value of a memory.

    Raise ``ModelError`` if the file does not fix all sizes of the memory.
    """
    if not all(isinstance(size, int) and size > 0 for size in tensor.shape):
        refuse(path, tensor.name, "a state of a fixed shape", str(tensor.shape))
    return np.zeros(tensor.shape, dtype_of(tensor))


def _count(path: Path, name: str, text: str) -> int:
    """Return the number in the metadata ``name``.

    ``text`` is the value in the metadata. Raise ``ModelError`` if the value is not a valid number.
    """
    if not text.isdecimal() or not 0 < int(text) <= MOST_TICKS:
        refuse(path, name, f"a number from 1 to {MOST_TICKS}", repr(text[:80]))
    return int(text)
