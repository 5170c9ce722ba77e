"""``safety_harness.evaluate`` and ``prove``: what they return, and that the commands write the same."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import safety_harness
from safety_harness.base.exceptions import InputError
from safety_harness.extensions.lab.commands.evaluate import evaluate as evaluate_command
from safety_harness.extensions.lab.commands.prove import prove as prove_command
from safety_harness.extensions.lab.scoring import score as scoring
from tests.lab.proof.regions import plan_file

MINE = """
import numpy as np
from safety_harness.cell.avoidance.avoider import Proposal

class Towards:
    name = "towards"

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        way = hand_position_in_base_m - tcp_position_in_base_m
        return Proposal(tcp_position_in_base_m + 0.1 * way / max(np.linalg.norm(way), 1e-9))
"""
FEW: dict[str, Any] = {"questions": 60, "search": 40, "regions": ["seen"]}


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(scoring, "LATER_S", 0.0)
    (tmp_path / "mine.py").write_text(MINE)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def untimed(file: Path) -> Any:
    """A document without its times of answers."""

    def kept(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: kept(part) for key, part in value.items() if "time" not in key and "_ms" not in key}
        return [kept(part) for part in value] if isinstance(value, list) else value

    return kept(json.loads(file.read_text()))


def test_what_is_scored_and_written_afterwards_is_what_the_command_writes(folder: Path) -> None:
    found = safety_harness.evaluate("mine.py:Towards", **FEW)
    assert [one.name for one in folder.iterdir()] == ["mine.py"]
    assert evaluate_command(["mine.py:Towards"], out=Path("out"), **FEW) == found.exit_code == 1
    Path("out").rename("by-command")
    found.write("out")
    assert untimed(Path("out/evaluation.json")) == untimed(Path("by-command/evaluation.json"))
    worst = [*Path("out").glob("*.yaml")]
    assert len(worst) == len([*Path("by-command").glob("*.yaml")]) > 0
    for one in worst:
        assert one.read_text() == (Path("by-command") / one.name).read_text()
    assert repr(found).startswith(
        f"<mine.py:Towards: {len(found.avoiders[0].findings)} findings. Basis: in no"
    )


def test_a_worst_question_that_is_written_elsewhere_still_names_its_avoider(folder: Path) -> None:
    found = safety_harness.evaluate("mine.py:Towards", **FEW).write("deep/er")
    file = found.avoiders[0].worst[0].file.path
    assert file is not None
    assert "../../mine.py:Towards" in file.read_text()


def test_what_is_proven_and_written_afterwards_is_what_the_command_writes(folder: Path) -> None:
    plan = plan_file(folder)
    found = safety_harness.prove(plan, halvings=40)
    assert prove_command(plan, out=Path("out"), halvings=40) == found.exit_code == 0
    by_command = Path("out/certificate.json").read_bytes()
    found.write("afterwards")
    assert Path("afterwards/certificate.json").read_bytes() == by_command
    assert Path("afterwards/proof.html").is_file()
    assert repr(found).startswith("<student, steps at most 150 mm")
    assert repr(found).count("proven") == 2
    again = safety_harness.prove(plan, halvings=40, resume="afterwards")
    assert again.exit_code == 0


def test_what_cannot_be_used_is_refused(folder: Path) -> None:
    with pytest.raises(InputError, match="tudent"):
        safety_harness.evaluate("studend")
    with pytest.raises(InputError, match=r"gone\.yaml"):
        safety_harness.prove("gone.yaml")
