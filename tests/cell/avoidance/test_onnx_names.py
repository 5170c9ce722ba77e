"""Names that exporters choose: a layout says what they hold, and it is part of what is tested."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import pytest
from examples import scenario
from onnx import TensorProto as T
from onnx import helper, numpy_helper

from safety_harness.admission.admit import admit
from safety_harness.admission.avoiders import Avoiders, is_a_program, is_executed, with_avoider
from safety_harness.base.exceptions import ModelError
from safety_harness.cell.avoidance.onnx_model import OnnxAvoider
from safety_harness.cell.avoidance.onnx_names import layout_of
from safety_harness.cell.controller.out_of_process.onnx_policy import OnnxPolicy
from safety_harness.scenario.references import avoider_seen_from, file_and_name

HAND, TCP = np.array([0.8, -0.3, 0.1]), np.array([0.7, 0.0, 0.35])


def columns(
    inputs: dict[str, list[object]], outputs: dict[str, int], metadata: dict[str, str] | None = None
) -> bytes:
    """A file whose outputs are so many columns of its inputs side by side, from the first on."""
    nodes = [helper.make_node("Concat", [*inputs], ["all"], axis=1)]
    constants = [numpy_helper.from_array(np.array([n]), f"n{n}") for n in {0, 1, *outputs.values()}]
    for name, n in outputs.items():
        nodes.append(helper.make_node("Slice", ["all", "n0", f"n{n}", "n1"], [name]))
    graph = helper.make_graph(
        nodes,
        "columns",
        [helper.make_tensor_value_info(name, T.FLOAT, shape) for name, shape in inputs.items()],
        [helper.make_tensor_value_info(name, T.FLOAT, ["n", n]) for name, n in outputs.items()],
        constants,
    )
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
    helper.set_model_props(made, metadata or {})
    return bytes(made.SerializeToString())


def load(data: bytes, layout: str = "") -> OnnxAvoider:
    return OnnxAvoider.load(Path("mine.onnx"), data, hand=HAND, tcp=TCP, layout=layout)


def position(avoider: OnnxAvoider) -> list[float]:
    answer = avoider.propose(hand_position_in_base_m=HAND, tcp_position_in_base_m=TCP, seed=1)
    return [round(float(x), 6) for x in answer.position_in_base_m]


def refused(data: bytes, layout: str = "") -> ModelError:
    with pytest.raises(ModelError) as caught:
        load(data, layout)
    return caught.value


def test_a_layout_is_read_as_it_is_written() -> None:
    assert layout_of("X=hand,tcp,serving_default_Y:0=position") == {
        "X": ("hand_position_in_base_m", "tcp_position_in_base_m"),
        "serving_default_Y:0": ("position_in_base_m",),
    }
    assert layout_of("X=hand, tcp, Y=position") == layout_of("X=hand,tcp,Y=position")
    assert layout_of("") == {}


def test_one_input_takes_both_in_the_order_of_the_layout() -> None:
    data = columns({"X": ["n", 6]}, {"Y": 3})
    assert position(load(data, "X=hand,tcp,Y=position")) == HAND.tolist()
    assert position(load(data, "X=tcp,hand,Y=position")) == TCP.tolist()


def test_one_output_gives_position_and_spread() -> None:
    data = columns({"X": ["n", 6]}, {"Y": 6}, {"spread_threshold_m": "0.01"})
    answer = load(data, "X=hand,tcp,Y=position,spread").propose(
        hand_position_in_base_m=HAND, tcp_position_in_base_m=TCP, seed=1
    )
    assert answer.position_in_base_m == pytest.approx(HAND)
    assert answer.spread_m == pytest.approx(TCP)


def test_all_wrong_names_come_at_once_with_the_layout_that_fits() -> None:
    error = refused(columns({"input": ["n", 6]}, {"output": 3}))
    assert error.place.field == "input, output"
    assert error.got == "inputs input float32 ['n', 6]; outputs output float32 ['n', 3]"
    assert "mine.onnx:input=hand,tcp,output=position:" in error.hint


def test_short_names_in_the_file_itself_need_no_layout() -> None:
    data = columns({"hand": ["n", 3], "tcp": ["n", 3]}, {"position": 3})
    assert position(load(data)) == HAND.tolist()
    assert position(load(data, "hand=tcp,tcp=hand,position=position")) == TCP.tolist()
    both = columns({"hand": ["n", 3], "hand_position_in_base_m": ["n", 3]}, {"position": 3})
    assert refused(both, "").place.field == "hand_position_in_base_m"


def test_a_policy_may_carry_a_state_by_one_of_the_short_names() -> None:
    policy = OnnxPolicy(Path("p.onnx"), columns({"hand": [1, 3]}, {"tcp_velocity_mps": 3, "next_hand": 3}))
    assert policy.sees == ()


def test_where_shapes_leave_two_layouts_open_both_are_named() -> None:
    hint = refused(columns({"a": ["n", 3], "b": [1, 3]}, {"Y": 3})).hint
    assert "mine.onnx:a=hand,b=tcp,Y=position or mine.onnx:a=tcp,b=hand,Y=position:" in hint


def test_an_output_that_nobody_knows_is_refused_unless_it_is_said_to_be_unused() -> None:
    data = columns({"X": ["n", 6]}, {"Y": 3, "std": 1})
    assert "mine.onnx:X=hand,tcp,Y=position,std=unused:" in refused(data).hint
    assert refused(data, "X=hand,tcp,Y=position").place.field == "std"
    assert position(load(data, "X=hand,tcp,Y=position,std=unused")) == HAND.tolist()


@pytest.mark.parametrize(
    ("layout", "field"),
    [
        ("X=hand,Y=position", "tcp_position_in_base_m"),
        ("X=hand,tcp,Y=position,Z=unused", "Z"),
        ("X=hand,tcp,tcp,Y=position", "tcp_position_in_base_m"),
        ("X=hand,elbow,Y=position", "X"),
        ("X=unused,Y=position", "X"),
        ("X,Y", ", X, Y"),
    ],
)
def test_a_layout_that_means_nothing_is_refused(layout: str, field: str) -> None:
    error = refused(columns({"X": ["n", 6]}, {"Y": 3}), layout)
    assert error.place.field == field
    assert "mine.onnx:" in error.hint


def test_fixed_axes_that_do_not_fit_are_refused() -> None:
    error = refused(columns({"X": ["n", 7]}, {"Y": 3}), "X=hand,tcp,Y=position")
    assert (error.expected, error.got) == ("a shape of ['1 or n', 6]", "['n', 7]")
    error = refused(columns({"X": ["n", 6]}, {"Y": 4}), "X=hand,tcp,Y=position")
    assert (error.expected, error.got) == ("a shape of (1, 3) for one hand and one TCP", "(1, 4)")


def test_many_unknown_outputs_are_refused_at_once() -> None:
    error = refused(columns({"X": ["n", 6]}, {f"Y{k}": 3 for k in range(100)}))
    assert error.place.field is not None
    assert "Y99" in error.place.field


def test_a_spread_without_a_threshold_is_reported(capsys: pytest.CaptureFixture[str]) -> None:
    load(columns({"X": ["n", 6]}, {"Y": 6}), "X=hand,tcp,Y=position,spread")
    assert "no proposal can be doubted" in capsys.readouterr().err
    load(columns({"X": ["n", 6]}, {"Y": 6}, {"spread_threshold_m": "1"}), "X=hand,tcp,Y=position,spread")
    assert capsys.readouterr().err == ""


def test_the_layout_is_part_of_what_is_tested(tmp_path: Path) -> None:
    """Of one file two layouts are two avoiders, under their own names, seen from any folder."""
    (tmp_path / "mine.onnx").write_bytes(columns({"X": ["n", 6]}, {"Y": 3}))
    layouts = "X=hand,tcp,Y=position", "X=tcp,hand,Y=position"
    references = [f"{tmp_path}/mine.onnx:{layout}" for layout in layouts]
    made = Avoiders()
    avoiders = [made.avoider_for(with_avoider(scenario(), reference))[0] for reference in references]
    assert [one.name for one in avoiders] == [f"mine.onnx:{layout}" for layout in layouts]
    wanted = [
        one.propose(hand_position_in_base_m=HAND, tcp_position_in_base_m=TCP, seed=1).position_in_base_m
        for one in avoiders
    ]
    assert np.array(wanted) == pytest.approx(np.array([HAND, TCP]))
    assert admit(with_avoider(scenario(), references[0])).avoider.name == f"mine.onnx:{layouts[0]}"


def test_a_reference_with_a_layout_is_a_file_that_is_executed_and_no_program() -> None:
    reference = "models/mine.onnx:X=hand,tcp,Y:0=position"
    assert file_and_name(reference) == ("models/mine.onnx", "X=hand,tcp,Y:0=position")
    assert is_executed(reference)
    assert not is_a_program(reference)
    seen = avoider_seen_from(Path("/a/b"), reference, Path("/a"))
    assert seen == "../models/mine.onnx:X=hand,tcp,Y:0=position"


def test_a_file_of_other_people_s_names_is_read_whatever_they_are() -> None:
    """Keras' and TensorFlow's hold colons."""
    data = columns({"keras_tensor:0": ["n", 6]}, {"Identity:0": 3})
    assert position(load(data, "keras_tensor:0=hand,tcp,Identity:0=position")) == HAND.tolist()
    assert onnx.load_from_string(data).graph.input[0].name == "keras_tensor:0"
