"""An ONNX file as a controller: what it takes it sees, what it carries over is its own."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from safety_harness.base.exceptions import ControllerError, ModelError
from safety_harness.base.input_errors import InputErrors
from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.controller.driven import arm_of
from safety_harness.cell.controller.out_of_process.onnx_policy import OnnxPolicy
from safety_harness.cell.robot.robots import arm_model
from safety_harness.report.run_job import run
from safety_harness.scenario.robots import Robot
from safety_harness.seams.contract import Move, Seen, Stop, acts_per_answer_of
from safety_harness.seams.rows import SeenLayout, seen_dtype
from tests.cell.controller.out_of_process.programs import START

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
TCP, VELOCITY = "tcp_position_in_base_m", "tcp_velocity_mps"


def policy(
    nodes: list[tuple[Any, ...]],
    inputs: dict[str, tuple[Any, ...]],
    outputs: dict[str, tuple[Any, ...]],
    metadata: dict[str, str] | None = None,
) -> bytes:
    """A file of operators (name, inputs, outputs), with the constants one and half."""
    helper, double = onnx.helper, onnx.TensorProto.DOUBLE
    constants = {"one": 1.0, "half": 0.5}
    graph = helper.make_graph(
        [helper.make_node(*node) for node in nodes],
        "policy",
        [helper.make_tensor_value_info(name, double, shape) for name, shape in inputs.items()],
        [helper.make_tensor_value_info(name, double, shape) for name, shape in outputs.items()],
        [helper.make_tensor(name, double, [1, 1], [value]) for name, value in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, metadata or {})
    return bytes(model.SerializeToString())


def halving(**more: str) -> bytes:
    """Towards the base, by half of the way a second."""
    return policy([("Mul", [TCP, "half"], [VELOCITY])], {TCP: (1, 3)}, {VELOCITY: (1, 3)}, more)


def counting() -> bytes:
    """Says how often it was asked since the beginning, and stops from the third time on."""
    return policy(
        [
            ("Add", ["count", "one"], ["next_count"]),
            ("Expand", ["next_count", "three"], [VELOCITY]),
            ("Sub", ["next_count", "one"], ["less"]),
            ("Mul", ["less", "half"], ["halved"]),
            ("Sub", ["halved", "half"], ["stop"]),
        ],
        {"count": (1, 1), TCP: (1, 3)},
        {"next_count": (1, 1), VELOCITY: (1, 3), "stop": (1, 1)},
    )


def seen(sees: tuple[str, ...], tcp: tuple[float, ...] = (0.7, -0.1, 0.3), hands: int = 1) -> Seen:
    """As the harness makes it."""
    whole = np.zeros(1, seen_dtype(hands))
    whole["tcp_position_in_base_m"] = tcp
    whole["hand_count"], whole["hands"][0, 0] = 1, (0.5, -0.2, 0.3)
    layout = SeenLayout(hands, 6, sees)
    return Seen.of_row(0.0, 0.008, layout, whole.view(np.float64)[: layout.wanted])


def begun(data: bytes, layout: str = "") -> OnnxPolicy:
    made = OnnxPolicy(Path("mine.onnx"), data, layout)
    made.reset(settings=DEFAULTS, arm=arm_of(arm_model(Robot.UR10)), start=START, seed=1)
    return made


def moved(action: Any) -> list[float]:
    assert isinstance(action, Move)
    assert action.tcp_velocity_mps is not None
    return [float(x) for x in action.tcp_velocity_mps]


def test_it_sees_what_it_takes_and_moves_as_it_says() -> None:
    made = begun(halving(name="halfway"))
    assert (made.name, made.sees) == ("halfway", ("joints",))
    assert moved(made.act(seen(made.sees))) == [0.35, -0.05, 0.15]


def test_an_action_is_held_for_its_ticks() -> None:
    made = begun(halving(ticks="2"))
    places = [(0.2, 0.0, 0.0), (0.4, 0.0, 0.0), (0.6, 0.0, 0.0)]
    assert [moved(made.act(seen(made.sees, tcp)))[0] for tcp in places] == [0.1, 0.1, 0.3]


def expanding(*shape: int, **more: str) -> bytes:
    """The TCP's place times the number of the action, from 1 on, in an output of ``shape``."""
    data = policy(
        [("Expand", [TCP, "shape"], ["wide"]), ("Mul", ["wide", "steps"], [VELOCITY])],
        {TCP: (1, 3)},
        {VELOCITY: shape},
        more,
    )
    model = onnx.load_from_string(data)
    steps = np.arange(1.0, shape[-2] + 1.0).reshape(-1, 1)
    model.graph.initializer.append(onnx.numpy_helper.from_array(np.array(shape, np.int64), "shape"))
    model.graph.initializer.append(onnx.numpy_helper.from_array(steps, "steps"))
    return bytes(model.SerializeToString())


