"""A risk graph, which derives a required level and rate from severity, exposure and avoidance.

The default is the graph in Annex A (informative) of ISO 13849-1:2023, taken from public summaries. The rates
are the upper ends of that standard's bands of PFH_D. A risk assessment states the level that a safety
function must have. This module does not show that a function meets the level.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

from safety_harness.base.exceptions import near_miss
from safety_harness.scenario.codec import FreeKeys, Key, KeyTable, QuantityValue, Text
from safety_harness.scenario.fields import Field
from safety_harness.scenario.units import NUMBER

UNKNOWN = "not assessed"
SEVERITIES, EXPOSURES, AVOIDANCES = ("S1", "S2"), ("F1", "F2"), ("P1", "P2")
MEANINGS = {
    "S1": "slight injury",
    "S2": "serious injury",
    "F1": "seldom or briefly exposed",
    "F2": "frequently or long exposed",
    "P1": "avoidable",
    "P2": "scarcely avoidable",
}
PATHS = tuple(" ".join(path) for path in product(SEVERITIES, EXPOSURES, AVOIDANCES))
# The bands of ISO 13849-1 an hour.
PFH_D = {"a": (1e-5, 1e-4), "b": (3e-6, 1e-5), "c": (1e-6, 3e-6), "d": (1e-7, 1e-6), "e": (1e-8, 1e-7)}


@dataclass(frozen=True, kw_only=True)
class RiskGraph:
    """A risk graph, which maps each path to a level, and each level to the hourly violations that it allows.

    ``levels`` maps a path such as ``S2 F1 P2`` to its level. ``an_hour`` maps a level to a number of
    violations an hour.
    """

    name: str
    levels: Mapping[str, str]
    an_hour: Mapping[str, float]

    @property
    def order(self) -> tuple[str, ...]:
        """The levels in order, beginning with the most permissive level."""
        return tuple(sorted(self.an_hour, key=lambda level: -self.an_hour[level]))

    def below(self, level: str) -> str:
        """Return the next more permissive level, or ``level`` itself if it is already the most permissive."""
        return self.order[max(self.order.index(level) - 1, 0)]


ISO_13849 = RiskGraph(
    name="ISO 13849-1:2023, Annex A (informative)",
    levels=dict(zip(PATHS, "abbccdde", strict=True)),
    an_hour={level: high for level, (_, high) in PFH_D.items()},
)


@dataclass(frozen=True)
class DerivedRate:
    """The level and the rate that a risk graph gives, and a text for each step.

    The level and the rate are None if the assessment is incomplete.
    """

    level: str | None
    an_hour: float | None
    steps: tuple[str, ...]


def derived(graph: RiskGraph, severity: str, exposure: str, avoidance: str, *, unlikely: bool) -> DerivedRate:
    """Return the level and the rate for an assessment.

    The level and the rate are both None if the assessment is incomplete. If ``unlikely`` is true, the
    hazardous event has a low probability, which lowers the level by one.
    """
    assessment = {"severity": severity, "exposure": exposure, "avoidance": avoidance}
    if missing := [parameter for parameter, value in assessment.items() if value == UNKNOWN]:
        return DerivedRate(None, None, (f"{', '.join(missing)} not assessed: no level follows",))
    steps = [f"{parameter} {value}, {MEANINGS[value]}" for parameter, value in assessment.items()]
    level = graph.levels[" ".join(assessment.values())]
    if unlikely:
        steps += [f"by {graph.name}: level {level}", "the hazardous event has a low probability"]
        level = graph.below(level)
    rate = graph.an_hour[level]
    steps.append(
        f"{'one level less' if unlikely else f'by {graph.name}'}: level {level}, at most {rate:g} an hour"
    )
    return DerivedRate(level, rate, tuple(steps))


def band_of(an_hour: float) -> str:
    """Return a text with the band of PFH_D that contains the number ``an_hour``."""
    for level, (low, high) in PFH_D.items():
        if low <= an_hour < high:
            return f"of the size of band {level}"
    return "above all bands" if an_hour >= PFH_D["a"][1] else "below all bands"


_RATE = QuantityValue(NUMBER, least=0.0, most=1e6)
OWN_GRAPH = KeyTable(
    name="a risk graph",
    keys=(
        Key(
            "graph",
            Text(kind="text", expected="the graph's name and edition"),
            "whose graph it is",
            "the company's own, edition 3",
        ),
        Key(
            "levels",
            FreeKeys(
                of=Text(kind="text", expected="a level"),
                kind=f"mapping of {', '.join(PATHS)}",
                expected="the level of each of " + ", ".join(PATHS),
            ),
            "the level of each path",
            "levels: {S1 F1 P1: low, S1 F1 P2: low, S1 F2 P1: low, S1 F2 P2: high, S2 F1 P1: high, "
            "S2 F1 P2: high, S2 F2 P1: high, S2 F2 P2: high}",
        ),
        Key(
            "an hour",
            FreeKeys(
                of=_RATE,
                kind="mapping of levels to numbers",
                expected="the violations an hour of each level",
            ),
            "the largest number of violations an hour for each level",
            "an hour: {low: 0.1, high: 0.001}",
        ),
    ),
)


def read_graph(field: Field | None) -> RiskGraph:
    """Return the risk graph that the plan defines in ``field``, or the default graph if ``field`` is None."""
    if field is None:
        return ISO_13849
    given = field.fields(OWN_GRAPH.names)
    rates: dict[str, float] = {}
    for level, value in given.required("an hour").entries("a mapping of levels to violations an hour"):
        rates[level] = value.quantity(NUMBER, above=0.0, most=1e6)
    levels: dict[str, str] = {}
    listed = given.required("levels")
    for path, value in listed.entries("a mapping of the eight ways to levels"):
        if path not in PATHS:
            raise value.error(f"one of {', '.join(PATHS)}", got=path, hint=near_miss(path, PATHS))
        levels[path] = value.sentence("a level")
        if levels[path] not in rates:
            raise value.error(f'a level with a rate in "an hour": {", ".join(rates) or "none"}')
    if missing := [path for path in PATHS if path not in levels]:
        raise listed.error(f"a level for each of {', '.join(PATHS)}", got=f"none for {', '.join(missing)}")
    name = given.required("graph").sentence("the graph's name and edition")
    return RiskGraph(name=name, levels=levels, an_hour=rates)
