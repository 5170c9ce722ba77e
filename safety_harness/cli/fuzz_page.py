"""What ``fuzz`` writes at its end: findings.json, the coverage as a picture, and the page."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from safety_harness.admission.agreement import measured_agreement
from safety_harness.cli.console import replay_command, told_avoider
from safety_harness.cli.fuzz_json import as_json
from safety_harness.cli.show import write_text
from safety_harness.properties.answered import fallback_words
from safety_harness.report.computing_time import cost_words
from safety_harness.report.coverage_map import coverage_map
from safety_harness.report.page_parts import asset
from safety_harness.report.search_page import SearchEvidence, ShownCounterexample, render
from safety_harness.report.svg import standalone
from safety_harness.scenario.files import told
from safety_harness.search.counterexample import Counterexample
from safety_harness.search.disagreement import Disagreement
from safety_harness.search.findings import Findings, Group
from safety_harness.search.trials import Trials
from safety_harness.trace.provenance import provenance

FINDINGS, PAGE, COVERAGE = "findings.json", "fuzz.html", "coverage.svg"


@dataclass(frozen=True, eq=False)
class WrittenCounterexample:
    """A counterexample, the groups of runs that shrank to it, that of its own first, and its files."""

    one: Counterexample
    groups: list[Group]
    searcher: str
    path: Path
    trace_file: Path | None
    text: str

    @property
    def shown(self) -> ShownCounterexample:
        """As the page shows it."""
        replay = ""
        if self.trace_file is not None:
            replay = shlex.join(replay_command(self.one.shrunk.scenario, self.trace_file))
        return ShownCounterexample(
            one=self.one,
            groups=tuple(self.groups),
            searcher=self.searcher,
            file=self.path.name,
            trace_file="" if self.trace_file is None else self.trace_file.name,
            run_command=shlex.join(["safety-harness", "run", str(told(self.path))]),
            replay_command=replay,
            text=self.text,
        )


def evidence_of(
    trials: Trials,
    *,
    out: Path,
    budget: int,
    findings: Findings,
    baseline: Findings | None,
    written: Sequence[WrittenCounterexample],
    confirmed: int,
    unconfirmed: Sequence[Disagreement],
) -> SearchEvidence:
    """Everything that the page shows."""
    avoider = trials.avoider or trials.space.simplest.avoider
    made = provenance("kinematic, confirmed in pybullet", avoider)
    return SearchEvidence(
        title=trials.space.title,
        space=trials.space.name,
        avoider=avoider,
        computing_time=cost_words(trials.space.simplest.settings.avoidance.decision_time, trials.declared_s),
        seed=trials.seed,
        budget=budget,
        command=shlex.join(_command(trials, findings.searcher, budget, out, baseline is not None)),
        generated_at=datetime.now(UTC),
        findings=findings,
        fallback=fallback_words(trials.unanswered, trials.decisions),
        baseline=baseline,
        coverage=trials.coverage,
        violations=trials.violations,
        shown=tuple(one.shown for one in written),
        confirmed=confirmed,
        unconfirmed=tuple(unconfirmed),
        agreement=measured_agreement(),
        provenance=(
            ("Package", f"safety-harness {made.package_version}"),
            ("Source hash", made.source_hash),
            ("World", made.world),
            ("Seed", str(trials.seed)),
            ("Python", made.python),
            ("Platform", made.platform),
            ("Libraries", ", ".join(f"{name} {version}" for name, version in made.libraries)),
            *((name, f"sha256 {sha256}") for name, sha256 in made.files),
        ),
    )


def _command(trials: Trials, searcher: str, budget: int, out: Path, baseline: bool) -> list[str]:
    """The command line that makes all of this again."""
    assert trials.space.file is not None
    command = ["safety-harness", "fuzz", str(told(trials.space.file)), "--searcher", searcher]
    command += ["--budget", str(budget), "--seed", str(trials.seed), "--out", str(told(out))]
    command += [] if trials.avoider is None else ["--avoider", told_avoider(trials.avoider)]
    command += [word for sentence in trials.sentences for word in ("--claim", sentence)]
    return command + ["--baseline"] * baseline


def write_all(out: Path, trials: Trials, evidence: SearchEvidence) -> None:
    """The three files, in ``out``.  OutputError."""
    write_text(out / FINDINGS, json.dumps(as_json(trials, evidence), indent=1) + "\n")
    title = f"Coverage of {evidence.space}"
    drawn = coverage_map(evidence.coverage, evidence.violations.counts, prefix="coverage-", title=title)
    write_text(out / COVERAGE, standalone(drawn, style=asset("report.css")))
    write_text(out / PAGE, render(evidence))
