"""A small report, and a forger who edits its files and makes every hash anew."""

from __future__ import annotations

import json
import re
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from safety_harness.extensions.assurance.campaign.episodes import EpisodeRunner, trace_of
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import Plan, read_plan
from safety_harness.extensions.assurance.campaign.session import LEDGER, plan_of, processes, run_missing
from safety_harness.extensions.assurance.certification.evidence import Evidence, as_text
from safety_harness.extensions.assurance.certification.folder import (
    junit_xml,
    stored_files,
    write_folder,
    write_manifest,
)
from safety_harness.extensions.assurance.certification.gather import gather
from safety_harness.scenario.typed_json import typed
from safety_harness.scenario.write import write_scenario
from tests.assurance.campaign.hazards import HAZARDS
from tests.assurance.campaign.plans import PLAN, ledger_in, plan_in

FEW = PLAN.replace("runs: 30", "runs: 10").replace("runs: 20", "runs: 6")
FEWER = FEW.replace("random traces: 2", "random traces: 1").replace("violations: 3", "violations: 1")
SEARCHING = FEWER.replace(
    PLAN[PLAN.index("    hazard:") : PLAN.index("  - claim: joint")], "    hazards: [crushed hand]\n"
)
SEARCHING += HAZARDS + "search:\n  runs: 1\n"
SEARCHED = "search/1-near"
Touch = Callable[[Path], None]


def write(report: Path) -> Evidence:
    """The whole report anew, from what the ledger says now."""
    with Ledger.open(report / LEDGER) as ledger, plan_of(ledger) as plan:
        gathered = gather(plan, ledger, report, command="safety-harness certify plan.yaml")
        evidence = write_folder(report, gathered, ledger)
    write_manifest(report, evidence.files)
    return evidence


@contextmanager
def every_episode(folder: Path, text: str) -> Iterator[tuple[Plan, Path]]:
    """Yield a plan and its ledger with a row for each episode; whoever asks alters both."""
    plan = plan_in(folder, text)
    bench = EpisodeRunner(plan)
    with ledger_in(folder, plan) as ledger:
        for stratum, one in enumerate(plan.strata):
            ledger.record(bench.run(stratum, range(one.runs)))
        yield plan, ledger.path


def report_in(folder: Path) -> Path:
    """Sixteen kinematic runs, and what a search of one run would have found: one of their violations."""
    report = folder / "report"
    plan = plan_in(folder, SEARCHING)
    assert run_missing(plan, report / LEDGER, processes(1))
    with Ledger.open(report / LEDGER) as ledger:
        data = ledger.trace(0, ledger.violations_kept(0)[0]) or b""
        trace = trace_of(plan, 0, data)
    found = report / SEARCHED
    found.mkdir(parents=True)
    (found / "one.trace").write_bytes(data)
    text = write_scenario(replace(trace.scenario, title="counterexample: a claim", about=""))
    (found / "one.yaml").write_text(f"# A counterexample to: {plan.claims[0].sentence}\n{text}")
    findings = {
        "tried": 1,
        "budget": 1,
        "seed": plan.seed,
        "searcher": "default",
        "interrupted": False,
        "distinct": ["one"],
        "confirmed_in": ["PyBullet"],
        "confirmed": 1,
        "not_confirmed": [],
        "counterexamples": ["one.yaml"],
    }
    (found / "findings.json").write_text(json.dumps(findings))
    write(report)
    return report


def hashed_anew(report: Path) -> None:
    """Manifest and list of files as certify would write them of the files as they are now."""
    document = json.loads((report / "evidence.json").read_text())
    document["files"] = [
        {"path": one.path, "sha256": one.sha256, "bytes": one.bytes} for one in stored_files(report)
    ]
    _save(report, document)
    write_manifest(report, stored_files(report))


def _save(report: Path, document: dict[str, Any]) -> None:
    evidence = typed(document, Evidence, report / "evidence.json", defaults=True)
    (report / "evidence.json").write_text(as_text(evidence))
    (report / "junit.xml").write_text(junit_xml(evidence))


def said(**parts: Any) -> Touch:
    """Other evidence: ``claims__0__target=0.9`` is at claims[0].target; pages and hashes are made to fit."""

    def touch(report: Path) -> None:
        document = json.loads((report / "evidence.json").read_text())
        for place, value in parts.items():
            *way, last = [int(step) if step.isdigit() else step for step in place.split("__")]
            at: Any = document
            for step in way:
                at = at[step]
            assert at[last] != value
            at[last] = value
        _save(report, document)
        write_manifest(report, stored_files(report))

    return touch


def written(name: str, pattern: str, other: str) -> Touch:
    """Another text in the first place of a file that fits, and hashes that fit."""

    def touch(report: Path) -> None:
        text = (report / name).read_text()
        now, count = re.subn(pattern, other, text, count=1)
        assert count
        assert now != text
        (report / name).write_text(now)
        if name != "junit.xml":
            hashed_anew(report)
        write_manifest(report, stored_files(report))

    return touch


def in_ledger(*statements: str) -> Touch:
    """Another ledger, and hashes that fit."""

    def touch(report: Path) -> None:
        with closing(sqlite3.connect(report / LEDGER)) as connection, connection:
            for statement in statements:
                connection.execute(statement)
        hashed_anew(report)

    return touch


def made_anew(report: Path, plan_text: str) -> None:
    """The plan altered after its runs, in the ledger and its identity too; and a new report of it."""
    file = report / "plan" / "plan.yaml"
    file.write_text(plan_text)
    now = read_plan(file)
    with closing(sqlite3.connect(report / LEDGER)) as connection, connection:
        update = "UPDATE file SET data = ? WHERE name = 'plan.yaml'"
        connection.execute(update, (plan_text.encode(),))
        connection.execute("UPDATE about SET value = ? WHERE key = 'identity'", (now.identity.as_json(),))
        for k, claim in enumerate(now.claims):
            connection.execute("UPDATE claim SET target = ? WHERE id = ?", (claim.target, k))
    write(report)


def hidden(report: Path, rows: int, seed: int) -> list[int]:
    """So many violations of the first claim, drawn among those without a trace, become successes."""
    free = (
        "SELECT episode FROM judgement j WHERE stratum = 0 AND claim = 0 AND outcome = 1 AND NOT EXISTS "
        "(SELECT 1 FROM trace t WHERE t.stratum = 0 AND t.episode = j.episode) ORDER BY episode"
    )
    with closing(sqlite3.connect(report / LEDGER)) as connection, connection:
        there = [episode for (episode,) in connection.execute(free)]
        rng = np.random.default_rng(seed)
        chosen = sorted(rng.choice(there, rows, replace=False).tolist())
        update = (
            "UPDATE judgement SET outcome = 0, margin = 0.02 WHERE stratum = 0 AND claim = 0 AND episode = ?"
        )
        connection.executemany(update, [(episode,) for episode in chosen])
    return chosen


def other_software(report: Path, part: str = "the library numpy") -> None:
    """The ledger says that it was begun with another numpy, or another ``part``."""
    with Ledger.open(report / LEDGER) as ledger:
        identity = ledger.declared.identity
    parts = tuple((name, "0.1" if name == part else value) for name, value in identity.parts)
    other = replace(identity, parts=parts)
    in_ledger(f"UPDATE about SET value = '{other.as_json()}' WHERE key = 'identity'")(report)
    place = "libraries__0__1" if part == "the library numpy" else "source_hash"
    said(**{f"provenance__{place}": "0.1"}, plan__sha256=other.sha256)(report)
