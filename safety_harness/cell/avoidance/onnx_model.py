"""Run the avoider in an ONNX file.

The command ``export`` or any author can make such a file according to the contract below. Inputs and outputs
have the following names, or other names that a layout explains (``onnx_names``).

Inputs
    hand_position_in_base_m, tcp_position_in_base_m: (1, 3) or (n, 3), float16, float32 or float64, metres.
    seed, if the file has this input: (1,) or (n,), int64 or uint64. Both types contain the same 64 bits.
Outputs
    position_in_base_m: (1, 3), metres in the robot's base frame.
    spread_m, optional: (1, 3), one standard deviation per axis, metres.
Metadata
    spread_threshold_m, optional: the largest spread of a usable proposal, as text.
    decision_time_s, optional: the cost of a decision in simulated time, as text.

If ``export`` makes a file of a network with dropout, the file also has an input ``masks``. The metadata state
how to draw the masks from the seed. The harness loads the whole file from memory. The harness executes only
ONNX's own operators, and does not open a second file. These operators include loops and can make tensors of
any size. So the harness runs a user's file in a separate process (``isolation.isolated``). This module runs
in the process of its caller.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import ModelError, Place, described, on_one_line
from safety_harness.cell.avoidance.avoider import Proposal, Vector
from safety_harness.cell.avoidance.masks import masks
from safety_harness.cell.avoidance.model_file import (
    CARD_TIME,
    KEY,
    PLACES,
    WIDTH,
    Dropout,
    NetworkUse,
    network_use,
    refuse,
)
from safety_harness.cell.avoidance.onnx_file import OnnxFile
from safety_harness.cell.avoidance.onnx_names import (
    FLOATS,
    HAND,
    MASKS,
    POSITION,
    SEED,
    SPREAD,
    TCP,
    NamedQuantity,
)
from safety_harness.scenario.decision_times import LONGEST_S
from safety_harness.scenario.typed_json import of_format, parsed

EXPORT_FORMAT = "safety-harness export 1"
THRESHOLD = "spread_threshold_m"
GIVEN = {POSITION: NamedQuantity((3,), FLOATS), SPREAD: NamedQuantity((3,), FLOATS)}


@dataclass(frozen=True, eq=False)
class OnnxAvoider:
    """An avoider in an ONNX file.

    The file runs on one thread of the CPU in a fixed order of operations.
    """

    name: str
    spread_threshold_m: float | None
    decision_time_s: float
    _file: OnnxFile
    _exported: NetworkUse | None

    @classmethod
    def load(cls, path: Path, data: bytes, *, hand: Vector, tcp: Vector, layout: str = "") -> OnnxAvoider:
        """Load, check and try an ONNX file.

        ``path`` is the file, and ``data`` its contents. Raise ``ModelError`` if the file is faulty. If an
        input or output does not have a name of the harness, ``layout`` states its quantities
        (``onnx_names``). The method asks the same question twice, with the positions ``hand`` and ``tcp``
        (3,) [m]. Both answers must have the right shape and the same bits.
        """
        try:
            file = OnnxFile(path, data, layout)
            own = file.metadata
            use = _exported(path, own[KEY]) if KEY in own else None
            threshold_m = _number(path, own, THRESHOLD) if use is None else use.spread_threshold_m
            plain_s = _number(path, own, CARD_TIME, most=LONGEST_S) or 0.0
            time_s = plain_s if use is None else use.decision_time_s
            name = on_one_line(f"{path.name}:{layout}" if layout else f"ONNX model {path.name}")
            takes = _inputs_of(use)
            required = {*takes} - {SEED} | {POSITION}
            if use is not None or threshold_m is not None:
                required |= {SPREAD}  # without a spread, the threshold would never refuse a proposal
            file.lay_out(takes, GIVEN, required)
            avoider = cls(name, threshold_m, time_s, file, use)
            avoider._try(path, hand, tcp)
        except UnicodeDecodeError as error:  # of a damaged name
            raise ModelError(place=Place(file=path), expected="names in UTF-8", got=error.reason) from error
        return avoider

    @property
    def exported(self) -> bool:
        """Whether the file is a network that this package exported."""
        return self._exported is not None

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """Return the file's proposal.

        The spread is 0 if the file has no output for the spread. ``seed`` is any integer from 0 to 2^64 - 1.
        """
        answers = self._answers(hand_position_in_base_m, tcp_position_in_base_m, seed)
        return Proposal(*(answers[name][0] for name in GIVEN if name in answers))

    def _answers(self, hand: Vector, tcp: Vector, seed: int) -> dict[str, NDArray[Any]]:
        """Return the outputs of the file."""
        seeds = np.array([seed], dtype=np.uint64)
        arrays: dict[str, NDArray[Any]] = {
            HAND: np.asarray(hand)[None],
            TCP: np.asarray(tcp)[None],
            SEED: seeds,
        }
        if self._exported is not None and self._exported.dropout is not Dropout.NONE:
            arrays[MASKS] = drawn_masks(self._exported, seeds)
        return self._file.answers(arrays, dict.fromkeys(GIVEN, 3))

    def _try(self, path: Path, hand: Vector, tcp: Vector) -> None:
        """Ask the same question twice.

        Raise ``ModelError`` if the file fails or its two answers differ.
        """
        try:
            first, second = (self._answers(hand, tcp, seed=1) for _ in range(2))
        except Exception as error:  # onnxruntime's own errors have no other common base
            refuse(path, None, "a model that answers for one hand and one TCP", described(error))
        for name, value in first.items():
            repeated = second[name]
            if value.shape != (1, 3):
                refuse(path, name, "a shape of (1, 3) for one hand and one TCP", str(value.shape))
            if not np.array_equal(value, repeated, equal_nan=True):
                refuse(
                    path,
                    name,
                    "the same answer to the same question",
                    f"{value[0].tolist()}, then {repeated[0].tolist()}",
                    hint=f"random numbers must come from the input {SEED!r}",
                )
        if SPREAD in first and self.spread_threshold_m is None:  # the user should know this
            sys.stderr.write(f"{SPREAD} without {THRESHOLD} in the metadata: no proposal can be doubted\n")


def _exported(path: Path, text: str) -> NetworkUse:
    """Return the ``NetworkUse`` in the JSON metadata of an exported file.

    Raise ``ModelError`` if a field is wrong.
    """
    document = of_format(parsed(text, path, "metadata", ModelError), EXPORT_FORMAT, path, ModelError)
    return network_use(document, NetworkUse, path, unknown_fields=True)


def mask_shape(use: NetworkUse) -> tuple[int, int, int]:
    """Return the numbers of passes, places and units of a network's masks."""
    return use.passes, PLACES[use.dropout], WIDTH


def drawn_masks(use: NetworkUse, seeds: NDArray[np.uint64]) -> NDArray[np.bool_]:
    """Return the masks that ``LearnedAvoider`` uses for ``seeds`` (n,).

    The masks have the shape (n, passes, places, units).
    """
    return np.array([masks(seed, *mask_shape(use), use.dropout_probability) for seed in seeds])


def _inputs_of(exported: NetworkUse | None) -> dict[str, NamedQuantity]:
    """Return the quantities that the inputs may contain.

    An exported network with dropout also has masks.
    """
    masked = exported is not None and exported.dropout is not Dropout.NONE
    masks = {MASKS: NamedQuantity(mask_shape(exported), ("bool",))} if exported and masked else {}
    return {
        HAND: NamedQuantity((3,), FLOATS),
        TCP: NamedQuantity((3,), FLOATS),
        **masks,
        SEED: NamedQuantity((), ("int64", "uint64")),
    }


def _number(path: Path, metadata: Mapping[str, str], key: str, most: float = inf) -> float | None:
    """Return a number in a file's metadata, or None if it is absent.

    The number is a spread threshold [m] or a decision time [s].
    """
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
