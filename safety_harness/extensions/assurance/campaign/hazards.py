"""The hazards of a plan, each with its task, zone, event, severity and frequency.

Each hazard also states who decided about it, and for which reasons. docs/reference/plan.md describes the keys
of a hazard.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from safety_harness.base.exceptions import near_miss
from safety_harness.extensions.assurance.campaign.risk_graph import (
    AVOIDANCES,
    EXPOSURES,
    SEVERITIES,
    UNKNOWN,
    DerivedRate,
    RiskGraph,
    derived,
    read_graph,
)
from safety_harness.extensions.assurance.statistics.rates import SharedError, most_an_hour
from safety_harness.scenario.codec import Below, QuantityValue, Text, declared, key, table_of
from safety_harness.scenario.fields import Field, Fields
from safety_harness.scenario.files import resolved
from safety_harness.scenario.typed_json import read_json
from safety_harness.scenario.units import FRACTION, NUMBER

MOST_HAZARDS = 64  # a choice, as for strata and claims
LOW, NOT_LOW = "low", "not low"


def _line(expected: str) -> Text:
    return Text(kind="text, one line", expected=expected, reads=lambda field: _nonempty(field, expected))


def _prose(expected: str) -> Text:
    return Text(kind="text", reads=lambda field: _nonempty(field, expected, lines=True))


def _nonempty(field: Field, expected: str, *, lines: bool = False) -> str:
    text = field.prose(expected, lines=lines)
    if not text.strip():
        raise field.error(expected)
    return text


def _one_of(*choices: str) -> Text:
    listed = f"{', '.join(choices[:-1])} or {choices[-1]}"
    return Text(kind=listed, reads=lambda field: field.one_of({choice: choice for choice in choices}))


_SOURCE = _line("the source of the number")


@declared
class CountedApproaches:
    """A rate of approaches, given as a number of approaches and the hours in which they were counted.

    The approaches are assumed to be a Poisson process.
    """

    count: int = key(
        "counted",
        QuantityValue(NUMBER, least=0, most=10**9, whole=True),
        "approaches that were counted",
        "37",
    )
    hours: float = key("hours", QuantityValue(NUMBER, least=1e-3, most=1e6), "in the observed hours", "12")
    source: str = key("source", _SOURCE, "who counted, where and when", "two shifts at the packing table")
    file: Path | None = None

    def most_an_hour(self, chance: float) -> float:
        """Return an upper bound of the hourly rate.

        The true rate exceeds this bound with a probability of at most ``chance``.
        """
        return most_an_hour(self.count, self.hours, chance)

    @property
    def summary(self) -> str:
        """A text with the count, the hours and the source."""
        return f"{self.count} approaches in {self.hours:.4g} h ({self.source})"


@declared
class StatedApproaches:
    """An upper bound of the hourly rate of approaches, stated by its author with a confidence."""

    at_most: float = key("at most", QuantityValue(NUMBER, least=1e-9, most=1e6), "approaches an hour", "40")
    confidence: float = key(
        "confidence",
        QuantityValue(FRACTION, least=0.5, most=0.999999999),
        "its confidence; all rates share half of the error that the plan's confidence allows",
        "99 %",
    )
    source: str = key("source", _SOURCE, "the author of the bound, and the grounds", "the line's cycle time")

    def most_an_hour(self, chance: float) -> float:
        """Return the stated bound.

        ``read_hazards`` has already compared the confidence of the bound with ``chance``.
        """
        return self.at_most

    @property
    def summary(self) -> str:
        """A text with the bound, its confidence and the source."""
        return f"at most {self.at_most:g} an hour with {100.0 * self.confidence:.10g} % ({self.source})"


Approaches = CountedApproaches | StatedApproaches


def _fitted(field: Field) -> CountedApproaches:
    """Return the number of recorded approaches and the hours of recording.

    Both numbers come from the output of ``hands fit --json``.
    """
    name = field.sentence("the JSON output of hands fit --json")
    file = resolved((field.file.parent if field.file else Path()) / name)
    if not file.is_file():
        raise field.error(
            "the JSON output of hands fit --json, relative to the plan", got=f"no such file: {file}"
        )
    document: Any = read_json(file, "the JSON of hands fit --json")
    try:
        fit = document["result"]["fit"]
        count, hours = fit["approaches"], fit["hours"]
        files = len(fit["recordings"])
    except (KeyError, TypeError):
        raise field.error("the JSON output of hands fit --json", got=f"{name}, which has no fit") from None
    whole = isinstance(count, int) and not isinstance(count, bool) and count >= 0
    if not whole or not isinstance(hours, int | float) or isinstance(hours, bool) or not hours > 0.0:
        got = f"{name}: {str(count)[:40]} in {str(hours)[:40]} h"
        raise field.error("a number of approaches, in more than 0 hours", got=got)
    source = f"hands fit of {files} file{'s' if files != 1 else ''}, {name}"
    return CountedApproaches(count=count, hours=float(hours), source=source, file=file)


@declared
class _FittedApproaches:
    approaches: CountedApproaches = key(
        "fitted",
        Text(kind="file, relative to the plan", reads=_fitted),
        "the output of `safety-harness hands fit --json`: its approaches and hours",
        "hands.json",
    )


class _ApproachesValue(Below):
    """A mapping that gives the rate of approaches in one of three ways: fitted, counted or stated."""

    def read(self, field: Field) -> Approaches:
        """Return counted or stated approaches.

        Fitted approaches are converted to counted approaches.
        """
        approaches: Approaches | _FittedApproaches = super().read(field)
        return approaches.approaches if isinstance(approaches, _FittedApproaches) else approaches


APPROACHES = _ApproachesValue(
    noun="rate of approaches",
    tables=(
        table_of(_FittedApproaches, "approaches of recorded hands"),
        table_of(CountedApproaches, "approaches that were counted"),
        table_of(StatedApproaches, "approaches that somebody states"),
    ),
)


@declared
class Hazard:
    """A hazard of a plan, in the words of the plan's author.

    ``severity``, ``exposure`` and ``avoidance`` may be UNKNOWN.
    """

    name: str = key("hazard", _line("a name"), "its name in claims", "crushed hand")
    task: str = key("task", _line("what people do there"), "what people do", "parts are taken from the table")
    zone: str = key("zone", _line("where"), "where", "above the table, within reach of the arm")
    body_region: str = key(
        "body region", _line("a part of the body"), "the part that may be hurt", "hand and forearm"
    )
    event: str = key(
        "initiating event",
        _line("what begins it"),
        "what begins it",
        "a hand reaches past the object while the arm moves",
    )
    severity: str = key(
        "severity", _one_of(*SEVERITIES, UNKNOWN), "S1: slight injury; S2: serious, or death", "S2"
    )
    exposure: str = key(
        "exposure", _one_of(*EXPOSURES, UNKNOWN), "F1: seldom or briefly; F2: frequently or long", "F2"
    )
    avoidance: str = key(
        "avoidance", _one_of(*AVOIDANCES, UNKNOWN), "P1: avoidable; P2: scarcely avoidable", "P2"
    )
    probability: str = key(
        "event probability",
        _one_of(NOT_LOW, LOW),
        "of the hazardous event; if it is low, the required level is one lower",
        "low",
        default=NOT_LOW,
    )
    decided_by: str = key(
        "decided by", _line("who decided"), "who decided severity, exposure and avoidance", "the integrator"
    )
    because: str = key("because", _prose("why"), "why so", "the arm moves 10 kg at 250 mm/s")
    approaches: Approaches | None = key(
        "approaches",
        APPROACHES,
        "approaches an hour; without them there is no hourly bound",
        "{counted: 37, hours: 12, source: two shifts at the packing table}",
        "unknown",
        default=None,
    )

    def derived(self, graph: RiskGraph) -> DerivedRate:
        """Return the level and the rate that ``graph`` requires for this hazard.

        The result also has a text for each step through the graph.
        """
        low = self.probability == LOW
        return derived(graph, self.severity, self.exposure, self.avoidance, unlikely=low)


HAZARD = table_of(Hazard, "a hazard", where="a hazard of a plan")


@dataclass(frozen=True)
class PlannedHazards:
    """All hazards of a plan, and the risk graph for their rates.

    ``error`` states how the plan's error is divided among the bounds.
    """

    hazards: tuple[Hazard, ...]
    graph: RiskGraph
    error: SharedError

    @property
    def files(self) -> tuple[Path, ...]:
        """The files from which the plan takes rates of approaches."""
        rates = (item.approaches for item in self.hazards)
        return tuple(item.file for item in rates if isinstance(item, CountedApproaches) and item.file)

    def named(self, field: Field) -> tuple[str, ...]:
        """Return the names of the hazards that a claim lists.

        Raise ScenarioError if a name is unknown or listed twice.
        """
        names = [hazard.name for hazard in self.hazards]
        listed: list[str] = []
        for item in field.items("a list of the plan's hazards", least=1):
            name = item.sentence("the name of a hazard")
            if name not in names:
                known = ", ".join(names) or "none"
                raise item.error(f"a hazard of this plan ({known})", hint=near_miss(name, names))
            if name in listed:
                raise item.error("each hazard once")
            listed.append(name)
        return tuple(listed)

    def target(self, names: tuple[str, ...], field: Field) -> float:
        """Return the largest violation probability per run that keeps each hazard within its allowed rate.

        The function considers the hazards in ``names``. For one hazard, this probability is the allowed rate
        divided by the upper bound of the approaches in an hour. For several hazards, the function returns the
        smallest of their probabilities. The result is at most 0.5. Raise ScenarioError if a hazard has no
        assessment or no rate of approaches. The error states the place ``field``.
        """
        shares = []
        for hazard in self.hazards:
            if hazard.name in names:
                rate = hazard.derived(self.graph).an_hour
                if rate is None or hazard.approaches is None:
                    lacking = (
                        "its approaches an hour"
                        if rate is not None
                        else "its severity, exposure and avoidance"
                    )
                    raise field.error(
                        "a fraction, or derived from hazards with all needed keys",
                        got=f"{hazard.name!r} without {lacking}",
                    )
                shares.append(rate / hazard.approaches.most_an_hour(self.error.of_each_rate))
        if not shares:
            raise field.error('a fraction; derived only under the key "hazards"')
        return min(0.5, *shares)


def read_hazards(given: Fields, confidence: float) -> PlannedHazards:
    """Read the keys ``hazards`` and ``risk graph`` of a plan.

    Raise ScenarioError if a value is wrong. The error states the place of the value in the file.
    """
    listed, graph = given.optional("hazards"), given.optional("risk graph")
    items = listed.items("a list of hazards", least=1, most=MOST_HAZARDS) if listed else ()
    hazards: list[Hazard] = []
    for item in items:
        hazard: Hazard = HAZARD.read(item)
        if any(hazard.name == earlier.name for earlier in hazards):
            raise item.fields(HAZARD.names).required("hazard").error("a name for one hazard only")
        hazards.append(hazard)
    rates = sum(hazard.approaches is not None for hazard in hazards)
    error = SharedError(confidence, max(rates, 1))
    for item, hazard in zip(items, hazards, strict=True):
        rate = hazard.approaches
        if isinstance(rate, StatedApproaches) and 1.0 - rate.confidence > error.of_each_rate * (1.0 + 1e-9):
            least = 100.0 * (1.0 - error.of_each_rate)
            place = (
                item.fields(HAZARD.names).required("approaches").fields(("at most", "confidence", "source"))
            )
            raise place.required("confidence").error(
                f"{least:.10g} % or more: all rates share half of the error that the plan's confidence allows"
            )
    if graph and not hazards:
        raise graph.error("hazards for the risk graph", got="a risk graph alone")
    return PlannedHazards(tuple(hazards), read_graph(graph), error)
