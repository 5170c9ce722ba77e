"""An ONNX file as layers of ReLUs: perceptrons and residual networks; other operators are refused by name.

The program is onnxruntime's, in float32 or better: each operation is taken to round as float32 does, whatever
the order of its sums, and whatever of them the runtime fuses or folds beforehand.  What the answer does not
depend on (a spread, say) is not looked at.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.extras import ONNX
from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.asking import Question
from safety_harness.cell.avoidance.isolation.isolated import IsolatedAvoider, isolated_onnx
from safety_harness.cell.avoidance.model_file import OUTPUTS, PERCEPTRON_INPUTS, onnx_bytes, refuse
from safety_harness.cell.avoidance.onnx_names import HAND, POSITION, TCP
from safety_harness.extensions.lab.proof.network import (
    QUESTION,
    SINGLE,
    AffineForm,
    Layers,
    ReluNetwork,
    joined,
    packed,
    question,
)

Floats = NDArray[np.float64]

OPERATORS = (
    "Add, BatchNormalization, Cast, Concat, Constant, Div, Flatten, Gemm, Identity, MatMul, Mul, Relu, Sub"
)
MOST_UNITS, OLDEST = 2_000, 9
FLOAT_TYPES = (1, 11)  # TensorProto's float and double


@dataclass(frozen=True, eq=False)
class OnnxFunction:
    """What onnxruntime answers, in a process of its own, one question at a time as in a run."""

    avoider: IsolatedAvoider
    model = None  # and so no threshold of a spread

    def propose_many(
        self, hands_in_base_m: Floats, tcps_in_base_m: Floats, seeds: NDArray[np.uint64]
    ) -> tuple[Floats, Floats]:
        """Positions and spreads (n, 3) [m], NaN for no answer.

        For ``hands_in_base_m`` (n, 3), ``tcps_in_base_m`` (n, 3) and seeds (n,).
        """
        asked = [
            Question(hand, tcp, int(seed))
            for hand, tcp, seed in zip(hands_in_base_m, tcps_in_base_m, seeds, strict=True)
        ]
        answers = [one.proposal.position_in_base_m for one in self.avoider.answers(asked, together=False)]
        positions = np.array(answers, np.float64).reshape(-1, OUTPUTS)
        return positions, np.zeros_like(positions)


def read_onnx(path: Path) -> tuple[ReluNetwork, OnnxFunction]:
    """The layers of a file, and what answers; ModelError for another operator, with its name and node."""
    with ONNX.needed("proofs about ONNX files", path):
        network = packed(_layers(path, onnx_bytes(path)))
    return network, OnnxFunction(isolated_onnx(path, DEFAULTS))


def _layers(path: Path, data: bytes) -> list[AffineForm]:
    import onnx

    try:
        model = onnx.load_from_string(data)
    except Exception as error:  # protobuf's own
        refuse(path, None, "an ONNX file", type(error).__name__)
    versions = [one.version for one in model.opset_import if one.domain in ("", "ai.onnx")]
    if not versions or versions[0] < OLDEST:
        refuse(path, "opset_import", f"operators of version {OLDEST} or newer", str(versions))
    constants: dict[str, Floats] = {}
    for one in model.graph.initializer:
        if one.external_data:
            refuse(path, one.name, "tensors in the file itself", "external data")
        constants[one.name] = onnx.numpy_helper.to_array(one).astype(np.float64)
    layers = Layers()
    whole = question(SINGLE)
    forms: dict[str, AffineForm] = {
        name: AffineForm({QUESTION: whole.value[QUESTION][:, p]}, {QUESTION: whole.error[QUESTION][:, p]})
        for name, p in ((HAND, slice(0, 3)), (TCP, slice(3, PERCEPTRON_INPUTS)))
    }
    wanted, nodes = {POSITION}, []
    for node in reversed(model.graph.node):
        if wanted & set(node.output):
            nodes.append(node)
            wanted.update(node.input)
    for node in reversed(nodes):
        more = {one.name: onnx.helper.get_attribute_value(one) for one in node.attribute}
        place = f"{node.op_type} {node.name or node.output[0]!r}"
        if node.op_type == "Constant" and "value" in more:
            constants[node.output[0]] = onnx.numpy_helper.to_array(more["value"]).astype(np.float64)
            continue
        try:
            if node.domain not in ("", "ai.onnx"):
                raise ValueError(OPERATORS)
            given = [forms.get(name, constants.get(name)) for name in node.input if name]
            forms[node.output[0]] = _computed(node.op_type, given, more, layers)
        except ValueError as error:
            refuse(path, place, str(error), f"the operator {node.op_type}")
        if sum(form.width for form in layers.found) > MOST_UNITS:
            refuse(path, place, f"at most {MOST_UNITS} ReLU units", "more")
    if POSITION not in forms or forms[POSITION].width != OUTPUTS:
        refuse(path, POSITION, "an output of three coordinates that follows from hand and TCP", "none")
    return [*layers.found, forms[POSITION]]


def _computed(operator: str, given: list[Any], more: Mapping[str, Any], layers: Layers) -> AffineForm:
    """What an operator makes of ``given``, forms and constants; ValueError says what was expected."""
    shown = [isinstance(one, AffineForm) for one in given]
    if not any(shown[:2]) or any(one is None for one in given):
        raise ValueError("operands that follow from hand and TCP, and constants of the file")
    first: AffineForm = given[0] if shown[0] else given[1]
    rest = given[1:] if shown[0] else given[:1]
    alone = shown[0] and not any(shown[1:])
    if operator == "Relu" and len(given) == 1:
        return layers.relu(lambda: first)
    if operator == "Concat" and all(shown) and more.get("axis") in (1, -1):
        return joined(given)
    if operator in ("Identity", "Flatten") and more.get("axis", 1) in (1, -1):
        return first
    if operator == "Cast" and more.get("to") in FLOAT_TYPES:
        return first.scaled(np.ones(first.width), SINGLE)
    if operator in ("MatMul", "Gemm") and alone:
        fits = more.get("alpha", 1.0) == more.get("beta", 1.0) == 1.0 and not more.get("transA", 0)
        weight = rest[0].T if more.get("transB", 0) else rest[0]
        if not fits or weight.ndim != 2 or len(weight) != first.width:
            raise ValueError(f"x W + b with W of {first.width} rows, alpha and beta 1")
        return first.linear(weight, _row(rest[1] if rest[1:] else 0.0, weight.shape[1]), SINGLE)
    if operator in ("Add", "Sub") and all(shown):
        sign = 1.0 if operator == "Add" else -1.0
        if first.width != rest[0].width:
            raise ValueError("two of the same width")
        return first.plus(rest[0].scaled(np.full(first.width, sign), 0.0), SINGLE)
    if (operator in ("Add", "Sub", "Mul") and sum(shown) == 1) or (operator == "Div" and alone):
        constant = _row(rest[0], first.width)
        if operator in ("Mul", "Div"):
            return first.scaled(constant if operator == "Mul" else 1.0 / constant, SINGLE)
        turned = -1.0 if operator == "Sub" and not shown[0] else 1.0
        shift = -constant if operator == "Sub" and shown[0] else constant
        return first.linear(turned * np.eye(first.width), shift, SINGLE)
    if operator == "BatchNormalization" and alone and not more.get("training_mode", 0):
        gain, shift, mean, variance = (_row(one, first.width) for one in rest)
        centred = first.linear(np.eye(first.width), -mean, SINGLE)
        scale = gain / np.sqrt(variance + more.get("epsilon", 1e-5))
        return centred.linear(np.diag(scale), shift, SINGLE)
    raise ValueError(f"{OPERATORS}, of hand and TCP and of constants, row by row")


def _row(constant: Any, width: int) -> Floats:
    """(width,) what is added to, or multiplied with, each row; ValueError."""
    row: Floats = np.broadcast_to(np.asarray(constant, np.float64), (1, width))[0]
    return row
