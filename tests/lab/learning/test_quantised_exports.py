"""Networks that were quantised after their export."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import onnx
import pytest

from safety_harness.cell.avoidance.learned import LearnedAvoider
from safety_harness.cell.avoidance.model_file import Dropout
from safety_harness.cell.avoidance.onnx_model import OnnxAvoider
from tests.cell.avoidance.random_models import random_model

torch = pytest.importorskip("torch")
pytestmark = pytest.mark.filterwarnings("ignore")  # of exporters about themselves

HAND, TCP = np.array([0.8, -0.3, 0.1]), np.array([0.7, 0.0, 0.35])
QUESTION = np.concatenate([HAND, TCP])[None].astype(np.float32)
LAYOUT = "input=hand,tcp,output=position"


def answered(path: Path, layout: str = "") -> np.ndarray:
    avoider = OnnxAvoider.of(path, path.read_bytes(), hand=HAND, tcp=TCP, layout=layout)
    asked = {"hand_position_in_base_m": HAND, "tcp_position_in_base_m": TCP, "seed": 1}
    return np.asarray(avoider.propose(**asked).position_in_base_m, np.float64)  # type: ignore[arg-type]


def network() -> object:
    torch.manual_seed(0)
    return torch.nn.Sequential(torch.nn.Linear(6, 8), torch.nn.ReLU(), torch.nn.Linear(8, 3)).eval()


def write(path: Path, made: object, *, dynamo: bool, half: bool = False, external_data: bool = False) -> Path:
    example = torch.zeros((1, 6), dtype=torch.float16 if half else torch.float32)
    names = {"input_names": ["input"], "output_names": ["output"]}
    torch.onnx.export(
        made, (example,), path, dynamo=dynamo, external_data=external_data, verbose=False, **names
    )
    return path


@pytest.mark.parametrize("ours", [True, False])
def test_a_quantised_network_answers_to_its_own_digits(tmp_path: Path, ours: bool) -> None:
    """Of ``export`` too, whose shapes agree with those that the quantiser infers."""
    before = [*sys.path], {*sys.modules}
    from onnxruntime.quantization import QuantType, quantize_dynamic

    sys.path[:] = before[0]  # it adds a folder with modules of plain names, "onnx_model" among them
    for name in {"onnx_model", "fusion_utils", "onnx_utils"} - before[1]:
        sys.modules.pop(name, None)

    from safety_harness.extensions.lab.learning.export import write_export

    if ours:
        model, layout, path = random_model(Dropout.INTER, seed=3), "", tmp_path / "ours.onnx"
        write_export(model, b"a file", path, seed=0)
        own = LearnedAvoider.of(model).propose(
            hand_position_in_base_m=HAND, tcp_position_in_base_m=TCP, seed=1
        )
        wanted = own.position_in_base_m
    else:
        made, layout = network(), LAYOUT
        path = write(tmp_path / "theirs.onnx", made, dynamo=False)
        wanted = made(torch.from_numpy(QUESTION)).detach().numpy()[0]  # type: ignore[operator]
    small = tmp_path / "int8.onnx"
    quantize_dynamic(path, small, weight_type=QuantType.QInt8)
    assert any(one.op_type == "MatMulInteger" for one in onnx.load(small).graph.node)
    found = answered(small, layout)
    assert found == pytest.approx(wanted, abs=0.05)
    assert not np.array_equal(found, wanted)
