"""Attribution: a violation run again with ingredients changed, one at a time, then two.

All replays are kinematic and go on together.  What the first one does not reproduce is not attributed; what
no arm could have kept is unavoidable; of the rest the least sets of ingredients are named that help.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import combinations
from math import inf, isnan
from typing import Any, Protocol

from safety_harness.admission.admit import Admitted
from safety_harness.admission.claims import property_of
from safety_harness.admission.trial import run_all
from safety_harness.base.exceptions import described
from safety_harness.cell.simulation.simulate import INTERRUPTED
from safety_harness.cell.simulation.worlds import KINEMATIC, PYBULLET, WorldEntry
from safety_harness.claims.properties.answered import NOT_MODELLED
from safety_harness.claims.properties.base import Evaluation, Property, Unit
from safety_harness.scenario.model import Claim, Verdict
from safety_harness.search.attribution.ingredients import Altered, Change, Ingredient, changes_for
from safety_harness.search.attribution.unavoidable import why_unavoidable
from safety_harness.trace.trace import Trace

ABOUT_PROPOSALS = "propos"  # in the sentence of a claim: it judges proposals, or what was proposed

Changes = tuple[Change, ...]


class Outcome(Enum):
    """What became of the claim in a replay."""

    KEPT = "kept"
    NO_OCCASION = "no longer exercised"
    VIOLATED = "still violated"
    UNTOLD = "no verdict"

    @classmethod
    def of(cls, evaluation: Evaluation) -> Outcome:
        """By the verdict, and by whether an inconclusive one is for want of an occasion."""
        if evaluation.verdict is not Verdict.INCONCLUSIVE:
            return cls.KEPT if evaluation.verdict is Verdict.HOLDS else cls.VIOLATED
        idle = evaluation.reason.startswith(("never exercised", NOT_MODELLED))
        return cls.NO_OCCASION if idle else cls.UNTOLD


@dataclass(frozen=True, eq=False)
class Replay:
    """One replay with ``changes``; the margin [SI] is None where there is none."""

    changes: tuple[Change, ...]
    outcome: Outcome
    margin: float | None

    @property
    def helps(self) -> bool:
        """Is the claim not violated in a run that came to its end?"""
        return self.outcome in (Outcome.KEPT, Outcome.NO_OCCASION)

    @property
    def ingredients(self) -> tuple[Ingredient, ...]:
        """Those that are changed, in the order in which they are blamed."""
        order = list(Ingredient)
        return tuple(sorted({change.ingredient for change in self.changes}, key=order.index))

    @property
    def words(self) -> str:
        """The changes for people."""
        return " and ".join(map(str, self.changes))


class AttributionAnswer(Enum):
    """What can be said of a violation."""

    NOT_ATTRIBUTED = "not attributed"
    UNAVOIDABLE = "unavoidable"
    NOTHING_HELPED = "helped by nothing tried"
    ATTRIBUTED = "attributed"


@dataclass(frozen=True, eq=False, kw_only=True)
class Attribution:
    """Whose fault one violation is.

    ``margin`` is the one of the replay as it was [SI]; ``why`` says why it was unavoidable or why it is not
    attributed.  ``replays`` are all that were made with something changed, ``helping`` those that name the
    least sets of ingredients that help, one for each set, the one that is blamed first.
    """

    scenario: str
    claim: Claim
    unit: Unit
    answer: AttributionAnswer
    margin: float | None
    why: str = ""
    replays: tuple[Replay, ...] = ()
    helping: tuple[Replay, ...] = ()

    @property
    def cause(self) -> tuple[Ingredient, ...]:
        """The least set that is blamed; empty if there is none."""
        return self.helping[0].ingredients if self.helping else ()

    @property
    def mending(self) -> tuple[str, ...]:
        """Every change of the one ingredient that is blamed which helps; none where two are blamed."""
        alone = len(self.cause) == 1
        return tuple(
            one.words for one in self.replays if one.helps and one.ingredients == self.cause and alone
        )

    @property
    def group(self) -> str:
        """What it is counted as."""
        return " and ".join(one.value for one in self.cause) or self.answer.value

    @property
    def words(self) -> str:
        """The answer for people, with what else would have helped."""
        if not self.helping:
            return self.answer.value + (f": {self.why}" if self.why else "")
        return "; or ".join(f"{one.words}: {self._after(one)}" for one in self.helping)

    def _after(self, replay: Replay) -> str:
        margin: str = self.unit.margin_text(replay.margin)
        if replay.outcome is Outcome.KEPT:
            return margin
        words: str = replay.outcome.value
        return words if replay.margin is None else f"{words}, {margin}"


class Runner(Protocol):
    """Runs altered systems; an Exception stands for a run that could not be carried on."""

    def __call__(self, systems: Sequence[Altered]) -> Sequence[Trace | Exception]:
        """One for each, in their order.

        Who spoils an ingredient beside the scenario leaves it sound where ``changes`` has that ingredient.
        """


@dataclass(frozen=True)
class ReplaysInWorld:
    """A Runner that spoils nothing.  Ctrl-C raises KeyboardInterrupt."""

    world: WorldEntry = KINEMATIC

    def __call__(self, systems: Sequence[Altered]) -> list[Trace | Exception]:
        """All together where the world takes many."""
        runs = list(run_all(systems, self.world))
        if any(isinstance(run, Trace) and run.ended == INTERRUPTED for run in runs):
            raise KeyboardInterrupt
        return runs


def attribute(
    admitted: Admitted,
    claims: Sequence[Claim] = (),
    *,
    run: Runner = ReplaysInWorld(),
    spoilt: Collection[Ingredient] = (),
) -> tuple[Attribution, ...]:
    """Whose fault each violation of ``claims`` is; they have been seen violated, in whichever world.

    Without them it is every violation of the scenario's own claims, and those that it expects.  One that
    the kinematic replay does not reproduce is not attributed.  ``spoilt`` are the ingredients that ``run``
    spoils beside the scenario.  InadmissibleError for a claim that cannot be judged in this scenario; a run
    that fails where no violation has been seen raises what it raised.
    """
    given = tuple(claims)
    scenario = replace(admitted.scenario, claims=given or admitted.scenario.claims)
    properties = tuple(property_of(claim, scenario) for claim in scenario.claims)
    trials = _Trials(replace(Altered.of(admitted), scenario=scenario, properties=properties), run)
    first = trials.made([()])[()]
    seen = [bool(given) or claim.expected is Verdict.VIOLATED for claim in scenario.claims]
    if isinstance(first, Exception) and not any(seen):
        raise first
    found = []
    for number, prop in enumerate(properties):
        tell, why = _Told(trials, number, prop), ""
        if isinstance(first, Exception):
            margin, why = None, f"the kinematic replay fails: {described(first)}"
        else:
            evaluation = tell.evaluation(first)
            margin = evaluation.margin
            if evaluation.verdict is Verdict.VIOLATED:
                found.append(tell.attributed(margin, changes_for(spoilt)))
                continue
            why = f"the kinematic replay does not reproduce it: {evaluation.verdict.value}"
        if seen[number]:
            found.append(tell.made(answer=AttributionAnswer.NOT_ATTRIBUTED, margin=margin, why=why))
    return _jointly(found)


def confirmed(
    admitted: Admitted, attribution: Attribution, *, run: Runner = ReplaysInWorld(PYBULLET)
) -> tuple[Replay, ...]:
    """The violation in another world, and there with what is blamed changed: one replay, or two."""
    scenario = replace(admitted.scenario, claims=(attribution.claim,))
    trials = _Trials(replace(Altered.of(admitted), scenario=scenario), run)
    told = _Told(trials, 0, property_of(attribution.claim, scenario))
    return told.replays([(), *(one.changes for one in attribution.helping[:1])])


class _Trials:
    """The replays of one system; each is made once, however many claims ask for it."""

    def __init__(self, system: Altered, run: Runner) -> None:
        self.system, self._run = system, run
        self._done: dict[Changes, Trace | Exception] = {}
        self._idle: set[Changes] = set()  # what changes nothing

    def made(self, wanted: Iterable[Changes]) -> dict[Changes, Trace | Exception]:
        """The run after each of these lists of changes, but for those that change nothing."""
        wanted, systems = list(wanted), dict[Changes, Altered]()
        for changes in wanted:
            if changes not in self._done and changes not in self._idle:
                system = self._altered(changes)
                if system is None:
                    self._idle.add(changes)
                else:
                    systems[changes] = system
        if systems:
            self._done |= zip(systems, self._run(list(systems.values())), strict=True)
        return {changes: self._done[changes] for changes in wanted if changes in self._done}

    def _altered(self, changes: Changes) -> Altered | None:
        system: Altered | None = self.system
        for change in changes:
            system = None if system is None else change.on(system)
        return system


@dataclass(frozen=True, eq=False)
class _Told:
    """What is said of one claim of a system."""

    trials: _Trials
    number: int
    prop: Property

    def evaluation(self, run: Trace) -> Evaluation:
        """The word on a run, judged in its own scenario."""
        return property_of(self.trials.system.scenario.claims[self.number], run.scenario).evaluate(run)

    def attributed(self, margin: float | None, changes: Sequence[Change]) -> Attribution:
        """The bound, then single changes, then all pairs: of each ingredient what came nearest to help.

        A claim about proposals judges an answer before gate and fallback rule on it, which make it no better;
        nor do prediction and distance, which only ask something else: none of them is tried.
        """
        why = why_unavoidable(self.trials.system, self.prop)
        if why:
            return self.made(answer=AttributionAnswer.UNAVOIDABLE, margin=margin, why=why)
        judged_before = ABOUT_PROPOSALS in self.prop.sentence
        replays = self.replays((one,) for one in changes if not (judged_before and one.chosen))
        helping = _least(replays, self.prop.sentence)
        if not helping:
            pairs = combinations(sorted(_best(replays), key=lambda one: _rank(one.ingredients)), 2)
            paired = self.replays(one.changes + other.changes for one, other in pairs)
            replays, helping = replays + paired, _least(paired, self.prop.sentence)
        answer = AttributionAnswer.ATTRIBUTED if helping else AttributionAnswer.NOTHING_HELPED
        return self.made(answer=answer, margin=margin, replays=replays, helping=helping)

    def replays(self, wanted: Iterable[Changes]) -> tuple[Replay, ...]:
        """What became of the claim after each list of changes, but for those that change nothing."""
        return tuple(self._replay(changes, run) for changes, run in self.trials.made(wanted).items())

    def _replay(self, changes: Changes, run: Trace | Exception) -> Replay:
        if isinstance(run, Exception):
            return Replay(changes, Outcome.UNTOLD, None)
        evaluation = self.evaluation(run)
        return Replay(changes, Outcome.of(evaluation), evaluation.margin)

    def made(self, **said: Any) -> Attribution:
        """What is said of the claim; ``said`` are the other fields of an ``Attribution``."""
        scenario = self.trials.system.scenario
        claim, unit = scenario.claims[self.number], self.prop.unit
        return Attribution(scenario=scenario.name, claim=claim, unit=unit, **said)


def _rank(ingredients: Iterable[Ingredient]) -> list[int]:
    order = list(Ingredient)
    return [order.index(one) for one in ingredients]


def _gain(replay: Replay) -> float:
    """How near a change came to help: its margin, least of all where there is none."""
    return -inf if replay.margin is None or isnan(replay.margin) else replay.margin


def _by_ingredients(replays: Iterable[Replay]) -> list[list[Replay]]:
    groups: dict[tuple[Ingredient, ...], list[Replay]] = {}
    for replay in replays:
        groups.setdefault(replay.ingredients, []).append(replay)
    return list(groups.values())


def _best(replays: Iterable[Replay]) -> list[Replay]:
    """Of every ingredient the change that came nearest to help."""
    return [max(group, key=_gain) for group in _by_ingredients(replays)]


def _least(replays: Iterable[Replay], sentence: str) -> tuple[Replay, ...]:
    """For every set of ingredients that helps, its first change that does; the one that is blamed first.

    After ``_last_resort``: what can be broken before what a designer chose; those of which more changes help
    before others, each setting counting as all; then in the order of ``Ingredient``.
    """
    found = []
    for group in _by_ingredients(replays):
        helping = [replay for replay in group if replay.helps]
        if helping:
            first = min(helping, key=lambda one: one.outcome is not Outcome.KEPT)
            chosen = any(change.chosen for change in first.changes)
            often = 1.0 if Ingredient.SETTINGS in first.ingredients else len(helping) / len(group)
            found.append((*_last_resort(first, sentence), chosen, -often, _rank(first.ingredients), first))
    return tuple(replay for *_, replay in sorted(found, key=lambda one: one[:-1]))


def _last_resort(replay: Replay, sentence: str, helped: int = 0) -> tuple[bool, bool, int, bool]:
    """The system is blamed before the hand; what keeps the claim before what takes the occasion away.

    Gate and settings lead a claim about proposals to other questions: they are blamed after who answered.
    """
    own = ABOUT_PROPOSALS in sentence
    led = own and not {Ingredient.GATE, Ingredient.SETTINGS}.isdisjoint(replay.ingredients)
    return Ingredient.HAND in replay.ingredients, led, -helped, replay.outcome is not Outcome.KEPT


def _jointly(found: Sequence[Attribution]) -> tuple[Attribution, ...]:
    """One cause of many effects: what helps most of the violations of a run is blamed first for each."""
    helped = Counter(replay.ingredients for one in found for replay in one.helping)

    def ordered(one: Attribution) -> tuple[Replay, ...]:
        sentence = one.claim.sentence
        return tuple(
            sorted(one.helping, key=lambda each: _last_resort(each, sentence, helped[each.ingredients]))
        )

    return tuple(replace(one, helping=ordered(one)) for one in found)
