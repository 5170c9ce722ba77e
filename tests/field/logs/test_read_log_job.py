"""``safety_harness.read_log``: what it returns, and that judge writes and says the same."""

from __future__ import annotations

from pathlib import Path

import safety_harness
from safety_harness.cli.scenario_commands import judge
from safety_harness.scenario.model import Verdict

EXAMPLE = Path(__file__).parents[3] / "examples" / "logs" / "LOG.yaml"


def lines(folder: Path) -> list[str]:
    return [line for line in (folder / "report.json").read_text().splitlines() if "made_at" not in line]


def test_the_report_is_that_of_the_command(tmp_path: Path) -> None:
    found = safety_harness.read_log(EXAMPLE)
    assert judge([EXAMPLE], out=tmp_path / "out") == 0
    by_command = lines(tmp_path / "out")
    (tmp_path / "out").rename(tmp_path / "by-command")
    found.write(tmp_path / "out")
    assert lines(tmp_path / "out") == by_command
    assert found.trace.known.recorded
    assert found.assumptions


def test_its_verdict_is_one_line_which_says_that_it_is_a_log_and_any_claim_may_be_made_of_it() -> None:
    found = safety_harness.read_log(EXAMPLE)
    assert repr(found).startswith("<inconclusive: LOG.yaml, ") or repr(found).startswith("<holds: LOG.yaml, ")
    assert "Basis: in a log; claims exercised in " in repr(found)
    assert found.judge("always hand distance > 9 m").evaluations[0].verdict is Verdict.VIOLATED
