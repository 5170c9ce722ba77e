"""Find the cause of a violation by repeating its run with one changed ingredient, then with two.

By default, all replays run in the kinematic world, in one batch. A violation that the unchanged replay does
not reproduce is not attributed. A violation that no arm could avoid is unavoidable. For every other
violation, the result lists the smallest sets of ingredients that must change to avoid the violation.
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
from safety_harness.cell.simulation.worlds import KINEMATIC, WorldEntry, confirming_world
from safety_harness.claims.properties.answered import NOT_MODELLED
from safety_harness.claims.properties.base import Evaluation, Property, Unit
from safety_harness.extensions.attribution.ingredients import Altered, Change, Ingredient, changes_for
from safety_harness.extensions.attribution.unavoidable import why_unavoidable
from safety_harness.scenario.model import Claim, Verdict
from safety_harness.search.trials import world_of
from safety_harness.trace.trace import Trace

ABOUT_PROPOSALS = "propos"  # marks a claim about proposals: its sentence has "proposals" or "proposed"

Changes = tuple[Change, ...]


class Outcome(Enum):
    """The result of a claim in a replay: kept, violated, never exercised, or unknown."""

    KEPT = "kept"
    NO_OCCASION = "no longer exercised"
    VIOLATED = "still violated"
    UNTOLD = "no verdict"

    @classmethod
    def from_evaluation(cls, evaluation: Evaluation) -> Outcome:
        """Return the outcome for ``evaluation``.

        An inconclusive evaluation may only mean that the run had no occasion to test the claim.
        """
        if evaluation.verdict is not Verdict.INCONCLUSIVE:
            return cls.KEPT if evaluation.verdict is Verdict.HOLDS else cls.VIOLATED
        idle = evaluation.reason.startswith(("never exercised", NOT_MODELLED))
        return cls.NO_OCCASION if idle else cls.UNTOLD


@dataclass(frozen=True, eq=False)
class Replay:
    """One replay of a run after ``changes``.

    ``margin`` [SI] is None if the evaluation has no margin.
    """

    changes: tuple[Change, ...]
    outcome: Outcome
    margin: float | None

    @property
    def helps(self) -> bool:
        """Whether the replay ended normally and did not violate the claim."""
        return self.outcome in (Outcome.KEPT, Outcome.NO_OCCASION)

    @property
    def ingredients(self) -> tuple[Ingredient, ...]:
        """The changed ingredients, in the order of ``Ingredient``."""
        order = list(Ingredient)
        return tuple(sorted({change.ingredient for change in self.changes}, key=order.index))

    @property
    def summary(self) -> str:
        """A text that describes the changes."""
        return " and ".join(map(str, self.changes))


class AttributionAnswer(Enum):
    """The four possible results of an attribution."""

    NOT_ATTRIBUTED = "not attributed"
    UNAVOIDABLE = "unavoidable"
    NOTHING_HELPED = "helped by nothing tried"
    ATTRIBUTED = "attributed"


@dataclass(frozen=True, eq=False, kw_only=True)
class Attribution:
    """The cause of one violation.

    ``margin`` [SI] is the margin of the unchanged replay. ``why`` is the reason why a violation is
    unavoidable or not attributed. ``replays`` contains all replays with changes. ``helping`` has one replay
    for each smallest set of ingredients whose change avoids the violation. The blamed set of ingredients is
    the set that the first of these replays changes.
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
        """The blamed set of ingredients, or an empty set if no change avoids the violation."""
        return self.helping[0].ingredients if self.helping else ()

    @property
    def mending(self) -> tuple[str, ...]:
        """All changes of the blamed ingredient that avoid the violation.

        The result is empty if the cause is a pair.
        """
        if len(self.cause) != 1:
            return ()
        return tuple(
            trial.summary for trial in self.replays if trial.helps and trial.ingredients == self.cause
        )

    @property
    def group(self) -> str:
        """The name of the violation's group in a tally.

        The name lists the blamed ingredients. If no ingredient is blamed, the name is the text of ``answer``.
        """
        return " and ".join(ingredient.value for ingredient in self.cause) or self.answer.value

    @property
    def summary(self) -> str:
        """A text that describes the answer.

        The text lists the changes that avoid the violation as alternatives.
        """
        if not self.helping:
            return self.answer.value + (f": {self.why}" if self.why else "")
        return "; or ".join(f"{replay.summary}: {self._result_of(replay)}" for replay in self.helping)

    words = summary  # deprecated: the old name, for one release

    def _result_of(self, replay: Replay) -> str:
        """Return a text that describes the result of ``replay``.

        If the claim is kept, the text is only the margin. Otherwise, the text begins with the outcome.
        """
        margin: str = self.unit.margin_text(replay.margin)
        if replay.outcome is Outcome.KEPT:
            return margin
        text: str = replay.outcome.value
        return text if replay.margin is None else f"{text}, {margin}"


