"""Files as the tools that people use write them, asked as avoiders; each answers as its own library does."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import onnx
import pytest

from safety_harness.base.exceptions import ModelError
from safety_harness.cell.avoidance.onnx_model import OnnxAvoider

pytestmark = pytest.mark.filterwarnings("ignore")  # of exporters about themselves

HAND, TCP = np.array([0.8, -0.3, 0.1]), np.array([0.7, 0.0, 0.35])
QUESTION = np.concatenate([HAND, TCP])[None].astype(np.float32)
LAYOUT = "input=hand,tcp,output=position"
EXPORTED = Path(__file__).parent / "exported"
# What scikit-learn 1.9.1 predicts, as exported/make.py prints it.
OF_SKLEARN = {
    "linear": [0.7, 0.0, 0.45],
    "mlp": [0.46415, -0.00581, 0.27047],
    "forest": [0.6739, -0.29518, 0.64012],
}
OF_TORCH = [-0.4782091, 0.3478103, 0.4907542]  # what the network() answers to that question


def answered(path: Path, layout: str = "") -> np.ndarray:
    avoider = OnnxAvoider.load(path, path.read_bytes(), hand=HAND, tcp=TCP, layout=layout)
    asked = {"hand_position_in_base_m": HAND, "tcp_position_in_base_m": TCP, "seed": 1}
    return np.asarray(avoider.propose(**asked).position_in_base_m, np.float64)  # type: ignore[arg-type]


def network() -> object:
    torch = pytest.importorskip("torch")
    torch.manual_seed(0)
    return torch.nn.Sequential(torch.nn.Linear(6, 8), torch.nn.ReLU(), torch.nn.Linear(8, 3)).eval()


def own_answer(made: object) -> np.ndarray:
    torch = pytest.importorskip("torch")
    return np.asarray(made(torch.from_numpy(QUESTION)).detach().numpy()[0])  # type: ignore[operator]


def write(path: Path, made: object, *, dynamo: bool, half: bool = False, external_data: bool = False) -> Path:
    torch = pytest.importorskip("torch")
    example = torch.zeros((1, 6), dtype=torch.float16 if half else torch.float32)
    names = {"input_names": ["input"], "output_names": ["output"]}
    torch.onnx.export(
        made, (example,), path, dynamo=dynamo, external_data=external_data, verbose=False, **names
    )
    return path


@pytest.mark.parametrize("name", ["torch-dynamo", "torch-script", "torch-float16"])
def test_files_of_both_exporters_of_pytorch(name: str) -> None:
    """As the tests by night write them, without the traces of Python: by day PyTorch is not loaded."""
    path = EXPORTED / f"{name}.onnx"
    with pytest.raises(ModelError, match=f"{name}.onnx:{LAYOUT}:"):
        answered(path)
    digits = 2e-3 if name == "torch-float16" else 1e-6
    assert answered(path, LAYOUT) == pytest.approx(OF_TORCH, abs=digits)


def test_tensors_beside_a_file_of_pytorch_name_the_option_that_keeps_them_in_it(tmp_path: Path) -> None:
    model, path = onnx.load(EXPORTED / "torch-dynamo.onnx"), tmp_path / "mine.onnx"
    onnx.save_model(model, path, save_as_external_data=True, location="mine.onnx.data", size_threshold=0)
    assert (tmp_path / "mine.onnx.data").stat().st_size > 0
    with pytest.raises(ModelError, match="external_data=False"):
        answered(path, LAYOUT)


@pytest.mark.long
@pytest.mark.parametrize("dynamo", [True, False])
def test_both_exporters_of_pytorch(tmp_path: Path, dynamo: bool) -> None:
    made = network()
    path = write(tmp_path / "mine.onnx", made, dynamo=dynamo)
    with pytest.raises(ModelError, match=f"mine.onnx:{LAYOUT}:"):
        answered(path)
    own = own_answer(made)
    assert own == pytest.approx(OF_TORCH, abs=1e-6)
    assert answered(path, LAYOUT) == pytest.approx(own, abs=1e-6)


@pytest.mark.long
def test_tensors_beside_the_file_name_the_option_that_keeps_them_in_it(tmp_path: Path) -> None:
    torch = pytest.importorskip("torch")
    made = torch.nn.Sequential(torch.nn.Linear(6, 400), torch.nn.ReLU(), torch.nn.Linear(400, 3)).eval()
    path = write(tmp_path / "mine.onnx", made, dynamo=True, external_data=True)
    assert (tmp_path / "mine.onnx.data").stat().st_size > 0
    with pytest.raises(ModelError, match="external_data=False"):
        answered(path, LAYOUT)
    assert len(answered(write(path, made, dynamo=True), LAYOUT)) == 3


@pytest.mark.long
def test_a_network_in_float16_answers_to_its_own_digits(tmp_path: Path) -> None:
    made = network()
    own = own_answer(made)
    path = write(tmp_path / "half.onnx", made.half(), dynamo=True, half=True)  # type: ignore[attr-defined]
    assert answered(path, LAYOUT) == pytest.approx(own, abs=2e-3)


@pytest.mark.parametrize("name", ["linear", "forest"])
def test_files_of_skl2onnx_with_a_layout(name: str) -> None:
    found = answered(EXPORTED / f"{name}.onnx", "X=hand,tcp,variable=position")
    assert found == pytest.approx(OF_SKLEARN[name], abs=1e-5)


@pytest.mark.parametrize("name", OF_SKLEARN)
def test_the_script_gives_files_of_skl2onnx_our_names(tmp_path: Path, name: str) -> None:
    """That of the MLPRegressor has one column of three numbers, which no layout mends."""
    script = runpy.run_path(str(Path(__file__).parents[3] / "examples/sklearn_to_onnx.py"))
    made = script["with_our_names"](onnx.load(EXPORTED / f"{name}.onnx"))
    path = tmp_path / "mine.onnx"
    path.write_bytes(made.SerializeToString())
    assert answered(path) == pytest.approx(OF_SKLEARN[name], abs=1e-5)


def test_the_column_of_an_mlp_regressor_is_refused_as_it_is() -> None:
    with pytest.raises(ModelError, match=r"expected a shape of \(1, 3\) .* got \(3, 1\)"):
        answered(EXPORTED / "mlp.onnx", "X=hand,tcp,variable=position")


def test_the_script_refuses_other_columns() -> None:
    script = runpy.run_path(str(Path(__file__).parents[3] / "examples/sklearn_to_onnx.py"))
    model = onnx.load(EXPORTED / "linear.onnx")
    model.graph.input[0].type.tensor_type.shape.dim[1].dim_value = 7
    with pytest.raises(SystemExit, match="expected six columns"):
        script["with_our_names"](model)
