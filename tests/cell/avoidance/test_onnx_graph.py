"""A graph that draws, or that answers by the optimisation, is refused: it would pass for certain."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto as T
from onnx import helper, numpy_helper
from test_onnx_model import INPUTS, MIDDLE, OUTPUTS, load, model

from safety_harness.base.exceptions import ModelError
from safety_harness.cell.avoidance.onnx_graph import refuse_chance
from safety_harness.cell.controller.out_of_process.onnx_policy import OnnxPolicy

CONSTANTS = {
    "ratio": np.float32(0.5),
    "yes": np.array(True),
    "no": np.array(False),
    "identity": np.eye(3),
    "gain": np.ones(3),
    "shift": np.zeros(3),
}


def with_constants(made: onnx.ModelProto, **more: np.ndarray) -> onnx.ModelProto:
    for name, value in (CONSTANTS | more).items():
        made.graph.initializer.append(numpy_helper.from_array(np.asarray(value), name))
    return made


def dropping(mode: str, opset: int = 18) -> onnx.ModelProto:
    """Dropout, then a product with the identity: where the runtime drops the dropout as it optimises."""
    taken = ["middle", "ratio", mode] if opset >= 12 else ["middle"]
    nodes = [
        helper.make_node("Sum", ["hand_position_in_base_m", "tcp_position_in_base_m"], ["sum"]),
        helper.make_node("Mul", ["sum", "half"], ["middle"]),
        helper.make_node("Dropout", taken, ["kept"]),
        helper.make_node("MatMul", ["kept", "identity"], ["position_in_base_m"]),
    ]
    made = with_constants(model(nodes))
    made.opset_import[0].version = opset
    return made


def computed_mode() -> onnx.ModelProto:
    made = dropping("mode")
    made.graph.node.insert(0, helper.make_node("Identity", ["no"], ["mode"]))
    return made


def mode_of_a_node(value: bool) -> onnx.ModelProto:
    made = dropping("mode")
    constant = numpy_helper.from_array(np.array(value), "any")
    made.graph.node.insert(0, helper.make_node("Constant", [], ["mode"], value=constant))
    return made


def in_a_branch(mode: str) -> onnx.ModelProto:
    """Dropout within an ``If``, its mode outside."""
    branches = {
        name: helper.make_graph(
            [helper.make_node("Dropout", ["tcp_position_in_base_m", "ratio", mode], [name])],
            name,
            [],
            [helper.make_tensor_value_info(name, T.DOUBLE, ["n", 3])],
        )
        for name in ("then_branch", "else_branch")
    }
    return with_constants(model([helper.make_node("If", ["yes"], ["position_in_base_m"], **branches)]))


def in_a_function(mode: str) -> onnx.ModelProto:
    """Dropout within a function of the file, its mode an argument."""
    function = helper.make_function(
        "own",
        "Layer",
        ["x", "p", "m"],
        ["y"],
        [helper.make_node("Dropout", ["x", "p", "m"], ["y"])],
        [helper.make_opsetid("", 18)],
    )
    call = helper.make_node(
        "Layer", ["tcp_position_in_base_m", "ratio", mode], ["position_in_base_m"], domain="own"
    )
    made = with_constants(model([call]))
    made.functions.append(function)
    made.opset_import.append(helper.make_opsetid("own", 1))
    return made


def normalising(**training: int) -> onnx.ModelProto:
    taken = ["tcp_position_in_base_m", "gain", "shift", "shift", "gain"]
    node = helper.make_node("BatchNormalization", taken, ["position_in_base_m"], **training)
    return with_constants(model([node]))


@pytest.mark.parametrize(
    ("made", "where"),
    [
        (dropping("yes"), "Dropout 'kept'"),
        (dropping("", opset=11), "Dropout 'kept'"),  # of this version nothing says whether it is active
        (computed_mode(), "Dropout 'kept'"),
        (mode_of_a_node(True), "Dropout 'kept'"),
        (in_a_branch("yes"), "Dropout '(then|else)_branch'"),
        (in_a_function("yes"), "Dropout 'position_in_base_m'"),
        (normalising(training_mode=1), "BatchNormalization 'position_in_base_m'"),
    ],
)
def test_an_operator_left_in_training_is_refused(made: onnx.ModelProto, where: str, tmp_path: Path) -> None:
    """Also where the runtime's optimisation makes its answers repeat."""
    with pytest.raises(ModelError, match=f"{where}: expected an operator in evaluation mode"):
        refuse_chance(tmp_path / "mine.onnx", made.SerializeToString())