class Runner(Protocol):
    """A function that runs altered systems.

    If a run cannot be finished, the function returns an Exception instead of the run.
    """

    def __call__(self, systems: Sequence[Altered], /) -> Sequence[Trace | Exception]:
        """Return one run for each system, in their order.

        A runner may disturb an ingredient with a fault that is not part of the scenario. If the ``changes``
        of a system contain this ingredient, the runner does not disturb it.
        """


@dataclass(frozen=True)
class ReplaysInWorld:
    """A Runner that uses ``world`` and disturbs no ingredient.

    Ctrl-C raises KeyboardInterrupt.
    """

    world: WorldEntry = KINEMATIC

    def __call__(self, admitted: Sequence[Admitted]) -> list[Trace | Exception]:
        """Run all systems, in one batch if the world supports it."""
        runs = list(run_all(admitted, self.world))
        if any(isinstance(run, Trace) and run.ended == INTERRUPTED for run in runs):
            raise KeyboardInterrupt
        return runs


KINEMATIC_REPLAYS = ReplaysInWorld()


@renamed_parameters(spoilt="faulty")  # deprecated: the old name, for one release
def attribute(
    admitted: Admitted,
    claims: Sequence[Claim] = (),
    *,
    run: Runner = KINEMATIC_REPLAYS,
    faulty: Collection[Ingredient] = (),
) -> tuple[Attribution, ...]:
    """Return the cause of each violation in the ``admitted`` scenario.

    A violation that the unchanged replay does not reproduce is not attributed.

    Args:
        admitted: The admitted scenario.
        claims: Claims that were violated in some world. If no claims are given, the function attributes
            violations of the scenario's own claims, if the unchanged replay shows them or the scenario
            expects them.
        run: The runner of the replays.
        faulty: The ingredients that ``run`` disturbs with faults that are not part of the scenario.

    Returns:
        One attribution for each violation.

    Raises:
        InadmissibleError: The scenario has a claim that cannot be judged.
        Exception: The unchanged replay failed with this exception. The function raises it only if the caller
            gives no claims and the scenario expects no violation.

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
            margin, why = None, f"{_replay_words(run)} fails: {described(first)}"
        else:
            evaluation = judge.evaluation(first)
            margin = evaluation.margin
            if evaluation.verdict is Verdict.VIOLATED:
                attributions.append(judge.attributed(margin, changes_for(faulty)))
                continue
            why = f"{_replay_words(run)} does not reproduce it: {evaluation.verdict.value}"
        if seen[number]:
            attributions.append(judge.made(answer=AttributionAnswer.NOT_ATTRIBUTED, margin=margin, why=why))
    return _jointly(attributions)


def _replay_words(run: Runner) -> str:
    """Return a phrase for the unchanged replay, which states the world of the runner."""
    world = world_of(run)
    return "the kinematic replay" if world is KINEMATIC else f"the replay in {world}"


def confirmed(
    admitted: Admitted, attribution: Attribution, *, run: Runner | None = None
) -> tuple[Replay, ...]:
    """Repeat the violating run in another world: first without a change, then with the blamed change.

    Args:
        admitted: The admitted scenario.
        attribution: The violation and its cause.
        run: The runner of the other world. The default is the runner of the first installed reference.

    Returns:
        One replay, or two if a change is blamed.

    """
    scenario = replace(admitted.scenario, claims=(attribution.claim,))
    trials = _Trials(
        replace(Altered.from_admitted(admitted), scenario=scenario), run or ReplaysInWorld(confirming_world())
    )
    judge = _ClaimTrials(trials, 0, property_of(attribution.claim, scenario))
    return judge.replays([(), *(replay.changes for replay in attribution.helping[:1])])


class _Trials:
    """The replays of one system.

    Each list of changes runs only once, even if several claims need the run.
    """

    def __init__(self, system: Altered, run: Runner) -> None:
        self.system, self._run = system, run
        self._done: dict[Changes, Trace | Exception] = {}
        self._idle: set[Changes] = set()  # changes without an effect

    def made(self, wanted: Iterable[Changes]) -> dict[Changes, Trace | Exception]:
        """Return the run after each of the ``wanted`` lists of changes.

        Lists without an effect are omitted.
        """
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
        """Return the system after ``changes``, or None if one of the changes has no effect."""
        system: Altered | None = self.system
        for change in changes:
            system = None if system is None else change.on(system)
        return system


@dataclass(frozen=True, eq=False)
class _ClaimTrials:
    """The replays of one claim, and its attribution."""

    trials: _Trials
    number: int
    prop: Property

    def evaluation(self, run: Trace) -> Evaluation:
        """Return the claim's evaluation of ``run``.

        The claim is interpreted for the scenario of that run.
        """
        return property_of(self.trials.system.scenario.claims[self.number], run.scenario).evaluate(run)

    def attributed(self, margin: float | None, changes: Sequence[Change]) -> Attribution:
        """Return the attribution.

        The method first tries the bound of ``why_unavoidable``, then single changes, and then pairs. A pair
        combines the most helpful single changes of two ingredients. For a claim about proposals, the method
        skips changes of a designer's choices (``chosen``). Such a claim judges the avoider's answer. The gate
        and the fallback act after the answer and cannot improve it. Another prediction or critical distance
        would only change the queries to the avoider.
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
        """Return the ``Attribution`` for the claim.

        ``fields`` has the values of all fields except scenario, claim and unit.
        """
        scenario = self.trials.system.scenario
        claim, unit = scenario.claims[self.number], self.prop.unit
        return Attribution(scenario=scenario.name, claim=claim, unit=unit, **fields)


