"""Read perceptrons and residual networks from ONNX files as ReLU layers, and refuse other operators.

In a run, onnxruntime computes the answers, in float32 or better.  A proof assumes that each operation rounds
at least as accurately as float32.  It remains valid if the runtime changes the order of sums, fuses
operations or combines weights.  The module ignores nodes that do not affect the answer, such as those for a
spread.
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
    """The function in an ONNX file.

    It runs in onnxruntime in a separate process, which evaluates one input at a time.
    """

    avoider: IsolatedAvoider
    model = None  # so that there is no threshold of the spread

    def propose_many(
        self, hands_in_base_m: Floats, tcps_in_base_m: Floats, seeds: NDArray[np.uint64]
    ) -> tuple[Floats, Floats]:
        """Return positions and spreads, shape (n, 3) each [m].

        The position of a missing answer is NaN, and all spreads are zero.

        ``hands_in_base_m`` and ``tcps_in_base_m`` have the shape (n, 3), and ``seeds`` has the shape (n,).
        """
        posed = [
            Question(hand, tcp, int(seed))
            for hand, tcp, seed in zip(hands_in_base_m, tcps_in_base_m, seeds, strict=True)
        ]
        answers = [reply.proposal.position_in_base_m for reply in self.avoider.answers(posed, together=False)]
        positions = np.array(answers, np.float64).reshape(-1, OUTPUTS)
        return positions, np.zeros_like(positions)


def read_onnx(path: Path) -> tuple[ReluNetwork, OnnxFunction]:
    """Return the layers and the function of a file.

    Raise ModelError for an unsupported operator; the error includes its node.
    """
    with ONNX.needed("proofs about ONNX files", path):
        network = packed(_layers(path, onnx_bytes(path)))
    return network, OnnxFunction(isolated_onnx(path, DEFAULTS))


def _layers(path: Path, data: bytes) -> list[AffineForm]:
    """Return the layers of a file; the last layer is the answer."""
    import onnx

    try:
        model = onnx.load_from_string(data)
    except Exception as error:  # an exception of protobuf
        refuse(path, None, "an ONNX file", type(error).__name__)
    versions = [part.version for part in model.opset_import if part.domain in ("", "ai.onnx")]
    if not versions or versions[0] < OLDEST:
        refuse(path, "opset_import", f"operators of version {OLDEST} or newer", str(versions))
    constants: dict[str, Floats] = {}
    for part in model.graph.initializer:
        if part.external_data:
            refuse(path, part.name, "tensors in the file itself", "external data")
        constants[part.name] = onnx.numpy_helper.to_array(part).astype(np.float64)
    layers = Layers()
    whole = question(SINGLE)
    forms: dict[str, AffineForm] = {
        name: AffineForm({QUESTION: whole.value[QUESTION][:, p]}, {QUESTION: whole.error[QUESTION][:, p]})
        for name, p in ((HAND, slice(0, 3)), (TCP, slice(3, PERCEPTRON_INPUTS)))
    }
    # From the answer back to the inputs: a file may also compute outputs that nobody asks for.
    wanted, nodes = {POSITION}, []
    for node in reversed(model.graph.node):
        if wanted & set(node.output):
            nodes.append(node)
            wanted.update(node.input)
    for node in reversed(nodes):
        more = {part.name: onnx.helper.get_attribute_value(part) for part in node.attribute}
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
        if sum(form.width for form in layers.forms) > MOST_UNITS:
            refuse(path, place, f"at most {MOST_UNITS} ReLU units", "more")
    if POSITION not in forms or forms[POSITION].width != OUTPUTS:
        refuse(path, POSITION, "an output of three coordinates that follows from hand and TCP", "none")
    return [*layers.forms, forms[POSITION]]


def _computed(operator: str, given: list[Any], more: Mapping[str, Any], layers: Layers) -> AffineForm:
    """Return an operator's output for the operands ``given``, which are forms or constants.

    Raise ValueError if the operator or its operands are unsupported.
    """
    shown = [isinstance(operand, AffineForm) for operand in given]
    if not any(shown[:2]) or any(operand is None for operand in given):
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
        # A sign changes no digit, so the factor has no rounding error.
        return first.plus(rest[0].scaled(np.full(first.width, sign), 0.0), SINGLE)
    if (operator in ("Add", "Sub", "Mul") and sum(shown) == 1) or (operator == "Div" and alone):
        constant = _row(rest[0], first.width)
        # The reciprocal is rounded in float64; GUARD covers that error.
        if operator in ("Mul", "Div"):
            return first.scaled(constant if operator == "Mul" else 1.0 / constant, SINGLE)
        turned = -1.0 if operator == "Sub" and not shown[0] else 1.0
        shift = -constant if operator == "Sub" and shown[0] else constant
        return first.linear(turned * np.eye(first.width), shift, SINGLE)
    if operator == "BatchNormalization" and alone and not more.get("training_mode", 0):
        gain, shift, mean, variance = (_row(operand, first.width) for operand in rest)
        centred = first.linear(np.eye(first.width), -mean, SINGLE)
        scale = gain / np.sqrt(variance + more.get("epsilon", 1e-5))
        return centred.linear(np.diag(scale), shift, SINGLE)
    raise ValueError(f"{OPERATORS}, of hand and TCP and of constants, row by row")


def _row(constant: Any, width: int) -> Floats:
    """Return ``constant`` as an array of shape (width,), and raise ValueError if its shape does not fit."""
    row: Floats = np.broadcast_to(np.asarray(constant, np.float64), (1, width))[0]
    return row
