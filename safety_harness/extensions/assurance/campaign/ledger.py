"""The ledger: one SQLite file with a row for every planned episode that was run, and never two.

A commit is on the disk when ``record`` returns, so that nothing that happens later loses it; what happens
before leaves no part of a batch.  Others may read while one process writes.
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
from safety_harness.base.whole_file import replacing, writing
from safety_harness.cell.simulation.worlds import WorldEntry, worlds_by_label
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

_NUMBERS = 10 + len(COUNTS)
_EPISODE = f"INSERT INTO episode VALUES ({'?, ' * _NUMBERS}(SELECT id FROM cell WHERE words = ?){', ?' * 4})"
_SAMPLE = (
    "SELECT j.episode, j.outcome, e.seed, j.exercised, j.margin FROM judgement j JOIN episode e "
    "ON e.stratum = j.stratum AND e.episode = j.episode WHERE j.stratum = ? AND j.claim = ? "
    "AND j.episode < coalesce(?, j.episode + 1)"
)
_DISTINCT = "SELECT stratum, count(DISTINCT run), count(*) FROM episode WHERE run <> 0 GROUP BY stratum"
_TIMES = (  # numbers, whatever a stranger's ledger has there
    "SELECT total(answers), total(slow), ifnull(max(slowest_s + 0.0), 0.0), "
    "max(ifnull(max(limit_s + 0.0), 0.0), 1e-9) FROM answering WHERE stratum = ?"
)
_JUDGEMENT = f"INSERT INTO judgement VALUES ({', '.join('?' * 7)})"


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


WRISTS = (
    "recorded hands are wrists: straight fingers reach 120 to 150 mm beyond the sphere, and no distance here "
    "counts them"
)


def _is_recording(file: PlanFile) -> bool:
    """Is it a table of tracked points, whatever it is called?"""
    try:
        return bool(parse_recording(file.data, Path(file.name)).tracks)
    except RecordingError:
        return False


# How it was asked again: elsewhere, by driving again (an avoider: with the 8), in one call too.
APART, BY_RUNS, TOGETHER, OF_AVOIDER = 1, 2, 4, 8


def _how(found: RepeatabilityResult) -> int:
    if isinstance(found, DrivenAgain):
        return BY_RUNS + OF_AVOIDER * found.of_avoider
    return APART * found.apart + TOGETHER * found.together


class Ledger:
    """Made by ``create`` or ``open``; close it, or use it in a ``with``.

    Strata and claims are counted in the plan's order, which ``declared`` has.
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
        """A ledger without episodes at ``path``, where there must be none: whole or not at all."""
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
        """The ledger at ``path``; LedgerError when it cannot be used.

        ``check`` looks at all its pages; ``alone`` at nothing that lies beside the file.
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
        """Let go of the file, and remove an empty log beside it, unless the file was read alone."""
        self.connection.close()
        if self.tidies:
            remove_empty_log(self.path)

    def refuse_other(
        self,
        identity: Identity,
        hint: str = "put them back as they were, or begin another ledger (--ledger FILE)",
    ) -> None:
        """LedgerError that names what has changed since the ledger's plan was declared."""
        self.declared.identity.refuse_other(identity, self.path, hint=hint)

    def refuse_other_plan(self, plan: Plan) -> None:
        """As ``refuse_other``, and for other bytes of a file that the user's own module opened in a run."""
        self.refuse_other(plan.identity)
        there = {name: sha256 for name, sha256 in self.opened.items() if sha256}
        now = {name: sha256_of(plan.file.resolve().parent / name) for name in there}
        Identity(tuple(there.items())).refuse_other(
            Identity(tuple(now.items())), self.path, hint="put it back as it was, or begin another ledger"
        )

    @property
    def opened(self) -> dict[str, str]:
        """The files that modules of the user's opened, named from the plan's folder, and their SHA-256.

        It is empty for those that they write themselves.
        """
        found = self._has("opened")
        return dict(self.all("SELECT name, sha256 FROM opened ORDER BY name")) if found else {}

    def times(self, stratum: int) -> AnswersTook:
        """How long answers took in a stratum; none were timed where an older program made the ledger."""
        ((answers, slow, *times_s),) = self.all(_TIMES, stratum) if self._has("answering") else ((0, 0),)
        return AnswersTook(int(answers), int(slow), *times_s)

    @property
    def slow(self) -> list[str]:
        """Each stratum in which answers took longer than its runs allow, in words."""
        named = ((name, self.times(k).words) for k, name in enumerate(self.declared.strata))
        return [f"{name}: {words}" for name, words in named if words]

    def take_opened(self, files: Iterable[tuple[str, str]]) -> None:
        """Note files down; LedgerError for one of which earlier runs read other bytes."""
        for name, sha256 in sorted(files, key=itemgetter(1)):  # those that are written first
            known = self.opened.get(name)
            if sha256 and known is None and self._is_newer(name):
                raise unusable(self.path, f"{name} as it was when runs began", "one that is newer")
            if not sha256 or known is None:
                self.connection.execute("INSERT OR REPLACE INTO opened VALUES (?, ?)", (name, sha256))
            elif known not in ("", sha256):
                expected = f"{name} as earlier runs opened it"
                raise unusable(self.path, expected, "other bytes: it was written while runs were made")

    def _is_newer(self, name: str) -> bool:
        """Did a file come or change between the first session that ran anything and this one?"""
        (ends,) = self.all("SELECT min(began), max(began) FROM session WHERE EXISTS (SELECT 1 FROM episode)")
        begun_s, now_s = (datetime.fromisoformat(one or "1970-01-02").timestamp() for one in ends)
        file = self.declared.plan_file.parent / name
        return file.is_file() and begun_s < file.stat().st_ctime < now_s

    @property
    def files(self) -> tuple[PlanFile, ...]:
        """The files of the plan as they were when it was declared, the plan's own first."""
        return tuple(
            PlanFile(name, data) for name, data in self.all("SELECT name, data FROM file ORDER BY place")
        )

    @property
    def wrists(self) -> tuple[str, ...]:
        """What a reader has to know of recorded hands; nothing where no file of the plan is a recording."""
        return (WRISTS,) if any(map(_is_recording, self.files)) else ()

    @cached_property
    def counts(self) -> tuple[str, ...]:
        """Those of ``COUNTS`` that it notes; the others are read as 0."""
        return counts_in(self.connection)

    @cached_property
    def draws_sha256(self) -> str:
        """Of the files that draw the scenarios: all but the plan's own, programs and networks."""
        drawing = [
            file.sha256
            for file in self.files[1:]
            if not file.name.endswith((".py", MODEL_SUFFIX, ONNX_SUFFIX))
        ]
        return hashlib.sha256("".join(sorted(drawing)).encode()).hexdigest()

    def record(self, rows: Iterable[Row]) -> None:
        """Note episodes down, all of them or none; LedgerError if one of them is there already."""
        execute = self.connection.execute
        with self.transaction():
            for row in rows:
                self.take_opened(row.opened)
                counts = (row.decisions, row.proposed, row.opposite, row.stopped, row.faults, row.late)
                noted = (*row.overruling.counts, row.run, row.theorem)
                own = (row.stratum, row.episode, row.seed, row.draws, *counts, *noted)
                if row.cell:
                    execute("INSERT OR IGNORE INTO cell (words) VALUES (?)", (row.cell,))
                words = (row.cell, row.mishap or None, row.failure or None)
                here = (row.seconds, row.worker)
                execute(_EPISODE, (*own, *words, *here))
                for claim, one in enumerate(row.judgements):
                    found = (int(one.outcome), one.margin, one.worst_time_s, one.exercised)
                    execute(_JUDGEMENT, (row.stratum, claim, row.episode, *found))  # a NaN becomes NULL
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
        """All of what is written within, or none of it."""
        with explained(self.path):
            self.connection.execute("BEGIN IMMEDIATE")
            try:
                yield
                self.connection.execute("COMMIT")
            except BaseException:
                if self.connection.in_transaction:
                    self.connection.execute("ROLLBACK")
                raise

    def begin_session(self, began: str, workers: str, machine: str) -> None:
        """Note down who works on it, for people: nothing depends on it."""
        with self.transaction():
            insert = "INSERT INTO session (began, workers, machine) VALUES (?, ?, ?)"
            self.connection.execute(insert, (began, workers, machine))

    def note_repeated(self, found: RepeatabilityResult) -> None:
        """Note down what a second avoider answered to questions of a session, or a fresh controller did."""
        with self.transaction():
            self.connection.execute(
                "INSERT INTO repeated (questions, asked, differing, words, apart) VALUES (?, ?, ?, ?, ?)",
                (found.questions, found.asked, found.differing, found.words, _how(found)),
            )

    @property
    def asks_again(self) -> bool:
        """Has it a table for that?  Those of older programs have none."""
        return self._has("repeated")

    @property
    def repeated(self) -> RepeatabilityResult:
        """What second avoiders answered, of all sessions; the words are of the first that differed."""
        if not self.asks_again:
            return RepeatabilityResult(questions=0)
        order = "ORDER BY differing = 0, words = '', id"
        rows = list(self.all(f"SELECT questions, asked, differing, words, apart FROM repeated {order}"))
        questions, asked, differing = (sum(row[k] for row in rows) for k in range(3))
        kind: Callable[..., RepeatabilityResult] = RepeatabilityResult
        if any(row[4] & BY_RUNS for row in rows):
            kind = partial(DrivenAgain, of_avoider=any(row[4] & OF_AVOIDER for row in rows))
        return kind(
            questions=questions,
            asked=asked,
            differing=differing,
            words=next((row[3] for row in rows), ""),
            apart=any(row[4] & APART for row in rows),
            together=any(row[4] & TOGETHER for row in rows),
        )

    @property
    def dependent(self) -> str:
        """Why no bound is stated though all episodes are there; empty if one may be."""
        found = self.repeated.remembers
        if not found:
            return self._copies
        why = "the avoider remembers earlier questions"
        if isinstance(self.repeated, DrivenAgain):
            why = f"the {self.repeated.who} is another from run to run"
        return f"{why}: episodes are not independent, no bound is stated ({found})"

    @property
    def _copies(self) -> str:
        """That runs are copies of others, in words; the same scenario twice is no further evidence."""
        now = self.connection.total_changes, next(self.all("PRAGMA data_version"))
        if self._looked_at != now:  # a million runs take a second
            found = ((self.declared.strata[k], *counts) for k, *counts in self.all(_DISTINCT))
            few = [f"{one} distinct runs of {all_} in {name}" for name, one, all_ in found if one < all_]
            why = f"runs repeat others bit for bit, no bound is stated ({', '.join(few)})"
            self._looked_at, self._found = now, why if few else ""
        return self._found

    def missing(self, stratum: int) -> Iterator[range]:
        """The planned episodes that are not there yet, as ranges in their order; none beyond a stop."""
        after = self.stopped_after(stratum)
        end, expected = self.declared.planned[stratum] if after is None else after, 0
        for (episode,) in self.all("SELECT episode FROM episode WHERE stratum = ? ORDER BY episode", stratum):
            if episode > expected:
                yield range(expected, episode)
            expected = episode + 1
        if expected < end:
            yield range(expected, end)

    def violations_kept(self, stratum: int) -> list[int]:
        """The episodes with a violation whose traces are there, in their order."""
        question = "SELECT episode FROM trace WHERE stratum = ? AND violation ORDER BY episode"
        return [episode for (episode,) in self.all(question, stratum)]

    def drop_traces(self, stratum: int, episodes: Iterable[int]) -> None:
        """Remove stored traces: of violations beyond those that the plan keeps."""
        with self.transaction():
            delete = "DELETE FROM trace WHERE stratum = ? AND episode = ?"
            self.connection.executemany(delete, ((stratum, episode) for episode in episodes))

    def stop(self, stratum: int, after: int) -> None:
        """The stratum ends after its first ``after`` episodes; what was run beyond them is no part of it."""
        with self.transaction():
            for table in ("trace", "judgement", "episode", *["added"] * self._has("added")):
                delete = f"DELETE FROM {table} WHERE stratum = ? AND episode >= ?"
                self.connection.execute(delete, (stratum, after))
            self.connection.execute("UPDATE stratum SET stopped_after = ? WHERE id = ?", (after, stratum))

    def stopped_after(self, stratum: int) -> int | None:
        """The number of episodes after which the stratum was stopped; None if it was not."""
        ((after,),) = self.all("SELECT stopped_after FROM stratum WHERE id = ?", stratum)
        return None if after is None else int(after)

    def traces(self) -> list[tuple[int, int, bool]]:
        """(stratum, episode, whether it violates a claim) of every stored trace."""
        rows = self.all("SELECT stratum, episode, violation FROM trace ORDER BY stratum, episode")
        return [(stratum, episode, bool(violation)) for stratum, episode, violation in rows]

    def trace(self, stratum: int, episode: int) -> bytes | None:
        """A stored trace, as a .trace file has it; None if it was not kept."""
        question = "SELECT data FROM trace WHERE stratum = ? AND episode = ?"
        return next((data for (data,) in self.all(question, stratum, episode)), None)

    def outcomes(self, stratum: int, claim: int) -> tuple[Ints, Ints, Floats]:
        """(n,) episodes, outcomes and margins of what is there now, in the order of the episodes."""
        question = "SELECT episode, outcome, margin FROM judgement WHERE stratum = ? AND claim = ? ORDER BY 1"
        rows = list(self.all(question, stratum, claim))
        episodes, outcomes = (np.array([row[k] for row in rows], np.int64) for k in (0, 1))
        return episodes, outcomes, np.array([margin for *_, margin in rows], np.float64)  # NULL becomes NaN

    def sample(self, stratum: str, claim: str) -> IndependentSample:
        """What estimates of a claim in a stratum are made of; StatisticsError while episodes are missing.

        And for an avoider that answered otherwise when it was asked again.

        Both are named as the plan names them; KeyError for others.
        """
        declared = self.declared
        number, of = _place(declared.strata, stratum), _place(declared.claims, claim)
        if self.dependent:
            raise refusal("episodes", "independent episodes", self.dependent)
        after = self.stopped_after(number)
        rows = list(self.all(_SAMPLE, number, of, after))
        episodes, outcomes, seeds, exercised = (
            np.array([row[k] for row in rows], np.int64) for k in range(4)
        )
        margins = np.array([row[4] for row in rows], np.float64)
        return IndependentSample.of_stream(
            self.stream(number), episodes, outcomes, margins, seeds=seeds, exercised=exercised, claim=claim
        )

    def stream(self, stratum: int) -> Declaration:
        """What was said of a stratum's episodes before the first was run."""
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
        """Another ledger, to be read under a name in SQL."""
        self.connection.execute(f"ATTACH ? AS {name}", (f"file:{quote(str(path.absolute()))}?mode=ro",))
        try:
            yield
        finally:
            self.connection.execute(f"DETACH {name}")

    def _has(self, table: str) -> bool:
        """Is there such a table?  Ledgers of older programs lack some."""
        return bool(list(self.all("SELECT 1 FROM sqlite_master WHERE name = ? AND type = 'table'", table)))

    def all(self, question: str, *values: object) -> Iterator[tuple[Any, ...]]:
        """The rows of the answer to a question in SQL."""
        with explained(self.path):
            yield from self.connection.execute(question, values)


