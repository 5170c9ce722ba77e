"""A plan of a few short episodes, some of which violate its first claim."""

from __future__ import annotations

from pathlib import Path

from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import Plan, read_plan
from tests.search.short_space import TEXT

PLAN = """\
plan: a hand nearby
about: a test
avoider: opposite pose
world: kinematic
seed: 7
strata:
  - stratum: near
    space: short.yaml
    runs: 30
  - stratum: nearer
    space: short.yaml
    runs: 20
claims:
  - claim: hand distance never below 150 mm
    violated in at most: 50 %
    hazard: a hand is crushed
  - claim: joint speeds within limits
keep:
  random traces: 2
  violations: 3
"""


def plan_in(folder: Path, text: str = PLAN, space: str = TEXT) -> Plan:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "short.yaml").write_text(space)
    (folder / "plan.yaml").write_text(text)
    return read_plan(folder / "plan.yaml")


def ledger_in(folder: Path, plan: Plan) -> Ledger:
    return Ledger.create(folder / "ledger.sqlite", plan)
