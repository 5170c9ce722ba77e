"""Try one fault in a sound system: find claims that the fault violates and the sound system keeps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

from safety_harness.admission.admit import Admitted
from safety_harness.admission.claims import property_of
from safety_harness.base.exceptions import FlakyAvoiderError, described
from safety_harness.cell.avoidance.avoider import spread_threshold_of
from safety_harness.cell.avoidance.flaky import refuse_flaky
from safety_harness.cell.simulation.worlds import KINEMATIC, REFERENCE, WorldEntry, references
from safety_harness.claims.properties.base import Evaluation, Unit
from safety_harness.claims.properties.hand_distance import HAND_DISTANCE
from safety_harness.claims.properties.shield_theorem import REFUTED
from safety_harness.claims.properties.touching import theorem_bits
from safety_harness.extensions.selftest.fault import BEHIND_A_SHIELD, SeededFault
from safety_harness.extensions.selftest.geometry import Kept, hand_distance_kept
from safety_harness.extensions.selftest.perception_faults import OF_KALMAN_FILTER
from safety_harness.extensions.selftest.suite import claims_of
from safety_harness.extensions.selftest.system import ChangedSystem
from safety_harness.scenario.model import Verdict
from safety_harness.trace.trace import Trace

SAME_TWICE = "the same question has the same answer"
RUN_FAILED = "the run can be carried through"
LEAST_M = 0.050  # limit of the catalogue's example about the hand distance
Evaluations = Mapping[str, Evaluation]  # by sentence

# The least difference [SI] of the margins with and without a fault; no catch then depends on rounding.
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
    """A claim that is violated with the fault, although it holds without the fault in the same scenario.

    ``margin`` is the margin with the fault, and ``before`` the margin without it. ``true`` states that
    independent geometry confirms the alarm, which matters only for harmless changes.
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
    """The findings of PyBullet's kinematics and distances on the hand distance, in runs with hands.

    The limit is kept in ``kept`` runs and broken in ``broken`` runs; the other runs are too near to it to
    decide. In the runs ``contradicted``, the harness's verdict is the opposite.
    """

    runs: int = 0
    kept: int = 0
    broken: int = 0
    contradicted: tuple[str, ...] = ()

    def with_run(self, scenario: str, kept: Kept, verdict: Verdict) -> Geometry:
        """Return the findings with those of a further run."""
        contradicted = {Kept.PROVEN: Verdict.VIOLATED, Kept.REFUTED: Verdict.HOLDS}.get(kept) is verdict
        return Geometry(
            runs=self.runs + 1,
            kept=self.kept + (kept is Kept.PROVEN),
            broken=self.broken + (kept is Kept.REFUTED),
            contradicted=(*self.contradicted, *([scenario] if contradicted else [])),
        )


@dataclass(frozen=True, kw_only=True)
class Rung:
    """One magnitude of a fault, the number of episodes tried with it, and the alarms.

    ``alarms`` are all alarms of the episode that caught the fault. ``confirmed`` states whether the
    reference ``confirming`` shows the catch too; None if none ran. Only harmless changes have a ``geometry``.
    """

    magnitude: float
    words: str
    episodes: int
    alarms: tuple[Alarm, ...] = ()
    confirmed: bool | None = None
    confirming: str = ""
    geometry: Geometry | None = None

    @property
    def caught(self) -> bool:
        """Whether the fault caused an alarm."""
        return bool(self.alarms)


