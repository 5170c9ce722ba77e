"""Attribution: repeat a violation with ingredients changed, one at a time, then two.

All replays are kinematic, and run together.  A violation that the unchanged replay does not show is not
attributed.  A violation that no arm could avoid is unavoidable.  For all others, the result names the
smallest sets of ingredients that help.
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
from safety_harness.base.renamed import renamed_parameters
from safety_harness.cell.simulation.simulate import INTERRUPTED
from safety_harness.cell.simulation.worlds import KINEMATIC, PYBULLET, WorldEntry
from safety_harness.claims.properties.answered import NOT_MODELLED
from safety_harness.claims.properties.base import Evaluation, Property, Unit
from safety_harness.scenario.model import Claim, Verdict
from safety_harness.search.attribution.ingredients import Altered, Change, Ingredient, changes_for
from safety_harness.search.attribution.unavoidable import why_unavoidable
from safety_harness.trace.trace import Trace

ABOUT_PROPOSALS = "propos"  # marks a claim about proposals: its sentence has "proposals" or "proposed"

Changes = tuple[Change, ...]


class Outcome(Enum):
    """The state of the claim in a replay."""

    KEPT = "kept"
    NO_OCCASION = "no longer exercised"
    VIOLATED = "still violated"
    UNTOLD = "no verdict"

    @classmethod
    def from_evaluation(cls, evaluation: Evaluation) -> Outcome:
        """Return the outcome of a verdict; an inconclusive verdict may lack an occasion."""
        if evaluation.verdict is not Verdict.INCONCLUSIVE:
            return cls.KEPT if evaluation.verdict is Verdict.HOLDS else cls.VIOLATED
        idle = evaluation.reason.startswith(("never exercised", NOT_MODELLED))
        return cls.NO_OCCASION if idle else cls.UNTOLD


@dataclass(frozen=True, eq=False)
class Replay:
    """One replay with ``changes``; ``margin`` [SI] is None where the evaluation has no margin."""

    changes: tuple[Change, ...]
    outcome: Outcome
    margin: float | None

    @property
    def helps(self) -> bool:
        """Whether the run ended normally without a violation of the claim."""
        return self.outcome in (Outcome.KEPT, Outcome.NO_OCCASION)

    @property
    def ingredients(self) -> tuple[Ingredient, ...]:
        """The changed ingredients, in the order of blame."""
        order = list(Ingredient)
        return tuple(sorted({change.ingredient for change in self.changes}, key=order.index))

    @property
    def summary(self) -> str:
        """The changes in words."""
        return " and ".join(map(str, self.changes))


class AttributionAnswer(Enum):
    """The four answers about a violation."""

    NOT_ATTRIBUTED = "not attributed"
    UNAVOIDABLE = "unavoidable"
    NOTHING_HELPED = "helped by nothing tried"
    ATTRIBUTED = "attributed"


@dataclass(frozen=True, eq=False, kw_only=True)
class Attribution:
    """The cause of one violation.

    ``margin`` [SI] is the margin of the unchanged replay.  ``why`` gives the reason of an unavoidable or
    unattributed violation.  ``replays`` are all replays with a change.  ``helping`` has one replay for each
    smallest set of ingredients that helps; the first replay has the blamed set.
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
        """The blamed set of ingredients; empty if no set helps."""
        return self.helping[0].ingredients if self.helping else ()

    @property
    def mending(self) -> tuple[str, ...]:
        """All helpful changes of the blamed ingredient; empty if the cause has two ingredients."""
        if len(self.cause) != 1:
            return ()
        return tuple(
            trial.summary for trial in self.replays if trial.helps and trial.ingredients == self.cause
        )

    @property
    def group(self) -> str:
        """The group in which a tally counts this violation."""
        return " and ".join(ingredient.value for ingredient in self.cause) or self.answer.value

    @property
    def summary(self) -> str:
        """The answer in words, with the alternatives that help."""
        if not self.helping:
            return self.answer.value + (f": {self.why}" if self.why else "")
        return "; or ".join(f"{replay.summary}: {self._result_of(replay)}" for replay in self.helping)

    words = summary  # deprecated: the old name, for one release

    def _result_of(self, replay: Replay) -> str:
        """Return the margin after the change, with the outcome if the claim fails."""
        margin: str = self.unit.margin_text(replay.margin)
        if replay.outcome is Outcome.KEPT:
            return margin
        text: str = replay.outcome.value
        return text if replay.margin is None else f"{text}, {margin}"


class Runner(Protocol):
    """Runs altered systems; an Exception stands for a run that could not be finished."""

    def __call__(self, systems: Sequence[Altered]) -> Sequence[Trace | Exception]:
        """Return one run for each system, in their order.

        A runner that spoils an ingredient outside the scenario leaves it sound where ``changes`` has that
        ingredient.
        """


