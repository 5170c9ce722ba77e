"""What counts as caught: violated with the fault and held without it, in the same scenario."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import pytest
from small import shipped, trials

from safety_harness.admission.admit import admit
from safety_harness.cell.avoidance.avoider import Avoider
from safety_harness.claims.properties.base import Evaluation, Unit
from safety_harness.extensions.assurance.certification.tools import FaultState
from safety_harness.extensions.selftest import trial
from safety_harness.extensions.selftest.fault import FaultyPart, SeededFault, SeverityLevels
from safety_harness.extensions.selftest.outcome import outcome_of
from safety_harness.extensions.selftest.session import sound_remarks, try_out
from safety_harness.extensions.selftest.system import ChangedSystem
from safety_harness.extensions.selftest.trial import RUN_FAILED, FaultTrials, alarms_between
from safety_harness.scenario.model import Verdict
from safety_harness.scenario.read import parse_scenario
from tests.cell.controller.test_shield import ONLY_THE_ARM, REACH, Swings, forgetful

HOLDS = Evaluation(
    sentence="a claim",
    verdict=Verdict.HOLDS,
    unit=Unit.LENGTH,
    margin=0.01,
    worst_time_s=1.0,
    reason="",
    exercised=1,
)
VIOLATED = replace(HOLDS, verdict=Verdict.VIOLATED, margin=-0.01)
OPEN = replace(HOLDS, verdict=Verdict.INCONCLUSIVE, margin=None)
BY_A_HAIR = replace(HOLDS, margin=1e-4)
made_up = partial(SeededFault, part=FaultyPart.MOTION, hazard="made up for a test")


def nothing(system: ChangedSystem, magnitude: float) -> ChangedSystem:
    return system


def faster(system: ChangedSystem, factor: float) -> ChangedSystem:
    def make(admitted: object):  # type: ignore[no-untyped-def]
        def obey(command):  # type: ignore[no-untyped-def]
            command["joint_velocity_radps"] *= factor
            return command

        return obey

    return system.obeying(make)


@pytest.mark.parametrize(
    ("sound", "faulty", "caught"),
    [
        (HOLDS, VIOLATED, True),
        (HOLDS, HOLDS, False),
        (HOLDS, OPEN, False),
        (OPEN, VIOLATED, False),
        (VIOLATED, VIOLATED, False),
        (BY_A_HAIR, VIOLATED, True),
        (BY_A_HAIR, replace(VIOLATED, margin=-1e-4), False),
        (replace(HOLDS, margin=0.9e-3), replace(VIOLATED, margin=-5e-3), True),
        (HOLDS, replace(VIOLATED, margin=None), True),
        (replace(HOLDS, unit=Unit.COUNT, margin=0.0), VIOLATED, True),
        (replace(HOLDS, margin=None), VIOLATED, True),
    ],
)
def test_caught_means_violated_with_it_and_held_without_by_more_than_a_hair(
    sound: Evaluation, faulty: Evaluation, caught: bool
) -> None:
    assert bool(alarms_between({"a claim": sound}, {"a claim": faulty}, "here")) is caught


def test_a_fault_that_does_nothing_is_never_caught() -> None:
    rung = trials("network-certain", "second-hand").rung(made_up(name="nothing", seed_into=nothing), 1.0)
    assert not rung.caught
    assert rung.episodes == 2


def test_the_ladder_is_gone_down_until_one_survives_and_the_last_catch_is_confirmed() -> None:
    fault = made_up(name="faster", seed_into=faster, ladder=SeverityLevels((2.0, 1.1, 1.0, 0.999)))
    outcome = try_out(trials("network-certain"), fault)
    assert [rung.caught for rung in outcome.rungs] == [True, True, False]
    assert outcome.state is FaultState.CAUGHT
    assert outcome.smallest is not None
    assert outcome.smallest.magnitude == 1.1
    assert outcome.confirmed is True
    assert outcome.survivor is not None
    assert outcome.survivor.magnitude == 1.0


def test_what_a_faulty_system_raises_is_an_alarm_and_what_a_sound_one_raises_is_not() -> None:
    def breaks(system: ChangedSystem, magnitude: float) -> ChangedSystem:
        def fail(records: object) -> None:
            raise ZeroDivisionError("made up")

        return system.with_records(fail)

    fault = made_up(name="breaks", seed_into=breaks)
    alarms = trials("network-certain").alarms(fault, 1.0, 0)
    assert [alarm.claim for alarm in alarms] == [RUN_FAILED]
    assert "made up" in alarms[0].margin
    broken_already = replace(
        fault, circumstance=replace(fault.circumstance, name="broken", bring_about=lambda s: breaks(s, 1.0))
    )
    with pytest.raises(ZeroDivisionError):
        trials("network-certain").alarms(broken_already, 1.0, 0)


def test_a_mistake_of_our_own_judging_is_no_catch(monkeypatch: pytest.MonkeyPatch) -> None:
    """It passes through: a harness that breaks on a faulty run has not caught the fault."""
    bench = trials("network-certain")
    fault = made_up(name="faster", seed_into=faster)
    assert bench.alarms(fault, 2.0, 0)  # and the sound run is judged already

    def breaks(*_: object) -> None:
        raise ZeroDivisionError("our own")

    monkeypatch.setattr(trial, "property_of", breaks)
    with pytest.raises(ZeroDivisionError, match="our own"):
        bench.alarms(fault, 2.0, 0)


def test_a_sound_run_that_refutes_the_theorem_of_the_shield_fails() -> None:
    """No assumption that a trace tells was broken, and the arm touched a hand."""
    fault = made_up(name="nothing", seed_into=nothing)
    kept = admit(parse_scenario(REACH + ONLY_THE_ARM), controller=Swings())
    assert FaultTrials((kept,)).alarms(fault, 1.0, 0) == ()
    with pytest.raises(RuntimeError, match="the sound run unnamed refutes the theorem of its shield"):
        FaultTrials((forgetful(),)).alarms(fault, 1.0, 0)


def test_a_fault_of_the_spread_does_not_apply_without_one() -> None:
    fault = made_up(name="spread", seed_into=nothing, of_spread=True)
    assert not trials("nothing-reachable").applies(fault)
    assert trials("network-certain").applies(fault)
    assert try_out(trials("nothing-reachable"), fault).state is FaultState.UNTOUCHED


def test_an_avoider_that_is_not_repeatable_is_told_of() -> None:
    class Moody:
        name = "moody"
        questions = 0

        def propose(self, **question):  # type: ignore[no-untyped-def]
            self.questions += 1
            proposal = shipped("network-certain").avoider.propose(**question)
            return replace(proposal, spread_m=proposal.spread_m + 1e-9 * self.questions)

    moody: Avoider = Moody()
    admitted = replace(shipped("network-certain"), avoider=moody)
    told = sound_remarks((admitted,))
    assert any("not repeatable" in line for line in told)
    assert any("one question after another" in line for line in told)
    assert sound_remarks((shipped("network-certain"),)) == []


def test_a_harmless_change_with_an_alarm_is_a_false_alarm() -> None:
    fault = made_up(name="faster", seed_into=faster, harmless="so it is said", ladder=SeverityLevels((2.0,)))
    outcome = try_out(trials("network-certain", "second-hand"), fault)
    assert outcome.state is FaultState.FALSE_ALARM
    assert outcome.rungs[0].episodes == 2
    quiet = outcome_of(
        replace(fault, harmless="so it is"),
        (trials("network-certain").everywhere(replace(fault, seed_into=nothing)),),
    )
    assert quiet.state is FaultState.QUIET
