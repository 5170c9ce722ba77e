"""A copied plan reads the spaces that were copied with it."""

from __future__ import annotations

from pathlib import Path

import pytest

from safety_harness.base.shipped.contents import located
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT
from safety_harness.cli.shipped import copy
from safety_harness.extensions.assurance.campaign.plan import read_plan


def test_a_copied_plan_reads_the_copied_spaces(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert copy("shipped:quick") == AS_EXPECTED
    first = Path(capsys.readouterr().out.splitlines()[0])
    assert first == Path("plans/quick.yaml")
    for stratum in read_plan(first).strata:
        assert stratum.space.file is not None
        assert tmp_path in stratum.space.file.resolve().parents


def test_what_is_there_is_not_overwritten_without_being_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "scenarios/spaces/nominal.yaml"
    file.parent.mkdir(parents=True)
    file.write_text("mine")
    assert copy("shipped:quick", tmp_path) == BAD_INPUT
    assert "--overwrite" in capsys.readouterr().err
    assert file.read_text() == "mine"
    assert not (tmp_path / "plans").exists()
    assert copy("shipped:quick", tmp_path, overwrite=True) == AS_EXPECTED
    assert file.read_bytes() == located("shipped:nominal").read_bytes()
    assert copy("shipped:quick", tmp_path) == AS_EXPECTED  # the same files are there
