"""Faults of a predictor, ours or a user's: each is caught where the gate takes its sets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from small import trials

from safety_harness.admission.admit import Admitted, admit
from safety_harness.base.exceptions import InadmissibleError
from safety_harness.extensions.selftest.fault import SeededFault, SeverityLevels
from safety_harness.extensions.selftest.perception_faults import OF_KALMAN_FILTER, PERCEPTION_FAULTS
from safety_harness.extensions.selftest.predictor_faults import IN_SETS, PREDICTOR_FAULTS, predicted
from safety_harness.extensions.selftest.suite import QUICK, SelfTestPlan
from safety_harness.extensions.selftest.system import ChangedSystem
from safety_harness.extensions.selftest.trial import FaultTrials
from safety_harness.scenario.model import Driver
from safety_harness.scenario.read import parse_scenario
from safety_harness.trace.compare import first_difference
from safety_harness.trace.trace import Trace

SETS = {
    "Ball": "radius_m=0.25",
    "Box": "half_widths_m=np.array([0.25, 0.3, 0.35])",
    "Ellipsoid": "ellipsoid_m2=np.array([[0.08, 0.01, 0.0], [0.01, 0.08, 0.0], [0.0, 0.0, 0.08]])",
}
HEAD = "import numpy as np\nfrom safety_harness import HandSet, Predicted\n"
PREDICTOR = """
class {name}:
    name, sees = "mine", ("hands", "predicted hands")

    def reset(self, **start):
        pass

    def act(self, seen):
        return Predicted(
            hands=[
                HandSet(position_in_base_m=one.position_in_base_m, number=k, {sizes})
                for k, one in enumerate(seen.predicted_hands, 1)
            ]
        )
"""
SCENARIO = """
scenario: a hand comes to an arm whose gate takes predicted sets
duration: 2.4 s
seed: 3
tcp start: {offset: [40 mm, -120 mm, 60 mm]}
avoider: opposite pose
hands:
  - hand: right hand
    starts at: [1100 mm, -750 mm, 200 mm]
    elbow towards: [1600 mm, -1200 mm, 300 mm]
    moves:
      - wait: 300 ms
      - move to: [840 mm, -350 mm, 250 mm]
        speed: 0.4 m/s
      - wait: 200 ms
      - withdraw: 0.4 m/s
