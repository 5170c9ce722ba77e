"""A ledger as a table for other programs: one line for each episode and claim."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

from safety_harness.campaign.ledger import Ledger
from safety_harness.exceptions import OutputError, Place, ScenarioError
from safety_harness.statistics.sample import EpisodeOutcome
from safety_harness.whole_file import replacing

# Name, where it is, and its type in Parquet.
_COLUMNS = (
    ("stratum", "s.name", "string"),
    ("episode", "j.episode", "int64"),
    ("claim", "c.sentence", "string"),
    ("outcome", "j.outcome", "string"),
    ("margin_si", "j.margin", "float64"),
    ("worst_time_s", "j.worst_time_s", "float64"),
    ("exercised", "j.exercised", "int64"),
    ("seed", "e.seed", "int64"),
    ("draws", "e.draws", "int64"),
    ("decisions", "e.decisions", "int64"),
    ("proposed", "e.proposed", "int64"),
    ("opposite", "e.opposite", "int64"),
    ("stopped", "e.stopped", "int64"),
    ("faults", "e.faults", "int64"),
    ("late", "e.late", "int64"),
    ("cell", "l.words", "string"),
    ("mishap", "e.mishap", "string"),
    ("failure", "e.failure", "string"),
    ("seconds", "e.seconds", "float64"),
    ("worker", "e.worker", "string"),
)
_QUESTION = (
    f"SELECT {', '.join(place for _, place, _ in _COLUMNS)} FROM judgement j "
    "JOIN stratum s ON s.id = j.stratum JOIN claim c ON c.id = j.claim "
    "JOIN episode e ON e.stratum = j.stratum AND e.episode = j.episode LEFT JOIN cell l ON l.id = e.cell "
    "ORDER BY j.stratum, j.claim, j.episode"
)
_OUTCOME = [name for name, *_ in _COLUMNS].index("outcome")
_AT_ONCE = 50_000  # lines
SUFFIXES = (".csv", ".parquet")


def export(ledger: Ledger, out: Path) -> int:
    """Write the table as CSV or Parquet, by the suffix of ``out``; how many lines it has.

    Parquet needs pyarrow, the extra "export".  OutputError, or InputError for another suffix.
    """
    if out.suffix not in SUFFIXES:
        raise ScenarioError(
            place=Place(file=out), expected=f"a file that ends in {' or '.join(SUFFIXES)}", got=out.name
        )
    try:
        with replacing(out) as unfinished:
            return _csv(ledger, unfinished) if out.suffix == ".csv" else _parquet(ledger, unfinished)
    except OSError as error:
        raise OutputError.of(out, error) from error


def export_traces(ledger: Ledger, folder: Path) -> list[Path]:
    """Write every stored trace as a file that ``replay`` and ``judge`` take."""
    paths = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for stratum, episode, violation in ledger.traces():
            word = "violation" if violation else "random"
            path = folder / f"stratum-{stratum + 1}-episode-{episode}-{word}.trace"
            with replacing(path) as unfinished:
                unfinished.write_bytes(ledger.trace(stratum, episode) or b"")
            paths.append(path)
    except OSError as error:
        raise OutputError.of(folder, error) from error
    return paths


def _lines(ledger: Ledger) -> Iterator[list[Any]]:
    words = {int(outcome): outcome.name.lower() for outcome in EpisodeOutcome}
    for row in ledger.all(_QUESTION):
        line = list(row)
        line[_OUTCOME] = words[line[_OUTCOME]]
        yield line


def _csv(ledger: Ledger, path: Path) -> int:
    count = 0
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(name for name, *_ in _COLUMNS)
        for line in _lines(ledger):
            writer.writerow("" if value is None else value for value in line)
            count += 1
    return count


def _parquet(ledger: Ledger, path: Path) -> int:
    try:
        import pyarrow
        from pyarrow.parquet import ParquetWriter
    except ImportError:
        raise ScenarioError(
            place=Place(field="export"),
            expected="the library pyarrow",
            got="none",
            hint="pip install 'safety-harness[export]', or write a .csv",
        ) from None
    schema = pyarrow.schema([(name, pyarrow.type_for_alias(kind)) for name, _, kind in _COLUMNS])
    count, lines = 0, _lines(ledger)
    with ParquetWriter(path, schema, compression="zstd") as writer:
        while batch := list(islice(lines, _AT_ONCE)):
            columns = [pyarrow.array([line[k] for line in batch], kind.type) for k, kind in enumerate(schema)]
            writer.write_table(pyarrow.table(columns, schema=schema))
            count += len(batch)
    return count
