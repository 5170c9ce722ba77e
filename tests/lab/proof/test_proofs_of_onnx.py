"""An ONNX file is bounded as onnxruntime computes it; what is no ReLU network is refused by its operator."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from onnx import TensorProto as T
from onnx import helper, numpy_helper

from safety_harness.base.exceptions import ModelError
from safety_harness.extensions.lab.proof import check
from safety_harness.extensions.lab.proof.box_kernel import OUTSIDE, PROVEN, REFUTED
from safety_harness.extensions.lab.proof.certificate import write_certificate
from safety_harness.extensions.lab.proof.check import ANSWER, HAND, TCP, forms_of, network_of, onnx_steps
from safety_harness.extensions.lab.proof.claims import ClaimKind, DecisionClaim, optimum_constants
from safety_harness.extensions.lab.proof.onnx_file import OnnxFunction, read_onnx
from safety_harness.extensions.lab.proof.plan import read_proof_plan
from safety_harness.extensions.lab.proof.session import Effort, continue_proofs, fresh
from safety_harness.extensions.lab.proof.tree import examined
from tests.lab.proof.regions import SEEN_REGION, plan_file, random_boxes

Nodes = list[tuple[str, list[str], str, dict[str, object]]]
MLP: Nodes = [
    ("Concat", [HAND, TCP], "x", {"axis": 1}),
    ("Sub", ["x", "mean"], "centred", {}),
    ("Div", ["centred", "std"], "n", {}),
    ("Gemm", ["n", "w1t", "b1"], "z1", {"transB": 1}),
    ("Relu", ["z1"], "a1", {}),
    ("MatMul", ["a1", "w2"], "m2", {}),
    ("Add", ["b1", "m2"], "z2", {}),
    ("Relu", ["z2"], "a2", {}),
    ("Flatten", ["a2"], "f", {}),
    ("Gemm", ["f", "w3", "b3"], "y", {}),
    ("Mul", ["y", "scale"], "s", {}),
    ("Add", ["s", TCP], ANSWER, {}),
]
RESIDUAL: Nodes = [
    *MLP[:6],
    ("BatchNormalization", ["m2", "gain", "b1", "b2", "var"], "h", {"epsilon": 1e-4}),
    ("Identity", ["h"], "h2", {}),
    ("Add", ["h2", "a1"], "z2", {}),
    ("Relu", ["z2"], "a2", {}),
    ("Sub", ["half", "a2"], "turned", {}),
    ("Relu", ["turned"], "a3", {}),
    ("Sub", ["a2", "a3"], "f", {}),
    *MLP[-3:],
]


def onnx_file(folder: Path, nodes: Nodes, dtype: type = np.float32, seed: int = 0) -> Path:
    """With random weights; steps of some 0.1 m from the TCP."""
    rng, width = np.random.default_rng(seed), 12
    weights = {
        "mean": [0.84, -0.35, 0.0, 0.7, 0.0, 0.3],
        "std": [0.2, 0.2, 0.3, 0.1, 0.1, 0.1],
        "w1t": rng.normal(size=(width, 6)) / 2.0,
        "w2": rng.normal(size=(width, width)) / 3.0,
        "w3": rng.normal(size=(width, 3)) / 4.0,
        **{name: rng.normal(size=width) / 3.0 for name in ("b1", "b2", "gain")},
        "var": rng.uniform(0.5, 2.0, width),
        "half": 0.5,
        "b3": rng.normal(size=(1, 3)),
        "scale": [0.05],
    }
    kind = T.FLOAT if dtype is np.float32 else T.DOUBLE
    graph = helper.make_graph(
        [helper.make_node(op, of, [out], **more) for op, of, out, more in nodes],
        "graph",
        [helper.make_tensor_value_info(name, kind, [1, 3]) for name in (HAND, TCP)],
        [helper.make_tensor_value_info(ANSWER, kind, [1, 3])],
        [numpy_helper.from_array(np.array(value, dtype), name) for name, value in weights.items()],
    )
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
    (folder / "mine.onnx").write_bytes(made.SerializeToString())
    return folder / "mine.onnx"


@pytest.mark.parametrize(
    ("nodes", "dtype"), [(MLP, np.float64), (RESIDUAL, np.float32)], ids=["perceptron", "residual"]
)
def test_what_onnxruntime_answers_lies_within_the_bounds(tmp_path: Path, nodes: Nodes, dtype: type) -> None:
    network, asked = read_onnx(onnx_file(tmp_path, nodes, dtype))
    rng, decided = np.random.default_rng(1), 0
    for size, n in ((1.0, 12), (0.1, 8), (0.0, 1)):
        low, high = random_boxes(SEEN_REGION, 40, size, seed=int(10 * size))
        place = rng.random((40, n, 6))
        place[:, : n // 4] = np.round(place[:, : n // 4])
        questions = low[:, None] + place * (high - low)[:, None]
        hands, tcps = questions.reshape(-1, 6)[:, :3], questions.reshape(-1, 6)[:, 3:]
        answers, _ = asked.propose_many(hands, tcps, np.zeros(len(hands), np.uint64))
        for claim in (
            DecisionClaim(ClaimKind.AT_MOST, 0.08),
            DecisionClaim(ClaimKind.AT_LEAST, 0.08),
            DecisionClaim(ClaimKind.AWAY, 0.0),
        ):
            codes = examined(network, optimum_constants(), claim, SEEN_REGION, (low, high))
            margins = claim.margins(hands, tcps, answers).reshape(40, n)
            assert not (codes == OUTSIDE).any()
            assert (margins[codes == PROVEN] >= 0.0).all()
            assert (margins[codes == REFUTED] < 0.0).all()
            decided += int((codes >= PROVEN).sum())
            if size == 0.0:  # one question: the bounds are as wide as float32 rounds
                assert (codes >= PROVEN)[np.abs(margins[:, 0]) > 1e-4].all()
    assert decided > 150


def test_a_certificate_of_one_is_confirmed_by_a_reader_of_its_own_and_an_altered_one_is_not(
    tmp_path: Path,
) -> None:
    onnx_file(tmp_path, RESIDUAL)
    text = """\
