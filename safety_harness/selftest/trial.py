"""One fault on trial: which claim is violated with it and holds without it, on the same scenario."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from safety_harness.admission.admit import Admitted
from safety_harness.admission.claims import property_of
from safety_harness.admission.kinematic import run_many
from safety_harness.avoidance.avoider import described, spread_threshold_of
from safety_harness.avoidance.flaky import refuse_flaky
from safety_harness.exceptions import FlakyAvoiderError
from safety_harness.properties.base import Evaluation, Unit
from safety_harness.properties.spread_calibration import SpreadCalibration
from safety_harness.scenario.model import Verdict
from safety_harness.selftest.fault import Fault
from safety_harness.selftest.suite import Suite, claims_of
from safety_harness.selftest.system import System
from safety_harness.trace.trace import Trace

SAME_TWICE = "the same question has the same answer"
RUN_FAILED = "the run can be carried through"
# By how much a claim has to hold without the fault, so that its violation is no matter of a hair [SI].
CLEAR = {
    Unit.LENGTH: 1e-3,
    Unit.ANGLE: 1e-3,
    Unit.SPEED: 1e-3,
    Unit.ANGULAR_SPEED: 1e-3,
    Unit.TIME: 0.02,
    Unit.ACCELERATION: 0.02,
    Unit.ANGULAR_ACCELERATION: 0.02,
    Unit.FRACTION: 0.005,
    Unit.COUNT: 0.0,
}


@dataclass(frozen=True, kw_only=True)
class Alarm:
    """A claim that is violated with the fault and holds without it."""

    claim: str
    scenario: str
    margin: str
    before: str  # the margin without the fault

    def __str__(self) -> str:
        return f"{self.claim} ({self.scenario}: {self.margin}, {self.before} without)"


@dataclass(frozen=True, kw_only=True)
class Rung:
    """One magnitude of a fault: what caught it, if anything did, and after how many episodes.

    ``alarms`` are all those of the episode that caught it.  ``confirmed``: so does PyBullet; None where
    it was not asked.
    """

    magnitude: float
    words: str
    episodes: int
    alarms: tuple[Alarm, ...] = ()
    confirmed: bool | None = None

    @property
    def caught(self) -> bool:
        """Is there an alarm?"""
        return bool(self.alarms)


@dataclass(eq=False)
class Trials:
    """Tries faults on a suite, and remembers what the sound system does there."""

    suite: Suite
    _sound: dict[tuple[int, str, bool], dict[str, Evaluation]] = field(default_factory=dict)
    _sound_pool: Evaluation | None = None

    def applies(self, fault: Fault) -> bool:
        """A fault of the spread needs an avoider that states one."""
        every = [one.avoider for one in (*self.suite.episodes, *self.suite.pool)]
        return not fault.pooled or any(spread_threshold_of(avoider) is not None for avoider in every)

    def rung(self, fault: Fault, magnitude: float) -> Rung:
        """Episode after episode, until something catches it."""
        words = fault.ladder.words(magnitude)
        episodes = 0
        for number in range(len(self.suite.episodes)):
            episodes += 1
            alarms = self.alarms(fault, magnitude, number)
            if alarms:
                return Rung(magnitude=magnitude, words=words, episodes=episodes, alarms=alarms)
        together = self._pooled(fault, magnitude) if fault.pooled else ()
        if fault.pooled:
            episodes += len(self.suite.pool)
        return Rung(magnitude=magnitude, words=words, episodes=episodes, alarms=together)

    def alarms(
        self, fault: Fault, magnitude: float, number: int, *, in_pybullet: bool = False
    ) -> tuple[Alarm, ...]:
        """What is violated in an episode of the suite with the fault, and holds there without it."""
        admitted = self.suite.episodes[number]
        system = fault.circumstance.bring_about(System.of(admitted))
        sound = self._sound_words(system, fault, number, in_pybullet)
        try:
            found = judged(fault.seed_into(system, magnitude), in_pybullet=in_pybullet)
        except Exception as error:  # what a faulty system raises is what it is tried for
            found = {RUN_FAILED: check(RUN_FAILED, described(error))}
        return alarms_between(sound, found, admitted.scenario.name)

    def everywhere(self, fault: Fault) -> Rung:
        """Every alarm on the whole suite: for a fault of which there should be none."""
        magnitude = fault.ladder.values[0]
        found = [self.alarms(fault, magnitude, number) for number in range(len(self.suite.episodes))]
        return Rung(
            magnitude=magnitude,
            words=fault.ladder.words(magnitude),
            episodes=len(found),
            alarms=tuple(alarm for alarms in found for alarm in alarms),
        )

    def confirmed(self, fault: Fault, rung: Rung) -> bool | None:
        """Is one of the claims that caught it violated in PyBullet as well?  None for those of many runs."""
        number = rung.episodes - 1
        if number >= len(self.suite.episodes):
            return None
        there = self.alarms(fault, rung.magnitude, number, in_pybullet=True)
        return bool({alarm.claim for alarm in there} & {alarm.claim for alarm in rung.alarms})

    def _sound_words(
        self, system: System, fault: Fault, number: int, in_pybullet: bool
    ) -> Mapping[str, Evaluation]:
        key = (number, fault.circumstance.name, in_pybullet)
        if key not in self._sound:
            self._sound[key] = judged(system, in_pybullet=in_pybullet)
        return self._sound[key]

    def _pooled(self, fault: Fault, magnitude: float) -> tuple[Alarm, ...]:
        pool = self.suite.pool
        prop = SpreadCalibration()
        if self._sound_pool is None:
            self._sound_pool = prop.evaluate(run_many(pool))
        spoilt = [fault.seed_into(System.of(one), magnitude).admitted for one in pool]
        found = prop.evaluate(run_many(spoilt))
        if found.verdict is not Verdict.VIOLATED or not holds_clearly(self._sound_pool):
            return ()
        before = self._sound_pool.margin_text()
        name = f"{len(pool)} draws of nominal"
        return (Alarm(claim=prop.sentence, scenario=name, margin=found.margin_text(), before=before),)


def alarms_between(
    sound: Mapping[str, Evaluation], faulty: Mapping[str, Evaluation], scenario: str
) -> tuple[Alarm, ...]:
    """The sentences that hold clearly of the sound run and are violated in the faulty one."""
    return tuple(
        Alarm(
            claim=claim,
            scenario=scenario,
            margin=evaluation.reason if evaluation.margin is None else evaluation.margin_text(),
            before=sound[claim].margin_text(),
        )
        for claim, evaluation in faulty.items()
        if evaluation.verdict is Verdict.VIOLATED and holds_clearly(sound[claim])
    )


def holds_clearly(evaluation: Evaluation) -> bool:
    """Does it hold, and by more than a hair?"""
    if evaluation.verdict is not Verdict.HOLDS:
        return False
    return evaluation.margin is None or evaluation.margin >= CLEAR[evaluation.unit]


def judged(system: System, *, in_pybullet: bool = False) -> dict[str, Evaluation]:
    """The words of every claim on one run, by sentence, and of the two checks that are no claims.

    Whatever the run raises passes through.
    """
    claims = claims_of(system.admitted.scenario)
    trace = system.run(in_pybullet=in_pybullet)
    found = {RUN_FAILED: check(RUN_FAILED, ""), SAME_TWICE: check(SAME_TWICE, _flaky(system.admitted, trace))}
    for claim in claims:
        found[claim.sentence] = property_of(claim, trace.scenario).evaluate(trace)
    return found


def _flaky(admitted: Admitted, trace: Trace) -> str:
    try:
        refuse_flaky(admitted.avoider, trace)
    except FlakyAvoiderError as error:
        return str(error).splitlines()[0]
    return ""


def check(sentence: str, wrong: str) -> Evaluation:
    """A check without a margin as an evaluation: it holds if nothing is ``wrong``."""
    return Evaluation(
        sentence=sentence,
        verdict=Verdict.VIOLATED if wrong else Verdict.HOLDS,
        unit=Unit.COUNT,
        margin=None,
        worst_time_s=None,
        reason=wrong or "nothing wrong",
        exercised=1,
    )
