"""Define faults of a shield.

The shield is blind, omits a part of the arm, or assumes that hands are slower than they are. The faults are
tried where only the shield protects hands, because the controller does not avoid hands.
"""

from __future__ import annotations

from dataclasses import replace

from safety_harness.base.settings import HandSensorKind
from safety_harness.cell.controller.cycle import ControllerRecords
from safety_harness.extensions.selftest.fault import (
    BEHIND_A_SHIELD,
    Precondition,
    faults_in,
    known,
    minds_nobody,
    of_motion,
    seeded,
)
from safety_harness.extensions.selftest.system import ChangedSystem
from safety_harness.scenario.shield import Shield

FAR_M = 10.0  # far from any arm; a choice


def _alone(system: ChangedSystem) -> ChangedSystem:
    """Return the system with a shield, and with a controller that does not avoid hands.

    A system with an eye-in-hand sensor is returned unchanged.
    """
    scenario = system.admitted.scenario
    if scenario.settings.hand_sensor.kind is HandSensorKind.EYE_IN_HAND:
        return system
    shielded = replace(scenario, shield=Shield(uncertainty_m=0.04))
    behind = replace(system, admitted=replace(system.admitted, scenario=shielded))
    return behind.with_records(minds_nobody)


ALONE = Precondition(BEHIND_A_SHIELD, _alone)


@of_motion("shield looks elsewhere", "it sees hands in wrong places and misses the real hands", ALONE)
@seeded(known, (FAR_M, 1.0, 0.5), "m")
def _elsewhere(records: ControllerRecords, by_m: float) -> None:
    records.shield["transform_sensor_to_base"][:, 1, 3] -= by_m  # hands seem farther to the right


@of_motion("shield forgets links", "no slowing for a part of the arm", ALONE)
@seeded(known, (1.0, 2.0, 3.0), names=("all that move", "from the upper arm on", "from the forearm on"))
def _forgets(records: ControllerRecords, first: float) -> None:
    records.capsules["radius_m"][records.capsules["link_index"] >= int(first)] = -FAR_M  # far inside


@of_motion("shield takes hands for slow", "the arm is slowed too late", ALONE)
@seeded(known, (0.0, 0.05, 0.2), "times")
def _slow(records: ControllerRecords, factor: float) -> None:
    records.shield["hand_speed_mps"] *= factor


@of_motion("shield forgets forearms", "an elbow is where no hand is", ALONE)
@seeded(known, (0.0, 0.03, 0.06), "mm", 1e3)
def _armless(records: ControllerRecords, body_m: float) -> None:
    records.shield["body_m"] = body_m


SHIELD_FAULTS = faults_in(globals())
