"""The ledger of a campaign: one SQLite file with one row for each planned episode that ran.

When ``record`` returns, the rows of the batch are on the disk, and no later event can lose these rows. An
interruption before that moment leaves no part of the batch in the ledger. Other programs may read while one
process writes.
"""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager
from dataclasses import astuple, dataclass
from datetime import datetime
from functools import cached_property, partial
from operator import itemgetter
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from safety_harness.admission.repeatability import DrivenAgain, RepeatabilityResult
from safety_harness.base.exceptions import RecordingError
from safety_harness.base.renamed import renamed_parameters
from safety_harness.base.whole_file import replacing, writing
from safety_harness.cell.simulation.worlds import WorldEntry, world_labelled
from safety_harness.claims.properties.base import Unit
from safety_harness.extensions.assurance.campaign.identity import Identity, PlanFile
from safety_harness.extensions.assurance.campaign.opening import (
    ADDED,
    COUNTS,
    connect,
    counts_in,
    create,
    explained,
    refuse_any_file,
    remove_empty_log,
    unusable,
)
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.campaign.rows import Row
from safety_harness.extensions.assurance.statistics.sample import (
    Declaration,
    Floats,
    IndependentSample,
    Ints,
    refusal,
)
from safety_harness.scenario.recording import parse_recording
from safety_harness.scenario.references import MODEL_SUFFIX, ONNX_SUFFIX, portable
from safety_harness.seams.isolation.opened import sha256_of
from safety_harness.trace.answer_times import AnswersTook

_NUMBERS = 10 + len(COUNTS)  # columns before the cell: four numbers, six counts of decisions, and COUNTS
_EPISODE = f"INSERT INTO episode VALUES ({'?, ' * _NUMBERS}(SELECT id FROM cell WHERE words = ?){', ?' * 4})"
_SAMPLE = (
    "SELECT j.episode, j.outcome, e.seed, j.exercised, j.margin FROM judgement j JOIN episode e "
    "ON e.stratum = j.stratum AND e.episode = j.episode WHERE j.stratum = ? AND j.claim = ? "
    "AND j.episode < coalesce(?, j.episode + 1)"
)
_DISTINCT = "SELECT stratum, count(DISTINCT run), count(*) FROM episode WHERE run <> 0 GROUP BY stratum"
_TIMES = (  # numbers, even if a stranger's ledger has text there
    "SELECT total(answers), total(slow), ifnull(max(slowest_s + 0.0), 0.0), "
    "max(ifnull(max(limit_s + 0.0), 0.0), 1e-9) FROM answering WHERE stratum = ?"
)
_JUDGEMENT = f"INSERT INTO judgement VALUES ({', '.join('?' * 7)})"


@dataclass(frozen=True)
class Declared:
    """The plan as a ledger stores it.

    ``planned`` has the number of episodes of each stratum.
    """

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


WRISTS = (
    "recorded hands are wrists: straight fingers reach 120 to 150 mm beyond the sphere, and no distance here "
    "counts them"
)


def _is_recording(file: PlanFile) -> bool:
    """Return True if the content of ``file`` is a table of tracked points, whatever its file name."""
    try:
        return bool(parse_recording(file.data, Path(file.name)).tracks)
    except RecordingError:
        return False


# Bits of how questions were repeated: in another process, by new runs, in one call, by a fresh avoider.
BY_PROCESS, BY_RUNS, TOGETHER, OF_AVOIDER = 1, 2, 4, 8
BESIDE = {"safety filter": 16, "predictor": 32}  # bits of further fresh parts of new runs


def _how(result: RepeatabilityResult) -> int:
    if isinstance(result, DrivenAgain):
        return BY_RUNS + OF_AVOIDER * result.of_avoider + sum(BESIDE[kind] for kind in result.beside)
    return BY_PROCESS * result.apart + TOGETHER * result.together


