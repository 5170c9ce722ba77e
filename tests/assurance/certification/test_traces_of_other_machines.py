"""What a repeated run says of a stored trace that another machine made."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import pytest
from examples import VISIT, scenario

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_trial
from safety_harness.cell.simulation.worlds import KINEMATIC, PYBULLET, WorldEntry
from safety_harness.extensions.assurance.certification import verify_runs
from safety_harness.extensions.assurance.certification.verify_runs import Compared
from safety_harness.trace.trace import Trace


@cache
def made(world: WorldEntry) -> Trace:
    return run_trial(admit(scenario(VISIT, duration_s=0.4)), world=world)


@pytest.mark.parametrize(
    ("world", "by", "machine", "fault", "open_words"),
    [
        (PYBULLET, 0.0, "another", False, ""),
        (PYBULLET, 1e-12, "another", False, "1 stored traces equal repeated runs to 1e-06 only"),
        (PYBULLET, 1e-3, "another", True, "1 stored traces differ from the repeated runs"),
        (PYBULLET, 1e-12, None, True, "1 stored traces differ from the repeated runs"),
        (KINEMATIC, 1e-12, "another", True, "1 stored traces differ from the repeated runs"),
    ],
)
def test_only_an_engines_last_bits_may_come_from_another_machine(
    world: WorldEntry,
    by: float,
    machine: str | None,
    fault: bool,
    open_words: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    again = made(world)
    ticks = again.ticks.copy()
    ticks["joint_position_rad"][-1, 0] += by
    ticks.flags.writeable = False
    origin = replace(again.provenance, machine=machine or again.provenance.machine)
    monkeypatch.setattr(verify_runs, "trace_of", lambda *_: again)
    plan: Any = SimpleNamespace(world=world, strata=[SimpleNamespace(name="near")])
    ledger: Any = None
    row: Any = SimpleNamespace(trace=b"", stratum=0, episode=0)
    compared = Compared(plan, ledger, same=True)
    compared.add_trace(replace(again, ticks=ticks, provenance=origin), row)
    assert bool(compared.faults) == fault
    assert [line.partition(":")[0] for line in compared.unchecked] == [open_words] * bool(open_words)
