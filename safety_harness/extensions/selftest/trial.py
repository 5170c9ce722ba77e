"""One fault in a sound system: the claims violated with it that hold without it, on the same scenario."""

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
LEAST_M = 0.050  # limit of the catalogue's example about the hand distance
Evaluations = Mapping[str, Evaluation]  # by sentence

# The least difference of the margins with and without a fault [SI], so that no catch depends on rounding.
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

    ``margin`` is the margin with the fault, and ``before`` the margin without it. ``true``: independent
    geometry confirms it, which only harmless changes need.
    """

    claim: str
    scenario: str
    margin: str
    before: str
    true: bool = False

    def __str__(self) -> str:
        text = f"{self.claim} ({self.scenario}: {self.margin}, {self.before} without)"
        return f"{text}, which is true" if self.true else text


@dataclass(frozen=True, kw_only=True)
class Geometry:
    """The results of PyBullet's kinematics and distances for the hand distance, in runs with hands.

    The limit is ``kept`` in some runs and ``broken`` in some, and the rest is too near to decide. In the
    ``contradicted`` runs our verdict is the opposite.
    """

    runs: int = 0
    kept: int = 0
    broken: int = 0
    contradicted: tuple[str, ...] = ()

    def with_run(self, scenario: str, kept: Kept, verdict: Verdict) -> Geometry:
        """Return the results with a further run."""
        contradicted = {Kept.PROVEN: Verdict.VIOLATED, Kept.REFUTED: Verdict.HOLDS}.get(kept) is verdict
        return Geometry(
            runs=self.runs + 1,
            kept=self.kept + (kept is Kept.PROVEN),
            broken=self.broken + (kept is Kept.REFUTED),
            contradicted=(*self.contradicted, *([scenario] if contradicted else [])),
        )


@dataclass(frozen=True, kw_only=True)
class Rung:
    """One magnitude of a fault, the number of episodes tried, and the alarms.

    ``alarms`` are all alarms of the episode that caught it. ``confirmed`` states whether PyBullet confirms
    the catch, None if it did not run. Only harmless changes have a ``geometry``.
    """

    magnitude: float
    words: str
    episodes: int
    alarms: tuple[Alarm, ...] = ()
    confirmed: bool | None = None
    geometry: Geometry | None = None

    @property
    def caught(self) -> bool:
        """Whether there is an alarm."""
        return bool(self.alarms)


@dataclass(eq=False)
class FaultTrials:
    """Tries faults on a suite of episodes, and remembers the results of the sound system."""

    episodes: tuple[Admitted, ...]
    _sound: dict[tuple[int, str, str], Evaluations] = field(default_factory=dict)

    def applies(self, fault: SeededFault) -> bool:
        """Return whether a fault applies to these episodes.

        A fault of the spread needs an avoider with a spread. Faults of avoider, gate and the visual servo's
        own records do not apply if a controller replaces the servo.
        """
        if not self._all_servo:
            return self._touches_any(fault)
        if not fault.of_spread:
            return True
        return any(spread_threshold_of(episode.avoider) is not None for episode in self.episodes)

    @property
    def _all_servo(self) -> bool:
        return all(episode.driver is None for episode in self.episodes)

    def _touches_any(self, fault: SeededFault) -> bool:
        """Return whether the fault changes only the world, its observations or its commands."""
        sound = ChangedSystem(self.episodes[0])
        faulty = fault.seed_into(fault.circumstance.bring_about(sound), fault.ladder.values[0])
        own = faulty.admitted.avoider is sound.admitted.avoider
        return own and not faulty.edits and faulty.pilot is None

    def rung(self, fault: SeededFault, magnitude: float) -> Rung:
        """Return the result of one magnitude: episode after episode, up to the first catch."""
        text, alarms = fault.ladder.label(magnitude), tuple[Alarm, ...]()
        for number in range(len(self.episodes)):
            alarms = self.alarms(fault, magnitude, number)
            if alarms:
                break
        return Rung(magnitude=magnitude, words=text, episodes=number + 1, alarms=alarms)

    def alarms(
        self, fault: SeededFault, magnitude: float, number: int, world: WorldEntry = KINEMATIC
    ) -> tuple[Alarm, ...]:
        """Return the claims violated with the fault that hold without it, in one episode of the suite."""
        sound, faulty, _ = self._with_and_without(fault, magnitude, number, world)
        return alarms_between(sound, faulty, self.episodes[number].scenario.name)

    def everywhere(self, fault: SeededFault) -> Rung:
        """Return all alarms of a harmless change on the whole suite, and the results of the geometry."""
        magnitude, every, geometry = fault.ladder.values[0], list[Alarm](), Geometry()
        for number, admitted in enumerate(self.episodes):
            name = admitted.scenario.name
            sound, faulty, trace = self._with_and_without(fault, magnitude, number)
            alarms = alarms_between(sound, faulty, name)
            if trace is not None and trace.scenario.hands and REFERENCE.is_installed:
                kept = hand_distance_kept(trace, LEAST_M)
                geometry = geometry.with_run(name, kept, faulty[HAND_DISTANCE.example].verdict)
                alarms = confirmed_by(kept, alarms)
            every += alarms
        return Rung(
            magnitude=magnitude,
            words=fault.ladder.label(magnitude),
            episodes=len(self.episodes),
            alarms=tuple(every),
            geometry=geometry,
        )

    def confirmed(self, fault: SeededFault, rung: Rung) -> bool | None:
        """Return whether a claim that caught the fault is violated in PyBullet too; None without PyBullet."""
        if not REFERENCE.is_installed:
            return None
        there = self.alarms(fault, rung.magnitude, rung.episodes - 1, REFERENCE)
        return bool({alarm.claim for alarm in there} & {alarm.claim for alarm in rung.alarms})

    def _with_and_without(
        self, fault: SeededFault, magnitude: float, number: int, world: WorldEntry = KINEMATIC
    ) -> tuple[Evaluations, Evaluations, Trace | None]:
        """Return the evaluations without the fault and with it, and the run with it unless it failed."""
        system = fault.circumstance.bring_about(ChangedSystem(self.episodes[number]))
        key = (number, fault.circumstance.name, world.name)
        if key not in self._sound:
            run = system.run(world)
            if theorem_bits(run) & REFUTED:
                raise RuntimeError(f"the sound run {run.scenario.name} refutes the theorem of its shield")
            self._sound[key] = evaluations_of(system.admitted, run)
        faulty = fault.seed_into(system, magnitude)
        try:
            trace = faulty.run(world)
        except Exception as error:  # an exception of a faulty system is a catch; an error in judging is not
            return self._sound[key], {RUN_FAILED: check(RUN_FAILED, described(error))}, None
        return self._sound[key], evaluations_of(faulty.admitted, trace), trace


def alarms_between(sound: Evaluations, faulty: Evaluations, scenario: str) -> tuple[Alarm, ...]:
    """Return the claims that hold in the sound run and are violated in the faulty run, by a clear margin."""
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
    """Return the alarms; one about the hand distance is true if the geometry refutes the limit."""
    refuted = kept is Kept.REFUTED
    return tuple(replace(alarm, true=refuted and alarm.claim == HAND_DISTANCE.example) for alarm in alarms)


def fallen(sound: Evaluation, faulty: Evaluation) -> bool:
    """Return whether a claim held and is violated now, with margins at least ``CLEAR`` apart."""
    if (sound.verdict, faulty.verdict) != (Verdict.HOLDS, Verdict.VIOLATED):
        return False
    if sound.margin is None or faulty.margin is None:
        return True
    return sound.margin - faulty.margin >= CLEAR[sound.unit]


def evaluations_of(admitted: Admitted, trace: Trace) -> dict[str, Evaluation]:
    """Return the evaluations of one run by sentence: all claims, and the two further checks."""
    evaluations = {RUN_FAILED: check(RUN_FAILED, ""), SAME_TWICE: check(SAME_TWICE, _flaky(admitted, trace))}
    for claim in claims_of(admitted.scenario):
        evaluations[claim.sentence] = property_of(claim, trace.scenario).evaluate(trace)
    return evaluations


def _flaky(admitted: Admitted, trace: Trace) -> str:
    if admitted.driver is not None:
        return ""
    try:
        refuse_flaky(admitted.avoider, trace)
    except FlakyAvoiderError as error:
        return str(error).splitlines()[0]
    return ""


def check(sentence: str, problem: str) -> Evaluation:
    """Return a check without a margin as an evaluation; it holds without a ``problem``."""
    return Evaluation(
        sentence=sentence,
        verdict=Verdict.VIOLATED if problem else Verdict.HOLDS,
        unit=Unit.COUNT,
        margin=None,
        worst_time_s=None,
        reason=problem or "nothing wrong",
        exercised=1,
    )
