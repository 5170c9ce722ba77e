from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from cell.avoidance.random_models import SEEN, random_perceptron

from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.isolation.isolated import isolated_onnx
from safety_harness.cell.avoidance.model_file import save_model
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, INTERRUPTED
from safety_harness.extensions.lab.commands.learning import export
from safety_harness.extensions.lab.learning import export as module
from safety_harness.space.regions import exported_use


@pytest.fixture(scope="module", autouse=True)
def _converted_once() -> Iterator[None]:
    """The one model here, a quick one; ``learning/test_export.py`` has that twice gives the same bytes."""
    with pytest.MonkeyPatch.context() as patch:
        once = cache(lambda metadata: convert(random_perceptron(), metadata))
        convert = module._onnx_bytes
        patch.setattr(module, "_onnx_bytes", lambda model, metadata: once(metadata))
        yield


@pytest.fixture
def model(tmp_path: Path) -> Path:
    path = tmp_path / "model.safetensors"
    save_model(random_perceptron(), path)
    return path


def test_a_model_file_becomes_one_that_a_run_can_use(
    model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new" / "model.onnx"
    assert export(model, out=out) == AS_EXPECTED
    printed = capsys.readouterr()
    first, second = printed.out.splitlines()
    assert first == f"onnx: {out}"
    assert float(second.split(" by ")[1].split()[0]) < 1e-3
    avoider = isolated_onnx(out, DEFAULTS)
    assert avoider.name == "ONNX model model.onnx"
    assert exported_use(out).seen == SEEN
    assert printed.err == f"next: safety-harness evaluate {out}\n"


def test_mistakes_are_explained_and_nothing_is_written(
    model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for source, name, seed, said in (
        (model, "out.onnx", -1, "--seed"),
        (model, "out.pt", 0, "ends in .onnx"),
        (tmp_path / "none.safetensors", "out.onnx", 0, "no such file"),
    ):
        assert export(source, out=tmp_path / name, seed=seed) == BAD_INPUT
        assert said in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["model.safetensors"]


def test_a_difference_from_the_original_is_exit_code_2(
    model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(module, "MOST_DIFFERENT_M", 1e-12)
    assert export(model, out=tmp_path / "out.onnx") == BAD_INPUT
    assert "the original's answers" in capsys.readouterr().err
    assert not (tmp_path / "out.onnx").exists()


def test_ctrl_c_leaves_nothing(
    model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "difference", interrupted)
    assert export(model, out=tmp_path / "out.onnx") == INTERRUPTED
    assert "interrupted before the export" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["model.safetensors"]
