"""The seams: a system without a fault is the system, and a fault leaves the one it is seeded into alone."""

from __future__ import annotations

import pytest
from small import shipped

from safety_harness.admission.trial import run_kinematic, run_trial
from safety_harness.base.settings import GateKind
from safety_harness.cell.avoidance.gate import Gate
from safety_harness.cell.simulation.worlds import PYBULLET
from safety_harness.extensions.selftest.system import ChangedSystem, Delayed, Records
from safety_harness.trace.compare import first_difference


def same(records: Records) -> Records:
    return records


def test_the_sound_system_gives_the_bits_of_a_plain_run() -> None:
    admitted = shipped("network-certain")
    assert first_difference(ChangedSystem(admitted).run(), run_kinematic(admitted)) is None


def test_in_pybullet_too() -> None:
    admitted = shipped("network-certain")
    assert first_difference(ChangedSystem(admitted).run(PYBULLET), run_trial(admitted)) is None


def test_seams_that_change_nothing_change_no_bit() -> None:
    sound = ChangedSystem(shipped("network-certain"))
    seamed = (
        sound.with_avoider(lambda avoider: avoider)
        .with_gate(Gate)
        .with_records(lambda records: None)
        .with_pilot(lambda pilot: pilot)
        .seeing(lambda admitted: same)
        .obeying(lambda admitted: same)
    )
    assert first_difference(sound.run(), seamed.run()) is None


def test_an_edit_reaches_its_own_run_and_no_other() -> None:
    sound = ChangedSystem(shipped("network-certain"))
    before = sound.run()

    def blinder(records: object) -> None:
        records.parameters["critical_distance_m"] = 0.01  # type: ignore[attr-defined]

    assert len(sound.with_records(blinder).run().decisions) == 0
    assert len(sound.with_gate(kind=GateKind.REACH).run().decisions) == len(before.decisions)
    assert first_difference(before, sound.run()) is None


def test_what_is_delayed_comes_out_once_and_the_last_of_several() -> None:
    queue = Delayed(0.1)
    assert queue.due(0.0) is None
    queue.put(0.0, "first")
    queue.put(0.05, "second")
    assert queue.due(0.09) is None
    assert queue.due(0.1) == "first"
    assert queue.due(0.1) is None
    queue.put(0.1, "third")
    assert queue.due(0.5) == "third"
    assert queue.due(0.5) is None


def test_ctrl_c_in_a_run_passes_through() -> None:
    def interrupted(records: Records) -> Records:
        raise KeyboardInterrupt

    system = ChangedSystem(shipped("network-certain")).obeying(lambda admitted: interrupted)
    with pytest.raises(KeyboardInterrupt):
        system.run()
