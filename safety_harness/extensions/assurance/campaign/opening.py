"""Connections to a ledger: check the file, limit writing, explain SQLite's errors, and create the tables."""

from __future__ import annotations

import fcntl
import os
import re
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from urllib.parse import quote

from safety_harness.base.exceptions import LedgerError, OutputError, Place
from safety_harness.base.extension_points import ExtensionPoint, RegisteredPart, parts, warn
from safety_harness.base.whole_file import writing
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome
from safety_harness.scenario.files import refuse_no_file
from safety_harness.scenario.kinds import FileKind, refuse_other_kind
from safety_harness.trace.overruling import COUNTS as OVERRULED_BY

BUSY_MS = 30_000  # to wait while another process writes
LARGEST_CHECKED_BYTES = 2 * 2**30  # opening checks each page up to this size
_MAGIC = b"SQLite format 3\0"
_WHOLE = "a ledger, whole"
unusable = LedgerError.of_file


def refuse_no_ledger(path: Path) -> None:
    """Raise LedgerError if the file ``path`` is missing, truncated, no SQLite database, or no ledger."""
    refuse_other_kind(path, FileKind.LEDGER, error=LedgerError)
    refuse_no_file(path, "a ledger", LedgerError)
    try:
        with path.open("rb") as stream:
            header = stream.read(100)
        size = path.stat().st_size
    except OSError as error:
        raise unusable(path, "a ledger that can be read", error.strerror or str(error)) from error
    if len(header) < 100 or not header.startswith(_MAGIC):
        raise unusable(path, "a ledger (an SQLite database)", "another file, or a part of a ledger")
    if int.from_bytes(header[68:72], "big") != APPLICATION_ID and not _unfinished(path):
        raise unusable(path, "a ledger", "another SQLite database")
    page = int.from_bytes(header[16:18], "big")
    page = 65536 if page == 1 else page
    pages = int.from_bytes(header[28:32], "big")
    if size < page * pages and not _unfinished(path):
        raise unusable(path, f"{_WHOLE}: {page * pages:,} bytes", f"{size:,}: it has been truncated")


def _unfinished(path: Path) -> bool:
    """Return True if the ledger has a write-ahead log with pages that are not yet in its file."""
    log = path.with_name(path.name + "-wal")
    return log.exists() and log.stat().st_size > 0


def connect(path: Path, *, write: bool, check: bool = True, alone: bool = False) -> sqlite3.Connection:
    """Return a connection to the ledger at ``path``.

    Raise LedgerError if the file is damaged or has another version. A reader may read while another process
    writes. The reader then sees the state at the beginning of its query. If ``alone`` is true, a reader
    ignores the files beside the ledger and writes no such file. In this case, the reader also treats the file
    as untrusted, and allows only the tables, views and triggers of a ledger.
    """
    refuse_no_ledger(path)
    with explained(path):
        try:
            connection = _open(path, "rw" if write else "ro&immutable=1" if alone else "ro")
            connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
        except sqlite3.OperationalError:
            if write or _unfinished(path):
                raise
            connection = _open(path, "ro&immutable=1")  # no shared memory in a folder that cannot be written
        try:
            _refuse_other_version(connection, path)
            if alone:
                _refuse_other_tables(connection, path)
            if check and path.stat().st_size <= LARGEST_CHECKED_BYTES:
                # For a stranger's ledger, also compare indexes with tables: queries read from both.
                kind = "integrity" if alone else "quick"
                (result,) = connection.execute(f"PRAGMA {kind}_check(1)").fetchone()
                if result != "ok":
                    raise unusable(path, _WHOLE, f"damage: {' '.join(result.split())}")
            _count_nothing_else(connection)
            _show_added(connection)
            if not write:
                connection.execute("PRAGMA query_only = ON")
        except BaseException:
            connection.close()
            raise
    return connection


def _open(path: Path, mode: str) -> sqlite3.Connection:
    uri = f"file:{quote(str(path.absolute()))}?mode={mode}"
    connection = sqlite3.connect(uri, uri=True, isolation_level=None, timeout=BUSY_MS / 1e3)
    if mode == "rw":  # a commit that returns is on the disk; readers may read meanwhile
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute("PRAGMA foreign_keys = OFF")
    return connection


def _refuse_other_version(connection: sqlite3.Connection, path: Path) -> None:
    if connection.execute("PRAGMA application_id").fetchone()[0] != APPLICATION_ID:
        raise unusable(path, "a ledger", "another SQLite database")
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    if version != VERSION:
        program = "a newer" if version > VERSION else "an older"
        raise LedgerError(
            place=Place(file=path),
            expected=f"a ledger of version {VERSION}",
            got=f"version {version}, of {program} program",
            hint="use the program that made it, or run its plan anew into another ledger (--out FOLDER)",
        )


