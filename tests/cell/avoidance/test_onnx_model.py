"""Anybody's ONNX file: what keeps the contract decides, and everything else is refused with what is wrong."""

from __future__ import annotations

import json
import os
import runpy
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from onnx import TensorProto as T
from onnx import helper, numpy_helper
from random_models import SEEN

from safety_harness.base.exceptions import AvoiderError, ModelError
from safety_harness.cell.avoidance.avoider import Proposal, checked, spread_threshold_of
from safety_harness.cell.avoidance.masks import masks
from safety_harness.cell.avoidance.model_file import KEY, Calibration
from safety_harness.cell.avoidance.onnx_model import EXPORT_FORMAT, OnnxAvoider

HAND, TCP = np.array([0.8, -0.3, 0.1]), np.array([0.7, 0.0, 0.35])
INPUTS = {"hand_position_in_base_m": (T.DOUBLE, ["n", 3]), "tcp_position_in_base_m": (T.DOUBLE, ["n", 3])}
OUTPUTS = {"position_in_base_m": (T.DOUBLE, ["n", 3])}
MIDDLE = [  # half way between hand and TCP
    helper.make_node("Sum", ["hand_position_in_base_m", "tcp_position_in_base_m"], ["sum"]),
    helper.make_node("Mul", ["sum", "half"], ["position_in_base_m"]),
]

Typed = dict[str, tuple[int, list[Any]]]


def model(
    nodes: list[onnx.NodeProto] = MIDDLE,
    inputs: Typed = INPUTS,
    outputs: Typed = OUTPUTS,
    metadata: dict[str, str] | None = None,
    dtype: type = np.float64,
) -> onnx.ModelProto:
    infos = [
        [helper.make_tensor_value_info(name, *typed) for name, typed in some.items()]
        for some in (inputs, outputs)
    ]
    half = numpy_helper.from_array(np.array(0.5, dtype), "half")
    graph = helper.make_graph(nodes, "graph", *infos, [half])
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
    helper.set_model_props(made, metadata or {})
    return made


def load(path: Path, made: onnx.ModelProto | bytes) -> OnnxAvoider:
    data = made if isinstance(made, bytes) else made.SerializeToString()
    return OnnxAvoider.load(path / "mine.onnx", data, hand=HAND, tcp=TCP)


def ask(avoider: OnnxAvoider, *, seed: int = 1, hand: np.ndarray = HAND) -> Proposal:
    return checked(avoider.propose(hand_position_in_base_m=hand, tcp_position_in_base_m=TCP, seed=seed))


@pytest.mark.parametrize("rows", ["n", 1, None])
def test_the_least_file_decides_without_a_spread(tmp_path: Path, rows: object) -> None:
    shape = [rows, 3]
    inputs = {name: (T.DOUBLE, shape) for name in INPUTS}
    avoider = load(tmp_path, model(inputs=inputs, outputs={"position_in_base_m": (T.DOUBLE, shape)}))
    proposal = ask(avoider)
    assert proposal.position_in_base_m == pytest.approx((HAND + TCP) / 2, abs=1e-15)
    assert proposal.spread_m.tolist() == [0.0, 0.0, 0.0]
    assert spread_threshold_of(avoider) is None
    assert avoider.name == "ONNX model mine.onnx"


def test_a_file_in_float32_decides_too(tmp_path: Path) -> None:
    single = model(
        inputs={name: (T.FLOAT, ["n", 3]) for name in INPUTS},
        outputs={"position_in_base_m": (T.FLOAT, ["n", 3])},
        dtype=np.float32,
    )
    assert ask(load(tmp_path, single)).position_in_base_m == pytest.approx((HAND + TCP) / 2, abs=1e-7)


