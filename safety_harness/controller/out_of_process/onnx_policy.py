"""A policy in an ONNX file as a controller; it runs in a process of its own.

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

from copy import copy
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.avoidance.model_file import refuse
from safety_harness.avoidance.onnx_model import open_session
from safety_harness.controller.arrays import Arrays, observed
from safety_harness.controller.contract import IMAGE, SIGHTS, Action, DrivenArm, Move, Seen, Start, Stop
from safety_harness.controller.rows import SeenLayout, seen_dtype
from safety_harness.exceptions import on_one_line
from safety_harness.settings import Settings

MOVES = ("tcp_velocity_mps", "tcp_angular_velocity_radps", "joint_velocity_radps")
STOP, NEXT, NAME, TICKS = "stop", "next_", "name", "ticks"
MOST_TICKS = 1000
TYPES = {
    "tensor(float)": np.float32,
    "tensor(double)": np.float64,
    "tensor(int8)": np.int8,
    "tensor(int64)": np.int64,
    "tensor(uint8)": np.uint8,
    "tensor(bool)": np.bool_,
}


class OnnxPolicy:
    """The function of an ONNX file, on one thread of the CPU, in one order of operations."""

    reports = ()

    def __init__(self, path: Path, data: bytes) -> None:
        """Load and check it; ModelError for what is no policy."""
        self._session = open_session(path, data)
        own = dict(self._session.get_modelmeta().custom_metadata_map)
        self.name = on_one_line(own.get(NAME, f"ONNX policy {path.name}"))
        self._hold = _ticks(path, own.get(TICKS, "1"))
        taken = {one.name: one for one in self._session.get_inputs()}
        given = {one.name: one for one in self._session.get_outputs()}
        for name, one in (*taken.items(), *given.items()):
            if one.type not in TYPES:
                refuse(path, name, f"a type of: {', '.join(TYPES)}", one.type)
        self._types = {name: TYPES[one.type] for name, one in taken.items()}
        self._states = {name: _fixed(path, one) for name, one in taken.items() if NEXT + name in given}
        self.sees = _sees(path, [name for name in taken if name not in self._states])
        self._arrays = tuple(word for word in self.sees if word != IMAGE)
        self._outputs = [
            name for name in given if name in (*MOVES, STOP) or name[len(NEXT) :] in self._states
        ]
        if not any(name in MOVES for name in given):
            refuse(path, None, f"an output of: {', '.join(MOVES)}", f"the outputs {', '.join(given)}")
        self._state: dict[str, NDArray[Any]] = {}
        self._joints, self._left = 0, 0
        self._action: Action = Stop()

    def reset(self, *, settings: Settings, arm: DrivenArm, start: Start, seed: int) -> None:
        """Begin with a state of zeros."""
        self._joints, self._left = len(arm.joint_names), 0
        self._state = {name: np.zeros(shape, self._types[name]) for name, shape in self._states.items()}

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
        feed = self._fed(seen)
        found = dict(zip(self._outputs, self._session.run(self._outputs, feed), strict=True))
        self._state = {name: found[NEXT + name] for name in self._states}
        if STOP in found and not float(found[STOP].reshape(-1)[0]) <= 0.5:
            return Stop()
        moves = {name: np.asarray(found[name], np.float64) for name in MOVES if name in found}
        return Move(**{name: value[0] for name, value in moves.items()})

    def _fed(self, seen: Seen) -> dict[str, NDArray[Any]]:
        """The inputs, of the row that ``seen`` is made of."""
        own = seen.__dict__
        layout, row = own["_makers"], own["_row"]
        arrays: Arrays = observed(_whole(row, layout, self._joints), self._arrays)
        if IMAGE in self.sees:
            arrays[IMAGE] = seen.image.pixels[None]
        arrays |= self._state
        return {name: arrays[name].astype(kind, copy=False) for name, kind in self._types.items()}


def _whole(row: NDArray[np.float64], layout: SeenLayout, joints: int) -> NDArray[np.void]:
    """(1,) SEEN of a row that ends with what is wanted of it."""
    dtype = seen_dtype(layout.hand_slots, joints)
    numbers = np.zeros(dtype.itemsize // 8)
    numbers[: len(row)] = row
    return numbers.view(dtype)


def _sees(path: Path, inputs: list[str]) -> tuple[str, ...]:
    """The words whose arrays are taken; ModelError for an input that is none of them."""
    known = {IMAGE: IMAGE}
    for sight in SIGHTS:
        if sight.word != IMAGE:
            arrays = observed(np.zeros(1, seen_dtype(1)), (sight.word,))
            known |= dict.fromkeys(arrays, sight.word)
    for name in inputs:
        if name not in known:
            got = f"{name}, and no output {NEXT}{name}"
            refuse(path, name, f"no inputs but {', '.join(known)}, and states", got)
    found = {known[name] for name in inputs}
    return tuple(sight.word for sight in SIGHTS if sight.word in found)


def _fixed(path: Path, one: Any) -> tuple[int, ...]:
    """The shape of a state, which has to say all its sizes."""
    if not all(isinstance(size, int) and size > 0 for size in one.shape):
        refuse(path, one.name, "a state of a fixed shape", str(one.shape))
    return tuple(one.shape)


def _ticks(path: Path, text: str) -> int:
    if not text.isdecimal() or not 0 < int(text) <= MOST_TICKS:
        refuse(path, TICKS, f"a number of ticks from 1 to {MOST_TICKS}", repr(text[:80]))
    return int(text)
