"""What a ledger says of its plan, as it was when the ledger was begun."""

from __future__ import annotations

import json
import os
import sqlite3
from dataclasses import dataclass
from pathlib import Path

from safety_harness.campaign.identity import Identity
from safety_harness.campaign.opening import explained
from safety_harness.campaign.plan import Plan
from safety_harness.exceptions import LedgerError, Place
from safety_harness.properties.base import Unit
from safety_harness.scenario.references import portable
from safety_harness.simulation.worlds import WorldEntry, worlds_by_label


@dataclass(frozen=True)
class Declared:
    """The plan in a ledger; ``strata`` with their ``planned`` episodes, ``claims`` with their ``units``."""

    title: str
    plan_file: Path
    identity: Identity
    seed: int
    world: WorldEntry
    confidence: float
    stop_early: bool
    strata: tuple[str, ...]
    planned: tuple[int, ...]
    claims: tuple[str, ...]
    units: tuple[Unit, ...]
    targets: tuple[float | None, ...]


def declare(connection: sqlite3.Connection, plan: Plan, ledger: Path) -> None:
    """Write the plan down, with all its files, in the ledger of that path."""
    about = {
        "title": plan.title,
        "plan file": portable(os.path.relpath(plan.file.resolve(), ledger.resolve().parent), ledger.parent),
        "identity": plan.identity.as_json(),
        "plan": json.dumps(
            {
                "seed": plan.seed,
                "world": plan.world.label,
                "confidence": plan.confidence,
                "stop early": plan.stop_early,
            }
        ),
    }
    connection.executemany("INSERT INTO about VALUES (?, ?)", about.items())
    connection.executemany(
        "INSERT INTO file (name, data) VALUES (?, ?)", [(f.name, f.data) for f in plan.files]
    )
    strata = [(k, one.name, one.space.name, one.runs) for k, one in enumerate(plan.strata)]
    connection.executemany("INSERT INTO stratum VALUES (?, ?, ?, ?, NULL)", strata)
    claims = [(k, one.sentence, one.unit.name, one.target, one.hazard) for k, one in enumerate(plan.claims)]
    connection.executemany("INSERT INTO claim VALUES (?, ?, ?, ?, ?)", claims)


def read_declared(connection: sqlite3.Connection, path: Path) -> Declared:
    """As it was written; LedgerError for what no plan can have given."""
    with explained(path):
        about = dict(connection.execute("SELECT key, value FROM about"))
        strata = connection.execute("SELECT name, planned FROM stratum ORDER BY id").fetchall()
        claims = connection.execute("SELECT sentence, unit, target FROM claim ORDER BY id").fetchall()
    try:
        plan = json.loads(about["plan"])
        return Declared(
            title=about["title"],
            plan_file=path.parent / about["plan file"],
            identity=Identity.from_json(about["identity"]),
            seed=int(plan["seed"]),
            world=worlds_by_label()[str(plan["world"])],
            confidence=float(plan["confidence"]),
            stop_early=bool(plan["stop early"]),
            strata=tuple(name for name, _ in strata),
            planned=tuple(int(planned) for _, planned in strata),
            claims=tuple(sentence for sentence, *_ in claims),
            units=tuple(Unit[unit] for _, unit, _ in claims),
            targets=tuple(target for *_, target in claims),
        )
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise LedgerError(
            place=Place(file=path),
            expected="a ledger with its plan",
            got=f"none that can be read ({error!r})",
        ) from error
