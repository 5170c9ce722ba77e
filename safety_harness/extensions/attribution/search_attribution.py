"""Attribute the violations of a search.

The attribution covers one counterexample, or all groups of violations.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

from safety_harness.admission.admit import Admitter
from safety_harness.base.exceptions import described
from safety_harness.cell.simulation.worlds import KINEMATIC, WorldEntry, confirming_world, references
from safety_harness.extensions.attribution.attribute import (
    Attribution,
    AttributionAnswer,
    Replay,
    ReplaysInWorld,
    attribute,
    confirmed,
)
from safety_harness.extensions.attribution.tally import AttributionTally, as_json_of
from safety_harness.scenario.model import Claim, Scenario
from safety_harness.search.counterexample import Allowance, Explanation
from safety_harness.search.findings import Group
from safety_harness.search.session import SearchSession
from safety_harness.search.shrink import SpentError
from safety_harness.search.written import WrittenCounterexample

MOST_ATTRIBUTED = 100  # groups of violations that are attributed for one search


def confirming_line(replay: Replay, attribution: Attribution) -> str:
    """Return a line with a reference world's verdict on a violation.

    The verdict is for the unchanged system or for a changed system.
    """
    margin = attribution.unit.margin_text(replay.margin)
    return f"in {confirming_world()}, {replay.summary or 'as it is'}: {replay.outcome.value}, {margin}"


@dataclass(frozen=True, eq=False)
class FaultsOfSearch:
    """The causes of a search's violations.

    ``groups`` is the number of all groups of violations. For ``attributed`` of these groups, the worst run
    was attributed. The groups are in the order in which the search found them. ``interrupted`` states whether
    Ctrl-C prevented the attribution of the remaining groups.
    """

    tally: AttributionTally
    attributed: int
    groups: int
    interrupted: bool

    @property
    def summary(self) -> str:
        """One line with the number of violation groups for each cause."""
        _, _, groups = self.tally.summary.partition(": ")
        some = "" if self.attributed == self.groups else f"{self.attributed} of "
        return f"whose fault, of {some}{self.groups} groups of violations: {groups or 'not asked'}"

    def as_json(self) -> dict[str, object]:
        """Return the tally as JSON, with the number of all groups and the number of attributed groups."""
        counts = {"groups_of_violations": self.groups, "attributed": self.attributed}
        return {"words": self.summary} | counts | self.tally.as_json()


@dataclass(eq=False)
class SearchAttribution:
    """The attribution of a search's violations.

    Each result is stored under the name of its counterexample. All replays run in ``world``.
    """

    world: WorldEntry = KINEMATIC
    found: dict[str, Attribution] = field(default_factory=dict)
    admitter: Admitter = field(default_factory=Admitter)

    def explain(
        self, scenario: Scenario, claim: Claim, allowance: Allowance | None = None, *, confirms: bool = True
    ) -> Explanation:
        """Explain one counterexample.

        Args:
            scenario: The violating scenario.
            claim: The violated claim.
            allowance: Limits the replays. The default sets no limit.
            confirms: Repeat the run in a reference, unchanged and with the change that removes the violation,
                if the allowance has so much.

        Returns:
            The explanation.

        Raises:
            SpentError: The allowance is too small for the replays.

        """
        allowance = allowance or Allowance()
        try:
            admitted = self.admitter.admit(scenario)
            replays = allowance.metered(ReplaysInWorld(self.world))
            (attribution,) = attribute(admitted, (claim,), run=replays)
            there: tuple[Replay, ...] = ()
            if confirms and attribution.answer is AttributionAnswer.ATTRIBUTED and any(references()):
                replays = allowance.metered(ReplaysInWorld(confirming_world()))
                with suppress(SpentError):
                    there = confirmed(admitted, attribution, run=replays)
        except SpentError:
            raise
        except Exception as error:  # a failing explanation must not lose the finding
            self.found.pop(scenario.name, None)  # of an example that had this name before a merge of groups
            return Explanation((f"whose fault: cannot be told: {described(error)}",))
        self.found[scenario.name] = attribution
        changed = (replay for replay in there if replay.changes)
        known = attribution.answer in (AttributionAnswer.ATTRIBUTED, AttributionAnswer.UNAVOIDABLE)
        return Explanation(
            (
                f"whose fault: {attribution.summary}",
                *(confirming_line(replay, attribution) for replay in changed),
            ),
            (attribution.mending or (f"{attribution.group}: {claim.sentence}",)) if known else (),
        )

    def answers(self, shown: Sequence[WrittenCounterexample]) -> dict[str, dict[str, object]]:
        """Return the attribution of each explained counterexample as JSON, by the name of its file."""
        return {
            written.path.name: as_json_of(self.found[written.path.stem])
            for written in shown
            if written.one.attribution and written.path.stem in self.found
        }

    def of_search(self, session: SearchSession) -> FaultsOfSearch | None:
        """Attribute all groups of violations.

        The result is None if there are no groups, if the session does not explain all groups, or after an
        interruption.
        """
        searches = [session.findings] + ([] if session.baseline is None else [session.baseline])
        groups = [group for findings in searches for group in findings.groups if group.claim is not None]
        if not groups or session.interrupted or not session.explains_all:
            return None
        # Spread the choice over all groups, which are in the order of the search.
        every = -(-len(groups) // MOST_ATTRIBUTED)
        chosen = groups[::every]
        attributions: list[Attribution] = []
        done = 0
        try:
            with session.output.messages() as report:
                for together in _by_run(chosen):
                    report(f"whose fault: {done} of {len(chosen)} groups of violations")
                    try:
                        attributions += self._of_run(session, together)
                        done += len(together)
                    except Exception as error:
                        session.output.say(f"a violation cannot be attributed: {described(error)}")
        except KeyboardInterrupt:
            session.findings.interrupted = True
        tally = AttributionTally.from_attributions(attributions)
        return FaultsOfSearch(tally, done, len(groups), session.interrupted)

    def _of_run(self, session: SearchSession, groups: list[Group]) -> tuple[Attribution, ...]:
        """Attribute several groups with the same worst run.

        The run's scenario is admitted only once.
        """
        trials, worst = session.trials, groups[0].worst
        claims = tuple(trials.claims[group.claim] for group in groups if group.claim is not None)
        admitted = self.admitter.admit(trials.scenario(worst.point, worst.number))
        return attribute(admitted, claims, run=ReplaysInWorld(self.world))


def _by_run(groups: list[Group]) -> Iterator[list[Group]]:
    runs: dict[tuple[bytes, int], list[Group]] = {}
    for group in groups:
        runs.setdefault((group.worst.point.tobytes(), group.worst.number), []).append(group)
    yield from runs.values()
