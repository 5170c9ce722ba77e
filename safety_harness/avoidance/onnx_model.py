"""An avoider in an ONNX file: one that ``export`` wrote, or anybody's that keeps the contract below.

Inputs
    hand_position_in_base_m, tcp_position_in_base_m: (1, 3) or (n, 3), float32 or float64, metres.
    seed, if the file wants one: (1,) or (n,), int64 or uint64; the same 64 bits either way.
Outputs
    position_in_base_m: (1, 3), metres in the robot's base frame.
    spread_m, if the file knows one: (1, 3), one standard deviation by axis, metres.
Metadata
    spread_threshold_m, if there is to be one: the largest spread with which a proposal is used, as text.
    decision_time_s, if there is to be one: what a decision costs in simulated time, as text.

A file of ``export`` with dropout has an input ``masks`` as well, and says in its metadata how to draw
them from the seed.  Files are loaded whole, from memory: nothing is executed but ONNX's own operators,
and no other file is opened.  Those operators have loops and make tensors of any size: a stranger's file is
loaded and asked in a process of its own (``isolation.isolated``); what is here runs where it is called.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.avoidance.avoider import Proposal, Vector
from safety_harness.avoidance.masks import masks
from safety_harness.avoidance.model_file import (
    CARD_TIME,
    KEY,
    PLACES,
    WIDTH,
    Dropout,
    NetworkUse,
    network_use,
    refuse,
)
from safety_harness.avoidance.onnx_graph import refuse_chance, refuse_dependence
from safety_harness.exceptions import ModelError, Place, described, on_one_line
from safety_harness.scenario.decision_times import LONGEST_S
from safety_harness.scenario.typed_json import of_format, parsed

EXPORT_FORMAT = "safety-harness export 1"
HAND, TCP, SEED, MASKS = "hand_position_in_base_m", "tcp_position_in_base_m", "seed", "masks"
POSITION, SPREAD, THRESHOLD = "position_in_base_m", "spread_m", "spread_threshold_m"
FLOATS = {"tensor(float)": "float32", "tensor(double)": "float64"}
INTEGERS = {"tensor(int64)": "int64", "tensor(uint64)": "uint64"}
BOOLEANS = {"tensor(bool)": "bool"}


@dataclass(frozen=True, eq=False)
class OnnxAvoider:
    """The function of an ONNX file, on one thread of the CPU, in one order of operations."""

    name: str
    spread_threshold_m: float | None
    decision_time_s: float
    _session: Any
    _dtypes: Mapping[str, str]  # of the inputs
    _outputs: tuple[str, ...]
    _exported: NetworkUse | None

    @classmethod
    def of(cls, path: Path, data: bytes, *, hand: Vector, tcp: Vector) -> OnnxAvoider:
        """Load, check and try the file ``path`` with the contents ``data``; ModelError says what is wrong.

        It is asked the same question twice, about ``hand`` and ``tcp`` (3,) [m]: what cannot answer,
        answers in another shape, or not twice the same, is refused.
        """
        try:
            session = open_session(path, data)
            own = dict(session.get_modelmeta().custom_metadata_map)
            use = _exported(path, own[KEY]) if KEY in own else None
            threshold_m = _number(path, own, THRESHOLD) if use is None else use.spread_threshold_m
            outputs = _outputs(path, session, spread_wanted=use is not None or threshold_m is not None)
            plain_s = _number(path, own, CARD_TIME, most=LONGEST_S) or 0.0
            time_s = plain_s if use is None else use.decision_time_s
            name = on_one_line(f"ONNX model {path.name}")
            avoider = cls(name, threshold_m, time_s, session, _inputs(path, session, use), outputs, use)
            avoider._try(path, hand, tcp)
        except UnicodeDecodeError as error:  # of a damaged name
            raise ModelError(place=Place(file=path), expected="names in UTF-8", got=error.reason) from error
        return avoider

    @property
    def exported(self) -> bool:
        """Is it a network of this package, exported?"""
        return self._exported is not None

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """One decision; ``seed`` is any integer from 0 to 2^64 - 1.  No spread: the file knows none."""
        answers = self._answers(hand_position_in_base_m, tcp_position_in_base_m, seed)
        return Proposal(*(answer[0] for answer in answers))

    def _answers(self, hand: Vector, tcp: Vector, seed: int) -> list[NDArray[Any]]:
        """The outputs as the file gives them."""
        feed: dict[str, NDArray[Any]] = {
            HAND: np.asarray(hand)[None].astype(self._dtypes[HAND]),
            TCP: np.asarray(tcp)[None].astype(self._dtypes[TCP]),
        }
        if SEED in self._dtypes:
            feed[SEED] = np.array([seed], dtype=np.uint64).view(self._dtypes[SEED])
        if self._exported is not None and MASKS in self._dtypes:
            feed[MASKS] = drawn_masks(self._exported, np.array([seed], dtype=np.uint64))
        answers: list[NDArray[Any]] = self._session.run(self._outputs, feed)
        return answers

    def _try(self, path: Path, hand: Vector, tcp: Vector) -> None:
        """The same question twice."""
        try:
            first, second = (self._answers(hand, tcp, seed=1) for _ in range(2))
        except Exception as error:  # onnxruntime's own have no common base but Exception
            refuse(path, None, "a model that answers for one hand and one TCP", _words(error))
        for name, one, other in zip(self._outputs, first, second, strict=True):
            if one.shape != (1, 3):
                refuse(path, name, "a shape of (1, 3) for one hand and one TCP", str(one.shape))
            if not np.array_equal(one, other, equal_nan=True):
                refuse(
                    path,
                    name,
                    "the same answer to the same question",
                    f"{one[0].tolist()}, then {other[0].tolist()}",
                    hint=f"random numbers must come from the input {SEED!r}",
                )


def _exported(path: Path, text: str) -> NetworkUse:
    """What the JSON in a file of ``export`` says of its use; ModelError for the first field that is wrong."""
    found = of_format(parsed(text, path, "metadata", ModelError), EXPORT_FORMAT, path, ModelError)
    return network_use(found, NetworkUse, path, others=True)


def mask_shape(use: NetworkUse) -> tuple[int, int, int]:
    """Passes, places, units."""
    return use.passes, PLACES[use.dropout], WIDTH


def drawn_masks(use: NetworkUse, seeds: NDArray[np.uint64]) -> NDArray[np.bool_]:
    """(n, passes, places, units) of what ``LearnedAvoider`` keeps for these seeds (n,)."""
    return np.array([masks(seed, *mask_shape(use), use.dropout_probability) for seed in seeds])


def open_session(path: Path, data: bytes) -> Any:
    """Return the file in onnxruntime: one thread, in order, no file beside it.

    Raise ModelError if the runtime cannot load it, if it draws random numbers, or if its answer depends on
    the runtime's optimisation.
    """
    session = _session(path, data, optimised=True)
    refuse_chance(path, data)
    refuse_dependence(path, session, _session(path, data, optimised=False))
    return session


def _session(path: Path, data: bytes, *, optimised: bool) -> Any:
    import onnxruntime  # an extra: who asks for one has looked

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.use_deterministic_compute = True
    if not optimised:
        options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    options.log_severity_level = 4  # what is wrong comes as an exception
    options.add_session_config_entry("session.load_model_format", "ONNX")
    # External data are sought in a folder, which this file is not: there are none.
    options.add_session_config_entry("session.model_external_initializers_file_folder_path", str(path))
    try:
        return onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's own have no common base but Exception
        hint = "store the tensors in the file itself" if "xternal data" in str(error) else ""
        refuse(path, None, "an ONNX file that onnxruntime can load", _words(error), hint)


def _inputs(path: Path, session: Any, exported: NetworkUse | None) -> dict[str, str]:
    """The numpy dtype of each input; ModelError for one that is missing, unknown or of another shape."""
    known: dict[str, tuple[tuple[int, ...], dict[str, str]]] = {HAND: ((3,), FLOATS), TCP: ((3,), FLOATS)}
    if exported is not None and exported.dropout is not Dropout.NONE:
        known[MASKS] = (mask_shape(exported), BOOLEANS)
    known[SEED] = ((), INTEGERS)
    there = {one.name: one for one in session.get_inputs()}
    for name in known:
        if name != SEED and name not in there:
            refuse(path, name, "an input of this name", f"the inputs {', '.join(there) or 'none'}")
    for name, one in there.items():
        if name not in known:
            refuse(path, name, f"no inputs but {', '.join(known)}", "this one too")
        (rest, types) = known[name]
        if one.type not in types:
            refuse(path, name, " or ".join(types.values()), one.type)
        if not _fits(one.shape, rest):
            refuse(path, name, f"a shape of {['1 or n', *rest]}", str(one.shape))
    return {name: known[name][1][one.type] for name, one in there.items()}


def _outputs(path: Path, session: Any, *, spread_wanted: bool) -> tuple[str, ...]:
    """The position, and the spread if there is one; without it no threshold would ever be met."""
    there = {one.name: one for one in session.get_outputs()}
    wanted = (POSITION, SPREAD) if spread_wanted or SPREAD in there else (POSITION,)
    for name in wanted:
        if name not in there:
            refuse(path, name, "an output of this name", f"the outputs {', '.join(there)}")
        if there[name].type not in FLOATS:
            refuse(path, name, " or ".join(FLOATS.values()), there[name].type)
    return wanted


def _fits(shape: list[int | str | None], rest: tuple[int, ...]) -> bool:
    """One row or any number of them, then exactly ``rest``."""
    if len(shape) != 1 + len(rest) or shape[1:] != [*rest]:
        return False
    return shape[0] in (1, None) or isinstance(shape[0], str)


def _number(path: Path, metadata: Mapping[str, str], key: str, most: float = inf) -> float | None:
    """The plain spread threshold [m] of anybody's file, or its decision time [s]."""
    text = metadata.get(key)
    if text is None:
        return None
    try:
        number = float(text)
    except ValueError:
        number = float("nan")
    if not (isfinite(number) and 0.0 <= number <= most):
        kind = "a length in metres, at least 0" if key == THRESHOLD else f"a time from 0 s to {most:g} s"
        refuse(path, key, kind, repr(text[:80]))
    return number


def _words(error: Exception) -> str:
    words = described(error)
    return words if len(words) <= 300 else words[:297] + "..."
