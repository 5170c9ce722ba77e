"""Print digests of results on this machine, or on the machine that environment variables pretend: a program.

Each key names a result, and each value covers all of its bits.  Another machine has to print the same text.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from safety_harness import (
    Cube,
    Trials,
    admit,
    certify,
    find_violations,
    in_kinematic,
    judge,
    read_space,
    run_kinematic,
    searcher_named,
)
from safety_harness.base.proportions import lower_bound, upper_bound
from safety_harness.base.special import normal_quantile
from safety_harness.extensions.assurance.campaign.episodes import EpisodeRunner
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import read_plan
from safety_harness.extensions.assurance.campaign.summary import bounds_in, fingerprint_of
from safety_harness.extensions.assurance.statistics.rates import most_an_hour
from safety_harness.extensions.assurance.statistics.sequential import anytime_lower, anytime_upper
from safety_harness.scenario.read import read_scenario

ROOT = Path(__file__).resolve().parents[2]
SCENARIOS = (
    "hand-visits-and-leaves",
    "nearest-candidate-visit",
    "trembling-hand",
    "robot-panda",
    "eye-in-hand-sees",
)
SPACE = ROOT / "scenarios" / "spaces" / "nominal.yaml"
PLAN = """\
plan: a few runs
avoider: mc-dropout
world: kinematic
seed: 1
strata:
  - {stratum: seen, space: space.yaml, runs: 16}
claims:
  - claim: hand distance never below 50 mm
    violated in at most: 50 %
  - claim: TCP speed never above 250 mm/s
"""
SEARCH = "search: {runs: 20}\nkeep: {random traces: 2, violations: 2}\n"
OF_THIS_MACHINE = {"provenance", "files"}  # times, versions and processor; hashes of files that hold them


def digest(*parts: Any) -> str:
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:16]


def of_traces(found: dict[str, str], names: tuple[str, ...]) -> None:
    for name in names:
        trace = run_kinematic(admit(read_scenario(ROOT / "scenarios" / f"{name}.yaml")))
        for kind, rows in (("ticks", trace.ticks), ("decisions", trace.decisions)):
            for column in rows.dtype.names:
                found[f"{name}: {kind}.{column}"] = digest(np.ascontiguousarray(rows[column]).tobytes())
        found[f"{name}: judged"] = digest(
            [(str(one.verdict), one.margin, one.worst_time_s) for one in judge(trace)]
        )


def plan_in(folder: str, text: str) -> Path:
    (file := Path(folder) / "plan.yaml").write_text(text)
    shutil.copy(SPACE, file.with_name("space.yaml"))
    return file


def of_campaign(found: dict[str, str]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        plan = read_plan(plan_in(folder, PLAN))
        runner = EpisodeRunner(plan)
        with Ledger.create(Path(folder) / "ledger.sqlite", plan) as ledger:
            ledger.record(runner.run(0, range(16), keep_violations=False))
            found["campaign: fingerprint"] = fingerprint_of(ledger)
            found["campaign: bounds"] = digest(bounds_in(ledger))


def of_certificate(found: dict[str, str]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        report = certify(plan_in(folder, PLAN + SEARCH), out=Path(folder) / "report", workers=1)
        assert report.complete
        for name, part in msgspec.to_builtins(report.evidence).items():
            if name not in OF_THIS_MACHINE:
                found[f"certificate: {name}"] = digest(part)


def of_search(found: dict[str, str], budget: int) -> None:
    trials = Trials(read_space(SPACE), in_kinematic, seed=3)
    cube = Cube.from_space(trials.space)
    for name in ("default", "diverse", "quasi-random"):
        asked: list[bytes] = []
        searcher = searcher_named(name)(cube, claims=len(trials.goals), seed=3)

        def evaluate(points: Any, first: int, asked: list[bytes] = asked) -> Any:
            outcomes = trials(points, first)
            asked.extend((points.tobytes(), outcomes.margins.tobytes()))
            return outcomes

        find_violations(cube, trials.goals, evaluate, searcher, budget=budget, batch=8)
        found[f"search: {name}"] = digest(asked)


def of_bounds(found: dict[str, str]) -> None:
    pairs = [(k, n) for n in (1, 7, 59, 1000, 30_000) for k in (0, 1, n // 3, n - 1) if k < n]
    for bound in (upper_bound, lower_bound, anytime_upper, anytime_lower):
        found[f"bounds: {bound.__name__}"] = digest([bound(k, n, 0.025) for k, n in pairs])
    found["bounds: rates"] = digest([most_an_hour(k, 3.0, 0.05) for k in range(20)])
    found["bounds: normal"] = digest(normal_quantile(np.linspace(0.001, 0.999, 999)).tobytes())


def main(quick: bool) -> None:
    found: dict[str, str] = {}
    of_bounds(found)
    of_traces(found, SCENARIOS[:3] if quick else SCENARIOS)
    of_campaign(found)
    of_search(found, 60 if quick else 300)
    if not quick:
        of_certificate(found)
    print(json.dumps(found))


if __name__ == "__main__":
    main("--quick" in sys.argv)