class Ledger:
    """The ledger of a plan, made by ``create`` or ``open``.

    Close the ledger after use, or use it in a ``with`` statement. Strata and claims are numbered by their
    position in ``declared``, which keeps the plan's order.
    """

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self.path = path
        self.connection = connection
        self.declared = _declared(connection, path)
        self.tidies = False
        self._looked_at: object = None
        self._found = ""

    @classmethod
    def create(cls, path: Path, plan: Plan) -> Ledger:
        """Create and return a ledger of ``plan`` that has no episodes yet.

        If the creation fails, no file remains.

        Args:
            path: The path of the new file, which must not exist.
            plan: The plan. The ledger stores copies of all files of the plan.

        Raises:
            LedgerError: The file exists already.
            OutputError: The file cannot be written.

        """
        refuse_any_file(path)
        with (
            writing(path),
            replacing(path) as unfinished,
            explained(path),
            closing(sqlite3.connect(unfinished, isolation_level=None)) as connection,
        ):
            connection.execute("BEGIN")
            create(connection)
            _declare(connection, plan, path)
            connection.execute("COMMIT")
        return cls.open(path, write=True, check=False)

    @classmethod
    def open(cls, path: Path, *, write: bool = False, check: bool = True, alone: bool = False) -> Ledger:
        """Return the ledger in the file ``path``.

        Args:
            path: The file.
            write: Whether to open the file for writing.
            check: Whether SQLite checks all pages of a file of at most 2 GiB.
            alone: Whether to ignore the files beside the ledger, such as a write-ahead log, and to refuse
                foreign tables.

        Raises:
            LedgerError: The file is damaged, is locked, has another version or is not a ledger.

        """
        connection = connect(path, write=write, check=check, alone=alone)
        try:
            ledger = cls(path, connection)
            ledger.tidies = not alone
            return ledger
        except BaseException:
            connection.close()
            raise

    def __enter__(self) -> Ledger:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file.

        The method also removes an empty log beside the file, unless the ledger was opened with ``alone``.
        """
        self.connection.close()
        if self.tidies:
            remove_empty_log(self.path)

    def refuse_other(
        self,
        identity: Identity,
        hint: str = "restore them, or begin another ledger (--out FOLDER)",
    ) -> None:
        """Raise LedgerError if the plan has changed since the ledger began.

        Args:
            identity: The present identity of the plan.
            hint: The advice in the error.

        Raises:
            LedgerError: The plan has changed. The error lists the changes.

        """
        self.declared.identity.refuse_other(identity, self.path, hint=hint)

    def refuse_other_plan(self, plan: Plan) -> None:
        """Raise LedgerError if ``plan`` or a file that a user's module opened has changed since the runs.

        Args:
            plan: The present plan.

        Raises:
            LedgerError: The plan, or a file that a user's module opened, has changed. The error lists the
                changes.

        """
        self.refuse_other(plan.identity)
        there = {name: sha256 for name, sha256 in self.opened.items() if sha256}
        now = {name: sha256_of(plan.file.resolve().parent / name) for name in there}
        Identity(tuple(there.items())).refuse_other(
            Identity(tuple(now.items())), self.path, hint="restore it, or begin another ledger"
        )

    @property
    def opened(self) -> dict[str, str]:
        """A mapping from the path of each file that a user's module opened to the SHA-256 of the file.

        The paths are relative to the plan's folder. The SHA-256 is empty if the module itself writes the
        file.
        """
        present = self._has("opened")
        return dict(self.all("SELECT name, sha256 FROM opened ORDER BY name")) if present else {}

    def times(self, stratum: int) -> AnswersTook:
        """Return the answer times of a stratum, which are empty if an older program wrote the ledger.

        Args:
            stratum: The number of the stratum.

        """
        ((answers, slow, *times_s),) = self.all(_TIMES, stratum) if self._has("answering") else ((0, 0),)
        return AnswersTook(int(answers), int(slow), *times_s)

    @property
    def slow(self) -> list[str]:
        """A sentence for each stratum in which answers took longer than the runs allow."""
        named = ((name, self.times(k).summary) for k, name in enumerate(self.declared.strata))
        return [f"{name}: {text}" for name, text in named if text]

    def take_opened(self, files: Iterable[tuple[str, str]]) -> None:
        """Record the files that users' modules opened during runs.

        Args:
            files: For each file, its path relative to the plan's folder, and the SHA-256 of its content.

        Raises:
            LedgerError: The content of a file differs from the content that earlier runs read, or the file is
                newer than those runs.

        """
        for name, sha256 in sorted(files, key=itemgetter(1)):  # first the files that the module itself writes
            known = self.opened.get(name)
            if sha256 and known is None and self._is_newer(name):
                raise unusable(self.path, f"{name} as it was when runs began", "a newer file")
            if not sha256 or known is None:
                self.connection.execute("INSERT OR REPLACE INTO opened VALUES (?, ?)", (name, sha256))
            elif known not in ("", sha256):
                expected = f"{name} as earlier runs opened it"
                raise unusable(self.path, expected, "other bytes: it changed during the runs")

    def _is_newer(self, name: str) -> bool:
        """Return whether the file ``name`` changed between the first session with runs and this session."""
        (ends,) = self.all("SELECT min(began), max(began) FROM session WHERE EXISTS (SELECT 1 FROM episode)")
        begun_s, now_s = (datetime.fromisoformat(began or "1970-01-02").timestamp() for began in ends)
        file = self.declared.plan_file.parent / name
        # The time of change, because a program can set the time of modification back.
        return file.is_file() and begun_s < file.stat().st_ctime < now_s

    @property
    def files(self) -> tuple[PlanFile, ...]:
        """The plan's files with the content that they had when the ledger began.

        The plan's own file comes first.
        """
        return tuple(
            PlanFile(name, data) for name, data in self.all("SELECT name, data FROM file ORDER BY place")
        )

    @property
    def wrists(self) -> tuple[str, ...]:
        """A remark on the meaning of recorded hands.

        The tuple is empty if no file of the plan is a recording.
        """
        return (WRISTS,) if any(map(_is_recording, self.files)) else ()

    @cached_property
    def counts(self) -> tuple[str, ...]:
        """The names in ``COUNTS`` for which this ledger has a column.

        A reader sees 0 for each missing count.
        """
        return counts_in(self.connection)

    @cached_property
    def draws_sha256(self) -> str:
        """The SHA-256 of the files that determine the scenarios.

        The hash does not cover the plan's own file, programs and networks.
        """
        drawing = [
            file.sha256
            for file in self.files[1:]
            if not file.name.endswith((".py", MODEL_SUFFIX, ONNX_SUFFIX))
        ]
        return hashlib.sha256("".join(sorted(drawing)).encode()).hexdigest()

    def record(self, rows: Iterable[Row]) -> None:
        """Write the rows of new episodes in one transaction.

        Args:
            rows: The rows.

        Raises:
            LedgerError: The ledger already has one of these episodes, or the ledger cannot be written.
            OutputError: The disk is full.

        """
        execute = self.connection.execute
        with self.transaction():
            for row in rows:
                self.take_opened(row.opened)
                counts = (row.decisions, row.proposed, row.opposite, row.stopped, row.faults, row.late)
                noted = (*row.overruling.counts, row.run, row.theorem)
                own = (row.stratum, row.episode, row.seed, row.draws, *counts, *noted)
                if row.cell:
                    execute("INSERT OR IGNORE INTO cell (words) VALUES (?)", (row.cell,))
                texts = (row.cell, row.run_error or None, row.failure or None)
                here = (row.seconds, row.worker)
                execute(_EPISODE, (*own, *texts, *here))
                for claim, verdict in enumerate(row.judgements):
                    judged = (int(verdict.outcome), verdict.margin, verdict.worst_time_s, verdict.exercised)
                    execute(_JUDGEMENT, (row.stratum, claim, row.episode, *judged))  # a NaN becomes NULL
                if row.added:
                    execute(ADDED)
                for name, number in row.added:
                    execute("INSERT INTO added VALUES (?, ?, ?, ?)", (name, row.stratum, row.episode, number))
                if row.times.answers:
                    execute(
                        "INSERT INTO answering VALUES (?, ?, ?, ?, ?)", (row.stratum, *astuple(row.times))
                    )
                if row.trace is not None:
                    kept = (row.stratum, row.episode, row.violates, row.trace)
                    execute("INSERT INTO trace VALUES (?, ?, ?, ?)", kept)

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Commit all statements in a ``with`` block together.

        If the block raises an exception, roll back all statements.
        """
        with explained(self.path):
            # Take the write lock at the beginning, so that no second writer can begin in between.
            self.connection.execute("BEGIN IMMEDIATE")
            try:
                yield
                self.connection.execute("COMMIT")
            except BaseException:
                if self.connection.in_transaction:
                    self.connection.execute("ROLLBACK")
                raise

    def begin_session(self, began: str, workers: str, machine: str) -> None:
        """Record when and where a session runs episodes, and with how many workers.

        These texts are only for human readers.

        Args:
            began: The start time, ISO 8601 in UTC.
            workers: The number of workers.
            machine: A text that describes the machine.

        """
        with self.transaction():
            insert = "INSERT INTO session (began, workers, machine) VALUES (?, ?, ?)"
            self.connection.execute(insert, (began, workers, machine))

    def note_repeated(self, result: RepeatabilityResult) -> None:
        """Record the result of a repeatability check of this session.

        In this check, a second avoider answered the queries of the session again, or a new controller
        repeated the runs of the session.

        Args:
            result: The counts, and a text that describes the largest difference.

        """
        with self.transaction():
            self.connection.execute(
                "INSERT INTO repeated (questions, asked, differing, words, apart) VALUES (?, ?, ?, ?, ?)",
                (result.questions, result.asked, result.differing, result.words, _how(result)),
            )

    @property
    def asks_again(self) -> bool:
        """Whether the ledger has a table of repeated queries, which older programs did not write."""
        return self._has("repeated")

    @property
    def repeated(self) -> RepeatabilityResult:
        """The combined result of the repeatability checks in all sessions.

        If there is a difference, the result has a text on the first difference.
        """
        if not self.asks_again:
            return RepeatabilityResult(questions=0)
        order = "ORDER BY differing = 0, words = '', id"
        rows = list(self.all(f"SELECT questions, asked, differing, words, apart FROM repeated {order}"))
        questions, asked_again, differing = (sum(row[k] for row in rows) for k in range(3))
        kind: Callable[..., RepeatabilityResult] = RepeatabilityResult
        if any(row[4] & BY_RUNS for row in rows):
            beside = tuple(kind for kind, bit in BESIDE.items() if any(row[4] & bit for row in rows))
            of_avoider = any(row[4] & OF_AVOIDER for row in rows)
            kind = partial(
                DrivenAgain,
                of_avoider=of_avoider,
                beside=beside,
                of_simulator=self.declared.world.program,
            )
        return kind(
            questions=questions,
            asked=asked_again,
            differing=differing,
            words=next((row[3] for row in rows), ""),
            apart=any(row[4] & BY_PROCESS for row in rows),
            together=any(row[4] & TOGETHER for row in rows),
        )

    @property
    def dependent(self) -> str:
        """The reason why even a complete ledger gives no bound, or an empty string if it gives bounds."""
        difference = self.repeated.remembers
        if not difference:
            return self._copies
        why = "the avoider remembers earlier questions"
        if isinstance(self.repeated, DrivenAgain):
            why = f"the {self.repeated.who} is another from run to run"
        return f"{why}: episodes are not independent, no bound is stated ({difference})"

    @property
    def _copies(self) -> str:
        """A sentence which states that some runs only repeat other runs and add no evidence.

        The sentence is empty if all runs are distinct.
        """
        now = self.connection.total_changes, next(self.all("PRAGMA data_version"))
        if self._looked_at != now:  # the query takes a second for a million runs
            rows = ((self.declared.strata[k], *counts) for k, *counts in self.all(_DISTINCT))
            few = [f"{new} distinct runs of {runs} in {name}" for name, new, runs in rows if new < runs]
            why = f"runs repeat others bit for bit, no bound is stated ({', '.join(few)})"
            self._looked_at, self._found = now, why if few else ""
        return self._found

    def missing(self, stratum: int) -> Iterator[range]:
        """Yield ascending ranges of the missing episodes.

        The ranges end at the planned number of episodes, or where the stratum stopped early.

        Args:
            stratum: The number of the stratum.

        """
        stop = self.stopped_after(stratum)
        end, expected = self.declared.planned[stratum] if stop is None else stop, 0
        for (episode,) in self.all("SELECT episode FROM episode WHERE stratum = ? ORDER BY episode", stratum):
            if episode > expected:
                yield range(expected, episode)
            expected = episode + 1
        if expected < end:
            yield range(expected, end)

    def violations_kept(self, stratum: int) -> list[int]:
        """Return the violating episodes that have a stored trace, in ascending order.

        Args:
            stratum: The number of the stratum.

        """
        question = "SELECT episode FROM trace WHERE stratum = ? AND violation ORDER BY episode"
        return [episode for (episode,) in self.all(question, stratum)]

    def drop_traces(self, stratum: int, episodes: Iterable[int]) -> None:
        """Remove the stored traces of ``episodes``, because the plan keeps fewer violations.

        Args:
            stratum: The number of the stratum.
            episodes: The episodes whose traces to remove.

        """
        with self.transaction():
            delete = "DELETE FROM trace WHERE stratum = ? AND episode = ?"
            self.connection.executemany(delete, ((stratum, episode) for episode in episodes))

    @renamed_parameters(after="episodes")  # deprecated: the old name, for one release
    def stop(self, stratum: int, episodes: int) -> None:
        """End a stratum early, and remove all later episodes.

        Args:
            stratum: The number of the stratum.
            episodes: The number of episodes that remain.

        """
        with self.transaction():
            for table in ("trace", "judgement", "episode", *["added"] * self._has("added")):
                delete = f"DELETE FROM {table} WHERE stratum = ? AND episode >= ?"
                self.connection.execute(delete, (stratum, episodes))
            self.connection.execute("UPDATE stratum SET stopped_after = ? WHERE id = ?", (episodes, stratum))

    def stopped_after(self, stratum: int) -> int | None:
        """Return the number of episodes after which a stratum stopped, or None if it did not stop.

        Args:
            stratum: The number of the stratum.

        """
        ((episodes,),) = self.all("SELECT stopped_after FROM stratum WHERE id = ?", stratum)
        return None if episodes is None else int(episodes)

    def traces(self) -> list[tuple[int, int, bool]]:
        """Return a triple (stratum, episode, whether the episode violates a claim) for each stored trace."""
        rows = self.all("SELECT stratum, episode, violation FROM trace ORDER BY stratum, episode")
        return [(stratum, episode, bool(violation)) for stratum, episode, violation in rows]

    def trace(self, stratum: int, episode: int) -> bytes | None:
        """Return a stored trace as the bytes of a .trace file, or None if the episode has no stored trace.

        Args:
            stratum: The number of the stratum.
            episode: The number of the episode.

        """
        question = "SELECT data FROM trace WHERE stratum = ? AND episode = ?"
        return next((data for (data,) in self.all(question, stratum, episode)), None)

    def outcomes(self, stratum: int, claim: int) -> tuple[Ints, Ints, Floats]:
        """Return the episodes, outcomes and margins of a claim in a stratum, in the order of the episodes.

        Args:
            stratum: The number of the stratum.
            claim: The number of the claim.

        Returns:
            Three arrays of shape (n,), with a value for each of the n episodes in the ledger. A margin is in
            SI units, and NaN if the episode has no margin.

        """
        question = "SELECT episode, outcome, margin FROM judgement WHERE stratum = ? AND claim = ? ORDER BY 1"
        rows = list(self.all(question, stratum, claim))
        episodes, outcomes = (np.array([row[k] for row in rows], np.int64) for k in (0, 1))
        return episodes, outcomes, np.array([margin for *_, margin in rows], np.float64)  # NULL becomes NaN

    def sample(self, stratum: str, claim: str) -> IndependentSample:
        """Return the sample from which the violation probability of a claim in a stratum is estimated.

        Args:
            stratum: The name of the stratum in the plan.
            claim: The text of the claim in the plan.

        Raises:
            KeyError: The plan has no such stratum or claim.
            StatisticsError: Episodes are missing, or ``dependent`` states that the episodes depend on each
                other.

        """
        declared = self.declared
        number, position = _place(declared.strata, stratum), _place(declared.claims, claim)
        if self.dependent:
            raise refusal("episodes", "independent episodes", self.dependent)
        stop = self.stopped_after(number)
        rows = list(self.all(_SAMPLE, number, position, stop))
        episodes, outcomes, seeds, exercised = (
            np.array([row[k] for row in rows], np.int64) for k in range(4)
        )
        margins = np.array([row[4] for row in rows], np.float64)
        return IndependentSample.of_stream(
            self.stream(number), episodes, outcomes, margins, seeds=seeds, exercised=exercised, claim=claim
        )

    def stream(self, stratum: int) -> Declaration:
        """Return the declaration of a stratum's stream of episodes, as fixed before its first run.

        Args:
            stratum: The number of the stratum.

        """
        declared = self.declared
        return Declaration(
            plan_sha256=declared.identity.sha256,
            draws_sha256=self.draws_sha256,
            stratum=declared.strata[stratum],
            seed=declared.seed,
            planned=declared.planned[stratum],
            world=declared.world,
            stop_early=declared.stop_early,
        )

    @contextmanager
    def attached(self, path: Path, name: str) -> Iterator[None]:
        """Attach another ledger for reading, for the duration of a ``with`` block.

        Args:
            path: The file of the other ledger.
            name: The name of the other ledger in SQL.

        """
        self.connection.execute(f"ATTACH ? AS {name}", (f"file:{quote(str(path.absolute()))}?mode=ro",))
        try:
            yield
        finally:
            self.connection.execute(f"DETACH {name}")

    def _has(self, table: str) -> bool:
        """Return True if the ledger has the table ``table``.

        Older programs did not write all tables.
        """
        return bool(list(self.all("SELECT 1 FROM sqlite_master WHERE name = ? AND type = 'table'", table)))

    def all(self, question: str, *values: object) -> Iterator[tuple[Any, ...]]:
        """Yield the rows that an SQL query returns.

        Args:
            question: The query.
            values: The values for the placeholders of the query.

        Raises:
            LedgerError: SQLite cannot answer the query.

        """
        with explained(self.path):
            yield from self.connection.execute(question, values)


