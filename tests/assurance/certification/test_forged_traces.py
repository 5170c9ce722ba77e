"""Claims believe the poses, speeds and distances of a trace: verify first sees whether they can be true."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from forging import every_episode
from partly_measured import partly_measured

from safety_harness.base.exceptions import TraceError
from safety_harness.extensions.assurance.campaign.episodes import trace_bytes, trace_of
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.certification.verify_runs import check_traces
from safety_harness.trace.trace import Trace
from tests.assurance.campaign.plans import PLAN

SMALL = PLAN.replace("runs: 30", "runs: 3").replace("runs: 20", "runs: 2")


@pytest.fixture
def ran(tmp_path: Path) -> Iterator[tuple[Plan, Path]]:
    with every_episode(tmp_path, SMALL) as found:
        yield found


def checked(plan: Plan, path: Path) -> tuple[str, ...]:
    with Ledger.open(path) as ledger:
        return check_traces(plan, ledger, same=True).faults


def put(path: Path, stratum: int, episode: int, trace: Trace) -> None:
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute(
            "UPDATE trace SET data = ? WHERE stratum = ? AND episode = ?",
            (trace_bytes(trace), stratum, episode),
        )


def test_a_stored_trace_that_was_not_simulated_is_no_evidence(ran: tuple[Plan, Path]) -> None:
    plan, path = ran
    with Ledger.open(path) as ledger:
        stratum, episode, _ = next(iter(ledger.traces()))
        trace = trace_of(plan, stratum, ledger.trace(stratum, episode) or b"")
    put(path, stratum, episode, partly_measured(trace))
    (fault,) = checked(plan, path)
    assert f"run {episode}, known: got columns that are " in fault
    with pytest.raises(TraceError), Ledger.open(path) as ledger:
        trace_of(plan, stratum, ledger.trace(stratum, episode) or b"")


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
    put(path, stratum, episode, replace(trace, ticks=ticks))
    (fault,) = checked(plan, path)
    assert f"run {episode}, " in fault
    assert f"{field} at tick" in fault