def _refuse_other_tables(connection: sqlite3.Connection, path: Path) -> None:
    """Raise LedgerError if the file has a foreign table or view, which could return false rows."""
    connection.execute("PRAGMA trusted_schema = OFF")
    with closing(sqlite3.connect(":memory:")) as whole:
        create(whole, counts_in(connection))
        whole.execute(ADDED)
        known = {name: definition for name, *definition in whole.execute(_TEXTS)}
    present = {name: definition for name, *definition in connection.execute(_TEXTS)}
    for name in {"repeated", "opened", "answering", "added"} - {*present}:  # optional tables
        del known[name]
    foreign = [name for name in {*known, *present} if known.get(name) != present.get(name)]
    if foreign:
        raise unusable(path, "a ledger's own tables", f"something else: {sorted(map(str, foreign))[0]}")


# The SQL text of a table includes collations, checks and computed columns, which influence its contents.
# All programs that made ledgers of this version wrote the same text for a table.
_TEXTS = "SELECT name, type, tbl_name, sql FROM sqlite_master"


@contextmanager
def explained(path: Path) -> Iterator[None]:
    """Raise OutputError if SQLite reports a full disk, and LedgerError for all its other errors."""
    try:
        yield
    except sqlite3.Error as error:
        text, code = str(error), getattr(error, "sqlite_errorcode", 0) & 0xFF
        if code in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR):
            raise OutputError.from_os_error(
                path, OSError(f"{text}; the ledger keeps all committed episodes")
            ) from error
        if code in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
            raise unusable(path, "a ledger without the lock of another process", text) from error
        raise unusable(path, "a ledger, whole and readable", text) from error
    except UnicodeDecodeError as error:  # SQLite's message quotes a damaged schema
        raise unusable(path, "a ledger, whole and readable", "text that is not UTF-8") from error


@contextmanager
def only_runner(path: Path) -> Iterator[None]:
    """Hold the lock that allows only one runner of a ledger.

    Raise LedgerError if another process holds the lock. The operating system releases the lock when the
    process ends, even after a crash. At the end of the block, the function removes the lock's file. It also
    removes the ledger's folder if it created this folder and the folder is still empty.
    """
    file = path.with_name(path.name + ".lock")
    new_folder = not path.parent.exists()
    with writing(file):
        path.parent.mkdir(parents=True, exist_ok=True)
        stream = file.open("a+")
    with stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if not os.path.samestat(os.fstat(stream.fileno()), file.stat()):
                raise BlockingIOError  # the previous runner has just removed the file
        except OSError as error:
            stream.seek(0)
            got = f"the process {stream.read().strip()}"
            raise unusable(path, "a ledger without another runner", got) from error
        stream.truncate(0)
        stream.write(f"{os.getpid()}\n")
        stream.flush()
        try:
            yield
        finally:
            file.unlink(missing_ok=True)
            if new_folder:
                with suppress(OSError):  # it is not empty
                    path.parent.rmdir()


def remove_empty_log(path: Path) -> None:
    """Let SQLite remove the empty log that a reader leaves, unless other connections use the log."""
    log = path.with_name(path.name + "-wal")
    with suppress(sqlite3.Error, OSError):
        if log.stat().st_size == 0:
            with closing(_open(path, "rw")) as connection:
                connection.execute("SELECT count(*) FROM sqlite_master").fetchone()


def refuse_any_file(path: Path) -> None:
    """Raise LedgerError if the path of a new ledger exists already."""
    if path.exists():
        raise unusable(path, "a path without a file", "a file")


COUNTS = (*OVERRULED_BY, "run", "theorem")  # counts of an episode; 0 if an older program did not write them
OWN_COLUMNS = (  # columns in tables for other programs
    *("stratum", "episode", "claim", "outcome", "margin_si", "worst_time_s", "exercised", "seed", "draws"),
    *("decisions", "proposed", "opposite", "stopped", "faults", "late", "overruled", *COUNTS),
    *("proposals", "cell", "mishap", "failure", "seconds", "worker"),
)
APPLICATION_ID = 0x53_48_4C_47  # "SHLG", in the header of the file
VERSION = 2  # of the tables: version 2 added what the gate overruled

_WHEN = " ".join(f"WHEN {int(outcome)} THEN '{outcome.name.lower()}'" for outcome in EpisodeOutcome)
OUTCOME = f"CASE j.outcome {_WHEN} END"  # the outcome of a judgement j, in words
OVERRULED = "e.overruled_replaced + e.overruled_stopped"  # the overruled proposals of an episode e