def test_a_chunk_is_carried_out_up_to_its_horizon_then_the_policy_answers_again() -> None:
    made = begun(expanding(1, 5, 3, horizon="2", ticks="2"))
    xs_m = [0.1, 9.0, 9.0, 9.0, 0.2, 9.0, 9.0, 9.0]
    speeds = [moved(made.act(seen(made.sees, (x_m, 0.0, 0.0))))[0] for x_m in xs_m]
    assert speeds == [0.1, 0.1, 0.2, 0.2, 0.2, 0.2, 0.4, 0.4]
    assert acts_per_answer_of(made) == 4
    made.act(seen(made.sees, (0.5, 0.0, 0.0)))
    made.reset(settings=DEFAULTS, arm=arm_of(arm_model(Robot.UR10)), start=START, seed=1)
    assert moved(made.act(seen(made.sees, (0.3, 0.0, 0.0))))[0] == 0.3


@pytest.mark.parametrize(
    ("shape", "metadata", "expected"),
    [
        (
            (50, 3),
            {},
            r"\(50, 3\); expected \(1, 3\), or a chunk \(1, k, 3\) with the metadata horizon",
        ),
        ((1, 50, 3), {}, r"the shape \(1, 50, 3\); expected \(1, 3\), or a chunk"),
        ((50, 3), {"horizon": "8"}, r"expected \(1, k, 3\) with k of at least 8"),
        ((1, 4, 3), {"horizon": "8"}, r"the shape \(1, 4, 3\); expected \(1, k, 3\) with k of at least 8"),
        ((1, 1, 3), {"horizon": "1"}, None),
    ],
)
def test_an_output_of_a_shape_that_is_not_declared_is_refused(
    shape: tuple[int, ...], metadata: dict[str, str], expected: str | None
) -> None:
    made = begun(expanding(*shape, **metadata))
    if expected is None:
        assert isinstance(made.act(seen(made.sees)), Move)
    else:
        with pytest.raises(ControllerError, match=expected):
            made.act(seen(made.sees))


def test_a_policy_whose_chunk_is_not_declared_is_refused_before_the_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "chunks.onnx").write_bytes(expanding(50, 3))
    with pytest.raises(InputErrors, match=r"the output tcp_velocity_mps has the shape \(50, 3\)"):
        run("shipped:first-run", controller=tmp_path / "chunks.onnx", world="kinematic")


def test_metadata_of_a_wrong_type_are_refused_by_their_name(tmp_path: Path) -> None:
    (tmp_path / "chunks.onnx").write_bytes(expanding(1, 8, 3, horizon="four"))
    with pytest.raises(InputErrors, match=r"expected a number from 1 to 1000; got horizon: 'four'"):
        run("shipped:first-run", controller=tmp_path / "chunks.onnx", world="kinematic")


def renamed(data: bytes, name: str) -> bytes:
    """The file with another name of its output."""
    model = onnx.load_from_string(data)
    model.graph.node[-1].output[0] = model.graph.output[0].name = name
    return bytes(model.SerializeToString())


def test_a_chunk_under_another_name_is_laid_out_and_never_called_unused() -> None:
    data = renamed(expanding(1, 8, 3, horizon="4"), "action")
    with pytest.raises(ModelError) as caught:
        begun(data)
    assert (
        caught.value.hint == "a layout says what each holds: mine.onnx:NAME=QUANTITY,QUANTITY,NAME=QUANTITY"
    )
    made = begun(data, f"action={VELOCITY}")
    assert moved(made.act(seen(made.sees, (0.1, 0.0, 0.0)))) == [0.1, 0.0, 0.0]