@pytest.mark.parametrize("dtype", [T.INT64, T.UINT64])
def test_a_seed_arrives_whole(tmp_path: Path, dtype: int) -> None:
    """Its two 32-bit halves come back as a position."""
    nodes = [
        helper.make_node("Cast", ["seed"], ["bits"], to=T.UINT64),
        helper.make_node("Mod", ["bits", "two32"], ["low"]),
        helper.make_node("Div", ["bits", "two32"], ["high"]),
        helper.make_node("Concat", ["low", "high", "low"], ["row"], axis=0),
        helper.make_node("Cast", ["row"], ["numbers"], to=T.DOUBLE),
        helper.make_node("Unsqueeze", ["numbers", "first"], ["position_in_base_m"]),
    ]
    made = model(nodes, INPUTS | {"seed": (dtype, [1])})
    made.graph.initializer.append(numpy_helper.from_array(np.array([2**32], np.uint64), "two32"))
    made.graph.initializer.append(numpy_helper.from_array(np.array([0], np.int64), "first"))
    avoider = load(tmp_path, made)
    for seed in (0, 5, 2**63 + 3, 2**64 - 1):
        high, low = divmod(seed, 2**32)
        assert ask(avoider, seed=seed).position_in_base_m.tolist() == [low, high, low]


def spread_model(metadata: dict[str, str]) -> onnx.ModelProto:
    spread = helper.make_node("Mul", ["position_in_base_m", "half"], ["spread_m"])
    return model(
        [*MIDDLE, spread],
        outputs=OUTPUTS | {"spread_m": (T.DOUBLE, ["n", 3])},
        metadata=metadata,
    )


def test_spread_and_threshold_are_the_file_s(tmp_path: Path) -> None:
    avoider = load(tmp_path, spread_model({"spread_threshold_m": "0.015"}))
    assert spread_threshold_of(avoider) == 0.015
    assert avoider.propose(
        hand_position_in_base_m=HAND, tcp_position_in_base_m=TCP, seed=1
    ).spread_m == pytest.approx((HAND + TCP) / 4)
    assert spread_threshold_of(load(tmp_path, spread_model({}))) is None


def test_what_a_decision_costs_is_what_the_file_declares(tmp_path: Path) -> None:
    assert load(tmp_path, model(metadata={"decision_time_s": "0.04"})).decision_time_s == 0.04
    assert load(tmp_path, model()).decision_time_s == 0.0
    of_card = counts_kept(exported(card={"decision_time_s": 0.03}))
    assert load(tmp_path, of_card).decision_time_s == 0.03


