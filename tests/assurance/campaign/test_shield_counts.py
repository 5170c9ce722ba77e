"""A campaign counts the runs of a shielded stratum in which an assumption of the theorem did not hold."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np

from safety_harness.claims.properties.shield_theorem import SHIELDED
from safety_harness.extensions.assurance.campaign.episodes import EpisodeRunner, trace_of
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.campaign.rows import Row
from safety_harness.extensions.assurance.campaign.summary import shields_in, state_of
from safety_harness.extensions.assurance.certification.evidence import Evidence
from safety_harness.extensions.assurance.certification.result_tables import strata
from safety_harness.extensions.assurance.certification.results import strata_of
from safety_harness.extensions.assurance.certification.verify_runs import Compared
from safety_harness.extensions.assurance.commands.campaign_lines import ledger_data, ledger_lines
from tests.assurance.campaign.plans import ledger_in, plan_in
from tests.search.short_space import TEXT

RUNS, BOUND_MPS = 10, 1.0
SHIELD = f"shield: {{hand speed: {BOUND_MPS} m/s}}\n"
PLAN = f"""\
plan: hands that are faster than the shield takes them for
avoider: opposite pose
world: kinematic
seed: 7
strata:
  - stratum: behind a shield
    space: shielded.yaml
    runs: {RUNS}
  - stratum: without one
    space: short.yaml
    runs: 2
claims:
  - claim: joint speeds within limits
keep:
  random traces: {RUNS}
"""


def recorded(folder: Path) -> tuple[Plan, Ledger, list[Row]]:
    (folder / "shielded.yaml").write_text(TEXT.replace("claims:", f"{SHIELD}claims:"))
    plan = plan_in(folder, PLAN)
    runner = EpisodeRunner(plan)
    rows = [*runner.run(0, range(RUNS)), *runner.run(1, range(2))]
    ledger = ledger_in(folder, plan)
    ledger.record(rows)
    return plan, ledger, rows


def is_fast(plan: Plan, row: Row) -> bool:
    """By its stored trace alone: did the hand's centre move faster than the bound?"""
    trace = trace_of(plan, 0, row.trace or b"")
    way_m = np.diff(trace.ticks["hand_position_in_base_m"][:, 0], axis=0)
    period_s = trace.scenario.settings.clock.control_period_s
    return bool((np.linalg.norm(way_m, axis=1) > BOUND_MPS * period_s * (1.0 + 1e-6) + 1e-6).any())


def test_each_broken_assumption_is_counted_in_status_report_and_ledger(tmp_path: Path) -> None:
    plan, ledger, rows = recorded(tmp_path)
    fast = sum(is_fast(plan, row) for row in rows[:RUNS])
    assert 0 < fast < RUNS
    assert [row.theorem for row in rows[RUNS:]] == [0, 0]
    words = f"the assumptions that a trace tells held in {RUNS - fast} of {RUNS} runs"
    words += f", assumption 1 did not hold in {fast}"
    with ledger:
        state = state_of(ledger)
        line = f"shield in behind a shield: {words}"
        assert f"  {line}" in list(ledger_lines(ledger, state))
        assert ledger_data(ledger, state)["shields"] == shields_in(ledger) == (line,)
        found = SimpleNamespace(strata=strata_of(plan, ledger), shields=shields_in(ledger))
        assert f" S{line[1:]}." in str(strata(cast("Evidence", found)))
        query = "SELECT count(*) FROM episodes WHERE theorem & 2"
        assert list(ledger.all(query)) == [(fast,)]


def test_a_count_that_was_altered_is_found_by_running_again(tmp_path: Path) -> None:
    plan, ledger, rows = recorded(tmp_path)
    slow = next(row for row in rows if row.theorem == SHIELDED)
    with ledger:
        sound = Compared(plan, ledger, same=True)
        sound.add(slow)
        assert sound.faults == []
        ledger.connection.execute("UPDATE episode SET theorem = 0 WHERE theorem = 3")
        assert shields_in(ledger)[0].endswith(f"of {sum(r.theorem == SHIELDED for r in rows)} runs")
        altered = Compared(plan, ledger, same=True)
        altered.add(next(row for row in rows if row.theorem == SHIELDED | 1 << 1))
        assert len(altered.faults) == 1
        altered.add(replace(slow))
        assert len(altered.faults) == 1
