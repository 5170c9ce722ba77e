"""Faults of a user's safety filter: each is caught where only the filter protects hands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from small import trials

from safety_harness.admission.admit import Admitted, admit
from safety_harness.cell.simulation.worlds import KINEMATIC
from safety_harness.extensions.selftest.fault import SeededFault
from safety_harness.extensions.selftest.filter_faults import FILTER_FAULTS
from safety_harness.extensions.selftest.shield_faults import SHIELD_FAULTS
from safety_harness.extensions.selftest.suite import QUICK, SelfTestPlan
from safety_harness.extensions.selftest.system import ChangedSystem
from safety_harness.extensions.selftest.trial import FaultTrials
from safety_harness.scenario.read import parse_scenario

FILTER = """
import numpy as np

from safety_harness import Stop


class Halts:
    name, sees = "halts", ("joints", "hands", "predicted hands", "wanted command")

    def reset(self, **start):
        pass

    def act(self, seen):
        places = [hand.position_in_base_m for hand in seen.hands]
        places += [one.position_in_base_m + 0.6 * one.velocity_in_base_mps for one in seen.predicted_hands]
        near = [np.linalg.norm(place - seen.tcp_position_in_base_m) < 0.42 for place in places]
        return Stop() if any(near) else seen.wanted_command.action
"""
SCENARIO = """
scenario: two hands come to an arm that ignores them
duration: 2.4 s
tcp start: {offset: [40 mm, -120 mm, 60 mm]}
avoider: opposite pose
hands:
  - hand: far right hand
    starts at: [1100 mm, -1150 mm, 250 mm]
    elbow towards: [1600 mm, -1200 mm, 300 mm]
    moves: [{wait: 10 s}]
  - hand: right hand
    starts at: [1100 mm, -750 mm, 200 mm]
    elbow towards: [1600 mm, -1200 mm, 300 mm]
    moves: [{move to: [840 mm, -350 mm, 250 mm], speed: 1 m/s}, {wait: 400 ms}, {withdraw: 1 m/s}]
claims: {hand distance never below 50 mm: holds}
"""


@pytest.fixture(scope="module")
def filtered(tmp_path_factory: pytest.TempPathFactory) -> Admitted:
    file = tmp_path_factory.mktemp("filter") / "mine.py"
    file.write_text(FILTER)
    return admit(parse_scenario(f"{SCENARIO}safety filter: {file}:Halts\n"))


@pytest.mark.parametrize("fault", FILTER_FAULTS, ids=lambda fault: fault.name)
def test_a_fault_is_caught_and_its_sound_system_raises_no_alarm(
    fault: SeededFault, filtered: Admitted
) -> None:
    tried = FaultTrials((filtered,))
    assert tried.applies(fault)
    assert tried.alarms(fault, fault.ladder.values[0], 0)


def test_the_fault_is_in_what_the_filter_sees_and_the_filter_is_made_anew(filtered: Admitted) -> None:
    sound = ChangedSystem(filtered)
    first, again = sound.run(KINEMATIC), sound.run(KINEMATIC)
    fault = next(one for one in FILTER_FAULTS if one.name == "safety filter looks elsewhere")
    faulty = fault.seed_into(fault.circumstance.bring_about(sound), 10.0).run(KINEMATIC)
    assert first.ticks["demanded_joint_velocity_radps"].tobytes() == (
        again.ticks["demanded_joint_velocity_radps"].tobytes()
    )
    assert first.filtered is not None
    assert faulty.filtered is not None
    assert (first.ticks["mode"] == 2).any()  # it stops
    assert not (faulty.ticks["mode"] == 2).any()
    assert np.isfinite(faulty.ticks["predicted_hand_in_base_m"][faulty.ticks["track_valid"] != 0]).all()


def test_each_kind_applies_only_to_its_own_systems(filtered: Admitted) -> None:
    ours, yours = trials("second-hand"), FaultTrials((filtered,))
    for fault in FILTER_FAULTS:
        assert (ours.applies(fault), yours.applies(fault)) == (False, True), fault.name
    for fault in SHIELD_FAULTS:
        assert (ours.applies(fault), yours.applies(fault)) == (True, False), fault.name


def test_a_filter_for_every_scenario_takes_the_place_of_a_shield(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(FILTER)
    (tmp_path / "case.yaml").write_text(SCENARIO + "shield: speed and separation\n")
    (case,) = SelfTestPlan(QUICK, tmp_path, None, f"{tmp_path / 'mine.py'}:Halts").episodes()
    assert case.scenario.shield is None
    assert case.safety_filter is not None
