"""campaign: from plan to bounds, through interruptions, questions, comparisons and merges."""

from __future__ import annotations

import csv
import io
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import pytest
from typer.testing import CliRunner

from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, DIFFERS, INTERRUPTED
from safety_harness.cli.main import app
from safety_harness.extensions.assurance.campaign.episodes import failed_row
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.rows import ClaimJudgement, Row
from safety_harness.extensions.assurance.campaign.summary import fingerprint_of, tally_of
from safety_harness.extensions.assurance.campaign.watch import AvoiderWatch
from safety_harness.extensions.assurance.certification.folder import write_manifest
from safety_harness.extensions.assurance.commands.campaign import (
    RareWay,
    compare,
    export,
    merge,
    query,
    rare_violations,
    resume,
    run,
    status,
)
from safety_harness.extensions.assurance.statistics import importance
from safety_harness.extensions.assurance.statistics.rounding import rounded_up
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome
from safety_harness.trace.store import load_trace
from tests.assurance.campaign.benches import row_of
from tests.assurance.campaign.plans import PLAN, ledger_in, plan_in
from tests.search.short_space import TEXT

SMALL = PLAN.replace("runs: 30", "runs: 10").replace("runs: 20", "runs: 6")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small campaign, run once."""
    folder = tmp_path_factory.mktemp("campaign")
    plan_in(folder, SMALL)
    assert run(folder / "plan.yaml", ledger=folder / "ledger.sqlite", workers=2) == AS_EXPECTED
    return folder


def test_a_plan_is_run_to_its_bounds(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert status(folder / "ledger.sqlite") == AS_EXPECTED
    out = capsys.readouterr().out
    assert "episodes 16/16 in kinematic: near 10/10; nearer 6/6" in out
    assert "all 8 bounds, two a line, hold together with 95 % confidence, each line alone with 98.75 %" in out
    assert "near: hand distance never below 150 mm" in out
    assert "NOT shown" in out
    assert "model only" in out
    assert "fingerprint" in out
    assert "near: hand distance" not in (folder / "ledger.html").read_text()  # a table, and no lines
    assert "0 of 2 targets shown" in (folder / "ledger.html").read_text()


def test_status_writes_the_page_where_it_is_told_to(folder: Path, tmp_path: Path) -> None:
    ledger = str(folder / "ledger.sqlite")
    done = CliRunner().invoke(app, ["campaign", "status", ledger, "--html", str(tmp_path / "page.html")])
    assert done.exit_code == 0
    assert "targets shown" in (tmp_path / "page.html").read_text()
    assert CliRunner().invoke(app, ["campaign", "status", ledger, "--html", str(tmp_path)]).exit_code == 2


def test_a_complete_campaign_is_not_run_again(folder: Path) -> None:
    before = (folder / "ledger.sqlite").read_bytes()
    assert run(folder / "plan.yaml", ledger=folder / "ledger.sqlite") == AS_EXPECTED
    assert resume(folder / "ledger.sqlite") == AS_EXPECTED
    assert (folder / "ledger.sqlite").read_bytes() == before


def test_a_gate_that_requires_what_is_asked_to_be_shown_fails_where_it_is_not(
    folder: Path, tmp_path: Path
) -> None:
    """Complete is not shown, of a kinematic world nothing is, and a plan without a target shows nothing."""
    gate = ["campaign", "run", str(folder / "plan.yaml"), "--ledger", str(folder / "ledger.sqlite")]
    assert CliRunner().invoke(app, gate).exit_code == AS_EXPECTED
    assert CliRunner().invoke(app, [*gate, "--require-shown"]).exit_code == DIFFERS
    easy = SMALL.replace("kinematic", "PyBullet").replace("runs: 6", "runs: 10")
    easy = easy.replace("hand distance never below 150 mm", "TCP speed never above 2000 mm/s")
    plan_in(tmp_path, easy)
    gate = ["campaign", "run", str(tmp_path / "plan.yaml"), "--ledger", str(tmp_path / "ledger.sqlite")]
    assert CliRunner().invoke(app, [*gate, "--require-shown"]).exit_code == AS_EXPECTED
    (tmp_path / "none.yaml").write_text(easy.replace("    violated in at most: 50 %\n", ""))
    none = ["campaign", "run", str(tmp_path / "none.yaml"), "--ledger", str(tmp_path / "none.sqlite")]
    assert CliRunner().invoke(app, [*none, "--require-shown"]).exit_code == BAD_INPUT


def test_a_finished_report_gets_no_file_from_its_ledger(folder: Path, tmp_path: Path) -> None:
    """``verify`` would call it different."""
    report = Path(shutil.copytree(folder, tmp_path / "report"))
    (report / "ledger.html").unlink()
    write_manifest(report, ())
    gate = ["campaign", "run", str(folder / "plan.yaml"), "--ledger", str(report / "ledger.sqlite")]
    assert CliRunner().invoke(app, gate).exit_code == AS_EXPECTED
    assert not (report / "ledger.html").exists()


def test_why_episodes_failed_is_said_the_most_frequent_reason_first(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = plan_in(tmp_path, SMALL)
    with Ledger.create(tmp_path / "ledger.sqlite", plan) as ledger:
        ledger.record(row_of(0, k) for k in range(1, 10))
        ledger.record([failed_row(plan, 0, 0, "the avoider is gone")])
        odd = "an error of the harness itself: \x1b[2J"
        ledger.record(failed_row(plan, 1, k, odd) for k in range(6))
    assert status(ledger.path) == AS_EXPECTED
    tested, *lines = capsys.readouterr().out.splitlines()
    assert tested == "tested in near, nearer: avoider opposite pose"
    assert "near 10/10, 1 FAILED TO RUN; nearer 6/6, 6 FAILED TO RUN" in lines[1]
    assert lines[2] == "  6 times: an error of the harness itself: ?[2J (first in nearer, episode 0)"
    assert lines[3] == "  1 times: the avoider is gone (first in near, episode 0)"
    assert resume(ledger.path) == DIFFERS


def rows(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def test_questions_by_filters_and_in_sql(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ledger = folder / "ledger.sqlite"
    assert query(ledger, claim="hand distance", stratum="near", below="0 mm") == AS_EXPECTED
    found = rows(capsys.readouterr().out)
    assert found
    assert {row["outcome"] for row in found} == {"violated"}
    assert {row["stratum"] for row in found} == {"near"}
    margins = [float(row["margin"]) for row in found]
    assert margins == sorted(margins)
    assert query(ledger, outcome="violated", stratum="near") == AS_EXPECTED
    assert len(rows(capsys.readouterr().out)) == len(found)
    assert query(ledger, "SELECT count(*) AS n FROM episodes") == AS_EXPECTED
    assert capsys.readouterr().out == "n\n16\n"


@pytest.mark.parametrize(
    ("sql", "options"),
    [
        ("DROP TABLE episode", {}),
        ("ATTACH 'other.sqlite' AS other", {}),
        ("PRAGMA user_version = 9", {}),
        ("SELECT nothing FROM nowhere", {}),
        ("", {}),
        ("SELECT 1; SELECT 2", {}),
        (None, {"claim": "happiness"}),
        (None, {"below": "10 mm"}),
        (None, {"claim": "hand distance", "below": "10 kg"}),
        (None, {"stratum": "ne"}),
    ],
)
def test_a_question_that_cannot_be_answered_changes_nothing(
    folder: Path, sql: str | None, options: dict[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    before = (folder / "ledger.sqlite").read_bytes()
    assert query(folder / "ledger.sqlite", sql, **options) == BAD_INPUT
    assert "expected" in capsys.readouterr().err
    assert (folder / "ledger.sqlite").read_bytes() == before
    assert not Path("other.sqlite").exists()


def test_tables_and_traces_for_others(folder: Path, tmp_path: Path) -> None:
    from pyarrow import parquet

    ledger = folder / "ledger.sqlite"
    assert export(ledger, tmp_path / "a.csv", tmp_path / "traces") == AS_EXPECTED
    assert export(ledger, tmp_path / "a.parquet", None) == AS_EXPECTED
    lines = rows((tmp_path / "a.csv").read_text())
    table = parquet.read_table(tmp_path / "a.parquet").to_pylist()
    assert len(lines) == len(table) == 32
    for line, row in zip(lines, table, strict=True):
        assert {key: "" if value is None else str(value) for key, value in row.items()} == line
    traces = sorted((tmp_path / "traces").glob("*.trace"))
    assert len(traces) == len(Ledger.open(ledger).traces())
    assert load_trace(traces[0]).scenario.name.startswith("short#")
    assert export(ledger, tmp_path / "a.xlsx", None) == BAD_INPUT
    assert export(ledger, None, None) == BAD_INPUT


def test_two_avoiders_are_compared_on_the_same_episodes(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan_in(tmp_path, SMALL.replace("opposite pose", "nearest candidate"))
    other = tmp_path / "ledger.sqlite"
    assert run(tmp_path / "plan.yaml", ledger=other, workers=1) == AS_EXPECTED
    capsys.readouterr()
    assert compare(folder / "ledger.sqlite", other) == AS_EXPECTED  # 16 episodes show nothing
    out = capsys.readouterr().out
    assert "near: hand distance never below 150 mm: violated" in out
    assert "more often (from" in out
    assert "the 4 intervals hold together with 95 % confidence, each alone with 98.75 %" in out
    assert compare(folder / "ledger.sqlite", folder / "ledger.sqlite") == BAD_INPUT
    assert "the same runs: a comparison with itself" in capsys.readouterr().err


def test_a_campaign_is_held_against_an_avoider_without_a_plan_of_its_own(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = tmp_path / "mine.sqlite"
    mine.write_bytes((folder / "ledger.sqlite").read_bytes())
    assert compare(mine) == BAD_INPUT
    assert compare(mine, mine, against="nearest candidate") == BAD_INPUT
    capsys.readouterr()
    for _ in ("run", "there already"):
        assert compare(mine, against="nearest candidate", workers=1) == AS_EXPECTED
        assert "mine.sqlite violates a claim that" in capsys.readouterr().out
    with Ledger.open(tmp_path / "mine-against-nearest-candidate" / "ledger.sqlite") as other:
        assert "avoider: nearest candidate" in other.files[0].data.decode()
        assert tally_of(other).complete


def test_margins_lost_and_violations_of_one_campaign_alone_are_counted_by_hand(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    holds, violated, unclear = EpisodeOutcome.HOLDS, EpisodeOutcome.VIOLATED, EpisodeOutcome.INCONCLUSIVE
    # Of the first claim, episode by episode: new, gone, lost, lost less than the tolerance, unclear.
    pairs = [
        ((holds, 0.1), (violated, -0.1)),
        ((violated, -0.1), (holds, 0.1)),
        ((holds, 0.2), (holds, 0.1)),
        ((holds, 0.2), (holds, 0.195)),
        ((unclear, 0.0), (violated, -0.1)),
    ]
    for number, name in enumerate(("before", "after")):
        with ledger_in(tmp_path / name, plan_in(tmp_path / name)) as ledger:
            ledger.record(
                Row(
                    stratum=stratum,
                    episode=k,
                    seed=k,
                    judgements=(
                        ClaimJudgement(*pairs[k % 5][number], 0.2, 1),
                        ClaimJudgement(holds, 0.1, 0.2, 1),
                    ),
                )
                for stratum, count in enumerate((30, 20))
                for k in range(count)
            )
    compare(*(tmp_path / name / "ledger.sqlite" for name in ("before", "after")))
    out = capsys.readouterr().out
    lost = "margin lost by more than 10.0 mm, hand distance never below 150 mm: 10 episodes"
    assert f"{lost}, the worst +200.0 mm -> +100.0 mm in near, episode 2" in out
    assert "keeps in 10 of 50 runs; the other way round in 10 (p = 1)" in out


def test_an_avoider_that_is_shown_to_be_worse_ends_a_comparison_with_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, outcome, margin in (
        ("good", EpisodeOutcome.HOLDS, 0.1),
        ("bad", EpisodeOutcome.VIOLATED, -0.1),
    ):
        with ledger_in(tmp_path / name, plan_in(tmp_path / name)) as ledger:
            judgements = (
                ClaimJudgement(outcome, margin, 0.2, 1),
                ClaimJudgement(EpisodeOutcome.HOLDS, 0.1, 0.2, 1),
            )
            ledger.record(
                Row(stratum=stratum, episode=k, seed=k, judgements=judgements)
                for stratum, count in enumerate((30, 20))
                for k in range(count)
            )
    good, bad = (tmp_path / name / "ledger.sqlite" for name in ("good", "bad"))
    assert compare(good, bad) == DIFFERS
    assert "worse:" in capsys.readouterr().out
    assert compare(bad, good) == AS_EXPECTED
    assert "worse:" not in capsys.readouterr().out


def test_campaigns_over_other_spaces_are_not_compared(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from tests.search.short_space import TEXT

    plan = plan_in(tmp_path, SMALL, TEXT.replace("to 2 m/s", "to 1 m/s"))
    Ledger.create(tmp_path / "ledger.sqlite", plan).close()
    assert compare(folder / "ledger.sqlite", tmp_path / "ledger.sqlite") == BAD_INPUT
    err = capsys.readouterr().err
    assert "the same spaces" in err, err


def test_parts_of_a_plan_become_one_ledger(folder: Path, tmp_path: Path) -> None:
    plan = folder / "plan.yaml"
    parts = [tmp_path / f"part{k}.sqlite" for k in (1, 2)]
    for k, path in enumerate(parts, 1):
        assert run(plan, ledger=path, workers=1, part=f"{k}/2") == AS_EXPECTED
    assert merge(tmp_path / "whole.sqlite", [*parts, parts[0]]) == AS_EXPECTED
    with Ledger.open(tmp_path / "whole.sqlite") as whole, Ledger.open(folder / "ledger.sqlite") as expected:
        assert whole.declared.identity == expected.declared.identity
        assert tally_of(whole).of_claim(0) == tally_of(expected).of_claim(0)
        assert whole.outcomes(0, 0)[2].tolist() == expected.outcomes(0, 0)[2].tolist()
        assert next(whole.all("SELECT count(*) FROM session")) == (2,)  # the part named twice counts once
    assert merge(tmp_path / "whole.sqlite", parts) == BAD_INPUT


def test_ledgers_that_disagree_are_not_merged(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copies = [tmp_path / "a.sqlite", tmp_path / "b.sqlite"]
    for copy in copies:
        copy.write_bytes((folder / "ledger.sqlite").read_bytes())
    connection = sqlite3.connect(copies[1])
    connection.execute("UPDATE judgement SET margin = margin + 1e-12 WHERE episode = 4 AND claim = 0")
    connection.commit()
    connection.close()
    assert merge(tmp_path / "whole.sqlite", copies) == BAD_INPUT
    assert "episode 4" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.glob("*.sqlite")) == ["a.sqlite", "b.sqlite"]


def test_how_often_it_is_violated_is_estimated_or_it_is_said_why_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("safety_harness.extensions.assurance.campaign.rare.ADMITTED_OF", 50)
    monkeypatch.setattr(importance, "_MOST_LEVELS", 4)  # on the way to what is never violated
    monkeypatch.setattr(importance, "_MOST_RESTARTS", 0)
    monkeypatch.setattr(AvoiderWatch, "time_lines", ["computing time: too long"])
    plan_in(tmp_path, SMALL.replace("150 mm", "50 mm"))
    plan = tmp_path / "plan.yaml"
    assert rare_violations(plan, pilot=20, runs=120, replications=6) == DIFFERS
    *lines, slow, last = capsys.readouterr().out.splitlines()
    assert slow == "computing time: too long"
    assert last.startswith("Basis: in ")
    for line in lines:
        if "joint speeds" in line:  # which are never violated
            assert "no estimate (0 of 6 replications found a violation); at most" in line
        else:
            assert "of all runs violate it" in line
    assert rare_violations(plan, particles=10) == BAD_INPUT
    assert "--by splitting with it" in capsys.readouterr().err
    assert rare_violations(plan, rare_way=RareWay.SPLITTING, runs=100) == BAD_INPUT
    assert "--by importance with it" in capsys.readouterr().err


def test_bad_input_is_told_and_nothing_is_run(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("safety_harness.extensions.assurance.campaign.cluster._ANSWER_S", 0.2)
    assert run(tmp_path / "none.yaml") == BAD_INPUT
    assert run(folder / "plan.yaml", ledger=tmp_path / "l.sqlite", part="3/2") == BAD_INPUT
    assert run(folder / "plan.yaml", ledger=tmp_path / "l.sqlite", cluster="tcp://127.0.0.1:1") == BAD_INPUT
    assert status(tmp_path / "none.sqlite") == BAD_INPUT
    (tmp_path / "short.yaml").write_text((folder / "short.yaml").read_text())
    (tmp_path / "plan.yaml").write_text(SMALL.replace("seed: 7", "seed: 8"))
    capsys.readouterr()
    assert run(tmp_path / "plan.yaml", ledger=folder / "ledger.sqlite") == BAD_INPUT
    assert "the file plan.yaml changed" in capsys.readouterr().err
    assert CliRunner().invoke(app, ["campaign", "status", str(folder / "ledger.sqlite")]).exit_code == 0


def start(folder: Path, ledger: Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "safety_harness", "campaign", "run", str(folder / "long.yaml")]
    command += ["--ledger", str(ledger), "--workers", "2"]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_for_episodes(ledger: Path, at_least: int) -> None:
    for _ in range(3000):
        if ledger.exists():
            with Ledger.open(ledger, check=False) as reader:
                if tally_of(reader).done >= at_least:
                    return
        time.sleep(0.02)
    pytest.fail("no episodes come")


@pytest.fixture(scope="module")
def undisturbed(folder: Path) -> str:
    (folder / "long.yaml").write_text(PLAN.replace("runs: 30", "runs: 100").replace("runs: 20", "runs: 20"))
    path = folder / "undisturbed.sqlite"
    assert run(folder / "long.yaml", ledger=path, workers=2) == AS_EXPECTED
    with Ledger.open(path) as ledger:
        return fingerprint_of(ledger)


def test_a_runner_that_is_killed_at_any_moment_loses_nothing_that_was_committed(
    folder: Path, tmp_path: Path, undisturbed: str
) -> None:
    path, moments = tmp_path / "ledger.sqlite", random.Random(5)
    done = 0
    for _ in range(2):
        with start(folder, path) as process:
            wait_for_episodes(path, done + 1)
            time.sleep(moments.uniform(0.0, 0.3))
            process.send_signal(signal.SIGKILL)
        with Ledger.open(path) as ledger:
            before, done = done, tally_of(ledger).done
        assert done > before
        if done == 120:
            break
    assert resume(path, workers=2) == AS_EXPECTED
    with Ledger.open(path) as ledger:
        assert fingerprint_of(ledger) == undisturbed


def test_ctrl_c_keeps_every_finished_episode(folder: Path, tmp_path: Path, undisturbed: str) -> None:
    path = tmp_path / "ledger.sqlite"
    with start(folder, path) as process:
        wait_for_episodes(path, 1)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate()
    with Ledger.open(path) as ledger:
        complete = tally_of(ledger).complete
    assert process.returncode == (AS_EXPECTED if complete else INTERRUPTED)
    assert "running episodes finish" in err
    assert "Traceback" not in err
    assert resume(path, workers=2) == AS_EXPECTED
    with Ledger.open(path) as ledger:
        assert fingerprint_of(ledger) == undisturbed


def test_a_bound_is_never_rounded_down() -> None:
    for share in (0.001234, 0.0999999, 0.5, 0.12300001, 1e-7):
        assert float(rounded_up(share)) >= share * (1.0 - 1e-9)
        assert float(rounded_up(share)) <= share * 1.01
    assert (rounded_up(1.0), rounded_up(0.123)) == ("1", "0.123")


TYPOS = [
    ("mcdropout", None),
    ("mine.py:Mine", None),
    ("nothing.onnx", None),
    (None, "[opposite pose, mine.py:No]"),
]


def test_a_typo_in_an_avoider_leaves_no_ledger_and_the_corrected_plan_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ledger = tmp_path / "ledger.sqlite"
    (tmp_path / "mine.py").write_text("class Mine:\n    name = nothing\n")
    for plan_s, space_s in TYPOS:
        named = "" if plan_s is None else f"avoider: {plan_s}\n"
        space = TEXT if space_s is None else TEXT.replace("opposite pose", f"{{one of: {space_s}}}")
        plan_in(tmp_path, SMALL.replace("avoider: opposite pose\n", named), space)
        assert run(tmp_path / "plan.yaml", ledger=ledger, workers=1) == BAD_INPUT
        assert "avoider" in capsys.readouterr().err
        assert not ledger.exists()
    plan_in(tmp_path, SMALL)
    assert run(tmp_path / "plan.yaml", ledger=ledger, workers=1) == AS_EXPECTED


def test_a_ledger_in_which_nothing_was_run_is_begun_anew_and_one_with_results_is_not(tmp_path: Path) -> None:
    path = tmp_path / "ledger.sqlite"
    Ledger.create(path, plan_in(tmp_path, SMALL.replace("seed: 7", "seed: 8"))).close()
    plan = plan_in(tmp_path, SMALL)
    assert run(plan.file, ledger=path, workers=1) == AS_EXPECTED
    with Ledger.open(path) as ledger:
        assert ledger.declared.seed == 7
    plan_in(tmp_path, SMALL.replace("seed: 7", "seed: 8"))
    before = path.read_bytes()
    assert run(plan.file, ledger=path, workers=1) == BAD_INPUT
    assert path.read_bytes() == before


def test_out_is_a_folder_and_older_names_of_options_still_serve(tmp_path: Path) -> None:
    plan_in(tmp_path, SMALL)
    plan, kept = str(tmp_path / "plan.yaml"), tmp_path / "kept"
    made = CliRunner().invoke(app, ["campaign", "run", plan, "--out", str(kept), "--jobs", "1"])
    assert made.exit_code == AS_EXPECTED, made.output
    older = ["--ledger", str(kept / "ledger.sqlite"), "--workers", "1"]
    assert CliRunner().invoke(app, ["campaign", "run", plan, *older]).exit_code == AS_EXPECTED
