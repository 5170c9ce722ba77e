"""What a replay says of a difference: a fault of the machine, other arithmetic, or an engine's last bits."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
from examples import VISIT, scenario

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_trial
from safety_harness.cell.simulation.worlds import KINEMATIC, PYBULLET, WorldEntry
from safety_harness.cli.console import AS_EXPECTED, DIFFERS
from safety_harness.cli.scenario_commands import replay
from safety_harness.trace.provenance import machine
from safety_harness.trace.store import load_trace, save_trace
from safety_harness.trace.trace import Trace

FAULT = "a fault: with the same software this world has the same bits on every machine"
EARLIER = {"arithmetic": 0, "source_hash": "0"}


@cache
def made(world: WorldEntry) -> Trace:
    return run_trial(admit(scenario(VISIT, duration_s=1.4)), world=world)


def altered(trace: Trace, by: float, *, decided: bool = False, **provenance: object) -> Trace:
    """The trace with another last joint position, or another proposal, and another provenance."""
    ticks, decisions = trace.ticks.copy(), trace.decisions.copy()
    if decided:
        decisions["proposed_position_in_base_m"][0, 0] += by
    else:
        ticks["joint_position_rad"][-1, 0] += by
    for rows in (ticks, decisions):
        rows.flags.writeable = False
    made_by = replace(trace.provenance, **provenance)  # type: ignore[arg-type]
    return replace(trace, ticks=ticks, decisions=decisions, provenance=made_by)


@pytest.mark.parametrize(
    ("world", "by", "decided", "provenance", "code", "words", "no_words"),
    [
        (KINEMATIC, 1e-15, False, {}, DIFFERS, FAULT, "equal to"),
        (KINEMATIC, 1e-15, False, {"machine": "another"}, DIFFERS, FAULT, "equal to"),
        (KINEMATIC, 1e-12, False, EARLIER, AS_EXPECTED, "arithmetic 0 then, 1 now", "comparable"),
        (KINEMATIC, 1e-3, True, EARLIER, DIFFERS, "not comparable from decision 0 on", FAULT),
        (KINEMATIC, 1e-12, False, {"arithmetic": 0}, DIFFERS, FAULT, "equal to"),
        (KINEMATIC, 1e-12, False, {"source_hash": "0"}, DIFFERS, "source_hash: 0 then", FAULT),
        (PYBULLET, 1e-12, False, {"machine": "another"}, AS_EXPECTED, "an engine's last bits may", FAULT),
        (PYBULLET, 1e-3, False, {"machine": "another"}, DIFFERS, "an engine's last bits may", "equal to"),
        (PYBULLET, 1e-12, False, {}, DIFFERS, f"machine: {machine()}", "equal to"),
    ],
)
def test_a_difference_is_a_fault_unless_arithmetic_or_an_engine_explains_it(
    world: WorldEntry,
    by: float,
    decided: bool,
    provenance: dict[str, object],
    code: int,
    words: str,
    no_words: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    save_trace(altered(made(world), by, decided=decided, **provenance), tmp_path / "made.trace")
    assert replay(tmp_path / "made.trace") == code
    said = "".join(capsys.readouterr())
    assert words in said
    assert no_words not in said


def test_another_end_is_a_difference(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save_trace(replace(made(KINEMATIC), ended="the avoider crashed"), tmp_path / "made.trace")
    assert replay(tmp_path / "made.trace") == DIFFERS
    assert "another end in ended: the avoider crashed against complete" in "".join(capsys.readouterr())


def test_a_trace_names_its_arithmetic_and_the_kind_of_machine(tmp_path: Path) -> None:
    save_trace(made(KINEMATIC), tmp_path / "made.trace")
    stored = load_trace(tmp_path / "made.trace").provenance
    assert (stored.arithmetic, stored.machine) == (1, machine())
    assert "with" in stored.machine
    assert replace(stored, machine="another") == stored
