"""Export a ledger as a table for other programs, and query it by filters or by SQL that can only read."""

from __future__ import annotations

import csv
import sqlite3
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

from safety_harness.base.exceptions import Place, ScenarioError, near_miss
from safety_harness.base.extras import EXPORT
from safety_harness.base.whole_file import replacing, writing
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.opening import COUNTS, OUTCOME, OVERRULED, added_in
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome
from safety_harness.scenario.units import DIMENSIONS, NUMBER, parse_quantity

_NUMBERS = ("seed", "draws", "decisions", "proposed", "opposite", "stopped", "faults", "late", *COUNTS)
# Name, SQL expression, and type in Parquet.
_COLUMNS = (
    ("stratum", "s.name", "string"),
    ("episode", "j.episode", "int64"),
    ("claim", "c.sentence", "string"),
    ("outcome", f"COALESCE({OUTCOME}, j.outcome)", "string"),  # an unknown code stays a number
    ("margin_si", "j.margin", "float64"),
    ("worst_time_s", "j.worst_time_s", "float64"),
    ("exercised", "j.exercised", "int64"),
    *((name, f"e.{name}", "int64") for name in _NUMBERS),
    ("overruled", OVERRULED, "int64"),
    ("cell", "l.words", "string"),
    ("mishap", "e.mishap", "string"),
    ("failure", "e.failure", "string"),
    ("seconds", "e.seconds", "float64"),
    ("worker", "e.worker", "string"),
)
_JOINED = (
    "FROM judgement j JOIN stratum s ON s.id = j.stratum JOIN claim c ON c.id = j.claim "
    "JOIN episode e ON e.stratum = j.stratum AND e.episode = j.episode LEFT JOIN cell l ON l.id = e.cell "
    "ORDER BY j.stratum, j.claim, j.episode"
)
_ADDED = (
    "(SELECT number FROM added a WHERE a.name = '{0}' AND a.stratum = j.stratum AND a.episode = j.episode)"
)
_AT_ONCE = 50_000  # lines
SUFFIXES = (".csv", ".parquet")


def export(ledger: Ledger, out: Path) -> int:
    """Write the ledger's results as a CSV or Parquet table, and return the number of lines.

    The suffix of ``out`` selects the format. Parquet needs pyarrow, which the extra "export" installs. Raise
    OutputError if ``out`` cannot be written, and InputError if its suffix is unknown.
    """
    if out.suffix not in SUFFIXES:
        raise ScenarioError.of_file(out, f"a file that ends in {' or '.join(SUFFIXES)}", out.name)
    with writing(out), replacing(out) as unfinished:
        return _csv(ledger, unfinished) if out.suffix == ".csv" else _parquet(ledger, unfinished)


def export_traces(ledger: Ledger, folder: Path) -> list[Path]:
    """Write each stored trace as a file for ``replay`` and ``judge``, and return the paths."""
    paths = []
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for stratum, episode, violation in ledger.traces():
            reason = "violation" if violation else "random"
            path = folder / f"stratum-{stratum + 1}-episode-{episode}-{reason}.trace"
            with replacing(path) as unfinished:
                unfinished.write_bytes(ledger.trace(stratum, episode) or b"")
            paths.append(path)
    return paths


def _columns(ledger: Ledger) -> tuple[tuple[str, str, str], ...]:
    """Return the name, SQL expression and type of each column, including the columns that packages add."""
    added = ((name, _ADDED.format(name), "float64") for name in added_in(ledger.connection))
    return (*_COLUMNS, *added)


def _lines(ledger: Ledger) -> Iterator[tuple[object, ...]]:
    return ledger.all(f"SELECT {', '.join(place for _, place, _ in _columns(ledger))} {_JOINED}")


def _csv(ledger: Ledger, path: Path) -> int:
    count = 0
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(name for name, *_ in _columns(ledger))
        for line in _lines(ledger):
            writer.writerow(line)
            count += 1
    return count


def _parquet(ledger: Ledger, path: Path) -> int:
    with EXPORT.needed("a table in Parquet"):
        import pyarrow
        from pyarrow.parquet import ParquetWriter
    columns = _columns(ledger)
    schema = pyarrow.schema([(name, pyarrow.type_for_alias(kind)) for name, _, kind in columns])
    count, lines = 0, _lines(ledger)
    with ParquetWriter(path, schema, compression="zstd") as writer:
        while batch := list(islice(lines, _AT_ONCE)):
            arrays = [pyarrow.array([line[k] for line in batch], kind.type) for k, kind in enumerate(schema)]
            writer.write_table(pyarrow.table(arrays, schema=schema))
            count += len(batch)
    return count


_DIMENSIONS = {dimension.name: dimension for dimension in DIMENSIONS}  # by the names of units, except a count
_READING = {sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ, sqlite3.SQLITE_FUNCTION, sqlite3.SQLITE_RECURSIVE}


def question_of(
    ledger: Ledger, claim: str | None, stratum: str | None, outcome: str | None, below: str | None
) -> tuple[str, tuple[object, ...]]:
    """Return an SQL query of the view ``results``, and the values for its placeholders.

    The query returns the worst margins first. ``claim`` and ``stratum`` are full names, or words that occur
    in exactly one name. ``below`` is the text of a margin with its unit.
    """
    declared = ledger.declared
    outcomes = tuple(code.name.lower() for code in EpisodeOutcome)
    filters: list[tuple[str, object]] = []
    for option, wanted, names in (
        ("stratum", stratum, declared.strata),
        ("claim", claim, declared.claims),
        ("outcome", outcome, outcomes),
    ):
        if wanted is not None:
            filters.append((f"{option} = ?", _meant(names, wanted, f"--{option}")))
    if below is not None:
        named = zip(declared.claims, declared.units, strict=True)
        units = {unit for name, unit in named if claim is None or claim in name}
        if len(units) != 1:
            expected = "--claim too, for its unit"
            raise ScenarioError.of_option("--below", expected, "several claims")
        dimension = _DIMENSIONS.get(units.pop().name.lower().replace("_", " "), NUMBER)
        filters.append(("margin < ?", parse_quantity(below, dimension, Place(field="--below"))))
    where = " AND ".join(text for text, _ in filters) or "1"
    values = tuple(value for _, value in filters)
    # SQLite sorts NULL first; rows without a margin come last here.
    return f"SELECT * FROM results WHERE {where} ORDER BY margin IS NULL, margin, stratum, episode", values


def refuse_writing(connection: sqlite3.Connection) -> None:
    """Make ``connection`` read-only: it then refuses changes, attached files and settings."""
    connection.set_authorizer(
        lambda action, *_: sqlite3.SQLITE_OK if action in _READING else sqlite3.SQLITE_DENY
    )


def _meant(names: Sequence[str], text: str, option: str) -> str:
    if text in names:
        return text
    matching = [name for name in names if text in name]
    if len(matching) != 1:
        got = f"{text!r}, which {len(matching)} of them have" if matching else repr(text)
        raise ScenarioError.of_option(option, f"one of {', '.join(names)}", got, near_miss(text, names))
    return matching[0]