def test_a_hand_that_is_not_a_number_is_a_fault_and_no_proposal(tmp_path: Path) -> None:
    with pytest.raises(AvoiderError, match="not finite"):
        ask(load(tmp_path, model()), hand=np.array([np.nan, 0.0, 0.0]))


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (b"", "onnxruntime can load"),
        (b"import os", "onnxruntime can load"),
        (model().SerializeToString()[:-20], "onnxruntime can load"),
        (
            model(inputs={"hand": INPUTS["hand_position_in_base_m"]} | INPUTS),
            r"expected inputs .*; got inputs hand float64",
        ),
        (model(inputs=INPUTS | {"masks": (T.BOOL, ["n", 10, 3, 32])}), "onnx: masks: expected inputs"),
        (
            model(
                [helper.make_node("Identity", ["tcp_position_in_base_m"], ["position_in_base_m"])],
                {"tcp_position_in_base_m": (T.DOUBLE, ["n", 3])},
            ),
            "hand_position_in_base_m: expected inputs hand_.*; got inputs tcp_",
        ),
        (
            model(inputs=INPUTS | {"hand_position_in_base_m": (T.DOUBLE, [3])}),
            r"hand_position_in_base_m: expected a shape of \['1 or n', 3\]; got \[3\]",
        ),
        (model(inputs={name: (T.DOUBLE, ["n", 4]) for name in INPUTS}), r"_base_m: .* got \['n', 4\]"),
        (model(inputs={name: (T.DOUBLE, [5, 3]) for name in INPUTS}), r"got \[5, 3\]"),
        (
            model(
                [
                    helper.make_node("Cast", ["hand_position_in_base_m"], ["hand"], to=T.DOUBLE),
                    helper.make_node("Sum", ["hand", "tcp_position_in_base_m"], ["position_in_base_m"]),
                ],
                INPUTS | {"hand_position_in_base_m": (T.INT32, ["n", 3])},
            ),
            "expected float16 or float32 or float64; got tensor.int32",
        ),
        (model(inputs=INPUTS | {"seed": (T.INT32, [1])}), "seed: expected int64 or uint64"),
        (model(inputs=INPUTS | {"seed": (T.INT64, [])}), "seed: expected a shape"),
        (model(outputs={"sum": (T.DOUBLE, ["n", 3])}), "onnx: sum: expected .*mine.onnx:sum=position:"),
        (
            model(
                [*MIDDLE, helper.make_node("Abs", ["half"], ["variance"])],
                outputs=OUTPUTS | {"variance": (T.DOUBLE, [])},
            ),
            "onnx: variance: expected .*mine.onnx:variance=unused:",
        ),
        (model(metadata={"spread_threshold_m": "0.01"}), "onnx: spread_m: expected .*outputs"),
        (spread_model({"spread_threshold_m": "wide"}), "spread_threshold_m: expected a length"),
        (spread_model({"spread_threshold_m": "nan"}), "spread_threshold_m: expected a length"),
        (spread_model({"spread_threshold_m": "-1"}), "spread_threshold_m: expected a length"),
        (spread_model({KEY: "{"}), "metadata, in JSON"),
        (model(metadata={"decision_time_s": "soon"}), "decision_time_s: expected a time from 0 s to 60 s"),
        (model(metadata={"decision_time_s": "61"}), "decision_time_s: expected a time from 0 s to 60 s"),
        (spread_model({KEY: "{}"}), "format: expected 'safety-harness export 1'"),
    ],
)
def test_what_breaks_the_contract_is_refused(
    tmp_path: Path, made: onnx.ModelProto | bytes, said: str
) -> None:
    with pytest.raises(ModelError, match=said) as raised:
        load(tmp_path, made)
    assert raised.value.place.file == tmp_path / "mine.onnx"


@pytest.mark.parametrize("shape", [[3], [2, 3], [1, 4]])
def test_an_answer_of_another_shape_than_one_row_is_refused(tmp_path: Path, shape: list[int]) -> None:
    """Whatever the file declares: it is tried."""
    nodes = [
        helper.make_node("ConstantOfShape", ["shape"], ["zeros"]),
        helper.make_node("Cast", ["zeros"], ["position_in_base_m"], to=T.DOUBLE),
    ]
    made = model(nodes, outputs={"position_in_base_m": (T.DOUBLE, None)})  # type: ignore[dict-item]
    made.graph.initializer.append(numpy_helper.from_array(np.array(shape), "shape"))
    with pytest.raises(ModelError, match=r"position_in_base_m: expected a shape of \(1, 3\)"):
        load(tmp_path, made)


def test_random_numbers_that_come_from_no_seed_are_refused(tmp_path: Path) -> None:
    noise = helper.make_node("RandomNormal", [], ["position_in_base_m"], shape=[1, 3], dtype=T.DOUBLE)
    with pytest.raises(ModelError, match=r"RandomNormal .*'seed'"):
        load(tmp_path, model([noise]))


def test_a_model_that_cannot_answer_is_refused(tmp_path: Path) -> None:
    nodes = [helper.make_node("Reshape", ["tcp_position_in_base_m", "shape"], ["position_in_base_m"])]
    made = model(nodes)
    made.graph.initializer.append(numpy_helper.from_array(np.array([4, 4]), "shape"))
    made.graph.output[0].type.tensor_type.ClearField("shape")
    with pytest.raises(ModelError, match=r"onnxruntime can load|answers for one hand"):
        load(tmp_path, made)


