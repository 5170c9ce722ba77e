"""A policy in an ONNX file as a controller; it runs in a process of its own.

Inputs and outputs have these names, or others that a layout explains (``onnx_names``).

Inputs
    Any of the arrays of ``arrays.observed``, by their names, with a first axis of 1: what it takes it sees.
    ``image``: (1, height, width, 3), the pixels of the last image.
    NAME, where there is an output ``next_NAME``: what the policy carries from tick to tick; zeros at first.
Outputs
    tcp_velocity_mps (1, 3), tcp_angular_velocity_radps (1, 3), joint_velocity_radps (1, n): as of ``Move``.
    stop (1,), if there is one: above one half it is a protective stop.
Metadata
    name, if it is to be called otherwise than by its file; ticks, how long each action is held, 1 by default;
    training, what it was trained on, which only evidence reports read.
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
    """The function of an ONNX file, on one thread of the CPU, in one order of operations."""

    reports = ()

    def __init__(self, path: Path, data: bytes, layout: str = "") -> None:
        """Load and check it; ModelError for what is no policy.

        ``layout`` says what inputs and outputs hold whose names do not (``onnx_names``).
        """
        self._file = file = OnnxFile(path, data, layout)
        own, session = file.metadata, file.session
        name = on_one_line(own.get(NAME, f"ONNX policy {path.name}"))
        self.name = f"{name}:{layout}" if layout else name
        self._hold = _ticks(path, own.get(TICKS, "1"))
        given = {name for one in session.get_outputs() for name in file.layout.get(one.name, (one.name,))}
        carried = [one for one in session.get_inputs() if NEXT + one.name in given]
        states = {one.name: NamedQuantity(None, TYPES) for one in carried}
        takes = {name: kind for name, (_, kind) in _KNOWN.items()} | states
        gives = GIVEN | {NEXT + name: kind for name, kind in states.items()}
        file.lay_out(takes, gives, set())
        if not any(name in MOVES for name in given):
            refuse(path, None, f"an output of: {', '.join(MOVES)}", f"the outputs {', '.join(given)}")
        self._states = {one.name: _zeros(path, one) for one in carried}
        words = {_KNOWN[name][0] for one in file.inputs for name in one.holds if name not in states}
        self.sees = tuple(sight.word for sight in SIGHTS if sight.word in words)
        self._state: dict[str, NDArray[Any]] = {}
        self._joints, self._left = 0, 0
        self._action: Action = Stop()

    def reset(self, *, settings: Settings, arm: DrivenArm, start: Start, seed: int) -> None:
        """Begin with a state of zeros."""
        self._joints, self._left = len(arm.joint_names), 0
        self._state = self._states

    def another(self) -> OnnxPolicy:
        """One more of the same file, for an episode beside."""
        return copy(self)

    def act(self, seen: Seen) -> Action:
        """What the file answers, held for its ticks."""
        if self._left == 0:
            self._action, self._left = self._answer(seen), self._hold
        self._left -= 1
        return self._action

    def _answer(self, seen: Seen) -> Action:
        widths = dict.fromkeys(MOVES, 3) | {MOVES[2]: self._joints, STOP: 1}
        found = self._file.answers(self._observed(seen), widths)
        self._state = {name: found[NEXT + name] for name in self._states}
        if STOP in found and not float(found[STOP].reshape(-1)[0]) <= 0.5:
            return Stop()
        moves = {name: np.asarray(found[name], np.float64) for name in MOVES if name in found}
        return Move(**{name: value[0] for name, value in moves.items()})

    def _observed(self, seen: Seen) -> Arrays:
        """Return what the inputs hold, of the row that ``seen`` is made of."""
        own = seen.__dict__
        arrays = columns_of(own["_row"][None], seen.period_s, own["_makers"])
        if IMAGE in self.sees:
            arrays[IMAGE] = seen.image.pixels[None]
        return arrays | self._state


def _known() -> Iterator[tuple[str, tuple[str, NamedQuantity]]]:
    """Yield what can be seen, by name: its word, and its axes, of which hands and joints leave some open."""
    yield IMAGE, (IMAGE, NamedQuantity((ANY, ANY, 3), TYPES))
    for word in (sight.word for sight in SIGHTS if sight.word != IMAGE):
        few, more = (observed(np.zeros(1, seen_dtype(n, n)), (word,)) for n in (1, 2))
        for name in few:
            pairs = zip(few[name].shape[1:], more[name].shape[1:], strict=True)
            yield name, (word, NamedQuantity(tuple(a if a == b else ANY for a, b in pairs), TYPES))


_KNOWN = dict(_known())


def _zeros(path: Path, one: Any) -> NDArray[Any]:
    """A state at first; ModelError for one that does not say all its sizes."""
    if not all(isinstance(size, int) and size > 0 for size in one.shape):
        refuse(path, one.name, "a state of a fixed shape", str(one.shape))
    return np.zeros(one.shape, dtype_of(one))


def _ticks(path: Path, text: str) -> int:
    if not text.isdecimal() or not 0 < int(text) <= MOST_TICKS:
        refuse(path, TICKS, f"a number of ticks from 1 to {MOST_TICKS}", repr(text[:80]))
    return int(text)