def _place(names: tuple[str, ...], name: str) -> int:
    if name not in names:
        raise KeyError(f"{name!r} is not in {', '.join(names)}")
    return names.index(name)


def _declare(connection: sqlite3.Connection, plan: Plan, ledger: Path) -> None:
    """Write ``plan`` and all its files into a new ledger, which will have the path ``ledger``."""
    choices = {"seed": plan.seed, "world": plan.world.label}
    choices |= {"confidence": plan.confidence, "stop early": plan.stop_early}
    entries = {
        "title": plan.title,
        "plan file": portable(os.path.relpath(plan.file.resolve(), ledger.resolve().parent), ledger.parent),
        "identity": plan.identity.as_json(),
        "plan": json.dumps(choices),
    }
    connection.executemany("INSERT INTO about VALUES (?, ?)", entries.items())
    connection.executemany(
        "INSERT INTO file (name, data) VALUES (?, ?)", [(f.name, f.data) for f in plan.files]
    )
    strata = [(k, row.name, row.space.name, row.runs) for k, row in enumerate(plan.strata)]
    connection.executemany("INSERT INTO stratum VALUES (?, ?, ?, ?, NULL)", strata)
    claims = [(k, row.sentence, row.unit.name, row.target, row.hazard) for k, row in enumerate(plan.claims)]
    connection.executemany("INSERT INTO claim VALUES (?, ?, ?, ?, ?)", claims)