proof: a residual network
avoider: mine.onnx
regions:
  corner:
    hand: {from: [600 mm, -500 mm, -200 mm], to: [700 mm, -400 mm, -100 mm]}
    tcp: {from: [650 mm, -140 mm, 260 mm], to: [700 mm, -90 mm, 300 mm]}
claims:
  - {claim: steps at most 400 mm, in: corner}
  - {claim: leads away, in: corner}
  - {claim: steps at least 90 mm, in: corner}
"""
    plan = read_proof_plan(plan_file(tmp_path, text))
    proofs = list(continue_proofs(plan, fresh(plan), Effort(seconds=1e6, halvings=9)))
    found = write_certificate(tmp_path / "certificate.json", plan, proofs)
    model = plan.model_file.read_bytes()
    lines = check.check((tmp_path / "certificate.json").read_bytes(), model)
    verdicts = [one["verdict"] for one in found["claims"]]
    assert [line.split(":")[0] for line in lines] == verdicts
    assert verdicts[0] == "proven"
    assert "refuted" in verdicts
    found["claims"][0]["limit_m"] = 0.02
    with pytest.raises(ValueError, match="proven"):
        check.check(json.dumps(found).encode(), model)


def test_without_a_seen_space_a_claim_names_its_region(tmp_path: Path) -> None:
    onnx_file(tmp_path, MLP)
    plan = "proof: a\navoider: mine.onnx\nclaims: [{claim: leads away}]\n"
    with pytest.raises(Exception, match="does not state its seen space"):
        read_proof_plan(plan_file(tmp_path, plan))


@pytest.mark.parametrize(
    ("at", "node", "told"),
    [
        (4, ("Sigmoid", ["z1"], "a1", {}), "Sigmoid 'a1'"),
        (4, ("Mul", ["z1", "z1"], "a1", {}), "Mul 'a1'"),
        (4, ("LeakyRelu", ["z1"], "a1", {}), "LeakyRelu 'a1'"),
        (6, ("Add", ["z1", "seed"], "z2", {}), "Add 'z2'"),
        (3, ("Gemm", ["n", "w1t", "b1"], "z1", {"transB": 1, "alpha": 2.0}), "Gemm 'z1'"),
        (0, ("Concat", [HAND, TCP], "x", {"axis": 0}), "Concat 'x'"),
    ],
)
def test_others_are_refused_by_operator_and_node(
    tmp_path: Path, at: int, node: tuple[str, list[str], str, dict[str, object]], told: str
) -> None:
    path = onnx_file(tmp_path, [*MLP[:at], node, *MLP[at + 1 :]])
    with pytest.raises(ModelError) as caught:
        read_onnx(path)
    assert told in str(caught.value)
    if node[0] != "Gemm":  # of which the check takes any alpha
        with pytest.raises((AssertionError, KeyError, RuntimeError, ValueError)):
            assert onnx_steps(path.read_bytes())[-1][0] == ANSWER


def test_both_readers_make_the_same_of_a_file(tmp_path: Path) -> None:
    path = onnx_file(tmp_path, RESIDUAL)
    network, asked = read_onnx(path)
    assert isinstance(asked, OnnxFunction)
    assert network.widths.tolist() == [12, 12, 12, 3]
    question = np.array([[0.8, -0.3, 0.1, 0.7, 0.0, 0.35]])
    steps, unit, _ = network_of(path.read_bytes())
    z, _, r = forms_of(steps, unit, question, 0.0 * question)[ANSWER]
    answer, _ = asked.propose_many(question[:, :3], question[:, 3:], np.zeros(1, np.uint64))
    assert (np.abs(z - answer) <= r).all()
    assert (r < 1e-4).all()
