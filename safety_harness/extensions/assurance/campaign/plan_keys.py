"""The keys of a plan's file, which ``read_plan``, ``explain`` and the schema for editors use."""

from __future__ import annotations

from safety_harness.cell.simulation.worlds import WORLDS
from safety_harness.extensions.assurance.campaign.hazards import HAZARD
from safety_harness.extensions.assurance.campaign.risk_graph import OWN_GRAPH
from safety_harness.scenario.codec import REQUIRED, Below, Key, KeyTable, QuantityValue, Several, Text, Word
from safety_harness.scenario.units import FRACTION, NUMBER

LEAST_TARGET = 1e-9  # smaller targets need more runs than any plan has
MOST_TARGET = 0.5  # a claim that more than half of the runs violate is no claim

_LINE = Text(kind="text, one line", expected="a text on one line")
_WORLDS = [world.label for world in WORLDS]
_TEXT = Text(kind="text", expected="a text")


def _count(least: int) -> QuantityValue:
    return QuantityValue(NUMBER, least=least, whole=True)


def _table(name: str, *keys: Key) -> KeyTable:
    return KeyTable(name=name, where=f"{name} of a plan", path=name, keys=keys)


STRATUM = _table(
    "a stratum",
    Key("stratum", _LINE, "a name of its own", "seen", or_else=REQUIRED),
    Key(
        "space", _LINE, "a scenario space, relative to the plan", "shipped:unseen-both.yaml", or_else=REQUIRED
    ),
    Key("runs", _count(1), "number of independent runs in it", "3000", or_else=REQUIRED),
)
CLAIM = _table(
    "a claim",
    Key("claim", _LINE, "of the catalogue, or a formula", "repulsive poses reachable", or_else=REQUIRED),
    Key(
        "violated in at most",
        QuantityValue(FRACTION, least=LEAST_TARGET, most=MOST_TARGET, or_word="derived"),
        "the largest share of tested runs that may violate it; derived: from the plan's hazards",
        "1 %",
        or_else="only estimated",
    ),
    Key("hazard", _TEXT, "what may happen to whom, in words", "a hand is crushed", or_else="ours"),
    Key("hazards", Several(of=_LINE, kind="list of names"), "hazards of the plan", "[crushed hand]", "none"),
)
SEARCH = _table("the search", Key("runs", _count(0), "of the search for counterexamples", "2000", "0"))
KEPT = _table(
    "what is kept",
    Key("random traces", _count(0), "of each stratum, drawn beforehand", "20", "20"),
    Key("violations", _count(0), "of each stratum, the first by their numbers", "200", "200"),
)


def _below(table: KeyTable) -> Below:
    return Below(tables=(table,), noun=table.name)


def _several(table: KeyTable) -> Several:
    return Several(of=_below(table), kind="list of mappings", least=1)


PLAN = KeyTable(
    name="a plan",
    where="a plan",
    keys=(
        Key("plan", _LINE, "its title", "mc-dropout beside a reaching hand", or_else=REQUIRED),
        Key("about", _TEXT, "why, intended use, assumptions", "an example", "nothing"),
        Key("avoider", _LINE, "in place of the spaces' avoider", "mc-dropout", "the spaces' avoider"),
        Key("controller", _LINE, "in place of an avoider", "stop when near", "the visual servo"),
        Key(
            "world",
            Text(
                kind=f"{', '.join(_WORLDS)}, or a simulator: exec:, tcp: or unix:",
                pattern=rf"^({'|'.join(_WORLDS)}|[a-z][a-z0-9-]+:.+)$",
            ),
            "where it runs; `certify` needs it",
            "kinematic",
            "PyBullet",
        ),
        Key(
            "confidence",
            QuantityValue(FRACTION, least=0.5, most=0.999999),
            "of all bounds of the plan together",
            "95 %",
            "95 %",
        ),
        Key("seed", _count(0), "root of every random number", "1", "0"),
        Key("strata", _several(STRATUM), "the parts of the operational domain", "strata: []", REQUIRED),
        Key("hazards", _several(HAZARD), "what may happen", "hazards: []", "none"),
        Key(
            "risk graph",
            _below(OWN_GRAPH),
            "leads from hazards to rates",
            "risk graph: {}",
            "ISO 13849-1:2023, Annex A",
        ),
        Key("claims", _several(CLAIM), "what should hold", "claims: []", REQUIRED),
        Key(
            "search", _below(SEARCH), "for counterexamples, never for a bound", "search: {runs: 2000}", "none"
        ),
        Key("keep", _below(KEPT), "whole traces", "keep: {violations: 50}", "20 random ones, 200 violations"),
        Key(
            "stop early",
            Word(members=("yes", "no")),
            "a stratum ends when all its claims are decided",
            "yes",
            "no",
        ),
        Key("proof", _LINE, "certificate of prove, relative to the plan", "certificate.json", "none"),
    ),
)
TABLES = (PLAN, STRATUM, CLAIM, HAZARD, *HAZARD.below(), OWN_GRAPH, SEARCH, KEPT)
TITLE = "A plan of safety-harness"