def _place(names: tuple[str, ...], name: str) -> int:
    if name not in names:
        raise KeyError(f"{name!r} is none of {', '.join(names)}")
    return names.index(name)


def _declare(connection: sqlite3.Connection, plan: Plan, ledger: Path) -> None:
    """Write the plan down, with all its files, in the ledger of that path."""
    choices = {"seed": plan.seed, "world": plan.world.label}
    choices |= {"confidence": plan.confidence, "stop early": plan.stop_early}
    about = {
        "title": plan.title,
        "plan file": portable(os.path.relpath(plan.file.resolve(), ledger.resolve().parent), ledger.parent),
        "identity": plan.identity.as_json(),
        "plan": json.dumps(choices),
    }
    connection.executemany("INSERT INTO about VALUES (?, ?)", about.items())
    connection.executemany(
        "INSERT INTO file (name, data) VALUES (?, ?)", [(f.name, f.data) for f in plan.files]
    )
    strata = [(k, one.name, one.space.name, one.runs) for k, one in enumerate(plan.strata)]
    connection.executemany("INSERT INTO stratum VALUES (?, ?, ?, ?, NULL)", strata)
    claims = [(k, one.sentence, one.unit.name, one.target, one.hazard) for k, one in enumerate(plan.claims)]
    connection.executemany("INSERT INTO claim VALUES (?, ?, ?, ?, ?)", claims)


def _declared(connection: sqlite3.Connection, path: Path) -> Declared:
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
        raise unusable(path, "a ledger with its plan", f"none that can be read ({error!r})") from error
