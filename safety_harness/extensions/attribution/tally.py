"""Count how many violations each ingredient is blamed for, and how many violations each change avoids."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

from safety_harness.extensions.attribution.attribute import Attribution, AttributionAnswer

LAST = (AttributionAnswer.NOTHING_HELPED.value, AttributionAnswer.NOT_ATTRIBUTED.value)


@dataclass(frozen=True, eq=False)
class AttributionTally:
    """The attributions of the violations of a search, a campaign or a report.

    Each attribution is in one group.
    """

    attributions: tuple[Attribution, ...]

    @classmethod
    def from_attributions(cls, attributions: Iterable[Attribution]) -> AttributionTally:
        """Return the tally of ``attributions``, which may come from any number of runs."""
        return cls(tuple(attributions))

    of = from_attributions  # deprecated: the old name, for one release

    @cached_property
    def groups(self) -> dict[str, int]:
        """The number of violations in each group.

        The largest group comes first, and groups without a cause come last.
        """
        counts = Counter(attribution.group for attribution in self.attributions)
        return dict(sorted(counts.items(), key=lambda item: (item[0] in LAST, -item[1], item[0])))

    @cached_property
    def would_help(self) -> dict[str, int]:
        """The number of violations that each single change would have avoided, in descending order."""
        counts: Counter[str] = Counter()
        for attribution in self.attributions:
            for replay in attribution.replays:
                if len(replay.changes) == 1:
                    counts[replay.summary] += replay.helps
        return dict(sorted(counts.items(), key=lambda item: (-item[1], item[0])))

    @property
    def summary(self) -> str:
        """A text that lists the groups, such as ``of 303: 171 unavoidable, 83 critical distance``."""
        return group_words(self.groups)

    words = summary  # deprecated: the old name, for one release

    def lines(self) -> Iterator[str]:
        """Yield the lines of a table of groups and helpful changes, for a terminal.

        If there are no violations, yield no line.
        """
        if not self.attributions:
            return
        yield self.summary
        helping = {change: count for change, count in self.would_help.items() if count}
        if helping:
            yield "would have helped, changed alone:"
            yield from (f"{count:>7,}  {change}" for change, count in helping.items())

    def as_json(self) -> dict[str, object]:
        """Return the counts and all attributions as JSON.

        Each attribution includes its replays. Margins are in SI units.
        """
        return {
            "violations": len(self.attributions),
            "groups": self.groups,
            "would_have_helped": self.would_help,
            "attributions": [as_json_of(attribution) for attribution in self.attributions],
        }


def group_words(groups: Mapping[str, int]) -> str:
    """Return a text with the total number of violations, and the number in each of ``groups``."""
    return f"of {sum(groups.values())}: " + ", ".join(f"{count} {group}" for group, count in groups.items())


def as_json_of(answer: Attribution) -> dict[str, object]:
    """Return the attribution ``answer``, which includes its replays, as JSON.

    Margins are in SI units.
    """
    return {
        "scenario": answer.scenario,
        "claim": answer.claim.sentence,
        "answer": answer.answer.value,
        "ingredients": [ingredient.value for ingredient in answer.cause],
        "least_sets": [[ingredient.value for ingredient in replay.ingredients] for replay in answer.helping],
        "why": answer.why,
        "margin_si": answer.margin,
        "replays": [
            {
                "changes": list(map(str, replay.changes)),
                "outcome": replay.outcome.value,
                "margin_si": replay.margin,
            }
            for replay in answer.replays
        ],
    }
