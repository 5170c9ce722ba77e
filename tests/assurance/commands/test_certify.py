"""certify and verify from beginning to end, on runs of 0.4 s in the kinematic world."""

from __future__ import annotations

import json
import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from xml.etree import ElementTree

import jsonschema
import pytest
from once import replayed_once  # noqa: F401
from typer.testing import CliRunner

from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, DIFFERS, INTERRUPTED
from safety_harness.cli.main import app
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.session import plan_of
from safety_harness.extensions.assurance.certification import certify as certify_module
from safety_harness.extensions.assurance.certification import folder as folder_module
from safety_harness.extensions.assurance.certification import verify_report, whose_fault
from safety_harness.extensions.assurance.certification.counterexamples import declared_counterexamples
from safety_harness.extensions.assurance.certification.evidence import ClaimStatus, read_evidence, schema
from safety_harness.extensions.assurance.certification.findings import of_examples
from safety_harness.extensions.assurance.commands.certify import (
    certify,
    declare,
    seal_report,
    tell_delta,
    verify,
)
from safety_harness.search import session as search_session
from tests.assurance.campaign.plans import PLAN, plan_in
from tests.search.short_space import TEXT

SEARCHING = PLAN + "search:\n  runs: 20\n"


@pytest.fixture(scope="module", autouse=True)
def no_causes(replayed_once: None) -> Iterator[None]:  # noqa: F811
    """The causes of violations take longer than all else: ``test_gathered.py`` and ``test_verify.py``."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(whose_fault, "attribute", lambda *_: ())
        yield


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report; copied by tests that change it."""
    folder = tmp_path_factory.mktemp("certified")
    plan_in(folder, SEARCHING)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(search_session, "SHRINKING_RUNS", 10)
        patch.setattr(search_session, "MOST_SHRUNK", 1)
        assert certify(folder / "plan.yaml", out=folder / "report", workers=1) == DIFFERS
    return folder / "report"