claims: {hand distance never below 50 mm: holds}
"""
DRIVEN = "controller: stop when near"


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("predictor") / "mine.py"
    path.write_text(HEAD + "".join(PREDICTOR.format(name=name, sizes=size) for name, size in SETS.items()))
    return path


def of(file: Path, name: str) -> Admitted:
    return admit(parse_scenario(f"{SCENARIO}predictor: {file}:{name}\n"))


def named(name: str) -> SeededFault:
    return next(fault for fault in PREDICTOR_FAULTS if fault.name == name)


def faulty(admitted: Admitted, fault: SeededFault, magnitude: float) -> Trace:
    return fault.seed_into(IN_SETS.bring_about(ChangedSystem(admitted)), magnitude).run()


@pytest.mark.parametrize("fault", PREDICTOR_FAULTS, ids=lambda fault: fault.name)
def test_a_fault_of_a_users_predictor_is_caught(fault: SeededFault, file: Path) -> None:
    tried = FaultTrials((of(file, "Ball"),))
    assert tried.applies(fault)
    assert any("predict" in alarm.claim for alarm in tried.alarms(fault, fault.ladder.values[0], 0))


@pytest.mark.parametrize("fault", PREDICTOR_FAULTS, ids=lambda fault: fault.name)
def test_the_same_fault_of_the_kalman_filter_is_caught(fault: SeededFault) -> None:
    tried = trials("second-hand")
    assert tried.applies(fault)
    assert any("predict" in alarm.claim for alarm in tried.alarms(fault, fault.ladder.values[0], 0))


def test_a_wrapper_that_changes_nothing_changes_no_bit_and_raises_no_alarm(file: Path) -> None:
    same = SeededFault(
        named("predicted sets late").part,
        "same",
        "none",
        predicted(lambda magnitude, admitted: lambda hands: hands),
        SeverityLevels((1.0,)),
        IN_SETS,
        harmless="the hands are the predictor's own",
    )
    admitted = of(file, "Ellipsoid")
    sound = IN_SETS.bring_about(ChangedSystem(admitted)).run()
    wrapped = faulty(admitted, same, 1.0)
    assert first_difference(sound, wrapped) is None
    for name in sound.predicted.dtype.names or ():
        assert np.array_equal(sound.predicted[name], wrapped.predicted[name])
    assert FaultTrials((admitted,)).everywhere(same).alarms == ()


@pytest.mark.parametrize("name", SETS)
def test_each_kind_of_set_shrinks_by_the_factor(name: str, file: Path) -> None:
    admitted = of(file, name)
    sound = IN_SETS.bring_about(ChangedSystem(admitted)).run()
    small = faulty(admitted, named("predicted sets too small"), 0.1)
    there = sound.ticks["track_valid"].astype(bool)
    assert there.any()
    assert np.allclose(small.predicted["shape_m2"][there], 0.01 * sound.predicted["shape_m2"][there])


def test_sets_are_late_by_so_many_ticks_and_elsewhere_by_so_many_millimetres(file: Path) -> None:
    admitted = of(file, "Ball")
    sound = IN_SETS.bring_about(ChangedSystem(admitted)).run()
    first = slice(0, 40)  # before the arm moves, the runs differ by the fault alone
    own_m = sound.ticks["predicted_hand_in_base_m"][first, 0]
    late_m = faulty(admitted, named("predicted sets late"), 5.0).ticks["predicted_hand_in_base_m"][first, 0]
    assert np.array_equal(late_m[5:], own_m[:-5])
    off_m = faulty(admitted, named("predicted sets elsewhere"), 0.1).ticks["predicted_hand_in_base_m"]
    seen = sound.ticks["track_valid"][first, 0].astype(bool)
    assert np.allclose((off_m[first, 0] - own_m)[seen], [0.0, -0.1, 0.0])


def test_the_gate_takes_the_sets_although_the_scenario_does_not_say_so(file: Path) -> None:
    changed = IN_SETS.bring_about(ChangedSystem(of(file, "Ball"))).admitted.scenario
    assert changed.gate is not None
    assert list(changed.gate.demands) == ["every hand in its set"]


def test_with_a_predictor_the_faults_of_the_kalman_filter_do_not_apply(file: Path) -> None:
    ours, yours = trials("second-hand"), FaultTrials((of(file, "Ball"),))
    own = [fault for fault in PERCEPTION_FAULTS if fault.name in OF_KALMAN_FILTER]
    assert len(own) == len(OF_KALMAN_FILTER)
    assert [(ours.applies(fault), yours.applies(fault)) for fault in own] == [(True, False)] * len(own)


def test_with_a_controller_of_its_own_no_fault_of_a_predictor_applies() -> None:
    driven = FaultTrials((admit(parse_scenario(SCENARIO.replace("avoider: opposite pose", DRIVEN))),))
    assert not any(map(driven.applies, PREDICTOR_FAULTS))


def test_a_predictor_for_every_scenario_spares_those_with_a_controller(file: Path, tmp_path: Path) -> None:
    (tmp_path / "servo.yaml").write_text(SCENARIO)
    (tmp_path / "driven.yaml").write_text(
        SCENARIO.replace("avoider: opposite pose", DRIVEN).replace("scenario: a", "scenario: another")
    )
    episodes = SelfTestPlan(QUICK, tmp_path, None, None, f"{file}:Ball").episodes()
    found = {one.scenario.driven: one.predictor is not None for one in episodes}
    assert found == {False: True, True: False}


def test_a_predictor_beside_a_controller_for_every_scenario_is_refused(file: Path, tmp_path: Path) -> None:
    (tmp_path / "servo.yaml").write_text(SCENARIO)
    with pytest.raises(InadmissibleError, match="does its own prediction"):
        SelfTestPlan(QUICK, tmp_path, Driver("stop when near"), None, f"{file}:Ball").episodes()
