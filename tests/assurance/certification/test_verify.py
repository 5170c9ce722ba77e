"""What verify sees of a report that was touched, whatever else was made anew to fit."""

from __future__ import annotations

import json
import platform
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
from once import replayed_once  # noqa: F401
from scipy.stats import binomtest

from safety_harness.base.exceptions import CampaignError, InputError
from safety_harness.extensions.assurance.campaign.episodes import EpisodeRunner
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.campaign.session import LEDGER, plan_of, processes, run_missing
from safety_harness.extensions.assurance.certification import folder, verify_report
from safety_harness.extensions.assurance.certification.altered import Turn, chance_to_miss
from safety_harness.extensions.assurance.certification.evidence import (
    ClaimStatus,
    WhoseFault,
    as_text,
    read_evidence,
)
from safety_harness.extensions.assurance.certification.folder import (
    stored_files,
    write_folder,
    write_manifest,
)
from safety_harness.extensions.assurance.certification.gather import gather
from safety_harness.extensions.assurance.certification.lodged import declaration_of, write_seal
from safety_harness.extensions.assurance.certification.page import render
from safety_harness.extensions.assurance.certification.verify import verify
from safety_harness.extensions.assurance.certification.verify_files import Examination, ReportFolder
from safety_harness.extensions.assurance.certification.verify_runs import (
    MOST_AGAIN,
    Drawing,
    drawn,
    programs_in,
)
from tests.assurance.campaign.plans import PLAN, plan_in
from tests.search.short_space import TEXT

pytestmark = pytest.mark.usefixtures("replayed_once")
SMALL = PLAN.replace("runs: 30", "runs: 10").replace("runs: 20", "runs: 6")


def write(report: Path) -> None:
    """The whole report anew, from what the ledger says now."""
    with Ledger.open(report / LEDGER) as ledger, plan_of(ledger) as plan:
        gathered = gather(plan, ledger, report, command="safety-harness certify plan.yaml")
        evidence = write_folder(report, gathered, ledger)
    write_manifest(report, evidence.files)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    report = tmp_path_factory.mktemp("verified") / "report"
    assert run_missing(plan_in(report.parent, SMALL), report / LEDGER, processes(1))
    write(report)
    return report


