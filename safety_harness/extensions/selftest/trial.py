"""One fault on trial: which claim is violated with it and holds without it, on the same scenario."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from safety_harness.admission.admit import Admitted
from safety_harness.admission.claims import property_of
from safety_harness.base.exceptions import FlakyAvoiderError, described
from safety_harness.cell.avoidance.avoider import spread_threshold_of
from safety_harness.cell.avoidance.flaky import refuse_flaky
from safety_harness.cell.simulation.worlds import KINEMATIC, REFERENCE, WorldEntry
from safety_harness.claims.properties.base import Evaluation, Unit
from safety_harness.claims.properties.hand_distance import HAND_DISTANCE
from safety_harness.claims.properties.shield_theorem import REFUTED
from safety_harness.claims.properties.touching import theorem_bits
from safety_harness.extensions.selftest.fault import SeededFault
from safety_harness.extensions.selftest.geometry import Kept, hand_distance_kept
from safety_harness.extensions.selftest.suite import claims_of
from safety_harness.extensions.selftest.system import ChangedSystem
from safety_harness.scenario.model import Verdict
from safety_harness.trace.trace import Trace

SAME_TWICE = "the same question has the same answer"
RUN_FAILED = "the run can be carried through"
LEAST_M = 0.050  # of the catalogue's own sentence about the hand distance
Words = Mapping[str, Evaluation]  # by sentence

# How far apart the margins with and without a fault have to be, so that it is no matter of a hair [SI].
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
    """A claim that is violated with the fault and holds without it.

    ``margin`` with it and ``before``, without.  ``true``: geometry that is not ours says so too, which is
    asked of harmless changes only.
    """

    claim: str
    scenario: str
    margin: str
    before: str
    true: bool = False

    def __str__(self) -> str:
        words = f"{self.claim} ({self.scenario}: {self.margin}, {self.before} without)"
        return f"{words}, which is true" if self.true else words


@dataclass(frozen=True, kw_only=True)
class Geometry:
    """What PyBullet's own kinematics and distances say of the hand distance in so many runs with hands.

    It is ``kept`` in some and ``broken`` in others, too near to tell in the rest; in those ``contradicted``
    our verdict is the opposite.
    """

    runs: int = 0
    kept: int = 0
    broken: int = 0
    contradicted: tuple[str, ...] = ()

    def with_run(self, scenario: str, kept: Kept, verdict: Verdict) -> Geometry:
        """With one more."""
        wrong = {Kept.PROVEN: Verdict.VIOLATED, Kept.REFUTED: Verdict.HOLDS}.get(kept) is verdict
        return Geometry(
            runs=self.runs + 1,
            kept=self.kept + (kept is Kept.PROVEN),
            broken=self.broken + (kept is Kept.REFUTED),
            contradicted=(*self.contradicted, *([scenario] if wrong else [])),
        )


@dataclass(frozen=True, kw_only=True)
class Rung:
    """One magnitude of a fault: what caught it, if anything did, and after how many episodes.

    ``alarms`` are all those of the episode that caught it.  ``confirmed``: so does PyBullet; None where
    it was not asked.  ``geometry`` is of harmless changes.
    """

    magnitude: float
    words: str
    episodes: int
    alarms: tuple[Alarm, ...] = ()
    confirmed: bool | None = None
    geometry: Geometry | None = None

    @property
    def caught(self) -> bool:
        """Is there an alarm?"""
        return bool(self.alarms)


@dataclass(eq=False)
class FaultTrials:
    """Tries faults on a suite of episodes, and remembers what the sound system does there."""

    episodes: tuple[Admitted, ...]
    _sound: dict[tuple[int, str, str], Words] = field(default_factory=dict)

    def applies(self, fault: SeededFault) -> bool:
        """A fault of the spread needs an avoider that states one; others may need the visual servo.

        That is a fault in what the visual servo alone has: avoider, gate, and its own records.
        """
        if not self._all_servo:
            return self._touches_any(fault)
        if not fault.of_spread:
            return True
        return any(spread_threshold_of(one.avoider) is not None for one in self.episodes)

    @property
    def _all_servo(self) -> bool:
        return all(one.driver is None for one in self.episodes)

    def _touches_any(self, fault: SeededFault) -> bool:
        """Is all that the fault changes in the world, in what is seen of it or told to it?"""
        before = ChangedSystem(self.episodes[0])
        after = fault.seed_into(fault.circumstance.bring_about(before), fault.ladder.values[0])
        own = after.admitted.avoider is before.admitted.avoider
        return own and not after.edits and after.pilot is None

    def rung(self, fault: SeededFault, magnitude: float) -> Rung:
        """Episode after episode, until something catches it."""
        words, alarms = fault.ladder.words(magnitude), tuple[Alarm, ...]()
        for number in range(len(self.episodes)):
            alarms = self.alarms(fault, magnitude, number)
            if alarms:
                break
        return Rung(magnitude=magnitude, words=words, episodes=number + 1, alarms=alarms)

    def alarms(
        self, fault: SeededFault, magnitude: float, number: int, world: WorldEntry = KINEMATIC
    ) -> tuple[Alarm, ...]:
        """What is violated in an episode of the suite with the fault, and holds there without it."""
        sound, found, _ = self._with_and_without(fault, magnitude, number, world)
        return alarms_between(sound, found, self.episodes[number].scenario.name)

    def everywhere(self, fault: SeededFault) -> Rung:
        """Every alarm on the whole suite, for a fault of which there should be none; what geometry says."""
        magnitude, every, geometry = fault.ladder.values[0], list[Alarm](), Geometry()
        for number, admitted in enumerate(self.episodes):
            name = admitted.scenario.name
            sound, found, trace = self._with_and_without(fault, magnitude, number)
            alarms = alarms_between(sound, found, name)
            if trace is not None and trace.scenario.hands and REFERENCE.is_installed:
                kept = hand_distance_kept(trace, LEAST_M)
                geometry = geometry.with_run(name, kept, found[HAND_DISTANCE.example].verdict)
                alarms = confirmed_by(kept, alarms)
            every += alarms
        return Rung(
            magnitude=magnitude,
            words=fault.ladder.words(magnitude),
            episodes=len(self.episodes),
            alarms=tuple(every),
            geometry=geometry,
        )

    def confirmed(self, fault: SeededFault, rung: Rung) -> bool | None:
        """Is one of the claims that caught it violated in the reference as well?  None: not installed."""
        if not REFERENCE.is_installed:
            return None
        there = self.alarms(fault, rung.magnitude, rung.episodes - 1, REFERENCE)
        return bool({alarm.claim for alarm in there} & {alarm.claim for alarm in rung.alarms})

    def _with_and_without(
        self, fault: SeededFault, magnitude: float, number: int, world: WorldEntry = KINEMATIC
    ) -> tuple[Words, Words, Trace | None]:
        """The words on an episode without the fault and with it, and the run with it unless it failed."""
        system = fault.circumstance.bring_about(ChangedSystem(self.episodes[number]))
        key = (number, fault.circumstance.name, world.name)
        if key not in self._sound:
            run = system.run(world)
            if theorem_bits(run) & REFUTED:
                raise RuntimeError(f"the sound run {run.scenario.name} refutes the theorem of its shield")
            self._sound[key] = words_on(system.admitted, run)
        faulty = fault.seed_into(system, magnitude)
        try:
            trace = faulty.run(world)
        except Exception as error:  # what a faulty system raises is what it is tried for; our judging is not
            return self._sound[key], {RUN_FAILED: check(RUN_FAILED, described(error))}, None
        return self._sound[key], words_on(faulty.admitted, trace), trace


def alarms_between(sound: Words, faulty: Words, scenario: str) -> tuple[Alarm, ...]:
    """The sentences that hold of the sound run and are violated in the faulty one, by more than a hair."""
    return tuple(
        Alarm(
            claim=claim,
            scenario=scenario,
            margin=evaluation.reason if evaluation.margin is None else evaluation.margin_text(),
            before=sound[claim].margin_text(),
        )
        for claim, evaluation in faulty.items()
        if fallen(sound[claim], evaluation)
    )


def confirmed_by(kept: Kept, alarms: Sequence[Alarm]) -> tuple[Alarm, ...]:
    """Those about the hand distance are true where geometry refutes that it is kept."""
    refuted = kept is Kept.REFUTED
    return tuple(replace(one, true=refuted and one.claim == HAND_DISTANCE.example) for one in alarms)


def fallen(sound: Evaluation, faulty: Evaluation) -> bool:
    """Did a claim hold, and is it violated now, with margins that are more than a hair apart?"""
    if (sound.verdict, faulty.verdict) != (Verdict.HOLDS, Verdict.VIOLATED):
        return False
    if sound.margin is None or faulty.margin is None:
        return True
    return sound.margin - faulty.margin >= CLEAR[sound.unit]


def words_on(admitted: Admitted, trace: Trace) -> dict[str, Evaluation]:
    """The words of every claim on one run, by sentence, and of the two checks that are no claims."""
    found = {RUN_FAILED: check(RUN_FAILED, ""), SAME_TWICE: check(SAME_TWICE, _flaky(admitted, trace))}
    for claim in claims_of(admitted.scenario):
        found[claim.sentence] = property_of(claim, trace.scenario).evaluate(trace)
    return found


def _flaky(admitted: Admitted, trace: Trace) -> str:
    if admitted.driver is not None:
        return ""
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