@pytest.mark.parametrize("absolute", [True, False])
def test_tensors_in_another_file_are_refused(
    tmp_path: Path, absolute: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Even where that file lies ready, beside the model and in the working directory."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "half.bin").write_bytes(np.array(0.5).tobytes())
    made = model()
    (half,) = made.graph.initializer
    half.ClearField("raw_data")
    half.data_location = T.EXTERNAL
    half.external_data.add(key="location", value=os.fspath(tmp_path / "half.bin") if absolute else "half.bin")
    with pytest.raises(ModelError, match="in the file itself"):
        load(tmp_path, made)


CALIBRATION = Calibration(
    interval_multiplier=2.0, spread_threshold_m=0.02, residual_std_m=(0.01, 0.01, 0.01), samples=9
)


def exported(**changes: object) -> dict[str, str]:
    calibration = asdict(CALIBRATION)
    del calibration["more"]
    fields = {
        "format": EXPORT_FORMAT,
        "dropout": "inter",
        "dropout_probability": 0.25,
        "passes": 4,
        "seen": asdict(SEEN),
        "calibration": calibration,
    }
    return {KEY: json.dumps(fields | changes), "spread_threshold_m": "99"}


def counts_kept(metadata: dict[str, str], shape: list[object] | None = None) -> onnx.ModelProto:
    """The position tells how many units the masks keep in the first three passes."""
    nodes = [
        helper.make_node("Cast", ["masks"], ["ones"], to=T.DOUBLE),
        helper.make_node("ReduceSum", ["ones", "axes"], ["kept"], keepdims=0),
        helper.make_node("Slice", ["kept", "from", "to", "axis"], ["position_in_base_m"]),
        helper.make_node("Identity", ["hand_position_in_base_m"], ["spread_m"]),
    ]
    made = model(
        nodes,
        INPUTS | {"masks": (T.BOOL, shape or ["n", 4, 3, 32])},
        OUTPUTS | {"spread_m": (T.DOUBLE, ["n", 3])},
        metadata,
    )
    for name, value in (("axes", [2, 3]), ("from", [0]), ("to", [3]), ("axis", [1])):
        made.graph.initializer.append(numpy_helper.from_array(np.array(value), name))
    return made


def test_a_file_of_export_gets_the_masks_of_the_seed_and_has_the_calibration_s_threshold(
    tmp_path: Path,
) -> None:
    avoider = load(tmp_path, counts_kept(exported()))
    assert spread_threshold_of(avoider) == 0.02
    for seed in (0, 2**64 - 1):
        position = avoider.propose(
            hand_position_in_base_m=HAND, tcp_position_in_base_m=TCP, seed=seed
        ).position_in_base_m
        assert position.tolist() == masks(np.uint64(seed), 4, 3, 32, 0.25).sum(axis=(1, 2))[:3].tolist()
    assert load(tmp_path, counts_kept(exported(calibration=None))).spread_threshold_m is None


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (counts_kept(exported(format="other")), "format"),
        (counts_kept(exported(passes=1)), "passes"),
        (counts_kept(exported(passes=5)), r"masks: expected a shape of \['1 or n', 5, 3, 32\]"),
        (counts_kept(exported(dropout="full")), r"masks: expected a shape of \['1 or n', 4, 31, 32\]"),
        (counts_kept(exported(dropout_probability=0)), "dropout_probability"),
        (counts_kept(exported(dropout="none", dropout_probability=0)), "onnx: masks: expected inputs"),
        (spread_model(exported()), "onnx: masks: expected inputs"),
        (model(metadata=exported(dropout="none", dropout_probability=0)), "onnx: spread_m: expected inputs"),
        (counts_kept(exported(calibration={"samples": 1})), "calibration"),
    ],
)
def test_a_file_of_export_that_contradicts_itself_is_refused(
    tmp_path: Path, made: onnx.ModelProto, said: str
) -> None:
    with pytest.raises(ModelError, match=said):
        load(tmp_path, made)


def test_the_example_writes_a_file_that_keeps_the_contract(tmp_path: Path) -> None:
    example = runpy.run_path(str(Path(__file__).parents[3] / "examples/onnx_model.py"))
    avoider = load(tmp_path, example["straight_up"](0.05))
    proposal = ask(avoider)
    assert proposal.position_in_base_m == pytest.approx(TCP + [0.0, 0.0, 0.05], abs=1e-6)
    assert proposal.spread_m == pytest.approx([0.005] * 3)
    assert spread_threshold_of(avoider) == 0.01
