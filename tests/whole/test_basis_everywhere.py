"""Every output with verdicts names its world, the exercised runs, and what nothing watched."""

from __future__ import annotations

import ast
import json
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from xml.etree import ElementTree

import pytest
from typer.testing import CliRunner

from safety_harness.claims.properties.tally import (
    BASIS_OF_ANSWERS,
    EXCLUSIONS,
    UNWATCHED,
    UNWATCHED_IN_LOGS,
    basis,
)
from safety_harness.cli.fuzz import fuzz
from safety_harness.cli.main import app
from safety_harness.cli.scenario_commands import judge, run
from safety_harness.extensions.assurance.campaign.identity import Identity
from safety_harness.extensions.assurance.certification.delta import delta_between
from safety_harness.extensions.assurance.certification.delta_page import render as delta_page
from safety_harness.extensions.assurance.certification.folder import junit_xml
from safety_harness.extensions.assurance.certification.page import render as evidence_page
from safety_harness.extensions.assurance.commands import campaign
from safety_harness.extensions.assurance.commands.certify import certify, verify
from safety_harness.extensions.assurance.commands.history import history
from safety_harness.extensions.pages.commands.drawing import view
from safety_harness.search import session as search_session
from tests.assurance.campaign.plans import plan_in
from tests.assurance.certification.made_up_evidence import evidence
from tests.basis import rests_on
from tests.cli.test_own_avoider import VISIT
from tests.search.short_space import TEXT
from tests.whole.test_overruled_everywhere import PLAN

ROOT = Path(__file__).parents[2]


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_the_sentence_has_the_least_and_the_most_exercised_claim() -> None:
    said = basis(["PyBullet"], [(3, 12), (12, 12), (5, 12)])
    for counts, words in (
        ([(3, 12), (12, 12), (5, 12)], "claims exercised in 3 to 12 of 12 runs"),
        ([(0, 1), (1, 1)], "claims exercised in 0 to 1 of 1 runs"),
        ([(2, 2), (0, 1)], "claims exercised in 0 of 1 to 2 of 2 runs"),
        ([(1, 1), (1, 2)], "claims exercised in 1 of 2 to 1 of 1 runs"),
        ([(1, 1), (2, 2)], "claims exercised in 1 of 1 to 2 of 2 runs"),
        ([(7, 7), (7, 7)], "claims exercised in 7 of 7 runs"),
        ([], "no claim was exercised"),
    ):
        assert basis(["PyBullet"], counts).startswith(f"Basis: in PyBullet; {words}; nothing watched: ")
    assert rests_on(said, "PyBullet")
    assert not rests_on(said, "the kinematic world")
    assert not rests_on(said.replace("how the arm brakes", ""), "PyBullet")
    assert not rests_on(basis(["PyBullet"], "no run was made"), "PyBullet")
    both = basis(["PyBullet", "a log", "PyBullet"], [(0, 1)])
    assert both.startswith("Basis: in PyBullet and in a log; claims exercised in 0 of 1 runs; ")


def test_what_nothing_watches_is_what_the_report_excludes() -> None:
    assert set(EXCLUSIONS) < set(UNWATCHED)
    assert not any("sensors and their failures" in one for one in UNWATCHED_IN_LOGS)  # a log has real ones
    assert "no world; no run was made; nothing watched: what a run does with the answers" in BASIS_OF_ANSWERS


def test_run_judge_view_and_history_say_it_in_the_terminal_and_in_every_file(
    capsys: pytest.CaptureFixture[str],
) -> None:
    world = "the kinematic world"
    Path("visit.yaml").write_text(VISIT)
    run([Path("visit.yaml")], Path("out/1"), world="kinematic")
    assert (
        f"Basis: in {world}; claims exercised in 1 of 1 runs; what nothing watched: "
        in capsys.readouterr().err
    )
    run([Path("visit.yaml")], Path("out/1"), world="kinematic", verbose=True)
    assert rests_on(capsys.readouterr().err, world)
    traces = sorted(Path("out/1/traces").glob("*.trace"))
    judge(traces, out=Path("out/2"), verbose=True)
    assert rests_on(capsys.readouterr().err, world)
    for folder in ("out/1", "out/2"):
        for name in ("report.html", "summary.md"):
            assert rests_on(Path(folder, name).read_text(), world), name
        assert rests_on(json.loads(Path(folder, "report.json").read_text())["basis"], world)
        (found,) = json.loads(Path(folder, "report.sarif").read_text())["runs"]
        assert rests_on(found["properties"]["basis"], world)
    view(traces[0], out=Path("view.html"), opens=False)
    assert rests_on(Path("view.html").read_text(), world)
    capsys.readouterr()
    history(Path("out"), out=Path("history.html"))
    assert rests_on(capsys.readouterr().err, world)
    assert rests_on(Path("history.html").read_text(), world)


