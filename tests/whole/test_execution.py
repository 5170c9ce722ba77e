"""Only a command that runs a scenario executes a file of a user's, and it says so; all others only look."""

from __future__ import annotations

import logging
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from safety_harness.cell.avoidance.isolation import isolated
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT
from safety_harness.cli.main import app
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import read_plan
from safety_harness.extensions.assurance.certification import whose_fault
from safety_harness.seams.isolation import process, telling
from tests.assurance.campaign.plans import PLAN
from tests.search.short_space import TEXT

MINE = """\
from pathlib import Path

Path(__file__).with_name("executed").touch()
from safety_harness import Proposal


class Mine:
    name = "mine"

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        return Proposal(tcp_position_in_base_m + [0.0, 0.0, 0.07])
"""
OWN = "mine.py:Mine"
SPACE = TEXT.replace("opposite pose", OWN)
SCENARIO = (
    SPACE.replace("scenario space", "scenario")
    .replace("from -40 mm to 40 mm", "0 mm")
    .replace("from 700 mm to 900 mm", "800 mm")
    .replace("from 0.2 m/s to 2 m/s", "1 m/s")
)
SMALL_PLAN = (
    PLAN.replace("opposite pose", OWN)
    .replace("short.yaml", "space.yaml")
    .replace("runs: 30", "runs: 2")
    .replace("runs: 20", "runs: 2")
    .replace("    violated in at most: 50 %\n", "")  # which so few cannot show
)
TRACE = "out/traces/scenario.trace"
LOG = Path(__file__).parents[2] / "examples" / "logs"
GROUPS = ("campaign", "certify", "hands", "log", "robot", "scenario ")

# Every command: a new one has to take a stand.  Those that look, with their words and exit code ...
LOOKS: dict[str, tuple[str, int]] = {
    "validate": ("scenario.yaml space.yaml", AS_EXPECTED),
    "validate --avoider": (f"scenario.yaml --avoider {OWN}", AS_EXPECTED),
    "fmt": ("--check scenario.yaml space.yaml", 1),
    "explain": ("avoider", AS_EXPECTED),
    "claims": ("distance", AS_EXPECTED),
    "new": ("reaching another.yaml", AS_EXPECTED),
    "schema": ("", AS_EXPECTED),
    "replay": (TRACE, BAD_INPUT),  # without --avoider, which names the program anew
    "judge": (TRACE, 1),
    "view": (f"{TRACE} {TRACE} --no-open", AS_EXPECTED),
    "show": ("scenario.yaml space.yaml --draws 3", AS_EXPECTED),
    "sample": ("space.yaml --count 2", AS_EXPECTED),
    "scenario from": ("log/LOG.yaml --scenario scenario.yaml --around 50 mm --out from", AS_EXPECTED),
    "hands fit": ("scenario.yaml --out hands.yaml", BAD_INPUT),
    "prove": ("plan.yaml", BAD_INPUT),
    "log check": ("log/LOG.yaml", AS_EXPECTED),
    "log align": ("scenario.yaml --body hand", BAD_INPUT),
    "monitor": ("scenario.yaml", BAD_INPUT),
    "robot show": ("scenario.yaml", BAD_INPUT),
    "robot fit": ("scenario.yaml --out capsules.json", BAD_INPUT),
    "robot enclose": ("scenario.yaml", BAD_INPUT),
    "verify": ("report --runs 0", AS_EXPECTED),
    "verify as it is": ("report", BAD_INPUT),  # without --execute-programs
    "history": ("log", BAD_INPUT),  # no two reports
    "certify delta": ("report report", BAD_INPUT),  # a comparison with itself
    "certify declare": ("plan.yaml", AS_EXPECTED),
    "certify seal": ("report", AS_EXPECTED),
    "campaign status": ("report/ledger.sqlite", AS_EXPECTED),
    "campaign query": ("report/ledger.sqlite", AS_EXPECTED),
    "campaign export": ("report/ledger.sqlite table.csv --traces kept", AS_EXPECTED),
    "campaign compare": ("report/ledger.sqlite report/ledger.sqlite", BAD_INPUT),  # likewise
    "campaign attribute": ("report/ledger.sqlite", BAD_INPUT),  # without --execute-programs
    "attribute a trace": (TRACE, BAD_INPUT),
    "campaign merge": ("merged.sqlite report/ledger.sqlite", AS_EXPECTED),
    "metrics": (OWN, BAD_INPUT),
    "export": (OWN, BAD_INPUT),
    "dataset": ("--help", AS_EXPECTED),
    "train": ("--help", AS_EXPECTED),
    "reproduce": ("--help", AS_EXPECTED),
    "list": ("", AS_EXPECTED),
    "copy": ("shipped:own_avoider copied", AS_EXPECTED),
    "docs": ("--help", AS_EXPECTED),
    "doctor": ("--help", AS_EXPECTED),
    "warm": ("--help", AS_EXPECTED),
}
# ... and those that execute; of None another test sees, or it takes minutes.
EXECUTES: dict[str, str | None] = {
    "run": "scenario.yaml --out again",
    "replay": f"{TRACE} --avoider {OWN}",
    "fuzz": "space.yaml --budget 1",
    "certify plan": None,
    "evaluate": f"{OWN} --questions 20 --search 0 --region seen --out scores",
    "time": f"{OWN} --questions 100 --out times.json",
    "verify": None,
    "selftest": None,
    "attribute": "scenario.yaml",
    "compare-worlds": "log/LOG.yaml --scenario scenario.yaml --to 0.9s",
    "campaign attribute": "report/ledger.sqlite --execute-programs --most 1",
    "campaign pilot": "plan.yaml --runs 1",
    "campaign run": "plan.yaml --workers 1",
    "campaign resume": "begun.sqlite --workers 1",
    "campaign rare": "plan.yaml --by splitting --particles 10 --steps 1 --replications 3",
}


