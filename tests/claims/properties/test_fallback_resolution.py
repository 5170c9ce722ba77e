"""The fallback's onset, direction, speed and end are judged apart, each to its stated resolution."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from harmless import CERTAIN, HARMLESS, IN_DOUBT, SOUND, Astray, Reporting, Strays

from safety_harness import admit, read_scenario
from safety_harness.admission.trial import run_trial
from safety_harness.cell.controller.controller import AvoidingServo
from safety_harness.cell.simulation.worlds import KINEMATIC, PYBULLET, WorldEntry
from safety_harness.claims.properties.base import Evaluation
from safety_harness.claims.properties.fallback import CertainIsUsed, UncertainFallsBack
from safety_harness.scenario.model import Verdict
from safety_harness.trace.trace import Trace

CLAIM, USED = UncertainFallsBack(cycles=2), CertainIsUsed()
BUILT_IN, REPORTING = "the built-in stack", "a controller that reports"
REACH = replace(
    read_scenario(Path(__file__).parents[3] / "scenarios" / "hesitating-reach.yaml"),
    avoider="opposite pose",
    claims=(),
    duration_s=4.0,
)


def gone(system: str, fault: Astray = SOUND, world: WorldEntry = KINEMATIC) -> Trace:
    """A run in which every answer is uncertain and the fallback has this fault."""
    if system == REPORTING:
        return run_trial(admit(REACH, controller=Reporting(fault)), world=world)
    admitted = admit(REACH, avoider=IN_DOUBT)
    pilot = admitted.controller()
    assert isinstance(pilot, AvoidingServo)
    return run_trial(admitted, world=world, controller=Strays(pilot, fault))


def parts_of(evaluation: Evaluation) -> dict[str, Verdict]:
    """The verdicts by part."""
    return {part.sentence.rpartition(": ")[2]: part.verdict for part in evaluation.parts}


@pytest.mark.parametrize("system", [BUILT_IN, REPORTING])
def test_a_right_fallback_holds_in_every_part(system: str) -> None:
    evaluation = CLAIM.evaluate(gone(system))
    assert evaluation.exercised > 1, evaluation
    assert parts_of(evaluation) == dict.fromkeys(("onset", "direction", "speed", "end"), Verdict.HOLDS)


@pytest.mark.parametrize("system", [BUILT_IN, REPORTING])
@pytest.mark.parametrize(
    ("fault", "part"),
    [
        *((Astray(off_deg=off_deg), "direction") for off_deg in (1.0, 2.0, 3.0, 5.0, 6.0)),
        (Astray(late=3), "onset"),
        (Astray(late=5), "onset"),
        (Astray(speed=0.8), "speed"),
        (Astray(aside_m=0.002), "end"),
        (Astray(aside_m=0.009), "end"),
    ],
    ids=str,
)
def test_a_fallback_that_goes_astray_and_reports_the_opposite_pose_is_violated(
    system: str, fault: Astray, part: str
) -> None:
    """The part that the fault breaks says so."""
    evaluation = CLAIM.evaluate(gone(system, fault))
    assert (evaluation.verdict, parts_of(evaluation)[part]) == (Verdict.VIOLATED, Verdict.VIOLATED), (
        evaluation
    )


@pytest.mark.parametrize("system", [BUILT_IN, REPORTING])
def test_an_onset_as_late_as_the_claim_allows_holds(system: str) -> None:
    for late in (2, 30):
        trace = gone(system, Astray(late=late))
        for cycles, verdict in ((late, Verdict.HOLDS), (late - 1, Verdict.VIOLATED)):
            assert parts_of(UncertainFallsBack(cycles=cycles).evaluate(trace))["onset"] is verdict


# Whatever is not of the drives is the same in both worlds.
OF_DRIVES = ("drives lag and wait", "payload and torque limit")


@pytest.mark.parametrize(
    ("change", "world"),
    [
        (change, world)
        for change in HARMLESS
        for world in (KINEMATIC, *([PYBULLET] if change in OF_DRIVES else []))
    ]
    + [
        pytest.param(change, PYBULLET, marks=pytest.mark.long)
        for change in HARMLESS
        if change not in OF_DRIVES
    ],
    ids=lambda one: one if isinstance(one, str) else one.label,
)
def test_no_harmless_change_raises_an_alarm(change: str, world: WorldEntry, tmp_path: Path) -> None:
    cell = HARMLESS[change](tmp_path)(REACH)
    for prop, avoider in ((CLAIM, IN_DOUBT), (USED, CERTAIN)):
        evaluation = prop.evaluate(run_trial(admit(cell, avoider=avoider), world=world))
        assert (evaluation.verdict, evaluation.exercised > 0) == (Verdict.HOLDS, True), evaluation