def test_fuzz_says_it(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(search_session, "SHRINKING_RUNS", 2)
    Path("short.yaml").write_text(TEXT)
    fuzz(Path("short.yaml"), out=Path("out"), budget=4, verbose=True)
    said = [capsys.readouterr().out, Path("out/fuzz.html").read_text(), Path("out/findings.json").read_text()]
    assert all(rests_on(one, "the kinematic world and in PyBullet and in MuJoCo") for one in said)


def test_campaigns_say_it_while_they_stand_and_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    world = "the kinematic world"
    plan_in(tmp_path, PLAN.replace("AVOIDER", "opposite pose").replace("WORLD", "kinematic"), TEXT)
    ledgers = [Path("one.sqlite"), Path("other.sqlite")]
    said: list[str] = []
    for ledger in ledgers:
        campaign.run(Path("plan.yaml"), ledger=ledger, workers=1)
        said.append(capsys.readouterr().out)
    campaign.status(ledgers[0], html=Path("status.html"))
    said += [capsys.readouterr().out, Path("status.html").read_text(), Path("one.html").read_text()]
    campaign.compare(*ledgers)
    said.append(compared := capsys.readouterr().out)
    assert all(rests_on(one, world) for one in said)
    assert compared.count("Basis: ") == 2
    campaign.pilot_runs(Path("plan.yaml"), runs=2)
    assert rests_on(capsys.readouterr().out, world)


def test_certify_and_verify_say_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan_in(tmp_path, PLAN.replace("AVOIDER", "opposite pose").replace("WORLD", "kinematic"), TEXT)
    certify(Path("plan.yaml"), out=Path("report"), workers=1)
    said = [capsys.readouterr().out, Path("report/evidence.html").read_text()]
    verify(Path("report"), runs=0, seed=1)
    said.append(capsys.readouterr().out)
    assert all(rests_on(one, "the kinematic world") for one in said)


def test_every_case_of_a_certified_junit_file_says_it_of_its_own_runs() -> None:
    one = evidence()
    cases = list(ElementTree.fromstring(junit_xml(one).split("\n", 1)[1]).iter("testcase"))
    assert len(cases) == sum(len(claim.outcomes) for claim in one.claims)
    outcomes = {(out.stratum, claim.sentence): out for claim in one.claims for out in claim.outcomes}
    for case in cases:
        out = outcomes[case.get("classname", ""), case.get("name", "")]
        said = case.findtext("system-out", "")
        assert rests_on(said, one.plan.world)
        assert f"exercised in {out.tested - out.failed} of {out.runs} runs" in said


def test_a_delta_says_it_of_both_reports() -> None:
    one = evidence()
    model = replace(one, plan=replace(one.plan, world="kinematic", model_only=True))
    nothing = (Identity(()), Identity(()))
    found = delta_between(one, model, names=("old", "new"), identities=nothing, paired={})
    page = delta_page(found, command="again", generated_at=datetime(2026, 11, 26, tzinfo=UTC))
    for text in (page, " ".join(found.bases), found.as_text()):
        assert rests_on(text, one.plan.world)
        assert rests_on(text, "the kinematic world")
    assert rests_on(evidence_page(model, {}), "the kinematic world")


def test_a_monitor_says_it_at_the_end(tmp_path: Path) -> None:
    claim = "always hand distance > 50 mm"
    lines = [
        {
            "time_s": 0.008 * k,
            "joint_position_rad": [0, -1.2, 1.9, -2.2, -1.5, 0],
            "hands": {
                "hand": {
                    "hand_position_in_base_m": [0.9, 0.1, 0.3],
                    "elbow_position_in_base_m": [1.2, 0.1, 0.4],
                }
            },
        }
        for k in range(10)
    ]
    stream = "".join(json.dumps(line) + "\n" for line in lines)
    found = CliRunner().invoke(app, ["monitor", "--robot", "ur10", "--claim", claim], input=stream)
    assert rests_on(found.stderr, "a stream of a cell", unwatched=UNWATCHED_IN_LOGS)


WITHOUT_VERDICTS = {"extensions/arms/page.py"}  # shows arms


def test_no_page_is_made_without_a_basis_and_each_template_places_it() -> None:
    """``render_page`` asks for it; a page's own layout has to show it."""
    empty = [
        file.relative_to(ROOT / "safety_harness").as_posix()
        for file in (ROOT / "safety_harness").rglob("*.py")
        for call in ast.walk(ast.parse(file.read_text()))
        if isinstance(call, ast.Call) and getattr(call.func, "id", "") == "render_page"
        for word in call.keywords
        if word.arg == "basis" and isinstance(word.value, ast.Constant)
    ]
    assert set(empty) == WITHOUT_VERDICTS
    templates = sorted((ROOT / "safety_harness").rglob("*.html.j2"))
    assert len(templates) > 10
    for file in templates:
        text = file.read_text()
        own_layout = "{% block page %}" in text
        if own_layout and file.name != "arms.html.j2":
            assert "{{ basis }}" in text, file.name
