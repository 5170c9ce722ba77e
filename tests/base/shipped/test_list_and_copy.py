"""``safety-harness list`` and ``copy``: what comes with the package, told and copied."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from safety_harness.base.shipped.contents import ShippedKind, located, shipped_files
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, answered_as_json
from safety_harness.cli.shipped import copy, list_shipped
from safety_harness.scenario.expand import gather, read_all_scenarios


def test_everything_is_listed_once_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert list_shipped() == AS_EXPECTED
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(shipped_files())
    (quick,) = (line for line in lines if line.startswith("shipped:quick "))
    assert quick.endswith("the paper's avoider beside a hand, in seconds")


def test_one_kind_alone_and_for_programs(capsys: pytest.CaptureFixture[str]) -> None:
    assert answered_as_json(lambda: list_shipped(ShippedKind.SPACES)) == AS_EXPECTED
    told = json.loads(capsys.readouterr().out)["result"]["files"]
    assert {one["kind"] for one in told} == {"spaces"}
    assert all(Path(one["file"]) == located(one["name"]) for one in told)


@pytest.mark.parametrize("kind", ["scenarios", "spaces"])
def test_a_copied_file_can_be_read_where_it_is(kind: str, tmp_path: Path) -> None:
    for one in shipped_files():
        if one.kind == kind:
            folder = tmp_path / one.name
            assert copy(f"shipped:{one.name}", folder) == AS_EXPECTED
            (file,) = folder.rglob(one.path.name)
            assert not gather([file], spaces=True).errors


def test_a_recording_comes_with_its_licence(tmp_path: Path) -> None:
    copy("recorded-handover", tmp_path)
    assert (tmp_path / "recordings/LICENSE").is_file()
    assert (tmp_path / "recorded-handover.yaml").is_file()


def test_a_folder_is_copied_with_what_it_extends(tmp_path: Path) -> None:
    assert copy("shipped:own_avoider", tmp_path) == AS_EXPECTED
    assert read_all_scenarios(tmp_path / "own_avoider/one-visit.yaml")
    assert not list(tmp_path.rglob("__pycache__"))


def test_what_is_not_shipped_is_not_copied(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert copy("shipped:quik", tmp_path) == BAD_INPUT
    assert "shipped:quick" in capsys.readouterr().err
