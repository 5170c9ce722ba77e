"""Run a policy in an ONNX file as a controller, in a process of its own.

Inputs and outputs have the following names, or other names that a layout explains (``onnx_names``).

Inputs
    Any of the arrays of ``arrays.observed``, by their names, with a first axis of 1: the policy sees these.
    ``image``: (1, height, width, 3), the pixels of the last image.
    NAME, with an output ``next_NAME``: the policy's memory from tick to tick; zeros at first.
Outputs
    tcp_velocity_mps (1, 3), tcp_angular_velocity_radps (1, 3), joint_velocity_radps (1, n): as in ``Move``.
    stop (1,), optional: a number above one half means a protective stop.
Metadata
    name, optional: its name in place of the file's; ticks: the duration of each action, 1 by default;
    training: its training data, which only evidence reports read.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import on_one_line
from safety_harness.base.settings import Settings
from safety_harness.cell.avoidance.model_file import refuse
from safety_harness.cell.avoidance.onnx_file import OnnxFile
from safety_harness.cell.avoidance.onnx_names import ANY, FLOATS, NamedQuantity, dtype_of
from safety_harness.cell.controller.answers import columns_of
from safety_harness.cell.controller.arrays import Arrays, observed
from safety_harness.seams.contract import IMAGE, SIGHTS, Action, DrivenArm, Move, Seen, Start, Stop
from safety_harness.seams.rows import seen_dtype

MOVES = ("tcp_velocity_mps", "tcp_angular_velocity_radps", "joint_velocity_radps")
STOP, NEXT, NAME, TICKS = "stop", "next_", "name", "ticks"
MOST_TICKS = 1000
TYPES = (*FLOATS, "int8", "int64", "uint8", "bool")
GIVEN = {name: NamedQuantity((ANY if name == MOVES[2] else 3,), TYPES) for name in MOVES}
GIVEN |= {STOP: NamedQuantity((), TYPES)}


class OnnxPolicy:
    """A policy in an ONNX file, which runs on one thread of the CPU in a fixed order of operations."""

    reports = ()

    def __init__(self, path: Path, data: bytes, layout: str = "") -> None:
        """Load and check the file; raise ``ModelError`` unless it is a policy.

        ``layout`` states the quantities of inputs and outputs whose names are not ours (``onnx_names``).
        """
        self._file = file = OnnxFile(path, data, layout)
        own, session = file.metadata, file.session
        name = on_one_line(own.get(NAME, f"ONNX policy {path.name}"))
        self.name = f"{name}:{layout}" if layout else name
        self._hold = _ticks(path, own.get(TICKS, "1"))
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
        self._joints, self._left = 0, 0
        self._action: Action = Stop()

    def reset(self, *, settings: Settings, arm: DrivenArm, start: Start, seed: int) -> None:
        """Begin an episode: set the policy's memory to zeros."""
        self._joints, self._left = len(arm.joint_names), 0
        self._state = self._states

    def another(self) -> OnnxPolicy:
        """Return a second policy from the same file, for an episode in another lane."""
        return copy(self)

    def act(self, seen: Seen) -> Action:
        """Return the policy's action; run the file only when the last action's number of ticks is over."""
        if self._left == 0:
            self._action, self._left = self._answer(seen), self._hold
        self._left -= 1
        return self._action

    def _answer(self, seen: Seen) -> Action:
        """Run the file on ``seen``, keep the policy's next memory, and return the action."""
        widths = dict.fromkeys(MOVES, 3) | {MOVES[2]: self._joints, STOP: 1}
        outputs = self._file.answers(self._observed(seen), widths)
        self._state = {name: outputs[NEXT + name] for name in self._states}
        if STOP in outputs and not float(outputs[STOP].reshape(-1)[0]) <= 0.5:
            return Stop()
        moves = {name: np.asarray(outputs[name], np.float64) for name in MOVES if name in outputs}
        return Move(**{name: value[0] for name, value in moves.items()})

    def _observed(self, seen: Seen) -> Arrays:
        """Return the file's inputs, made of the quantities in ``seen``."""
        own = seen.__dict__
        arrays = columns_of(own["_row"][None], seen.period_s, own["_makers"])
        if IMAGE in self.sees:
            arrays[IMAGE] = seen.image.pixels[None]
        return arrays | self._state


def _known() -> Iterator[tuple[str, tuple[str, NamedQuantity]]]:
    """Yield each visible quantity's name, word and axes; axes of hands and joints are open."""
    yield IMAGE, (IMAGE, NamedQuantity((ANY, ANY, 3), TYPES))
    for sight_word in (sight.word for sight in SIGHTS if sight.word != IMAGE):
        few, more = (observed(np.zeros(1, seen_dtype(n, n)), (sight_word,)) for n in (1, 2))
        for name in few:
            pairs = zip(few[name].shape[1:], more[name].shape[1:], strict=True)
            yield name, (sight_word, NamedQuantity(tuple(a if a == b else ANY for a, b in pairs), TYPES))


_KNOWN = dict(_known())


def _zeros(path: Path, tensor: Any) -> NDArray[Any]:
    """Return zeros for a memory's first value; ``ModelError`` if the file leaves one of its sizes open."""
    if not all(isinstance(size, int) and size > 0 for size in tensor.shape):
        refuse(path, tensor.name, "a state of a fixed shape", str(tensor.shape))
    return np.zeros(tensor.shape, dtype_of(tensor))


def _ticks(path: Path, text: str) -> int:
    """Return the number of ticks of each action from the metadata's ``text``; ``ModelError`` otherwise."""
    if not text.isdecimal() or not 0 < int(text) <= MOST_TICKS:
        refuse(path, TICKS, f"a number of ticks from 1 to {MOST_TICKS}", repr(text[:80]))
    return int(text)
