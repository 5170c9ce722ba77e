"""The tables of a ledger, and how a ledger of an earlier version becomes one of this."""

from __future__ import annotations

import sqlite3

from safety_harness.statistics.sample import EpisodeOutcome

APPLICATION_ID = 0x53_48_4C_47  # "SHLG", in the header of the file
VERSION = 1

_OUTCOME = " ".join(f"WHEN {int(outcome)} THEN '{outcome.name.lower()}'" for outcome in EpisodeOutcome)

_TABLES = f"""
CREATE TABLE about (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE file (place INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE, data BLOB NOT NULL);
CREATE TABLE stratum (
    id INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE, space TEXT NOT NULL, planned INTEGER NOT NULL,
    stopped_after INTEGER  -- episodes; NULL: not stopped early
);
CREATE TABLE claim (
    id INTEGER PRIMARY KEY, sentence TEXT NOT NULL UNIQUE, unit TEXT NOT NULL,
    target REAL, hazard TEXT NOT NULL
);
CREATE TABLE cell (id INTEGER PRIMARY KEY, words TEXT NOT NULL UNIQUE);
CREATE TABLE episode (
    stratum INTEGER NOT NULL REFERENCES stratum, episode INTEGER NOT NULL,
    seed INTEGER NOT NULL, draws INTEGER NOT NULL,
    decisions INTEGER NOT NULL, proposed INTEGER NOT NULL, opposite INTEGER NOT NULL,
    stopped INTEGER NOT NULL,
    faults INTEGER NOT NULL, late INTEGER NOT NULL,
    cell INTEGER REFERENCES cell, mishap TEXT, failure TEXT,
    seconds REAL NOT NULL, worker TEXT NOT NULL,
    PRIMARY KEY (stratum, episode)
) WITHOUT ROWID;
CREATE TABLE judgement (
    stratum INTEGER NOT NULL, claim INTEGER NOT NULL REFERENCES claim, episode INTEGER NOT NULL,
    outcome INTEGER NOT NULL, margin REAL, worst_time_s REAL, exercised INTEGER NOT NULL,
    PRIMARY KEY (stratum, claim, episode)
) WITHOUT ROWID;
CREATE INDEX violation ON judgement (stratum, claim, episode) WHERE outcome = {int(EpisodeOutcome.VIOLATED)};
CREATE TABLE trace (
    stratum INTEGER NOT NULL, episode INTEGER NOT NULL, violation INTEGER NOT NULL, data BLOB NOT NULL,
    PRIMARY KEY (stratum, episode)
);
CREATE TABLE session (
    id INTEGER PRIMARY KEY, began TEXT NOT NULL, workers TEXT NOT NULL, machine TEXT NOT NULL
);
CREATE VIEW episodes AS
    SELECT s.name AS stratum, e.episode, e.seed, e.draws, e.decisions, e.proposed, e.opposite, e.stopped,
        e.faults, e.late, c.words AS cell, e.mishap, e.failure, e.seconds, e.worker
    FROM episode e JOIN stratum s ON s.id = e.stratum LEFT JOIN cell c ON c.id = e.cell;
CREATE VIEW results AS
    SELECT s.name AS stratum, j.episode, c.sentence AS claim, CASE j.outcome {_OUTCOME} END AS outcome,
        j.margin, j.worst_time_s, j.exercised
    FROM judgement j JOIN stratum s ON s.id = j.stratum JOIN claim c ON c.id = j.claim;
"""

# From the version that is the key to the next one; each in one transaction with the change of the version.
MIGRATIONS: dict[int, str] = {}


def create(connection: sqlite3.Connection) -> None:
    """Make the tables, within the transaction that is open."""
    for statement in _statements(_TABLES):
        connection.execute(statement)
    connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
    connection.execute(f"PRAGMA user_version = {VERSION}")


def migrate(
    connection: sqlite3.Connection, migrations: dict[int, str] = MIGRATIONS, to: int = VERSION
) -> None:
    """Bring a ledger of an earlier version to this one, step by step, each of them whole or not at all."""
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    while version < to:
        connection.execute("BEGIN IMMEDIATE")
        try:
            for statement in _statements(migrations[version]):
                connection.execute(statement)
            connection.execute(f"PRAGMA user_version = {version + 1}")
            connection.execute("COMMIT")
        except BaseException:
            connection.execute("ROLLBACK")
            raise
        version += 1


def _statements(script: str) -> list[str]:
    return [statement for statement in script.split(";\n") if statement.strip()]