def _tables(counts: tuple[str, ...]) -> str:
    return f"""
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
    {" INTEGER NOT NULL, ".join(counts)} INTEGER NOT NULL,
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
CREATE TABLE repeated (
    id INTEGER PRIMARY KEY, questions INTEGER NOT NULL, asked INTEGER NOT NULL,
    differing INTEGER NOT NULL, words TEXT NOT NULL, apart INTEGER NOT NULL
);
CREATE TABLE opened (name TEXT PRIMARY KEY, sha256 TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE answering (  -- how long answers took on the machines of the runs: part of no result
    stratum INTEGER NOT NULL, answers INTEGER NOT NULL, slow INTEGER NOT NULL,
    slowest_s REAL NOT NULL, limit_s REAL NOT NULL
);
CREATE VIEW episodes AS
    SELECT s.name AS stratum, e.episode, e.seed, e.draws, e.decisions, e.proposed, e.opposite, e.stopped,
        e.faults, e.late, {OVERRULED} AS overruled, e.{", e.".join(counts)},
        c.words AS cell, e.mishap, e.failure, e.seconds, e.worker
    FROM episode e JOIN stratum s ON s.id = e.stratum LEFT JOIN cell c ON c.id = e.cell;
CREATE VIEW results AS
    SELECT s.name AS stratum, j.episode, c.sentence AS claim, {OUTCOME} AS outcome,
        j.margin, j.worst_time_s, j.exercised
    FROM judgement j JOIN stratum s ON s.id = j.stratum JOIN claim c ON c.id = j.claim;
"""


# The table of columns that packages add; writing the first such number creates it.
ADDED = """CREATE TABLE IF NOT EXISTS added (
    name TEXT NOT NULL, stratum INTEGER NOT NULL, episode INTEGER NOT NULL, number REAL,
    PRIMARY KEY (name, stratum, episode)
) WITHOUT ROWID"""
_COLUMN = re.compile("[a-z][a-z0-9_]*")
_NAMES = (
    "WITH RECURSIVE known(name) AS (SELECT min(name) FROM added UNION ALL SELECT "
    "(SELECT min(name) FROM added WHERE name > known.name) FROM known WHERE known.name IS NOT NULL) "
    "SELECT name FROM known WHERE name IS NOT NULL LIMIT 100"
)


@lru_cache
def added_columns() -> tuple[RegisteredPart, ...]:
    """Return the parts that add a column.

    If the name of a part is invalid or already used, warn and skip the part.
    """
    columns: dict[str, RegisteredPart] = {}
    for part in parts(ExtensionPoint.LEDGER_COLUMNS):
        if part.name in (*OWN_COLUMNS, *columns) or not _COLUMN.fullmatch(part.name):
            warn(
                part,
                "another column has its name, or it is no word of lower-case letters, digits and underscores",
            )
        else:
            columns[part.name] = part
    return tuple(columns.values())


def added_in(connection: sqlite3.Connection) -> tuple[str, ...]:
    """Return the valid names of the columns that were added to a ledger.

    Other names are ignored, because the ledger may come from a stranger.
    """
    if not connection.execute("SELECT 1 FROM main.sqlite_master WHERE name = 'added'").fetchone():
        return ()
    names = [str(name) for (name,) in connection.execute(_NAMES)]
    return tuple(name for name in names if _COLUMN.fullmatch(name) and name not in OWN_COLUMNS)


def _show_added(connection: sqlite3.Connection) -> None:
    """Hide the view of episodes behind a temporary view that also has the added columns."""
    own = "FROM added a JOIN stratum s ON s.id = a.stratum WHERE s.name = e.stratum AND a.episode = e.episode"
    if columns := [f"(SELECT number {own} AND a.name = '{name}') AS {name}" for name in added_in(connection)]:
        connection.execute(
            f"CREATE TEMP VIEW episodes AS SELECT e.*, {', '.join(columns)} FROM main.episodes e"
        )


def create(connection: sqlite3.Connection, counts: tuple[str, ...] = COUNTS) -> None:
    """Create the tables in the open transaction.

    ``counts`` has fewer columns for ledgers that older programs wrote.
    """
    for statement in _tables(counts).split(";\n")[:-1]:
        connection.execute(statement)
    connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
    connection.execute(f"PRAGMA user_version = {VERSION}")


def counts_in(connection: sqlite3.Connection) -> tuple[str, ...]:
    """Return the names in ``COUNTS`` for which the ledger stores a count.

    Newer programs store more counts.
    """
    columns = {row[1] for row in connection.execute("PRAGMA main.table_info(episode)")}
    return tuple(name for name in COUNTS if name in columns)


def _count_nothing_else(connection: sqlite3.Connection) -> None:
    """Hide the table of episodes behind a temporary view that has 0 for each count that the ledger lacks."""
    there = counts_in(connection)
    if absent := [f"0 AS {name}" for name in COUNTS if name not in there]:
        connection.execute(f"CREATE TEMP VIEW episode AS SELECT *, {', '.join(absent)} FROM main.episode")