def _rank(ingredients: Iterable[Ingredient]) -> list[int]:
    """Return the position of each of ``ingredients`` in the order of ``Ingredient``."""
    order = list(Ingredient)
    return [order.index(ingredient) for ingredient in ingredients]


def _gain(replay: Replay) -> float:
    """Return a measure of how nearly ``replay`` kept the claim.

    The measure is the margin, or -inf without a margin.
    """
    return -inf if replay.margin is None or isnan(replay.margin) else replay.margin


def _by_ingredients(replays: Iterable[Replay]) -> list[list[Replay]]:
    """Group replays by their set of ingredients."""
    groups: dict[tuple[Ingredient, ...], list[Replay]] = {}
    for replay in replays:
        groups.setdefault(replay.ingredients, []).append(replay)
    return list(groups.values())


def _best(replays: Iterable[Replay]) -> list[Replay]:
    """Return the replay with the largest margin for each set of ingredients."""
    return [max(group, key=_gain) for group in _by_ingredients(replays)]


def _least(replays: Iterable[Replay], sentence: str) -> tuple[Replay, ...]:
    """Return one replay for each set of ingredients whose change avoids the violation.

    The first replay in the result changes the blamed set. The sets are sorted by ``_last_resort``, and then
    by three further rules. A part that can break comes before a designer's choice. A set comes earlier if a
    greater fraction of its changes avoids the violation. If a set contains settings, this fraction is set to
    1. Finally, sets are sorted by the order of the members of ``Ingredient``.
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
    """Return a sort key.

    This key puts changes of the system before changes of the hand, and then kept claims before untested
    claims. For a claim about proposals, gate and settings come after the rest of the system, because they
    change the queries. ``helped`` states how many violations of the run are avoided by changes of the same
    ingredients.
    """
    own = ABOUT_PROPOSALS in sentence
    led = own and not {Ingredient.GATE, Ingredient.SETTINGS}.isdisjoint(replay.ingredients)
    return Ingredient.HAND in replay.ingredients, led, -helped, replay.outcome is not Outcome.KEPT


def _jointly(attributions: Sequence[Attribution]) -> tuple[Attribution, ...]:
    """Sort the ``helping`` replays of each violation of a run.

    The set of ingredients that helps with the most violations of the run comes first. One cause often leads
    to several violations.
    """
    helped = Counter(replay.ingredients for answer in attributions for replay in answer.helping)

    def ordered(answer: Attribution) -> tuple[Replay, ...]:
        sentence = answer.claim.sentence
        return tuple(
            sorted(answer.helping, key=lambda each: _last_resort(each, sentence, helped[each.ingredients]))
        )

    return tuple(replace(answer, helping=ordered(answer)) for answer in attributions)
