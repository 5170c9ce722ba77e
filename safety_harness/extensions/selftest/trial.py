"""Seed one fault into a correct system, and find the claims that hold without the fault and fail with it."""

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
    """A claim that holds without the fault but is violated with the fault, in the same scenario.

    ``margin`` is the margin with the fault, and ``before`` is the margin without the fault. ``true`` is used
    only for harmless changes. It is True if independent geometry confirms the alarm.
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
    """The results of an independent check of the hand distance with PyBullet, in runs with hands.

    The limit of the distance is satisfied in ``kept`` runs, and violated in ``broken`` runs. The other runs
    are too near to the limit to decide. In the runs ``contradicted``, the harness's verdict contradicts these
    results.
    """

    runs: int = 0
    kept: int = 0
    broken: int = 0
    contradicted: tuple[str, ...] = ()

    def with_run(self, scenario: str, kept: Kept, verdict: Verdict) -> Geometry:
        """Return the findings with another run added."""
        contradicted = {Kept.PROVEN: Verdict.VIOLATED, Kept.REFUTED: Verdict.HOLDS}.get(kept) is verdict
        return Geometry(
            runs=self.runs + 1,
            kept=self.kept + (kept is Kept.PROVEN),
            broken=self.broken + (kept is Kept.REFUTED),
            contradicted=(*self.contradicted, *([scenario] if contradicted else [])),
        )


@dataclass(frozen=True, kw_only=True)
class Rung:
    """The result of one magnitude of a fault: the number of tried episodes, and the alarms.

    ``alarms`` are all alarms of the episode that caught the fault. ``confirming`` is a reference world.
    ``confirmed`` is True if a claim also catches the fault in that world. It is None if no reference ran.
    Only harmless changes have a ``geometry``.
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
        servo, a fault that changes the avoider, the gate or the servo's records does not apply. Faults of our
        shield apply only to systems without a user's safety filter, and faults of a filter apply only to
        systems with one. Faults of the Kalman filter do not apply where a predictor replaces it.
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
        """Try one magnitude on one episode after another until the first catch, and return the result."""
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
        """Repeat the catch in another reference world, and return ``rung`` with the result.

        The result states whether a claim that caught the fault is also violated in that reference. The rung
        is returned unchanged if no other reference is installed.
        """
        if (reference := self.confirming) is None:
            return rung
        there = self.alarms(fault, rung.magnitude, rung.episodes - 1, reference)
        shared = {alarm.claim for alarm in there} & {alarm.claim for alarm in rung.alarms}
        return replace(rung, confirmed=bool(shared), confirming=reference.label)

    @cached_property
    def confirming(self) -> WorldEntry | None:
        """The first installed reference that is not the world of the runs; None if there is no such world."""
        return next((world for world in references() if world.name != self.world.name), None)

    def _with_and_without(
        self, fault: SeededFault, magnitude: float, number: int, world: WorldEntry | None = None
    ) -> tuple[Evaluations, Evaluations, Trace | None]:
        """Return the evaluations without the fault, the evaluations with it, and the run with it.

        The run is None if it failed.
        """
        system = fault.circumstance.bring_about(ChangedSystem(self.episodes[number]))
        world = world or self.world
        key = (number, fault.circumstance.name, world.name)
        # Without a fault, a run depends only on the key; all faults and magnitudes share it.
        if key not in self._sound:
            run = system.run(world)
            # An error of this package, and no catch.
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
    """Return an alarm for each claim that holds without the fault and is clearly violated with the fault."""
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
    """Return ``alarms`` with the attribute ``true`` set.

    This attribute is True for an alarm about the hand distance if the geometric check refutes the limit.
    """
    refuted = kept is Kept.REFUTED
    return tuple(replace(alarm, true=refuted and alarm.claim == HAND_DISTANCE.example) for alarm in alarms)


def fallen(sound: Evaluation, faulty: Evaluation) -> bool:
    """Return whether a fault caused a clear violation of a claim.

    The verdict must change from "holds" to "violated". If both evaluations have a margin, the margin must
    also decrease by at least ``CLEAR``.
    """
    if (sound.verdict, faulty.verdict) != (Verdict.HOLDS, Verdict.VIOLATED):
        return False
    if sound.margin is None or faulty.margin is None:
        return True
    return sound.margin - faulty.margin >= CLEAR[sound.unit]


def evaluations_of(admitted: Admitted, trace: Trace) -> dict[str, Evaluation]:
    """Return the evaluations of one run by sentence, for all claims and for two further checks."""
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
    """Return the evaluation of a check without a margin; the check holds if ``problem`` is empty."""
    return Evaluation(
        sentence=sentence,
        verdict=Verdict.VIOLATED if problem else Verdict.HOLDS,
        unit=Unit.COUNT,
        margin=None,
        worst_time_s=None,
        reason=problem or "nothing wrong",
        exercised=1,
    )
