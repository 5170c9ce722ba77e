"""Claims on what comes of a controller: faults are noticed, sound ones and harmless changes are not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from examples import VISIT, hand, scenario
from harmless import HARMLESS
from planted_controllers import (
    Blind,
    Drifts,
    IgnoresTheSecondHand,
    SaysThatItRetreats,
    Sound,
    StopsLate,
    Wanders,
    alone,
)

from safety_harness.admission.admit import admit
from safety_harness.admission.claims import property_of
from safety_harness.admission.trial import run_kinematic, run_trial
from safety_harness.base.exceptions import InputError
from safety_harness.cell.simulation.worlds import PYBULLET
from safety_harness.claims.properties.base import Evaluation
from safety_harness.claims.properties.outcome import KeepsItsPlace, ReactsWithin
from safety_harness.claims.properties.servoing import Converged
from safety_harness.scenario.model import Claim, Scenario, Verdict
from safety_harness.scenario.moves import MoveTo, Wait
from safety_harness.scenario.read import read_scenario
from safety_harness.seams.contract import UserController
from safety_harness.trace.known import NOT_REPORTED, Measurement, Source
from safety_harness.trace.records import Mode
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import knowing

SCENARIOS = Path(__file__).parents[3] / "scenarios"
PLACE, REACTS = KeepsItsPlace(within_m=0.005), ReactsWithin(within_s=0.12)
NEAR = scenario(duration_s=6.0, offset=(0.01, 0.0, 0.01))
AFTER = hand(
    MoveTo(position_in_base_m=(0.9, -0.3, 0.3), speed_mps=1.0),
    Wait(duration_s=1.0),
    MoveTo(position_in_base_m=(1.3, -0.9, 0.3), speed_mps=1.0),
)


def shipped(name: str, duration_s: float | None = None) -> Scenario:
    read = read_scenario(SCENARIOS / f"{name}.yaml")
    return replace(read, claims=(), duration_s=duration_s or read.duration_s)


def driven(what: Scenario, controller: UserController) -> Trace:
    return run_kinematic(admit(alone(what), controller=controller))


def settled(controller: UserController) -> Trace:
    return driven(NEAR, controller)


def visited(controller: UserController) -> Trace:
    return driven(scenario(VISIT, duration_s=1.5), controller)


def met_by_the_second(controller: UserController) -> Trace:
    return driven(shipped("carrying-a-board", 2.0), controller)


@pytest.mark.parametrize(
    ("run", "fault", "claim"),
    [
        (settled, Drifts(), PLACE),
        (settled, Drifts(arrived_m=0.005), PLACE),
        (met_by_the_second, IgnoresTheSecondHand(), REACTS),
        (visited, StopsLate(), REACTS),
        (visited, StopsLate(brakes=False), REACTS),
    ],
    ids=["drifts", "drifts once arrived", "ignores a second hand", "stops late", "holds still late"],
)
def test_a_controller_is_noticed_by_its_motion_alone(
    run: Callable[[UserController], Trace], fault: UserController, claim: KeepsItsPlace | ReactsWithin
) -> None:
    trace, sound = run(fault), run(Sound())
    assert trace.known.column("mode") == NOT_REPORTED
    found = claim.evaluate(trace)
    assert found.verdict is Verdict.VIOLATED, found
    kept = claim.evaluate(sound)
    assert (kept.verdict, kept.exercised) == (Verdict.HOLDS, 1), kept


@pytest.mark.parametrize(("late", "held"), [(14, Verdict.HOLDS), (15, Verdict.VIOLATED)])
def test_a_stop_counts_from_where_the_drives_brake(late: int, held: Verdict) -> None:
    """The sensor tells at the next tick: 14 ticks late is 120 ms."""
    found = REACTS.evaluate(visited(StopsLate(late)))
    assert found.verdict is held, found
    assert found.margin == pytest.approx(0.12 - 0.008 * (late + 1), abs=1e-9)


def test_a_drift_counts_from_the_nearest_that_the_arm_was() -> None:
    found = PLACE.evaluate(driven(scenario(duration_s=3.0, offset=(0.0, 0.0, 0.0)), Drifts(until_m=0.006)))
    assert found.margin == pytest.approx(-0.001, abs=2e-5)


def circles(time_s: float) -> tuple[float, float, float]:
    return -0.0045 * np.sin(0.15 * time_s), 0.0045 * np.cos(0.15 * time_s), 0.0


def aside(time_s: float) -> tuple[float, float, float]:
    return 0.0, 0.004 * (time_s > 1.0), 0.0


@pytest.mark.parametrize(("way", "off_m"), [(circles, 0.03), (aside, 0.2)], ids=["circles", "aside"])
def test_an_arm_that_goes_no_farther_off_the_desired_position_leaves_its_place_all_the_same(
    way: Callable[[float], tuple[float, float, float]], off_m: float
) -> None:
    """From the place where it begins, by its own way: 30 mm aside are 2.2 mm farther off at 200 mm."""
    trace = driven(scenario(duration_s=8.0, offset=(off_m, 0.0, 0.0)), Wanders(way))
    tcp_m = trace.ticks["transform_tcp_to_base"][:, :3, 3]
    found = PLACE.evaluate(trace)
    assert found.verdict is Verdict.VIOLATED, found
    assert found.margin == pytest.approx(0.005 - np.linalg.norm(tcp_m - tcp_m[0], axis=1).max(), abs=1e-3)


def test_an_arm_that_goes_to_and_fro_holds_no_place() -> None:
    """At its turning point it is where it was a second before, and was elsewhere in between."""
    what = scenario(duration_s=3.0, offset=(0.2, 0.0, 0.0))
    found = PLACE.evaluate(driven(what, Wanders(lambda time_s: (0.0, 0.1 - 0.2 * (time_s > 1.5), 0.0))))
    assert (found.verdict, found.exercised) == (Verdict.INCONCLUSIVE, 0), found


@pytest.mark.parametrize("gain", [1.0, 2.0, 5.0])
@pytest.mark.parametrize("waits_s", [0.6, 1.2])
def test_an_arm_that_slows_because_it_arrives_has_not_reacted(gain: float, waits_s: float) -> None:
    come = MoveTo(position_in_base_m=(0.9, -0.3, 0.3), speed_mps=1.5)
    what = scenario(hand(Wait(duration_s=waits_s), come), duration_s=3.0, offset=(0.1, -0.05, 0.1))
    found = REACTS.evaluate(driven(what, Blind(gain, 0.1)))
    assert (found.verdict, found.exercised) == (Verdict.VIOLATED, 1), found


@pytest.mark.parametrize(("turns_radps", "held"), [(0.3, Verdict.VIOLATED), (6.0, Verdict.HOLDS)])
def test_an_arm_on_a_wide_curve_has_not_reacted(turns_radps: float, held: Verdict) -> None:
    """It turns from the hand, which comes after a second; whoever does so at once has reacted."""

    def curve(time_s: float) -> tuple[float, float, float]:
        angle_rad = min(turns_radps * max(time_s - 1.0, 0.0), 1.5)
        return -0.03 * np.cos(angle_rad), 0.0, 0.03 * np.sin(angle_rad)

    trace = driven(
        scenario(hand(Wait(duration_s=9.0)), duration_s=4.0, offset=(0.2, 0.0, 0.0)), Wanders(curve)
    )
    ticks = trace.ticks.copy()
    below_m = np.where(trace.time_s < 1.0, 2.0, 0.39)
    ticks["hand_position_in_base_m"][:, 0] = ticks["transform_tcp_to_base"][:, :3, 3]
    ticks["hand_position_in_base_m"][:, 0, 2] -= below_m
    found = REACTS.evaluate(replace(trace, ticks=ticks))
    assert (found.verdict, found.exercised) == (held, 1), found


@pytest.mark.parametrize(
    ("name", "reacts", "place"),
    [("hand-stays", 3, 0), ("hand-visits-and-leaves", 0, 1), ("wandering-hand", 1, 0)],
)
def test_the_built_in_stack_holds_where_the_claims_are_exercised(name: str, reacts: int, place: int) -> None:
    trace = run_kinematic(admit(shipped(name)))
    for claim, times in ((REACTS, reacts), (PLACE, place)):
        found = claim.evaluate(trace)
        assert found.exercised == times, found
        assert found.verdict is (Verdict.HOLDS if times else Verdict.INCONCLUSIVE), found


SYSTEMS = ("the built-in stack", "stop when near")


def changed(change: str, system: str, folder: Path) -> Scenario:
    """A hand comes to an arm that holds its place, stays and leaves."""
    what = scenario(AFTER, duration_s=6.0, offset=(0.02, -0.04, 0.02))
    return HARMLESS[change](folder)(what if system == SYSTEMS[0] else replace(alone(what), controller=system))


@pytest.mark.parametrize("system", SYSTEMS)
@pytest.mark.parametrize("change", HARMLESS)
def test_no_harmless_change_raises_an_alarm(change: str, system: str, tmp_path: Path) -> None:
    if change == "slow decisions" and system != SYSTEMS[0]:
        pytest.skip("it asks no avoider")
    trace = run_kinematic(admit(changed(change, system, tmp_path)))
    for claim in (PLACE, REACTS):
        found = claim.evaluate(trace)
        assert found.verdict is not Verdict.VIOLATED, found
    assert PLACE.evaluate(trace).exercised or REACTS.evaluate(trace).exercised


@pytest.mark.parametrize(("change", "system"), [("late hands", SYSTEMS[1]), ("tick of 16 ms", SYSTEMS[0])])
def test_nor_does_it_in_pybullet(change: str, system: str, tmp_path: Path) -> None:
    trace = run_trial(admit(changed(change, system, tmp_path)), world=PYBULLET)
    for claim in (PLACE, REACTS):
        assert claim.evaluate(trace).verdict is not Verdict.VIOLATED
    assert PLACE.evaluate(trace).exercised


def test_a_hand_that_leaves_before_it_could_be_answered_is_no_evidence() -> None:
    """It passes within the critical distance for about 60 ms."""
    trace = visited(StopsLate(200))
    ticks = trace.ticks.copy()
    apart_m = ticks["hand_position_in_base_m"][:, 0] - ticks["transform_tcp_to_base"][:, :3, 3]
    first = int(np.argmax(np.linalg.norm(apart_m, axis=1) < 0.4))
    ticks["hand_position_in_base_m"][first + 8 :, 0] += (2.0, 0.0, 0.0)
    found = REACTS.evaluate(replace(trace, ticks=ticks))
    assert (found.verdict, found.exercised) == (Verdict.INCONCLUSIVE, 0), found


def test_an_arm_that_stands_or_retreats_already_exercises_nothing() -> None:
    stands = REACTS.evaluate(visited(SaysThatItRetreats()))
    assert (stands.verdict, stands.exercised) == (Verdict.INCONCLUSIVE, 0)
    assert "which stood, or had reacted" in stands.reason
    nobody = REACTS.evaluate(settled(Sound()))
    assert "there is no hand in this scenario" in nobody.reason


@lru_cache
def stood_for_a_minute() -> Trace:
    return driven(scenario(duration_s=12.0, offset=(0.02, -0.03, 0.02)), SaysThatItRetreats())


@pytest.mark.parametrize("mode", [Mode.REPULSING, Mode.PROTECTIVE_STOP, Mode.SERVOING])
def test_what_converges_is_judged_by_motion_whatever_mode_is_reported(mode: Mode) -> None:
    """An arm that stands off for 12 s has not converged, though the closed form takes longer."""
    trace = stood_for_a_minute()
    ticks = trace.ticks.copy()
    ticks["mode"] = mode
    for one in (trace, replace(trace, ticks=ticks, known=knowing(trace, {"mode": Measurement()}).known)):
        found = Converged().evaluate(one)
        assert found.verdict is Verdict.VIOLATED, found
        assert found.margin == pytest.approx(0.001 - np.sqrt(0.02**2 + 0.03**2 + 0.02**2), abs=1e-6)


def test_a_short_run_that_comes_nearer_all_the_while_is_no_evidence_that_it_converges() -> None:
    found = Converged().evaluate(driven(scenario(duration_s=8.0, offset=(0.02, -0.03, 0.02)), Slower()))
    assert found.verdict is Verdict.INCONCLUSIVE, found


class Slower(Sound):
    """It gets on at the gain that the settings have near the desired pose."""

    def reset(self, **start: object) -> None:
        super().reset(**start)  # type: ignore[arg-type]
        self._gain = 0.1


@pytest.mark.parametrize("off_m", [0.0, 1e-4, 5e-3])
def test_uncertain_poses_leave_a_verdict_only_where_every_one_of_them_gives_it(off_m: float) -> None:
    uncertain = Measurement(source=Source.LOG, uncertainty=off_m)

    def said(trace: Trace, claim: KeepsItsPlace | Converged) -> Evaluation:
        return claim.evaluate(knowing(trace, {"transform_tcp_to_base": uncertain}))

    drifted, kept = settled(Drifts()), settled(Sound())
    assert said(drifted, PLACE).verdict is (Verdict.VIOLATED if off_m < 5e-3 else Verdict.INCONCLUSIVE)
    assert said(kept, PLACE).verdict is (Verdict.HOLDS if off_m < 5e-3 else Verdict.INCONCLUSIVE)
    assert said(stood_for_a_minute(), Converged()).verdict is Verdict.VIOLATED


@pytest.mark.parametrize(
    "sentence",
    [
        "keeps its place within 0 mm",
        "keeps its place within 5 s",
        "keeps its place within 1e300 m",
        "reacts within 120 mm",
        "reacts within 0 ms",
        "reacts within 2 h",
    ],
)
def test_a_limit_of_no_sense_is_refused(sentence: str) -> None:
    with pytest.raises(InputError):
        property_of(Claim(sentence=sentence, expected=Verdict.HOLDS), NEAR)


def test_the_limit_is_that_of_the_sentence() -> None:
    drifted, late = settled(Drifts()), visited(StopsLate())
    for sentence, trace in (("keeps its place within 50 mm", drifted), ("reacts within 0.3 s", late)):
        claim = property_of(Claim(sentence=sentence, expected=Verdict.HOLDS), trace.scenario)
        assert claim.evaluate(trace).verdict is Verdict.HOLDS