@dataclass(frozen=True)
class ReplaysInWorld:
    """A Runner that spoils no ingredient; Ctrl-C raises KeyboardInterrupt."""

    world: WorldEntry = KINEMATIC

    def __call__(self, systems: Sequence[Altered]) -> list[Trace | Exception]:
        """Run all systems, together if the world supports it."""
        runs = list(run_all(systems, self.world))
        if any(isinstance(run, Trace) and run.ended == INTERRUPTED for run in runs):
            raise KeyboardInterrupt
        return runs


@renamed_parameters(spoilt="faulty")  # deprecated: the old name, for one release
def attribute(
    admitted: Admitted,
    claims: Sequence[Claim] = (),
    *,
    run: Runner = ReplaysInWorld(),
    faulty: Collection[Ingredient] = (),
) -> tuple[Attribution, ...]:
    """Return the cause of each violation in a scenario.

    A violation that the kinematic replay does not reproduce is not attributed.

    Args:
        admitted: The admitted scenario.
        claims: Claims that were violated in some world.  Without them, the function attributes every
            violation of the scenario's own claims, and the violations that the scenario expects.
        run: The runner of the replays.
        faulty: The ingredients that ``run`` spoils outside the scenario.

    Returns:
        One attribution for each violation.

    Raises:
        InadmissibleError: A claim cannot be judged in this scenario.
        Exception: The exception of a failed run, if no violation was seen before.

    """
    given = tuple(claims)
    scenario = replace(admitted.scenario, claims=given or admitted.scenario.claims)
    properties = tuple(property_of(claim, scenario) for claim in scenario.claims)
    trials = _Trials(replace(Altered.from_admitted(admitted), scenario=scenario, properties=properties), run)
    first = trials.made([()])[()]
    seen = [bool(given) or claim.expected is Verdict.VIOLATED for claim in scenario.claims]
    if isinstance(first, Exception) and not any(seen):
        raise first
    attributions = []
    for number, prop in enumerate(properties):
        judge, why = _ClaimTrials(trials, number, prop), ""
        if isinstance(first, Exception):
            margin, why = None, f"the kinematic replay fails: {described(first)}"
        else:
            evaluation = judge.evaluation(first)
            margin = evaluation.margin
            if evaluation.verdict is Verdict.VIOLATED:
                attributions.append(judge.attributed(margin, changes_for(faulty)))
                continue
            why = f"the kinematic replay does not reproduce it: {evaluation.verdict.value}"
        if seen[number]:
            attributions.append(judge.made(answer=AttributionAnswer.NOT_ATTRIBUTED, margin=margin, why=why))
    return _jointly(attributions)


def confirmed(
    admitted: Admitted, attribution: Attribution, *, run: Runner = ReplaysInWorld(PYBULLET)
) -> tuple[Replay, ...]:
    """Repeat the violation in another world, unchanged and with the blamed change.

    Args:
        admitted: The admitted scenario.
        attribution: The violation and its cause.
        run: The runner of the other world; the default is PyBullet.

    Returns:
        One replay, or two if a change is blamed.

    """
    scenario = replace(admitted.scenario, claims=(attribution.claim,))
    trials = _Trials(replace(Altered.from_admitted(admitted), scenario=scenario), run)
    judge = _ClaimTrials(trials, 0, property_of(attribution.claim, scenario))
    return judge.replays([(), *(replay.changes for replay in attribution.helping[:1])])


class _Trials:
    """The replays of one system; each runs once, for any number of claims."""

    def __init__(self, system: Altered, run: Runner) -> None:
        self.system, self._run = system, run
        self._done: dict[Changes, Trace | Exception] = {}
        self._idle: set[Changes] = set()  # changes without an effect

    def made(self, wanted: Iterable[Changes]) -> dict[Changes, Trace | Exception]:
        """Return the run for each list of changes; lists without an effect are absent."""
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
        """Return the system after ``changes``; None if one has no effect."""
        system: Altered | None = self.system
        for change in changes:
            system = None if system is None else change.on(system)
        return system


