"""A program whose declared weights were exchanged is another system."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cell.controller.out_of_process.test_declared_files import DECLARED, program_in
from tests.whole.test_own_controller import PLAN, SPACE, command


def test_a_program_whose_declared_weights_were_exchanged_is_not_resumed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    program_in(tmp_path, DECLARED[0])
    (tmp_path / "space.yaml").write_text(SPACE.replace("mine.py:StopAndGo", '"exec:./still.py"'))
    (tmp_path / "plan.yaml").write_text(PLAN.replace("mine.py:StopAndGo", '"exec:./still.py"'))
    made = command("campaign", "run", "plan.yaml", "--ledger", "one.sqlite", "--workers", "1")
    assert "which files this program opens is not known, but for those that it declares" in made.output
    (tmp_path / "weights.json").write_text("[-1.0]")
    again = command("campaign", "resume", "one.sqlite", "--workers", "1")
    assert again.exit_code == 2, again.output
    assert "the system under test in" in again.output
    (tmp_path / "weights.json").write_text("[1.0]")
    assert command("campaign", "resume", "one.sqlite", "--workers", "1").exit_code == made.exit_code
    (tmp_path / "weights.json").write_text("[-1.0]")
    status = command("campaign", "status", "one.sqlite")
    assert status.exit_code == 0
    assert "tested in near: controller exec:./still.py; which files this program opens" in status.output
