"""An ONNX file has a process of its own: what loops for ever in it or fills the memory costs a decision."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto as T
from onnx import helper, numpy_helper
from random_models import SEEN
from test_onnx_model import INPUTS, counts_kept, exported, model

from safety_harness.admission.avoiders import resolve_avoider
from safety_harness.base.exceptions import ModelError, NoAnswerError, Place
from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance import model_file
from safety_harness.cell.avoidance.asking import Question, ask
from safety_harness.cell.avoidance.gate import Query, ask_many
from safety_harness.cell.avoidance.isolation import isolated
from safety_harness.cell.avoidance.isolation.isolated import IsolatedAvoider, isolated_onnx
from safety_harness.cell.avoidance.onnx_model import OnnxAvoider
from safety_harness.space.regions import exported_use
from tests.examples import scenario

HAND, TCP = np.array([0.8, -0.3, 0.1]), np.array([0.7, 0.0, 0.35])
GOOD, BAD = 0, 7  # seeds
FOR_EVER = 10**12  # turns of a loop


def written(folder: Path, made: onnx.ModelProto) -> Path:
    path = folder / "mine.onnx"
    path.write_bytes(made.SerializeToString())
    return path


def load(folder: Path, made: onnx.ModelProto) -> IsolatedAvoider:
    return isolated_onnx(written(folder, made), DEFAULTS)


def looping(turns: int) -> onnx.ModelProto:
    """As many turns as ``turns`` of a loop that does nothing, if it is asked with the bad seed."""
    body = helper.make_graph(
        [
            helper.make_node("Identity", ["more"], ["still more"]),
            helper.make_node("Identity", ["here"], ["there"]),
        ],
        "body",
        [
            helper.make_tensor_value_info("turn", T.INT64, []),
            helper.make_tensor_value_info("more", T.BOOL, []),
            helper.make_tensor_value_info("here", T.DOUBLE, ["n", 3]),
        ],
        [
            helper.make_tensor_value_info("still more", T.BOOL, []),
            helper.make_tensor_value_info("there", T.DOUBLE, ["n", 3]),
        ],
    )
    loop = helper.make_node(
        "Loop", ["turns", "", "tcp_position_in_base_m"], ["position_in_base_m"], body=body
    )
    return if_bad(turns, [loop])


def if_bad(amount: int, nodes: list[onnx.NodeProto]) -> onnx.ModelProto:
    """A model in which ``turns`` is ``amount`` if it is asked with the bad seed, else 1."""
    chosen = [
        helper.make_node("Squeeze", ["seed"], ["one seed"]),
        helper.make_node("Equal", ["one seed", "bad"], ["is bad"]),
        helper.make_node("Where", ["is bad", "amount", "once"], ["turns"]),
    ]
    made = model(chosen + nodes, INPUTS | {"seed": (T.INT64, [1])})
    for name, value in (("bad", BAD), ("amount", amount), ("once", 1)):
        made.graph.initializer.append(numpy_helper.from_array(np.array(value, np.int64), name))
    return made


def always(made: onnx.ModelProto) -> onnx.ModelProto:
    """Whatever the seed."""
    for one in made.graph.initializer:
        if one.name == "once":
            (amount,) = (other for other in made.graph.initializer if other.name == "amount")
            one.CopyFrom(amount)
            one.name = "once"
    return made


def asked(avoider: IsolatedAvoider | OnnxAvoider, seed: int) -> str:
    """The fault, or the position's bits."""
    answer = ask(avoider, Question(HAND, TCP, seed))
    return answer.fault or answer.proposal.position_in_base_m.tobytes().hex()


def test_an_answer_has_the_bits_that_it_has_at_home(tmp_path: Path) -> None:
    made = counts_kept(exported())
    path = written(tmp_path, made)
    there, seen = isolated_onnx(path, DEFAULTS), exported_use(path).seen
    here = OnnxAvoider.load(tmp_path / "mine.onnx", made.SerializeToString(), hand=HAND, tcp=TCP)
    for seed in (0, 3, 2**64 - 1):
        assert asked(there, seed) == asked(here, seed)
    assert there.spread_threshold_m == here.spread_threshold_m == 0.02
    assert there.name == here.name
    assert seen == SEEN


def test_a_model_that_never_answers_is_refused_when_its_time_is_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert asked(load(tmp_path, always(looping(3))), GOOD) == TCP.tobytes().hex()
    monkeypatch.setattr(isolated, "ONNX_S", 2.0)
    with pytest.raises(ModelError, match="answers twice within 2 s; got its time was over") as raised:
        load(tmp_path, always(looping(FOR_EVER)))
    assert raised.value.place.file == tmp_path / "mine.onnx"


def test_a_model_that_hangs_at_one_question_ends_that_run_alone(tmp_path: Path) -> None:
    avoider = load(tmp_path, looping(FOR_EVER))
    good, bad = (
        Query(HAND, TCP, np.eye(4), np.zeros(6), HAND[None], seed, limit_s=1.0) for seed in (GOOD, BAD)
    )
    with pytest.raises(NoAnswerError, match="within 1 s of wall time"):
        ask_many([avoider] * 3, [good, bad, good])
    (again,) = ask_many([avoider], [good])
    assert again.proposal.position_in_base_m.tolist() == TCP.tolist()


def test_a_model_that_fills_the_memory_at_one_question_costs_that_decision_alone(tmp_path: Path) -> None:
    enormous = [
        helper.make_node("Reshape", ["turns", "row"], ["shape"]),
        helper.make_node("ConstantOfShape", ["shape"], ["zeros"]),
        helper.make_node("ReduceMax", ["zeros"], ["zero"], keepdims=0),
        helper.make_node("CastLike", ["zero", "tcp_position_in_base_m"], ["nothing"]),
        helper.make_node("Add", ["tcp_position_in_base_m", "nothing"], ["position_in_base_m"]),
    ]
    made = if_bad(10**10, enormous)
    made.graph.initializer.append(numpy_helper.from_array(np.array([1], np.int64), "row"))
    avoider = load(tmp_path, made)
    assert "alloc" in asked(avoider, BAD).lower()
    assert asked(avoider, GOOD) == TCP.tobytes().hex()
    with pytest.raises(ModelError, match=r"(?i)alloc"):
        load(tmp_path, always(made))


def test_what_the_file_says_is_told_with_its_field(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="int64 or uint64") as raised:
        load(tmp_path, model(inputs=INPUTS | {"seed": (T.INT32, [1])}))
    assert raised.value.place == Place(file=tmp_path / "mine.onnx", field="seed")


def test_a_model_that_has_seen_another_workspace_is_refused(tmp_path: Path) -> None:
    elsewhere = asdict(replace(SEEN, tcp_low_m=(0.71, -0.15, 0.25)))
    path = written(tmp_path, counts_kept(exported(seen=elsewhere)))
    with pytest.raises(ModelError, match="another workspace"):
        resolve_avoider(replace(scenario(avoider=path.name), file=tmp_path / "f.yaml"))


def test_a_file_that_is_not_there_or_too_large_is_refused_unread(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for path in (tmp_path / "none.onnx", tmp_path):
        with pytest.raises(ModelError, match="can be read"):
            isolated_onnx(path, DEFAULTS)
    monkeypatch.setattr(model_file, "LARGEST_ONNX_BYTES", 100)
    with pytest.raises(ModelError, match="at most 100 bytes"):
        load(tmp_path, model())
