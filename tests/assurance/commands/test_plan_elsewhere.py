"""A plan whose controller lies in another folder than its space, by every command, from a third folder."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from safety_harness.admission import repeatability
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, DIFFERS
from safety_harness.cli.main import app
from safety_harness.extensions.assurance.certification import whose_fault
from safety_harness.extensions.attribution import search_attribution
from safety_harness.search import session as search_session
from tests.assurance.campaign.plans import PLAN
from tests.search.short_space import TEXT

STAND = """\
from safety_harness import Move


class Drift:
    name, sees = "drift", ()

    def reset(self, **begins):
        pass

    def act(self, seen):
        return Move(tcp_velocity_mps=(0.05, 0.0, 0.0))
"""
SMALL = PLAN.replace("runs: 30", "runs: 9").replace("runs: 20", "runs: 9") + "search:\n  runs: 2\n"


def told(result: Result) -> str:
    return f"{result.output}\n{result.exception!r}"


def _looks_for_few_causes(patch: pytest.MonkeyPatch) -> None:
    """One of each kind is enough to find the controller, or not."""
    patch.setattr(search_session, "SHRINKING_RUNS", 2)
    patch.setattr(search_session, "MOST_SHRUNK", 1)
    patch.setattr(search_attribution, "MOST_ATTRIBUTED", 1)
    patch.setattr(whose_fault, "MOST", 1)
    patch.setattr(repeatability, "LEAST_RUNS", 1)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its folder, with the ledger of both parts, each ledger of one part, and the report."""
    where = tmp_path_factory.mktemp("elsewhere")
    for name in ("plans", "controllers", "spaces", "here"):
        (where / name).mkdir()
    (where / "controllers" / "drift.py").write_text(STAND)
    (where / "spaces" / "short.yaml").write_text(TEXT)
    text = SMALL.replace("avoider: opposite pose", "controller: ../controllers/drift.py:Drift")
    (where / "plans" / "plan.yaml").write_text(text.replace("short.yaml", "../spaces/short.yaml"))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(where / "here")
        _looks_for_few_causes(patch)
        for part in ("1/2", "2/2"):
            ledger = f"{part[0]}.sqlite"
            result = CliRunner().invoke(
                app, f"campaign run ../plans/plan.yaml --ledger {ledger} --part {part} --workers 1".split()
            )
            assert result.exit_code in (AS_EXPECTED, DIFFERS), told(result)
        Path("report").mkdir()
        shutil.copy("1.sqlite", "report/ledger.sqlite")  # which goes on with the other half
        result = CliRunner().invoke(
            app, ["certify", "../plans/plan.yaml", "--out", "report", "--workers", "1"]
        )
        assert result.exit_code == DIFFERS, told(result)
        assert "refuted" in result.output
        assert "cannot be made" not in result.output, told(result)
    return where


@pytest.mark.parametrize(
    ("command", "code", "words"),
    [
        ("validate ../plans/plan.yaml", AS_EXPECTED, ""),
        ("campaign pilot ../plans/plan.yaml --runs 2 --workers 1", DIFFERS, "runs: about"),
        ("campaign merge whole.sqlite 1.sqlite 2.sqlite", AS_EXPECTED, "18 episodes"),
        ("campaign resume 1.sqlite --workers 1", AS_EXPECTED, "episodes 18/18"),
        ("campaign status report/ledger.sqlite", AS_EXPECTED, "episodes 18/18"),
        ("campaign attribute report/ledger.sqlite --execute-programs --most 1", AS_EXPECTED, "hand distance"),
        (
            "campaign attribute report/ledger.sqlite --execute-programs --confirm --most 1",
            AS_EXPECTED,
            "hand distance",
        ),
        ("verify report --runs 1 --seed 1 --execute-programs", AS_EXPECTED, "the report stands"),
        (
            "fuzz ../spaces/short.yaml --controller ../controllers/drift.py:Drift --budget 2 --out fuzz",
            DIFFERS,
            "hand distance",
        ),
    ],
    ids=lambda value: " ".join(value.split()[:2]) if isinstance(value, str) and " " in value else None,
)
def test_every_command_finds_the_controller(
    made: Path, command: str, code: int, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(made / "here")
    _looks_for_few_causes(monkeypatch)
    result = CliRunner().invoke(app, command.split())
    assert result.exit_code == code, told(result)
    assert words in result.output
    assert "cannot be made" not in result.output, told(result)


def test_a_refused_comparison_leaves_nothing_in_the_report(
    made: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(made / "here")
    command = "campaign compare report/ledger.sqlite --controller ../controllers/drift.py:Drift --workers 1"
    before = {*Path("report").rglob("*")}
    result = CliRunner().invoke(app, command.split())  # found, and refused: it is the ledger's own
    assert result.exit_code == BAD_INPUT, told(result)
    assert "cannot be made" not in result.output, told(result)
    assert {*Path("report").rglob("*")} == before
    kept = Path("report", "ledger-against-controllers-drift-py-drift")
    kept.mkdir()
    assert CliRunner().invoke(app, command.split()).exit_code == BAD_INPUT
    assert kept.is_dir()  # it was there before: perhaps it has more in it than the plan
    shutil.rmtree(kept)


def test_exported_traces_are_replayed_and_attributed(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(made / "here")
    assert (
        CliRunner()
        .invoke(app, ["campaign", "export", "report/ledger.sqlite", "--traces", "traces"])
        .exit_code
        == 0
    )
    trace = str(next(Path("traces").rglob("*.trace")))
    for command in ("replay", "attribute"):
        words = [command, trace, "--controller", "../controllers/drift.py:Drift"]
        result = CliRunner().invoke(app, words)
        assert result.exit_code == AS_EXPECTED, told(result)