def test_active_dropout_that_optimisation_hides_makes_no_avoider(tmp_path: Path) -> None:
    """The file answers twice the same with optimisation, and otherwise without."""
    with pytest.raises(ModelError, match="evaluation mode"):
        load(tmp_path, dropping("yes"))


@pytest.mark.parametrize(
    "made", [dropping("no"), dropping(""), mode_of_a_node(False), in_a_branch("no"), in_a_function("no")]
)
def test_dropout_that_is_off_decides(made: onnx.ModelProto, tmp_path: Path) -> None:
    load(tmp_path, made)


@pytest.mark.parametrize("operator", ["RandomNormalLike", "RandomUniformLike", "Bernoulli"])
def test_a_random_operator_is_refused_also_where_two_answers_hide_it(tmp_path: Path, operator: str) -> None:
    """Its draw is scaled to less than one unit in the last place, or hidden by a rare condition."""
    hidden = [
        *MIDDLE[:1],
        helper.make_node("Sigmoid", ["sum"], ["share"]),
        helper.make_node(operator, ["share"], ["draw"]),
        helper.make_node("Mul", ["draw", "tiny"], ["small"]),
        helper.make_node("Add", ["sum", "small"], ["position_in_base_m"]),
    ]
    with pytest.raises(ModelError, match=f"{operator} 'draw': .*'seed'"):
        load(tmp_path, with_constants(model(hidden), tiny=np.array(1e-300)))


def rounded_twice() -> onnx.ModelProto:
    """Two roundings to a step of 10 and 20 mm: the runtime leaves one of them out as it optimises."""
    nodes = [
        helper.make_node("Add", ["hand_position_in_base_m", "tcp_position_in_base_m"], ["sum"]),
        helper.make_node("QuantizeLinear", ["sum", "fine", "zero"], ["q1"]),
        helper.make_node("DequantizeLinear", ["q1", "fine", "zero"], ["d1"]),
        helper.make_node("QuantizeLinear", ["d1", "coarse", "zero"], ["q2"]),
        helper.make_node("DequantizeLinear", ["q2", "coarse", "zero"], ["position_in_base_m"]),
    ]
    single = {name: (T.FLOAT, shape) for name, (_, shape) in INPUTS.items()}
    made = model(nodes, single, {name: (T.FLOAT, shape) for name, (_, shape) in OUTPUTS.items()})
    scales = {"fine": np.float32(0.01), "coarse": np.float32(0.02)}
    return with_constants(made, **scales, zero=np.array(0, np.int8))


def test_an_answer_that_depends_on_optimisation_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="the same answer with and without the runtime's optimisation"):
        load(tmp_path, rounded_twice())


def test_a_policy_is_held_to_the_same(tmp_path: Path) -> None:
    """Dropout in a controller's file is refused as in an avoider's."""
    nodes = [
        helper.make_node("Dropout", ["tcp_position_in_base_m", "ratio", "yes"], ["kept"]),
        helper.make_node("MatMul", ["kept", "identity"], ["tcp_velocity_mps"]),
    ]
    made = with_constants(
        model(
            nodes,
            {"tcp_position_in_base_m": (T.DOUBLE, [1, 3])},
            {"tcp_velocity_mps": (T.DOUBLE, [1, 3])},
        )
    )
    with pytest.raises(ModelError, match="evaluation mode"):
        OnnxPolicy(tmp_path / "mine.onnx", made.SerializeToString())
