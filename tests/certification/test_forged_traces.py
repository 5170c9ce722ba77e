"""Claims believe the poses, speeds and distances of a trace: verify first sees whether they can be true."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from safety_harness.campaign.episodes import EpisodeRunner, trace_bytes
from safety_harness.campaign.ledger import Ledger
from safety_harness.campaign.plan import Plan
from safety_harness.certification.stored import trace_of
from safety_harness.certification.verify_runs import check_traces
from tests.campaign.plans import PLAN, ledger_in, plan_in

SMALL = PLAN.replace("runs: 30", "runs: 3").replace("runs: 20", "runs: 2")


@pytest.fixture
def ran(tmp_path: Path) -> Iterator[tuple[Plan, Path]]:
    plan = plan_in(tmp_path, SMALL)
    bench = EpisodeRunner(plan)
    with ledger_in(tmp_path, plan) as ledger:
        for stratum, one in enumerate(plan.strata):
            ledger.record(bench.run(stratum, range(one.runs)))
        yield plan, ledger.path


def checked(plan: Plan, path: Path) -> tuple[str, ...]:
    with Ledger.open(path) as ledger:
        return check_traces(plan, ledger, same=True).faults


@pytest.mark.parametrize("field", ["hand_distance_m", "tcp_speed_mps", "transform_tcp_to_base"])
def test_a_trace_whose_numbers_no_run_can_have_written_is_no_evidence(
    ran: tuple[Plan, Path], field: str
) -> None:
    plan, path = ran
    assert checked(plan, path) == ()
    with Ledger.open(path) as ledger:
        stratum, episode, _ = next(iter(ledger.traces()))
        trace = trace_of(plan, stratum, ledger.trace(stratum, episode) or b"")
    ticks = trace.ticks.copy()
    ticks[field] = np.where(np.isfinite(ticks[field]), ticks[field] + 0.001, ticks[field])
    forged = trace_bytes(replace(trace, ticks=ticks))
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute(
            "UPDATE trace SET data = ? WHERE stratum = ? AND episode = ?", (forged, stratum, episode)
        )
    (fault,) = checked(plan, path)
    assert f"run {episode}: " in fault
    assert f"{field} at tick" in fault
