"""What a campaign and a certificate need of the libraries that are installed."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from safety_harness.cli.console import BAD_INPUT
from safety_harness.cli.scenario_commands import run
from safety_harness.extensions.assurance.campaign.identity import identity_of
from safety_harness.extensions.assurance.commands.certify import certify
from safety_harness.trace.provenance import provenance
from tests.trace.test_provenance import forget, installed

REPOSITORY = Path(__file__).parents[3]


@pytest.fixture(autouse=True)
def forgetful() -> Iterator[None]:
    """Packages that a test installs are seen, and forgotten after it."""
    forget()
    yield
    forget()


def test_certify_refuses_two_owners_of_a_module_and_run_warns(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    installed(tmp_path / "site", "onnxruntime-gpu", "2.0", names="onnxruntime\n")
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    forget()
    assert certify(REPOSITORY / "plans" / "quick.yaml", out=tmp_path / "report") == BAD_INPUT
    refused = capsys.readouterr().err
    assert "the module onnxruntime" in refused
    assert "onnxruntime-gpu 2.0" in refused
    assert not (tmp_path / "report").exists()
    run([tmp_path / "none.yaml"], tmp_path / "out")
    assert "warning: onnxruntime " in capsys.readouterr().err


def test_a_campaign_s_identity_is_of_versions_and_not_of_a_machine_s_files() -> None:
    parts = dict(identity_of([], [], None, "PyBullet").parts)
    assert not parts["the library pybullet"].startswith("not")
    assert "the library pybullet" not in dict(identity_of([], [], None, "kinematic").parts)
    assert parts["the library numpy"] == sys.modules["numpy"].__version__
    files = provenance("PyBullet").files
    assert files
    assert not any(name in f"{parts}" or sha256 in f"{parts}" for name, sha256 in files)