def _world(label: str) -> WorldEntry:
    """Return the world that a ledger refers to.

    Raise ValueError if there is no such world.
    """
    if (world := world_labelled(label)) is None:
        raise ValueError(f"unknown world {label!r}")
    return world


def _declared(connection: sqlite3.Connection, path: Path) -> Declared:
    """Return the plan as the ledger stores it.

    Raise LedgerError if the stored content cannot come from a plan.
    """
    with explained(path):
        entries = dict(connection.execute("SELECT key, value FROM about"))
        strata = connection.execute("SELECT name, planned FROM stratum ORDER BY id").fetchall()
        claims = connection.execute("SELECT sentence, unit, target FROM claim ORDER BY id").fetchall()
    try:
        plan = json.loads(entries["plan"])
        return Declared(
            title=entries["title"],
            plan_file=path.parent / entries["plan file"],
            identity=Identity.from_json(entries["identity"]),
            seed=int(plan["seed"]),
            world=_world(str(plan["world"])),
            confidence=float(plan["confidence"]),
            stop_early=bool(plan["stop early"]),
            strata=tuple(name for name, _ in strata),
            planned=tuple(int(planned) for _, planned in strata),
            claims=tuple(sentence for sentence, *_ in claims),
            units=tuple(Unit[unit] for _, unit, _ in claims),
            targets=tuple(target for *_, target in claims),
        )
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise unusable(path, "a ledger with its plan", f"an unreadable plan ({error!r})") from error