@dataclass(eq=False)
class FaultTrials:
    """A trial that runs faults on a suite of episodes, and keeps the results of the sound system."""

    episodes: tuple[Admitted, ...]
    world: WorldEntry = KINEMATIC
    _sound: dict[tuple[int, str, str], Evaluations] = field(default_factory=dict)

    def applies(self, fault: SeededFault) -> bool:
        """Return whether a fault applies to these episodes.

        A fault of the spread applies only to an avoider with a spread. If a controller replaces the visual
        servo, faults of the avoider, the gate and the servo's own records do not apply. Faults of our shield
        apply only without a user's safety filter, and faults of a filter only with one.
        Faults of the Kalman filter do not apply where a predictor replaces it.
        """
        filtered = any(episode.safety_filter is not None for episode in self.episodes)
        if fault.of_filter or (filtered and fault.circumstance.name == BEHIND_A_SHIELD):
            return filtered and fault.of_filter
        if fault.name in OF_KALMAN_FILTER and any(episode.predictor is not None for episode in self.episodes):
            return False
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
        """Return the result of one magnitude, tried on one episode after another until the first catch."""
        text, alarms = fault.ladder.label(magnitude), tuple[Alarm, ...]()
        for number in range(len(self.episodes)):
            alarms = self.alarms(fault, magnitude, number)
            if alarms:
                break
        return Rung(magnitude=magnitude, words=text, episodes=number + 1, alarms=alarms)

    def alarms(
        self, fault: SeededFault, magnitude: float, number: int, world: WorldEntry | None = None
    ) -> tuple[Alarm, ...]:
        """Return the claims that hold without the fault but are violated with it, in one episode."""
        sound, faulty, _ = self._with_and_without(fault, magnitude, number, world)
        return alarms_between(sound, faulty, self.episodes[number].scenario.name)

    def everywhere(self, fault: SeededFault) -> Rung:
        """Return all alarms of a harmless change on the whole suite, and the findings of the geometry."""
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

    def confirmed(self, fault: SeededFault, rung: Rung) -> Rung:
        """Return ``rung`` with whether a claim that caught the fault is violated in another reference too.

        The rung is returned unchanged if no other reference is installed.
        """
        if (reference := self.confirming) is None:
            return rung
        there = self.alarms(fault, rung.magnitude, rung.episodes - 1, reference)
        shared = {alarm.claim for alarm in there} & {alarm.claim for alarm in rung.alarms}
        return replace(rung, confirmed=bool(shared), confirming=reference.label)

    @cached_property
    def confirming(self) -> WorldEntry | None:
        """The first installed reference other than the world of the runs; None if there is none."""
        return next((world for world in references() if world.name != self.world.name), None)

    def _with_and_without(
        self, fault: SeededFault, magnitude: float, number: int, world: WorldEntry | None = None
    ) -> tuple[Evaluations, Evaluations, Trace | None]:
        """Return the evaluations without and with the fault, and the run with it; None if that run failed."""
        system = fault.circumstance.bring_about(ChangedSystem(self.episodes[number]))
        world = world or self.world
        key = (number, fault.circumstance.name, world.name)
        if key not in self._sound:
            run = system.run(world)
            if theorem_bits(run) & REFUTED:
                raise RuntimeError(f"the sound run {run.scenario.name} refutes the theorem of its shield")
            self._sound[key] = evaluations_of(system.admitted, run)
        faulty = fault.seed_into(system, magnitude)
        try:
            trace = faulty.run(world)
        except Exception as error:  # a faulty system's exception is a catch, unlike an error in judging
            return self._sound[key], {RUN_FAILED: check(RUN_FAILED, described(error))}, None
        return self._sound[key], evaluations_of(faulty.admitted, trace), trace


def alarms_between(sound: Evaluations, faulty: Evaluations, scenario: str) -> tuple[Alarm, ...]:
    """Return the claims that hold in the sound run and are violated by a clear margin in the faulty run."""
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
    """Return ``alarms``; an alarm about the hand distance is true if the geometry refutes the limit."""
    refuted = kept is Kept.REFUTED
    return tuple(replace(alarm, true=refuted and alarm.claim == HAND_DISTANCE.example) for alarm in alarms)


def fallen(sound: Evaluation, faulty: Evaluation) -> bool:
    """Return whether a claim that held is violated now, with margins at least ``CLEAR`` apart."""
    if (sound.verdict, faulty.verdict) != (Verdict.HOLDS, Verdict.VIOLATED):
        return False
    if sound.margin is None or faulty.margin is None:
        return True
    return sound.margin - faulty.margin >= CLEAR[sound.unit]


def evaluations_of(admitted: Admitted, trace: Trace) -> dict[str, Evaluation]:
    """Return the evaluations of one run by their sentences: all claims, and two further checks."""
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
    """Return a check without a margin as an evaluation, which holds unless there is a ``problem``."""
    return Evaluation(
        sentence=sentence,
        verdict=Verdict.VIOLATED if problem else Verdict.HOLDS,
        unit=Unit.COUNT,
        margin=None,
        worst_time_s=None,
        reason=problem or "nothing wrong",
        exercised=1,
    )