def commands(group: Any, *before: str) -> Iterator[str]:
    for name, one in group.commands.items():
        yield from commands(one, *before, name) if hasattr(one, "commands") else [" ".join([*before, name])]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files of a user's, and what commands made of them."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "mine.py").write_text(MINE)
    (folder / "scenario.yaml").write_text(SCENARIO)
    (folder / "space.yaml").write_text(SPACE)
    (folder / "plan.yaml").write_text(SMALL_PLAN)
    shutil.copytree(LOG, folder / "log")
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.chdir(folder)
        monkeypatch.setattr(whose_fault, "MOST", 1)
        for words in ("run scenario.yaml --out out", "certify plan.yaml --out report --workers 1"):
            found = CliRunner().invoke(app, words.split())
            assert found.exit_code < BAD_INPUT, found.output
    assert (folder / "executed").exists()
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy in which nothing was executed yet."""
    folder = tmp_path / "copy"
    shutil.copytree(made, folder, ignore=shutil.ignore_patterns("executed"))
    monkeypatch.chdir(folder)
    monkeypatch.setattr(telling, "executed", {})
    isolated._connection.cache_clear()  # processes that live from a test before
    return folder


def test_every_command_takes_a_stand() -> None:
    stands = {name for name in LOOKS if " " not in name or name.startswith(GROUPS)} | EXECUTES.keys()
    assert stands == set(commands(typer.main.get_command(app)))


def test_the_document_has_the_same_table() -> None:
    text = (Path(__file__).parents[2] / "docs" / "reference" / "command-line.md").read_text()
    row = next(line for line in text.splitlines() if line.startswith("| `run`, `fuzz`"))
    executing = set(re.findall(r"`([a-z]+(?:[ -][a-z]+)*)`", row.split("|")[1])) - {"pytest"}
    assert executing == {name.removesuffix(" plan") for name in EXECUTES} - {
        "replay",
        "verify",
        "campaign attribute",
    }


@pytest.mark.parametrize("name", LOOKS)
def test_a_command_that_looks_executes_nothing(
    folder: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    def begun(*_: object) -> None:
        raise AssertionError("a process was begun")

    monkeypatch.setattr(process.Process, "__init__", begun)
    words, code = LOOKS[name]
    command = name if name.startswith(GROUPS) else name.split()[0]
    found = CliRunner().invoke(app, [*command.split(), *words.split()])
    assert found.exit_code == code, found.output
    assert not (folder / "executed").exists()
    assert telling.executed == {}


@pytest.mark.parametrize("name", [name for name, words in EXECUTES.items() if words])
def test_a_command_that_runs_says_once_what_it_executes(
    folder: Path, caplog: pytest.LogCaptureFixture, name: str
) -> None:
    Ledger.create(folder / "begun.sqlite", read_plan(folder / "plan.yaml")).close()
    with caplog.at_level(logging.WARNING):
        found = CliRunner().invoke(app, [*name.split(), *(EXECUTES[name] or "").split()])
    assert found.exit_code in (0, 1), found.output
    assert (folder / "executed").exists()
    said = [text for text in caplog.messages if text.startswith("executes")]
    assert len(said) == 1
    assert said[0].startswith("executes mine.py (sha256 ")
    assert said[0].endswith("), in a process of its own, as you")


DEFINED = {
    "a class": "class Mine:\n    def propose(self, **q): ...\n",
    "an instance": "class A:\n    def propose(self, **q): ...\nMine = A()\n",
    "a base elsewhere": "from x import A\nclass Mine(A): pass\n",
    "in a condition": "try:\n    from x import Mine\nexcept ImportError:\n    Mine = None\n",
    "imported as": "import numpy as Mine\n",
    "a tuple": "a, Mine = 1, 2\n",
    "from everywhere": "from x import *\n",
    "hidden": "globals()['Mi' + 'ne'] = 1\n",
    "assigned method": "class Mine:\n    propose = print\n",
    "deep": f"Mine = 1{' + 1' * 2_000}\n",
    "long": "# " + "x" * 1_000_000,
}
UNDEFINED = {
    "nothing": "",
    "another name": "class Yours:\n    def propose(self): ...\n",
    "within a function": "def f():\n    Mine = 1\n",
    "no method": "class Mine:\n    def suggest(self): ...\n",
    "no Python": "class Mine:\n  def propose(self\n",
    "a null byte": "Mine = 1\0",
    "too deep": "Mine = " + "(" * 5_000,
}


@pytest.mark.parametrize("text", DEFINED.values(), ids=DEFINED)
def test_validate_takes_a_name_that_the_text_may_define(folder: Path, text: str) -> None:
    (folder / "mine.py").write_text(text)
    assert CliRunner().invoke(app, ["validate", "scenario.yaml"]).exit_code == AS_EXPECTED


@pytest.mark.parametrize("text", UNDEFINED.values(), ids=UNDEFINED)
def test_validate_refuses_a_name_that_the_text_does_not_define(folder: Path, text: str) -> None:
    (folder / "mine.py").write_text(text)
    found = CliRunner().invoke(app, ["validate", "scenario.yaml"])
    assert found.exit_code == BAD_INPUT
    assert "scenario.yaml:3: avoider" in found.output


def test_validate_says_of_a_file_that_there_is_none(folder: Path) -> None:
    (folder / "mine.py").unlink()
    found = CliRunner().invoke(app, ["validate", "scenario.yaml", "space.yaml"])
    assert found.exit_code == BAD_INPUT
    assert found.output.count("no such file") == 2


def test_a_link_by_the_name_of_a_model_is_not_executed_as_a_program(folder: Path) -> None:
    (folder / "blob").write_text((folder / "mine.py").read_text())
    (folder / "model.safetensors").symlink_to(folder / "blob")
    found = CliRunner().invoke(app, ["run", "scenario.yaml", "--avoider", "model.safetensors"])
    assert found.exit_code == BAD_INPUT
    assert not (folder / "executed").exists()
