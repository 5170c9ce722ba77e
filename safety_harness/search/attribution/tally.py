"""Many attributions together: for how many each ingredient is blamed, and what would have helped."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

from safety_harness.search.attribution.attribute import Attribution, AttributionAnswer

LAST = (AttributionAnswer.NOTHING_HELPED.value, AttributionAnswer.NOT_ATTRIBUTED.value)


@dataclass(frozen=True, eq=False)
class AttributionTally:
    """The violations of a search, a campaign or a report, each in one group."""

    attributions: tuple[Attribution, ...]

    @classmethod
    def of(cls, attributions: Iterable[Attribution]) -> AttributionTally:
        """Those of any number of runs."""
        return cls(tuple(attributions))

    @cached_property
    def groups(self) -> dict[str, int]:
        """How many are counted as what, the most first; what nothing is said of comes last."""
        found = Counter(one.group for one in self.attributions)
        return dict(sorted(found.items(), key=lambda item: (item[0] in LAST, -item[1], item[0])))

    @cached_property
    def would_help(self) -> dict[str, int]:
        """How many violations every single change would have avoided, the most first."""
        found: Counter[str] = Counter()
        for one in self.attributions:
            for replay in one.replays:
                if len(replay.changes) == 1:
                    found[replay.words] += replay.helps
        return dict(sorted(found.items(), key=lambda item: (-item[1], item[0])))

    @property
    def words(self) -> str:
        """``of 303: 171 unavoidable, 83 critical distance``."""
        return group_words(self.groups)

    def lines(self) -> Iterator[str]:
        """The groups and the changes as tables for a terminal; nothing where there is nothing to tell."""
        if not self.attributions:
            return
        yield self.words
        helping = {change: count for change, count in self.would_help.items() if count}
        if helping:
            yield "would have helped, changed alone:"
            yield from (f"{count:>7,}  {change}" for change, count in helping.items())

    def as_json(self) -> dict[str, object]:
        """Counts, and every attribution with its replays; margins in SI."""
        return {
            "violations": len(self.attributions),
            "groups": self.groups,
            "would_have_helped": self.would_help,
            "attributions": [as_json_of(one) for one in self.attributions],
        }


def group_words(groups: Mapping[str, int]) -> str:
    """How many violations each group has, of how many."""
    return f"of {sum(groups.values())}: " + ", ".join(f"{count} {group}" for group, count in groups.items())


def as_json_of(one: Attribution) -> dict[str, object]:
    """One violation with its replays; margins in SI."""
    return {
        "scenario": one.scenario,
        "claim": one.claim.sentence,
        "answer": one.answer.value,
        "ingredients": [ingredient.value for ingredient in one.cause],
        "least_sets": [[ingredient.value for ingredient in replay.ingredients] for replay in one.helping],
        "why": one.why,
        "margin_si": one.margin,
        "replays": [
            {
                "changes": list(map(str, replay.changes)),
                "outcome": replay.outcome.value,
                "margin_si": replay.margin,
            }
            for replay in one.replays
        ],
    }
