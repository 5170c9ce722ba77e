"""Questions to a ledger: filters as SQL, and SQL that can only read."""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence

from safety_harness.campaign.ledger import Ledger
from safety_harness.exceptions import Place, ScenarioError
from safety_harness.properties.base import Unit
from safety_harness.scenario.units import (
    ACCELERATION,
    ANGLE,
    ANGULAR_ACCELERATION,
    ANGULAR_SPEED,
    FRACTION,
    LENGTH,
    NUMBER,
    SPEED,
    TIME,
    near_miss,
    parse_quantity,
)
from safety_harness.statistics.sample import EpisodeOutcome

_DIMENSIONS = {
    Unit.LENGTH: LENGTH,
    Unit.ANGLE: ANGLE,
    Unit.SPEED: SPEED,
    Unit.ANGULAR_SPEED: ANGULAR_SPEED,
    Unit.TIME: TIME,
    Unit.ACCELERATION: ACCELERATION,
    Unit.ANGULAR_ACCELERATION: ANGULAR_ACCELERATION,
    Unit.FRACTION: FRACTION,
    Unit.COUNT: NUMBER,
}
_READING = {
    sqlite3.SQLITE_SELECT,
    sqlite3.SQLITE_READ,
    sqlite3.SQLITE_FUNCTION,
    sqlite3.SQLITE_RECURSIVE,
}


def question_of(
    ledger: Ledger, claim: str | None, stratum: str | None, outcome: str | None, below: str | None
) -> tuple[str, tuple[object, ...]]:
    """SQL over the view ``results``, worst margins first, and its values.

    A claim or stratum is named whole, or by words that only one has; ``below`` is a margin with its unit.
    """
    declared = ledger.declared
    filters: list[tuple[str, object]] = []
    if stratum is not None:
        filters.append(("stratum = ?", _meant(declared.strata, stratum, "--stratum")))
    if claim is not None:
        filters.append(("claim = ?", _meant(declared.claims, claim, "--claim")))
    if outcome is not None:
        names = tuple(one.name.lower() for one in EpisodeOutcome)
        filters.append(("outcome = ?", _meant(names, outcome, "--outcome")))
    if below is not None:
        units = {
            unit
            for name, unit in zip(declared.claims, declared.units, strict=True)
            if claim is None or claim in name
        }
        if len(units) != 1:
            place = Place(field="--below")
            raise ScenarioError(
                place=place, expected="--claim beside it, whose unit it has", got="several claims"
            )
        filters.append(
            ("margin < ?", parse_quantity(below, _DIMENSIONS[units.pop()], Place(field="--below")))
        )
    where = " AND ".join(text for text, _ in filters) or "1"
    values = tuple(value for _, value in filters)
    return f"SELECT * FROM results WHERE {where} ORDER BY margin IS NULL, margin, stratum, episode", values


def refuse_writing(connection: sqlite3.Connection) -> None:
    """From now on the connection only reads: nothing is changed, attached or set."""
    connection.set_authorizer(
        lambda action, *_: sqlite3.SQLITE_OK if action in _READING else sqlite3.SQLITE_DENY
    )


def _meant(names: Sequence[str], word: str, option: str) -> str:
    if word in names:
        return word
    found = [name for name in names if word in name]
    if len(found) != 1:
        got = f"{word!r}, which {len(found)} of them have" if found else repr(word)
        hint = near_miss(word, names)
        raise ScenarioError(
            place=Place(field=option), expected=f"one of {', '.join(names)}", got=got, hint=hint
        )
    return found[0]
