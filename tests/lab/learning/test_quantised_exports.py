"""Networks that were quantised after their export."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import onnx
import pytest

from safety_harness.cell.avoidance.learned import LearnedAvoider
from tests.cell.avoidance.random_models import random_perceptron
from tests.cell.avoidance.test_real_exports import (
    HAND,
    LAYOUT,
    QUESTION,
    TCP,
    answered,
    network,
    write,
)

torch = pytest.importorskip("torch")
pytestmark = pytest.mark.filterwarnings("ignore")  # of exporters about themselves


@pytest.mark.parametrize("ours", [True, False])
def test_a_quantised_network_answers_to_its_own_digits(
    tmp_path: Path, ours: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of ``export`` too, whose shapes agree with those that the quantiser infers."""
    monkeypatch.setattr(sys, "path", [one for one in sys.path if Path(one).name != "examples"])
    monkeypatch.delitem(sys.modules, "onnx_model", raising=False)  # an example of ours has this name
    before = [*sys.path], {*sys.modules}
    from onnxruntime.quantization import QuantType, quantize_dynamic

    sys.path[:] = before[0]  # it adds a folder with modules of plain names, "onnx_model" among them
    for name in {"onnx_model", "fusion_utils", "onnx_utils"} - before[1]:
        sys.modules.pop(name, None)

    from safety_harness.extensions.lab.learning.export import write_export

    if ours:
        model, layout, path = random_perceptron(seed=3), "", tmp_path / "ours.onnx"
        write_export(model, b"a file", path, seed=0)
        own = LearnedAvoider.from_model(model).propose(
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