@pytest.fixture
def report(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy to be touched; its page is what was written, without the seconds that drawing it again takes."""
    page = (made / "evidence.html").read_text()
    monkeypatch.setattr(verify_report, "render", lambda *_: page)
    monkeypatch.setattr(folder, "drawn", lambda evidence, _: (page, evidence))
    return Path(shutil.copytree(made, tmp_path / "report"))


def faults(report: Path, *, runs: int = 0) -> str:
    return "\n".join(line for check in verify(report, runs=runs, seed=1) for line in check.faults)


def change(report: Path, *statements: str) -> None:
    with closing(sqlite3.connect(report / LEDGER)) as connection, connection:
        for statement in statements:
            connection.execute(statement)


def test_a_report_stands_with_every_part_of_it_made_again(
    report: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(verify_report, "render", render)
    with Ledger.open(report / LEDGER) as ledger, plan_of(ledger) as plan:
        declared = declaration_of(plan).sha256
    checks = list(verify(report, seed=1, seal=write_seal(report).sha256, declared=declared))
    assert [fault for check in checks for fault in check.faults] == []
    names = [check.name for check in checks]
    assert names == ["files", "ledger", "plan", "stored traces", "numbers", "pages", "runs", "lodged"]
    assert not any(check.unchecked for check in checks)


def test_it_says_how_few_rows_turn_a_verdict_and_repeats_as_many_as_its_chance_asks(report: Path) -> None:
    def runs(**options: object) -> Examination:
        checks = verify(report, seed=1, **options)  # type: ignore[arg-type]
        return next(check for check in checks if check.name == "runs")

    whole, few = runs(miss=0.1), runs(runs=2)
    assert whole.looked_at.startswith("15 of 16 runs made again")
    assert "one altered row would turn 'refuted'" in whole.notes[0]
    assert "a chance of 6.25 %" in whole.notes[0]
    assert not whole.unchecked
    assert few.looked_at.startswith("2 of 16 runs made again")
    assert "stay unseen with a chance of up to 87.5 %; for 1 % it needs --runs 16" in few.unchecked[0]


def test_more_runs_than_some_minutes_take_are_made_only_when_asked_for() -> None:
    turns = [Turn("a claim", "all", ClaimStatus.NOT_SHOWN, 1)]
    drawing = Drawing(runs=None, miss=0.01, seed=1)
    assert drawing.number(12_000, turns) == MOST_AGAIN
    _, (left_open,) = drawing.miss_chances(12_000, MOST_AGAIN, turns, each_s=0.25)
    assert "up to 91.7 %; for 1 % it needs --runs 11880, some 50 min" in left_open
    assert replace(drawing, runs=11_880).number(12_000, turns) == 11_880
    assert drawing.miss_chances(12_000, 11_880, turns, each_s=0.25)[1] == ()


def test_altered_rows_are_drawn_as_often_as_it_says() -> None:
    """Ten of 600, by 200 seeds: the counts that a chance of one in a thousand leaves."""
    again, altered = 80, set(range(0, 600, 60))
    missed = sum(altered.isdisjoint(drawn(600, again, seed)) for seed in range(200))
    exactly = chance_to_miss(600, len(altered), again)
    assert binomtest(missed, 200, exactly).pvalue > 1e-3


LEDGERS: dict[str, tuple[tuple[str, ...], str]] = {
    "runs without their rows": (
        ("DELETE FROM episode WHERE episode > 3", "DELETE FROM trace WHERE episode > 3"),
        "runs are in the table judgement and not in episode",
    ),
    "runs without a judgement": (
        ("DELETE FROM judgement WHERE episode = 3 AND claim = 1",),
        "not judged by every claim once",
    ),
    "no run": (
        ("DELETE FROM judgement", "DELETE FROM episode", "DELETE FROM trace"),
        "there is no run in it",
    ),
    "runs beyond the plan": (
        ("UPDATE stratum SET planned = 5 WHERE id = 1",),
        "rows of the table run are of no declared run",
    ),
    "words for a number": (("UPDATE judgement SET margin = 'much' WHERE episode = 2",), "of another kind"),
    "an outcome that is none": (
        ("UPDATE judgement SET outcome = 9 WHERE episode = 2",),
        "unknown outcomes",
    ),
    "another file of the plan": (
        (
            "UPDATE file SET data = CAST(replace(CAST(data AS TEXT), '50 %', '49 %') AS BLOB) "
            "WHERE name = 'plan.yaml'",
        ),
        "the file plan.yaml changed: the ledger declares another",
    ),
    "a Python that made no trace": (
        (f"UPDATE about SET value = replace(value, '\"{platform.python_version()}\"', '\"3.0.0\"')",),
        "its trace comes from other software, or from another world",
    ),
    "another seed": (
        ("UPDATE about SET value = replace(value, '\"seed\": 7', '\"seed\": 8') WHERE key = 'plan'",),
        "seed: the ledger and its plan disagree",
    ),
    "a plan that may stop early": (
        (
            "UPDATE about SET value = replace(value, 'early\": false', 'early\": true') WHERE key = 'plan'",
            "DELETE FROM judgement WHERE episode > 6",
            "DELETE FROM episode WHERE episode > 6",
            "DELETE FROM trace WHERE episode > 6",
        ),
        "stop early: the ledger and its plan disagree",
    ),
    "a stratum that was stopped": (
        (
            "UPDATE stratum SET stopped_after = 4 WHERE id = 0",
            "DELETE FROM judgement WHERE stratum = 0 AND episode > 3",
            "DELETE FROM episode WHERE stratum = 0 AND episode > 3",
            "DELETE FROM trace WHERE stratum = 0 AND episode > 3",
        ),
        "near: stopped after 4 runs, which do not decide it",
    ),
    "another target": (
        ("UPDATE claim SET target = 0.4 WHERE id = 0",),
        "targets: the ledger and its plan disagree",
    ),
    "a view for a table": (
        ("ALTER TABLE session RENAME TO s", "CREATE VIEW session AS SELECT * FROM s"),
        "expected a ledger's own tables",
    ),
    "a trace that is gone": (
        ("DELETE FROM trace WHERE violation AND episode = (SELECT min(episode) FROM trace WHERE violation)",),
        "the ledger lacks its trace, which the plan keeps",
    ),
    "a trace of another run": (
        (
            "UPDATE trace SET data = (SELECT data FROM trace t WHERE t.violation AND t.stratum = 0 "
            "ORDER BY episode DESC LIMIT 1) WHERE violation AND stratum = 0",
        ),
        "its trace is of another scenario than the plan draws for it",
    ),
    "a violation that is no more": (
        (
            "UPDATE trace SET violation = 0",
            "UPDATE judgement SET outcome = 0, margin = -margin WHERE outcome = 1 AND margin < 0",
        ),
        "hand distance never below 150 mm: holds then, violated now",
    ),
    "a margin that is better": (
        ("UPDATE judgement SET margin = margin + 0.05 WHERE outcome = 0 AND claim = 0",),
        "hand distance never below 150 mm: a margin of",
    ),
    "other seeds": (("UPDATE episode SET seed = seed + 1",), "its seed is not the plan's"),
    "other reasons of the gate": (
        ("UPDATE episode SET overruled_uncertain = overruled_uncertain + 1",),
        "its draws, decisions, cell or mishap differ",
    ),
    "proposals that were never made": (
        ("UPDATE episode SET proposals = proposals + 1",),
        "impossible counts",
    ),
    "fewer stops": (
        ("UPDATE episode SET opposite = opposite + 1, decisions = decisions + 1",),
        "its draws, decisions, cell or mishap differ",
    ),
}


@pytest.mark.parametrize(("statements", "said"), LEDGERS.values(), ids=LEDGERS.keys())
def test_a_ledger_that_was_touched_does_not_stand(
    report: Path, statements: tuple[str, ...], said: str
) -> None:
    change(report, *statements)
    write_manifest(report, stored_files(report))
    assert said in faults(report)


def test_a_report_made_anew_from_a_ledger_without_a_trace_does_not_stand(report: Path) -> None:
    change(report, "DELETE FROM trace WHERE violation")
    write(report)
    assert "the ledger lacks its trace, which the plan keeps" in faults(report)


def test_outcomes_of_runs_without_a_trace_are_noticed_by_making_them_again(report: Path) -> None:
    kept = "SELECT 1 FROM trace t WHERE t.stratum = e.stratum AND t.episode = e.episode"
    change(report, f"UPDATE episode AS e SET cell = NULL WHERE NOT EXISTS ({kept})")
    write(report)
    assert "its draws, decisions, cell or mishap differ" in faults(report, runs=16)


def test_a_damaged_ledger_is_a_report_that_does_not_stand(report: Path) -> None:
    file = report / LEDGER
    file.write_bytes(file.read_bytes()[:5_000])
    *_, last = verify(report, runs=1, seed=1)
    assert not last.stands
    assert last.unchecked
    assert "truncated" in last.faults[0]


def edited(report: Path, **parts: object) -> None:
    """The evidence with other parts, and the rest of the report made anew of it."""
    evidence = replace(read_evidence(report / "evidence.json"), **parts)  # type: ignore[arg-type]
    (report / "evidence.json").write_text(as_text(evidence))
    write_manifest(report, stored_files(report))


@pytest.mark.parametrize(
    ("parts", "said"),
    [
        ({"standing": ClaimStatus.SHOWN}, "standing: "),
        ({"findings": ()}, "findings: 0 of them in the report"),
        ({"counterexamples": ()}, "counterexamples: 0 of them"),
        ({"strata": ()}, "strata: 0 of them"),
        ({"overruling": ()}, "overruling: 0 of them"),
        ({"interrupted": True}, "interrupted: True in the report"),
        ({"files": ()}, "and the manifest list different files"),
        ({"assumptions": ("none",)}, "assumptions: 1 of them"),
        ({"provenance": "rm -rf ~"}, "a command that certify does not write"),
        ({"provenance": "safety-harness verify x; rm -rf ~"}, "has a command that certify does not write"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_what_does_not_follow_from_the_ledger_is_noticed(
    report: Path, parts: dict[str, object], said: str
) -> None:
    if "provenance" in parts:
        origin = read_evidence(report / "evidence.json").provenance
        parts = {"provenance": replace(origin, command=parts["provenance"])}
    edited(report, **parts)
    assert said in faults(report)


def test_faults_that_do_not_come_out_again_are_noticed_where_runs_are_made_again(report: Path) -> None:
    edited(report, whose_fault=WhoseFault(about="1 of 1", groups=(("hand", 1),), would_help=()))
    assert "whose_fault.groups" in faults(report, runs=1)


def test_words_that_other_software_writes_otherwise_are_no_fault(
    report: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    claims = read_evidence(report / "evidence.json").claims
    reworded = tuple(replace(claim, rationale="In other words.", terms=()) for claim in claims)
    edited(report, claims=reworded)
    assert "claims[0].rationale: In other words." in faults(report)
    monkeypatch.setattr(ReportFolder, "same", False)  # another Python, say: it writes no words
    assert "claims[0].rationale: In other words." in faults(report)
    monkeypatch.setattr(ReportFolder, "same_words", False)
    found: dict[str, Examination] = {check.name: check for check in verify(report, runs=0, seed=1)}
    assert found["numbers"].stands
    assert any("claims[0].rationale" in one for one in found["numbers"].unchecked)
    assert found["pages"].stands
    edited(report, claims=tuple(replace(claim, target=0.6) for claim in claims))
    assert "claims[0].target" in faults(report)


def listed(report: Path) -> dict[str, str]:
    found: dict[str, str] = json.loads((report / "manifest.json").read_text())["sha256"]
    return found


def with_manifest(report: Path, hashes: dict[str, str]) -> None:
    document = {"format": "safety-harness manifest 1", "sha256": hashes}
    (report / "manifest.json").write_text(json.dumps(document))


def put(name: str, text: str = "x") -> Callable[[Path], None]:
    return lambda report: (report / name).write_text(text) and None


def shown(name: str, was: str, now: str) -> Callable[[Path], None]:
    """Another text in a file, and a manifest that fits."""

    def touch(report: Path) -> None:
        text = (report / name).read_text()
        assert was in text
        (report / name).write_text(text.replace(was, now))
        write_manifest(report, stored_files(report))

    return touch


def beside_the_plan(report: Path) -> None:
    """A file more, and a manifest that fits."""
    (report / "plan" / "more.yaml").write_text("x")
    write_manifest(report, stored_files(report))


FILES: dict[str, tuple[Callable[[Path], None], str]] = {
    "an empty manifest": (lambda report: with_manifest(report, {}), "evidence.html is not in the manifest"),
    "a file too many": (put("more.txt"), "more.txt is not in the manifest"),
    "a file too few": (lambda report: (report / "junit.xml").unlink(), "junit.xml is missing"),
    "a log of changes": (put("ledger.sqlite-wal"), "changes that the ledger lacks"),
    "another plan in the folder": (
        shown("plan/plan.yaml", "50 %", "1 %"),
        "plan/plan.yaml is not the ledger's",
    ),
    "a file beside the plan": (beside_the_plan, "plan/more.yaml is no file of the ledger's plan"),
    "JUnit XML": (
        shown("junit.xml", "<failure", "<skipped"),
        "junit.xml and evidence.json disagree",
    ),
    "the page": (
        shown("evidence.html", "It is no certificate", "It is a certificate"),
        "evidence.html and evidence.json disagree",
    ),
}


@pytest.mark.parametrize(("touch", "said"), FILES.values(), ids=FILES.keys())
def test_a_folder_that_was_touched_does_not_stand(
    report: Path, touch: Callable[[Path], None], said: str
) -> None:
    touch(report)
    assert said in faults(report)


@pytest.mark.parametrize("name", ["/etc/passwd", "../x", "plan/../evidence.json", "./x", "a\0b", ""])
def test_names_that_lead_elsewhere_are_refused(report: Path, name: str) -> None:
    with_manifest(report, listed(report) | {name: "0" * 64})
    with pytest.raises(InputError, match="below the report's folder"):
        list(verify(report))


@pytest.mark.parametrize("name", ["evidence.json", "manifest.json", LEDGER, "plan/plan.yaml"])
def test_a_file_of_a_report_that_is_damaged_is_told_in_order(report: Path, name: str) -> None:
    """Cut, flipped or filled with brackets, with a manifest that fits; all is seen that needs no run."""
    whole, before = (report / name).read_bytes(), read_evidence(report / "evidence.json")
    refused = 0
    for k in range(2):
        at = (2 * k + 1) * len(whole) // 4
        flipped = whole[:at] + bytes([whole[at] ^ 1 << k]) + whole[at + 1 :]
        for data in (whole[:at], flipped, whole[:at] + b"[" * 50_000 + whole[at:]):
            (report / name).write_bytes(data)
            if name != "manifest.json":
                write_manifest(report, stored_files(report))
            try:
                stands = all(check.stands for check in verify(report, runs=0, seed=1))
            except InputError:
                refused += 1
                continue
            if stands:
                assert name == "evidence.json"
                now = read_evidence(report / name)
                assert replace(now, credibility=before.credibility) == before
    assert (refused > 0) == (name == "manifest.json")


PROGRAM = """\
from pathlib import Path
Path({mark!r}).write_text("executed")


class Up:
    name = "up"
"""
SEEN = "avoider: one of mine.py:Up, opposite pose"
HIDDEN = "choices:\n  about:\n    one of: [mine.py:Up, opposite pose]\navoider: the about"


def with_program(theirs: Path, avoider: str) -> Plan:
    """A plan of which some draws name a program that leaves a mark where it is executed."""
    theirs.mkdir()
    (theirs / "mine.py").write_text(PROGRAM.format(mark=str(theirs / "mark")))
    text = SMALL.replace("avoider: opposite pose\n", "")
    return plan_in(theirs, text, TEXT.replace("avoider: opposite pose", avoider))


def test_a_program_that_only_some_draws_name_is_seen_before_anything_is_run(tmp_path: Path) -> None:
    assert programs_in(with_program(tmp_path / "theirs", SEEN)) == ["mine.py:Up"]
    assert programs_in(plan_in(tmp_path / "ours", SMALL)) == []


@pytest.mark.parametrize("avoider", [SEEN, HIDDEN])
def test_no_draw_is_executed_unasked_wherever_it_names_a_program(tmp_path: Path, avoider: str) -> None:
    bench = EpisodeRunner(with_program(tmp_path / "theirs", avoider), programs=False)
    refused = 0
    for episode in range(8):
        try:
            list(bench.run(0, [episode]))
        except CampaignError as error:
            refused += "names a program" in str(error)
    assert 0 < refused < 8
    assert not (tmp_path / "theirs" / "mark").exists()


def test_largest_differences_of_other_lists_are_a_fault_and_no_traceback() -> None:
    found = list(verify_report._differences({"largest": (("claim", "1 mm"),)}, {"largest": ()}, "reruns[0]"))
    assert [place for place, _, _ in found] == ["reruns[0].largest"]
    assert not any(verify_report._is_close(was, new) for _, was, new in found)
    assert verify_report._is_close("1.00 mm", "1.04 mm")