@pytest.fixture
def report(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy to be touched; its page is what was written, without the seconds that drawing it again takes."""
    page = (made / "evidence.html").read_text()
    monkeypatch.setattr(verify_report, "render", lambda *_: page)
    monkeypatch.setattr(folder_module, "drawn", lambda evidence, _: (page, evidence))
    return Path(shutil.copytree(made, tmp_path / "report"))


def words(capsys: pytest.CaptureFixture[str]) -> str:
    captured = capsys.readouterr()
    return captured.out + captured.err


def test_a_plan_becomes_a_folder_that_says_all_of_it(made: Path) -> None:
    evidence = read_evidence(made / "evidence.json")
    jsonschema.Draft202012Validator(schema()).validate(json.loads((made / "evidence.json").read_text()))
    assert [outcome.runs for outcome in evidence.claims[0].outcomes] == [30, 20]
    assert evidence.plan.model_only
    assert evidence.standing is not ClaimStatus.SHOWN
    ElementTree.parse(made / "junit.xml")
    text = (made / "evidence.html").read_text()
    assert "Model only" in text
    assert "It is no certificate" in text
    assert (made / "plan" / "plan.yaml").read_text() == SEARCHING


def test_what_a_search_finds_is_shown_and_is_in_no_bound(made: Path) -> None:
    evidence = read_evidence(made / "evidence.json")
    assert evidence.search is not None
    assert evidence.search.runs == 20
    searched = [one for one in evidence.counterexamples if not one.independent]
    declared = [one for one in evidence.counterexamples if one.independent]
    assert searched
    assert declared
    assert all((made / one.trace_file).is_file() for one in evidence.counterexamples)
    assert sum(outcome.runs for outcome in evidence.claims[0].outcomes) == 50


def test_every_violation_of_the_declared_runs_is_of_a_kind_that_is_shown(made: Path) -> None:
    evidence = read_evidence(made / "evidence.json")
    like_it = [0] * len(evidence.claims)
    for one in evidence.counterexamples:
        if one.independent:
            assert one.claim is not None
            like_it[one.claim - 1] += one.like_it
    assert like_it == [sum(outcome.violated for outcome in claim.outcomes) for claim in evidence.claims]
    assert sum(like_it) > 0


def test_kinds_of_violation_whose_traces_are_not_kept_are_counted(report: Path) -> None:
    with closing(sqlite3.connect(report / "ledger.sqlite")) as connection, connection:
        connection.execute("DELETE FROM trace")
    with Ledger.open(report / "ledger.sqlite") as ledger, plan_of(ledger) as plan:
        kinds = list(declared_counterexamples(plan, ledger))
        assert kinds
        assert not any(kinds)
        (found,) = of_examples(kinds)
        assert f"{len(kinds)} kinds of violation have no kept trace" in found.text


def test_the_same_command_again_makes_nothing_anew(
    made: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = (made / "evidence.html").read_text()
    monkeypatch.setattr(folder_module, "drawn", lambda evidence, _: (page, evidence))
    before = read_evidence(made / "evidence.json")
    ledger = (made / "ledger.sqlite").read_bytes()
    assert certify(made.parent / "plan.yaml", out=made, workers=1) == DIFFERS
    after = read_evidence(made / "evidence.json")
    assert (made / "ledger.sqlite").read_bytes() == ledger
    assert after.claims == before.claims
    assert "searching" not in words(capsys)


def test_a_report_stands(report: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert verify(report, runs=4, seed=1, execute_programs=False) == AS_EXPECTED
    said = words(capsys)
    assert f"next: safety-harness certify seal {report}" in said
    assert "the report stands" in said
    assert "4 of 50 runs made again" in said
    assert said.count("DIFF") == 0


def test_a_changed_file_is_noticed(report: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = report / "evidence.html"
    file.write_text(file.read_text().replace("refuted", "shown"))
    assert verify(report, runs=0, seed=1, execute_programs=False) == DIFFERS
    assert "evidence.html is not the file that was written" in words(capsys)


def test_numbers_that_the_ledger_does_not_give_are_noticed_whatever_the_hashes_say(
    report: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from safety_harness.extensions.assurance.certification.folder import stored_files, write_manifest

    file = report / "evidence.json"
    found = json.loads(file.read_text())
    found["claims"][0]["outcomes"][0]["violated"] = 0
    file.write_text(json.dumps(found))
    write_manifest(report, stored_files(report))
    assert verify(report, runs=0, seed=1, execute_programs=False) == DIFFERS
    said = words(capsys)
    assert "claims[0].outcomes[0].violated: 0 in the report" in said
    assert "is not the file" not in said


def test_outcomes_that_neither_trace_nor_run_gives_are_noticed(
    report: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Somebody makes violations into successes in the ledger, and everything else anew."""
    import sqlite3

    from safety_harness.extensions.assurance.certification.folder import stored_files, write_manifest

    with sqlite3.connect(report / "ledger.sqlite") as connection:
        connection.execute("UPDATE judgement SET outcome = 0, margin = 0.1 WHERE claim = 0 AND outcome = 1")
    connection.close()
    write_manifest(report, stored_files(report))
    assert verify(report, runs=50, seed=1, execute_programs=False) == DIFFERS
    said = words(capsys)
    assert "holds then, violated now" in said
    lines = said.splitlines()
    assert any(line.startswith("DIFF") and "stored traces" in line for line in lines)
    assert any(line.startswith("DIFF") and "runs made again" in line for line in lines)


def test_since_an_earlier_report_what_got_worse_fails_and_nothing_else(
    report: Path, made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = report.with_name("report.delta") / "delta.html"
    for pair in ((made, report), (report, report)):
        assert tell_delta(*pair) == BAD_INPUT
        assert "the same runs: a comparison with itself" in words(capsys)
    assert certify(made.parent / "plan.yaml", out=report, since=report, workers=1) == BAD_INPUT
    assert "a comparison with itself" in words(capsys)
    began(report, "2099-01-01T00:00:00+00:00")
    assert tell_delta(report, made) == BAD_INPUT
    assert "expected the earlier report first" in words(capsys)
    assert tell_delta(made, report) == AS_EXPECTED
    assert "nothing changed" in words(capsys)
    assert "nothing changed" in page.read_text()
    with closing(sqlite3.connect(report / "ledger.sqlite")) as connection, connection:
        connection.execute("UPDATE judgement SET outcome = 1, margin = -0.1 WHERE claim = 1 AND stratum = 0")
    assert certify(made.parent / "plan.yaml", out=report, since=made, workers=1) == DIFFERS
    said = words(capsys)
    assert "WORSE joint speeds within limits, near: 0 % to " in said
    assert "paired by episode" in said
    assert "got worse since report" in page.read_text()
    began(report, "2001-01-01T00:00:00+00:00")
    assert tell_delta(report, made) == AS_EXPECTED


def began(report: Path, at: str) -> None:
    """Let a report's runs have begun at another time."""
    with closing(sqlite3.connect(report / "ledger.sqlite")) as connection, connection:
        connection.execute("UPDATE session SET began = ?", (at,))
    folder_module.write_manifest(report, folder_module.stored_files(report))


def test_a_report_altered_by_hand_is_held_against_nothing(
    report: Path, made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (report / "evidence.json").read_text()
    (report / "evidence.json").write_text(text.replace("near", "far", 1))
    for pair in ((report, made), (made, report)):
        assert tell_delta(*pair) == BAD_INPUT
        assert "evidence.json is not the file that was written" in words(capsys)
    plan = made.parent / "plan.yaml"
    assert certify(plan, out=report.with_name("none"), since=report, workers=1) == BAD_INPUT
    assert not report.with_name("none").exists()


def test_a_folder_that_is_no_report_is_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert verify(tmp_path, runs=1, seed=1, execute_programs=False) == BAD_INPUT
    assert "manifest.json" in words(capsys)
    (tmp_path / "manifest.json").write_text(
        '{"format": "safety-harness manifest 1", "sha256": {"../x": "0"}}'
    )
    assert verify(tmp_path, runs=1, seed=1, execute_programs=False) == BAD_INPUT
    assert "below the report's folder" in words(capsys)


def test_a_budget_that_cannot_meet_its_target_is_refused_before_anything_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan_in(tmp_path, PLAN.replace("50 %", "0.1 %"))
    assert certify(tmp_path / "plan.yaml", out=tmp_path / "report") == BAD_INPUT
    said = words(capsys)
    assert "at least 5073 runs" in said
    assert not (tmp_path / "report").exists()


def test_what_is_declared_and_sealed_is_found_again_and_nothing_else(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As a user does it: declare, lodge, certify, seal, lodge, verify."""
    monkeypatch.setattr(folder_module, "drawn", lambda evidence, _: ("the page", evidence))
    monkeypatch.setattr(verify_report, "render", lambda *_: "the page")
    plan, out = tmp_path / "plan.yaml", tmp_path / "report"
    plan_in(tmp_path, PLAN.replace("runs: 30", "runs: 12").replace("runs: 20", "runs: 12"))
    assert declare(plan, None) == AS_EXPECTED
    declared = capsys.readouterr().out.strip()
    assert certify(plan, out=out, workers=1) == DIFFERS
    assert read_evidence(out / "evidence.json").record.declaration_sha256 == declared
    assert not any("declared before" in one.text for one in read_evidence(out / "evidence.json").findings)
    capsys.readouterr()
    assert seal_report(out) == AS_EXPECTED
    sealed = capsys.readouterr().out.strip()
    assert verify(out, runs=1, seed=1, execute_programs=False) == AS_EXPECTED
    then = capsys.readouterr().err.splitlines()[-1]
    assert then == f"next: safety-harness verify {out} --seal {tmp_path.resolve()}/report.seal.json"
    assert verify(out, runs=1, seed=1, execute_programs=False, seal=sealed, declared=declared) == AS_EXPECTED
    said = words(capsys)
    assert "the report is unaltered since its seal" in said
    assert "plan, seed, avoider, targets and software are the declared ones" in said
    assert verify(out, runs=0, seed=1, execute_programs=False, seal=declared) == DIFFERS
    assert verify(out, runs=0, seed=1, execute_programs=False, declared=sealed) == DIFFERS
    assert verify(out, runs=0, seed=1, execute_programs=False, seal="what?") == BAD_INPUT
    plan.write_text(plan.read_text().replace("50 %", "49 %").replace("seed: 7", "seed: 8"))
    words(capsys)
    assert certify(plan, out=tmp_path / "other", workers=1) == BAD_INPUT
    said = words(capsys)
    assert "seed: 7 was declared, and it is 8 now" in said
    assert "target of 'hand distance never below 150 mm': 0.5 was declared, and it is 0.49 now" in said
    assert not (tmp_path / "other").exists()
    assert declare(plan, None) == BAD_INPUT
    assert "it may be lodged already" in words(capsys)
    (out / "junit.xml").write_text("<testsuites/>")
    assert seal_report(out) == DIFFERS


def test_a_changed_space_is_named(report: Path, made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = report.parent / "changed"
    plan_in(folder, SEARCHING)
    space = folder / "short.yaml"
    space.write_text(space.read_text().replace("to 2 m/s", "to 1.9 m/s"))
    shutil.copytree(made, folder / "report")
    assert certify(folder / "plan.yaml", out=folder / "report", workers=1) == BAD_INPUT
    assert "short.yaml changed" in words(capsys)


def test_an_interrupted_certification_says_what_is_missing_and_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(folder_module, "drawn", lambda evidence, _: ("the page", evidence))
    plan_in(tmp_path, PLAN.replace("runs: 30", "runs: 12").replace("runs: 20", "runs: 12"))
    real = certify_module.run_missing

    def stopping(*arguments: object, **options: object) -> bool:
        done = 0

        def enough() -> bool:
            nonlocal done
            done += 1
            return done > 3

        return real(*arguments, **(options | {"enough": enough}))  # type: ignore[arg-type]

    monkeypatch.setattr(certify_module, "run_missing", stopping)
    out = tmp_path / "report"
    assert certify(tmp_path / "plan.yaml", out=out, workers=1) == INTERRUPTED
    partial = read_evidence(out / "evidence.json")
    assert partial.interrupted
    assert partial.standing in (ClaimStatus.INCOMPLETE, ClaimStatus.UNTESTED)
    assert all(outcome.bound is None for outcome in partial.claims[0].outcomes[:1])
    monkeypatch.setattr(certify_module, "run_missing", real)
    assert certify(tmp_path / "plan.yaml", out=out, workers=1) == DIFFERS
    assert not read_evidence(out / "evidence.json").interrupted
    with Ledger.open(out / "ledger.sqlite") as ledger:
        assert next(ledger.missing(0), None) is None
    words(capsys)


def test_a_program_in_a_report_is_not_executed_unasked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(folder_module, "drawn", lambda evidence, _: ("the page", evidence))
    monkeypatch.setattr(verify_report, "render", lambda *_: "the page")
    (tmp_path / "mine.py").write_text(
        "from pathlib import Path\n"
        "from safety_harness import Proposal\n\n\n"
        "class Up:\n"
        '    name = "up"\n\n'
        "    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):\n"
        "        return Proposal(tcp_position_in_base_m + [0.0, 0.0, 0.1])\n"
    )
    text = PLAN.replace("avoider: opposite pose", "avoider: mine.py:Up")
    plan_in(tmp_path, text.replace("runs: 30", "runs: 12").replace("runs: 20", "runs: 12"))
    out = tmp_path / "report"
    assert certify(tmp_path / "plan.yaml", out=out, workers=1) == DIFFERS
    assert verify(out, runs=2, seed=1, execute_programs=False) == BAD_INPUT
    assert "--execute-programs" in words(capsys)
    assert verify(out, runs=0, seed=1, execute_programs=False) == AS_EXPECTED
    assert verify(out, runs=2, seed=1, execute_programs=True) == AS_EXPECTED


@pytest.mark.parametrize(
    ("words", "code", "told"),
    [
        (["certify", "--help"], 0, "certify declare PLAN before the runs, and certify seal REPORT after"),
        (["certify"], 2, "Missing argument 'PLAN'"),
        (
            ["certify", "declare", "--help"],
            0,
            "Print a hash of the plan, seed, avoider, targets and software",
        ),
        (["certify", "seal"], 2, "Missing argument 'REPORT'"),
        (["certify", "--pdf", "--nonsense", "plan.yaml"], 2, "--nonsense"),
        (["verify", ".", "--miss", "0"], 2, "is no chance"),
        (["verify", ".", "--miss", "often"], 2, "is no chance"),
    ],
)
def test_a_plan_is_certified_declared_or_sealed_by_one_command(
    words: list[str], code: int, told: str
) -> None:
    done = CliRunner().invoke(app, words, env={"COLUMNS": "200", "NO_COLOR": "1"})
    assert done.exit_code == code
    assert told in done.output


def test_what_no_kept_run_tried_is_named_in_the_terminal_and_among_the_findings(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A reach that comes after the end of every run; and a limit that no run comes near to."""
    late = TEXT.replace("      - reach for tcp", "      - wait: 50 s\n      - reach for tcp")
    plan_in(tmp_path, PLAN.replace("150 mm", "1 mm"), late)
    certify(tmp_path / "plan.yaml", out=tmp_path / "report", workers=1)
    out = capsys.readouterr().err
    idle = "nothing is known of: move 2 of right hand (reach for tcp); hands[0].moves[1].reach for tcp, which"
    assert f"note: near: untried in 2 kept runs of 'a hand nearby', and {idle} varies" in out
    assert "note: hand distance never below 1 mm: no run came near its limit" in out
    found = [one.text for one in read_evidence(tmp_path / "report" / "evidence.json").findings]
    assert any(idle in text for text in found)


def test_a_move_that_some_draws_begin_is_not_called_untried(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Though none of the kept runs does: one draw in thirty of the space goes on after its wait."""
    seldom = "      - one of:\n          - wait: 50 s\n          - wait: 10 ms\n        chances: [30, 1]\n"
    rare = TEXT.replace("      - reach for tcp", seldom + "      - reach for tcp")
    plan_in(tmp_path, PLAN.replace("150 mm", "1 mm"), rare)
    certify(tmp_path / "plan.yaml", out=tmp_path / "report", workers=1)
    assert "untried" not in capsys.readouterr().err