def test_a_chunk_of_both_velocities_under_another_name_is_laid_out() -> None:
    model = onnx.load_from_string(renamed(expanding(1, 8, 3, horizon="4"), "action"))
    model.graph.node.append(onnx.helper.make_node("Concat", ["action", "action"], ["both"], axis=2))
    model.graph.output[0].name = "both"
    model.graph.output[0].type.tensor_type.shape.dim[2].dim_value = 6
    with pytest.raises(ModelError) as caught:
        begun(model.SerializeToString())
    assert "unused" not in caught.value.hint
    made = begun(model.SerializeToString(), f"both={VELOCITY},tcp_angular_velocity_radps")
    action = made.act(seen(made.sees, (0.1, 0.0, 0.0)))
    assert moved(action) == [0.1, 0.0, 0.0]
    assert action.tcp_angular_velocity_radps.tolist() == [0.1, 0.0, 0.0]  # type: ignore[union-attr]


@pytest.mark.parametrize("shape", [(8, 3), (1, 8, 4, 3)])
def test_the_only_output_is_never_called_unused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ModelError) as caught:
        begun(renamed(expanding(*shape), "action"))
    assert "unused" not in caught.value.hint


def test_hands_come_as_rows_with_flags() -> None:
    first = [("Slice", ["hands", "zero", "one64", "one64"], ["first"])]
    data = policy(
        [*first, ("Squeeze", ["first", "one64"], [VELOCITY])], {"hands": (1, "n", 3)}, {VELOCITY: (1, 3)}
    )
    model = onnx.load_from_string(data)
    for name, value in (("zero", 0), ("one64", 1)):
        model.graph.initializer.append(onnx.helper.make_tensor(name, onnx.TensorProto.INT64, [1], [value]))
    made = begun(model.SerializeToString())
    assert made.sees == ("hands",)
    for slots in (1, 3):
        assert moved(made.act(seen(made.sees, hands=slots))) == [0.5, -0.2, 0.3]


def with_shape(data: bytes) -> bytes:
    """The constant that ``counting`` expands to."""
    model = onnx.load_from_string(data)
    model.graph.initializer.append(onnx.helper.make_tensor("three", onnx.TensorProto.INT64, [2], [1, 3]))
    return bytes(model.SerializeToString())


def test_what_it_carries_begins_with_zeros_in_each_episode() -> None:
    made = begun(with_shape(counting()))
    for _ in range(2):
        assert moved(made.act(seen(made.sees))) == [1.0, 1.0, 1.0]
        assert moved(made.act(seen(made.sees))) == [2.0, 2.0, 2.0]
        assert isinstance(made.act(seen(made.sees)), Move)
        assert isinstance(made.act(seen(made.sees)), Stop)
        made.reset(settings=DEFAULTS, arm=arm_of(arm_model(Robot.UR10)), start=START, seed=1)


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"no onnx", "an ONNX file that onnxruntime can load"),
        (
            lambda: policy([("Identity", ["speed"], [VELOCITY])], {"speed": (1, 3)}, {VELOCITY: (1, 3)}),
            "onnx: speed: expected inputs image",
        ),
        (
            lambda: policy([("Identity", [TCP], ["go"])], {TCP: (1, 3)}, {"go": (1, 3)}),
            "onnx: go: expected inputs .*; outputs tcp_velocity_mps",
        ),
        (lambda: halving(ticks="many"), "ticks: expected a number from 1 to 1000"),
        (
            lambda: policy(
                [("Identity", ["s"], ["next_s"]), ("Identity", [TCP], [VELOCITY])],
                {"s": (1, "n"), TCP: (1, 3)},
                {"next_s": (1, "n"), VELOCITY: (1, 3)},
            ),
            "a state of a fixed shape",
        ),
    ],
    ids=["no file", "an unknown input", "no output", "ticks", "a state of any size"],
)
def test_what_is_no_policy_is_refused(data: Any, why: str) -> None:
    with pytest.raises(ModelError) as caught:
        OnnxPolicy(Path("mine.onnx"), data if isinstance(data, bytes) else data())
    assert re.search(why, str(caught.value))
