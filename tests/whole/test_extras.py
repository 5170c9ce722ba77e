"""What is said where an optional package is missing: one line, exit code 2; and that nobody else needs it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from safety_harness.admission.avoiders import resolve_avoider, scenario_of_avoider
from safety_harness.base.exceptions import InputError, MissingPackageError, explanation
from safety_harness.base.extras import CLUSTER, EXPORT, EXTRAS, IMAGES, LEARNING, ONNX, PYBULLET, Extra
from safety_harness.cell.avoidance.shipped import shipped_model
from safety_harness.cell.perception.detector import opencv
from safety_harness.extensions.assurance.campaign.cluster import connected
from safety_harness.extensions.assurance.campaign.exporting import export as export_ledger
from safety_harness.extensions.lab.commands.learning import export, train
from tests.assurance.campaign.plans import ledger_in, plan_in


def missing(monkeypatch: pytest.MonkeyPatch, *extras: Extra) -> None:
    """As if these were not installed; what of ours has imported them is forgotten."""
    packages = tuple(module for extra in extras for module in extra.modules)
    for name in list(sys.modules):
        if name.startswith(tuple(f"{one}." for one in packages)):
            monkeypatch.setitem(sys.modules, name, None)
    for name in packages:
        monkeypatch.setitem(sys.modules, name, None)
    for name in ("learning.training", "learning.networks", "learning.export"):
        monkeypatch.delitem(sys.modules, f"safety_harness.extensions.lab.{name}", raising=False)


def test_a_missing_package_is_one_line_with_what_needs_it_and_how_to_get_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    missing(monkeypatch, IMAGES)
    with pytest.raises(MissingPackageError) as error:
        opencv()
    line = "rendered images: needs cv2, which is not installed: pip install 'hand-safety-harness[images]'"
    assert explanation(error.value).startswith(line)
    assert "\n" not in explanation(error.value)
    assert isinstance(error.value, InputError)


def test_another_module_that_is_missing_is_raised_as_it_is() -> None:
    with pytest.raises(ModuleNotFoundError, match="no_such_module"), IMAGES.needed("a test"):
        import no_such_module  # type: ignore[import-not-found]  # noqa: F401


def test_above_python_3_11_pybullet_is_built_from_its_source(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "version_info", (3, 11, 9))
    assert PYBULLET.hint.startswith("pip install 'hand-safety-harness[pybullet]'; ")
    monkeypatch.setattr(sys, "version_info", (3, 13, 0))
    assert PYBULLET.hint.startswith("it has no wheel above Python 3.11; pip install pybullet builds it")
    assert "--world mujoco" in PYBULLET.hint


def test_an_onnx_file_names_the_extra_before_a_process_is_started(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "mine.onnx").write_bytes(b"")
    missing(monkeypatch, ONNX)
    with pytest.raises(MissingPackageError, match=r"mine\.onnx: needs onnxruntime, .*safety-harness\[onnx\]"):
        resolve_avoider(scenario_of_avoider(str(tmp_path / "mine.onnx")))


def test_train_and_export_name_the_extra(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    missing(monkeypatch, LEARNING)
    work: list[Callable[[], int]] = [
        lambda: train("trial-deterministic", out=tmp_path),
        lambda: export(str(shipped_model("deterministic")), tmp_path / "x.onnx"),
    ]
    for one, name in zip(work, ("train", "export"), strict=True):
        assert one() == 2
        said = capsys.readouterr().err
        assert (
            f"{name}: needs torch, which is not installed: pip install 'hand-safety-harness[learning]'"
            in said
        )


def test_parquet_and_a_cluster_name_their_extras_and_what_does_without(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    missing(monkeypatch, EXPORT, CLUSTER)
    with ledger_in(tmp_path, plan_in(tmp_path)) as ledger:
        with pytest.raises(MissingPackageError, match=r"pyarrow, .*\[export\]'; or use a \.csv"):
            export_ledger(ledger, tmp_path / "x.parquet")
        assert export_ledger(ledger, tmp_path / "x.csv") == 0
    with pytest.raises(MissingPackageError, match=r"--cluster: needs distributed, .*\[cluster\]"):
        connected("tcp://localhost:1", 1.0)


def test_no_module_of_the_package_imports_an_extra_before_it_is_used() -> None:
    packages = [module for extra in EXTRAS for module in extra.modules]
    code = f"""
import pkgutil, sys
from importlib import import_module


class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition('.')[0] in {packages!r}:
            raise ModuleNotFoundError(name=name)


sys.meta_path.insert(0, Missing())
import safety_harness
own = ('training', 'networks', 'learning.export', 'pybullet_world', 'simulation.cell', 'engine', '__main__',
    'mujoco_model', 'mujoco_world',
    '.gym', 'gym.environment', 'gym.observing', 'gym.vector', 'gym.stable_baselines')
for one in pkgutil.walk_packages(safety_harness.__path__, 'safety_harness.', onerror=lambda name: None):
    if not one.name.endswith(own):
        import_module(one.name)
print('done')
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.strip().endswith("done"), done.stderr


def test_a_message_travels_between_processes() -> None:
    with pytest.raises(MissingPackageError) as error, EXPORT.needed("a table"):
        raise ModuleNotFoundError(name="pyarrow.parquet")
    make, arguments = error.value.__reduce__()
    assert str(make(*arguments)) == str(error.value)
