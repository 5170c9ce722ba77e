"""What is put together from a ledger, and what an earlier report leaves behind."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from once import replayed_once  # noqa: F401

from safety_harness.base.proportions import upper_bound
from safety_harness.extensions.assurance.campaign.episodes import EpisodeRunner
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.campaign.runner import Stopping
from safety_harness.extensions.assurance.certification.argument_files import NOTES, read_notes
from safety_harness.extensions.assurance.certification.folder import (
    read_manifest,
    write_folder,
    write_manifest,
)
from safety_harness.extensions.assurance.certification.gather import gather
from safety_harness.extensions.assurance.certification.hazards import hazards_of
from safety_harness.extensions.assurance.certification.verify_files import check_plan
from safety_harness.extensions.assurance.certification.whose_fault import MOST
from safety_harness.extensions.assurance.statistics.rates import most_an_hour
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome
from tests.assurance.campaign.hazards import HAZARDOUS
from tests.assurance.campaign.plans import PLAN, ledger_in, plan_in

pytestmark = pytest.mark.usefixtures("replayed_once")
SMALL = PLAN.replace("runs: 30", "runs: 9").replace("runs: 20", "runs: 9")


@pytest.fixture
def plan(tmp_path: Path) -> Plan:
    return plan_in(tmp_path, SMALL)


@pytest.fixture
def ledger(tmp_path: Path, plan: Plan) -> Iterator[Ledger]:
    bench = EpisodeRunner(plan)
    with ledger_in(tmp_path / "report", plan) as made:
        for stratum in range(2):
            made.record(bench.run(stratum, range(9)))
        yield made


def texts(plan: Plan, ledger: Ledger) -> list[str]:
    found = gather(plan, ledger, ledger.path.parent, command="certify").evidence.findings
    return [one.text for one in found]


def test_traces_that_cannot_be_read_are_said_and_the_others_are_shown(plan: Plan, ledger: Ledger) -> None:
    whole = gather(plan, ledger, ledger.path.parent, command="certify").evidence
    assert len(whole.counterexamples) > 1
    shown = whole.counterexamples[0].trace_file.removesuffix(".trace").split("-")
    stratum, episode = int(shown[3]) - 1, int(shown[5])
    ledger.connection.execute(
        "UPDATE trace SET data = x'00' WHERE stratum = ? AND episode = ?", (stratum, episode)
    )
    now = gather(plan, ledger, ledger.path.parent, command="certify").evidence
    assert 0 < len(now.counterexamples) < len(whole.counterexamples)
    said = [one.text for one in now.findings if "cannot be read" in one.text]
    assert any(f"run {episode}: its stored trace cannot be read" in text for text in said)


def test_a_rate_an_hour_is_the_most_approaches_times_the_worst_stratums_bound(tmp_path: Path) -> None:
    text = HAZARDOUS.replace("runs: 30", "runs: 9").replace("runs: 20", "runs: 9")
    plan = plan_in(tmp_path, text)
    with ledger_in(tmp_path / "report", plan) as ledger:
        runner = EpisodeRunner(plan)
        ledger.record(runner.run(0, range(9)))
        (before,) = hazards_of(plan, ledger)
        ledger.record(runner.run(1, range(9)))
        (after,) = hazards_of(plan, ledger)
        samples = [ledger.sample(one.name, plan.claims[0].sentence) for one in plan.strata]
    assert (before.rates, before.met, before.level, before.claims) == ((), None, "d", (1,))
    (rate,) = after.rates
    per_run = max(upper_bound(one.at_worst, one.trials, 0.025 / 2) for one in samples)
    assert rate.an_hour == pytest.approx(most_an_hour(37, 12.0, 0.025) * per_run, rel=1e-12)
    assert after.met is False


def test_what_its_author_wrote_into_the_argument_is_in_the_next_report(plan: Plan, ledger: Ledger) -> None:
    folder = ledger.path.parent
    (folder / NOTES).write_text('"top": |\n  yes\n   but\n"gone": kept\n')
    evidence = write_folder(folder, gather(plan, ledger, folder, command="certify"), ledger)
    assert [(one.element, one.text) for one in evidence.notes] == [("top", "yes\n but"), ("gone", "kept")]
    assert "The author: yes" in (folder / "evidence.html").read_text()
    assert [one.text for one in evidence.findings if "'gone' is on no element" in one.text]
    assert read_notes(folder) == evidence.notes


def test_an_earlier_report_leaves_nothing_in_the_next_ones_manifest(plan: Plan, ledger: Ledger) -> None:
    folder = ledger.path.parent
    old = folder / "counterexamples" / "claim-1-stratum-9-run-9.trace"
    old.parent.mkdir()
    own = folder / "counterexamples" / "my own notes.txt"
    for file in (old, own, folder / "evidence.pdf", folder / "plan" / "old.yaml"):
        file.parent.mkdir(exist_ok=True)
        file.write_text("x")
    (folder / "manifest.json").write_text(
        '{"format": "safety-harness manifest 1", "sha256": {"plan/old.yaml": "0"}}'
    )
    evidence = write_folder(folder, gather(plan, ledger, folder, command="certify"), ledger)
    write_manifest(folder, evidence.files)
    listed = read_manifest(folder)
    assert own.is_file()
    assert not {"plan/old.yaml", "evidence.pdf"} & listed.keys()
    assert [name for name in listed if name.endswith(".trace")] == sorted(
        one.trace_file for one in evidence.counterexamples
    )


def test_a_plan_that_may_stop_early_is_interrupted_until_it_stops(tmp_path: Path) -> None:
    text = SMALL.replace("  - claim: joint speeds within limits\n", "").replace("runs: 9", "runs: 60")
    plan = plan_in(tmp_path, text + "stop early: yes\n")
    row = next(iter(EpisodeRunner(plan).run(0, [0], keep_violations=False)))
    with ledger_in(tmp_path / "report", plan) as ledger:
        for stratum in range(2):
            ledger.record(replace(row, stratum=stratum, episode=k, seed=k, trace=None) for k in range(50))
        assert gather(plan, ledger, tmp_path, command="certify").evidence.interrupted
        for stratum in range(2):
            ledger.stop(stratum, 50)
        assert not gather(plan, ledger, tmp_path, command="certify").evidence.interrupted
        assert all(next(ledger.missing(stratum), None) is None for stratum in range(2))
        assert Stopping(plan, ledger).decided == {0: 50, 1: 50}
        assert not any("stopped" in fault for fault in check_plan(tmp_path, plan, ledger).faults)


def test_violations_of_the_declared_runs_are_grouped_by_whose_fault_they_are(
    plan: Plan, ledger: Ledger
) -> None:
    found = gather(plan, ledger, ledger.path.parent, command="certify").evidence.whose_fault
    ((violated,),) = ledger.all(
        f"SELECT count(*) FROM judgement WHERE outcome = {int(EpisodeOutcome.VIOLATED)}"
    )
    assert 0 < violated <= MOST
    assert found.about.startswith(f"{violated} of {violated} violations")
    assert sum(count for _, count in found.groups) == violated


def test_without_a_violation_there_is_nothing_to_attribute(plan: Plan, ledger: Ledger) -> None:
    ledger.connection.execute(f"UPDATE judgement SET outcome = {int(EpisodeOutcome.HOLDS)}")
    found = gather(plan, ledger, ledger.path.parent, command="certify").evidence.whose_fault
    assert (found.about, found.groups) == ("", ())