@dataclass(frozen=True, eq=False)
class _ClaimTrials:
    """The attribution of one claim of a system."""

    trials: _Trials
    number: int
    prop: Property

    def evaluation(self, run: Trace) -> Evaluation:
        """Return the claim's evaluation of a run, in the run's own scenario."""
        return property_of(self.trials.system.scenario.claims[self.number], run.scenario).evaluate(run)

    def attributed(self, margin: float | None, changes: Sequence[Change]) -> Attribution:
        """Return the attribution: try the bound, then single changes, then all pairs.

        A pair combines for two ingredients the change that came nearest to help.  A claim about proposals
        skips chosen changes.  Gate and fallback act after the answer that such a claim judges, and cannot
        improve it.  Prediction and distance only change the question.
        """
        why = why_unavoidable(self.trials.system, self.prop)
        if why:
            return self.made(answer=AttributionAnswer.UNAVOIDABLE, margin=margin, why=why)
        judged_before = ABOUT_PROPOSALS in self.prop.sentence
        replays = self.replays((option,) for option in changes if not (judged_before and option.chosen))
        helping = _least(replays, self.prop.sentence)
        if not helping:
            pairs = combinations(sorted(_best(replays), key=lambda option: _rank(option.ingredients)), 2)
            paired = self.replays(option.changes + second.changes for option, second in pairs)
            replays, helping = replays + paired, _least(paired, self.prop.sentence)
        answer = AttributionAnswer.ATTRIBUTED if helping else AttributionAnswer.NOTHING_HELPED
        return self.made(answer=answer, margin=margin, replays=replays, helping=helping)

    def replays(self, wanted: Iterable[Changes]) -> tuple[Replay, ...]:
        """Return the claim's replay for each list of changes that has an effect."""
        return tuple(self._replay(changes, run) for changes, run in self.trials.made(wanted).items())

    def _replay(self, changes: Changes, run: Trace | Exception) -> Replay:
        if isinstance(run, Exception):
            return Replay(changes, Outcome.UNTOLD, None)
        evaluation = self.evaluation(run)
        return Replay(changes, Outcome.from_evaluation(evaluation), evaluation.margin)

    def made(self, **fields: Any) -> Attribution:
        """Return an ``Attribution`` of the claim; ``fields`` are its further fields."""
        scenario = self.trials.system.scenario
        claim, unit = scenario.claims[self.number], self.prop.unit
        return Attribution(scenario=scenario.name, claim=claim, unit=unit, **fields)


def _rank(ingredients: Iterable[Ingredient]) -> list[int]:
    """Return the places of ingredients in the order of blame."""
    order = list(Ingredient)
    return [order.index(ingredient) for ingredient in ingredients]


def _gain(replay: Replay) -> float:
    """Return how near a change came to help: the replay's margin, or -inf without a margin."""
    return -inf if replay.margin is None or isnan(replay.margin) else replay.margin


def _by_ingredients(replays: Iterable[Replay]) -> list[list[Replay]]:
    """Group replays by their set of ingredients."""
    groups: dict[tuple[Ingredient, ...], list[Replay]] = {}
    for replay in replays:
        groups.setdefault(replay.ingredients, []).append(replay)
    return list(groups.values())


def _best(replays: Iterable[Replay]) -> list[Replay]:
    """Return for each set of ingredients the replay that came nearest to help."""
    return [max(group, key=_gain) for group in _by_ingredients(replays)]


def _least(replays: Iterable[Replay], sentence: str) -> tuple[Replay, ...]:
    """Return the first helpful replay for each set of ingredients that helps, the blamed set first.

    The order is ``_last_resort``, then three rules.  Parts that can break come before choices of a designer.
    Sets with a greater share of helpful changes come first; settings count as if all helped.  The last rule
    is the order of ``Ingredient``.
    """
    ranking = []
    for group in _by_ingredients(replays):
        helping = [replay for replay in group if replay.helps]
        if helping:
            first = min(helping, key=lambda ranked: ranked.outcome is not Outcome.KEPT)
            chosen = any(change.chosen for change in first.changes)
            often = 1.0 if Ingredient.SETTINGS in first.ingredients else len(helping) / len(group)
            ranking.append((*_last_resort(first, sentence), chosen, -often, _rank(first.ingredients), first))
    return tuple(replay for *_, replay in sorted(ranking, key=lambda ranked: ranked[:-1]))


def _last_resort(replay: Replay, sentence: str, helped: int = 0) -> tuple[bool, bool, int, bool]:
    """Return a sort key: the system before the hand, a kept claim before a removed occasion.

    For a claim about proposals, gate and settings come last of the system, because they lead to other
    questions. ``helped`` is the number of violations of the run that the same ingredients help.
    """
    own = ABOUT_PROPOSALS in sentence
    led = own and not {Ingredient.GATE, Ingredient.SETTINGS}.isdisjoint(replay.ingredients)
    return Ingredient.HAND in replay.ingredients, led, -helped, replay.outcome is not Outcome.KEPT


def _jointly(attributions: Sequence[Attribution]) -> tuple[Attribution, ...]:
    """Reorder ``helping`` of a run's violations: the set that helps most of them comes first.

    One cause often has many effects.
    """
    helped = Counter(replay.ingredients for answer in attributions for replay in answer.helping)

    def ordered(answer: Attribution) -> tuple[Replay, ...]:
        sentence = answer.claim.sentence
        return tuple(
            sorted(answer.helping, key=lambda each: _last_resort(each, sentence, helped[each.ingredients]))
        )

    return tuple(replace(answer, helping=ordered(answer)) for answer in attributions)
