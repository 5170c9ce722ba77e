"""``safety_harness.attribute``: what it takes and returns, and that the command writes and says the same."""

from __future__ import annotations

from pathlib import Path

import pytest

import safety_harness
from safety_harness.base.exceptions import InputError
from safety_harness.extensions.attribution.commands.attribute import attribute as attribute_command
from safety_harness.report.run_result import RunResult
from tests.kinds_of_files import VISIT

TEXT = VISIT.partition("\nclaims:")[0].replace("tcp start", "avoider: opposite pose\ntcp start") + (
    "\nclaims:\n  always TCP speed < 1 mm/s: violated\n"
)


@pytest.fixture
def made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> RunResult:
    monkeypatch.chdir(tmp_path)
    Path("visit.yaml").write_text(TEXT)
    return safety_harness.run("visit.yaml", world="kinematic", out="out")


def test_a_run_its_trace_and_its_file_are_attributed_alike_and_as_the_command_does(
    made: RunResult, capsys: pytest.CaptureFixture[str]
) -> None:
    found = safety_harness.attribute(made)
    assert found.tally.as_json() == safety_harness.attribute(made.trace).tally.as_json()
    assert found.tally.as_json() == safety_harness.attribute("out/traces/visit.trace").tally.as_json()
    assert found.exit_code == attribute_command([Path("out/traces/visit.trace")], out=Path("by-command"))
    found.write("written")
    for name in ("attribution.json", "attribution.svg"):
        assert Path("written", name).read_bytes() == Path("by-command", name).read_bytes()
    assert repr(found).startswith("<violations in the kinematic world, of 1: ")
    assert repr(found)[:-1].endswith(capsys.readouterr().out.splitlines()[1])


def test_what_cannot_be_attributed_is_refused(made: RunResult) -> None:
    with pytest.raises(InputError, match=r"gone\.yaml"):
        safety_harness.attribute([made, "gone.yaml"])
