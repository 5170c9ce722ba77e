"""Check that all files are present, that the plan is as declared, and that the ledger records its runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from safety_harness.admission.spaces import MAX_REJECTION_RATIO
from safety_harness.base.exceptions import InputError, Place
from safety_harness.base.whole_file import sha256_of
from safety_harness.claims.signals.separation import WALKING_MPS
from safety_harness.extensions.assurance.campaign.episodes import random_episodes, root_seed
from safety_harness.extensions.assurance.campaign.identity import edition_of
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.opening import COUNTS
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.campaign.runner import Stopping
from safety_harness.extensions.assurance.campaign.session import LEDGER
from safety_harness.extensions.assurance.certification.evidence import Evidence
from safety_harness.extensions.assurance.certification.folder import (
    JSON,
    JUNIT,
    LARGEST_TRACE_BYTES,
    LOG,
    MANIFEST,
    OPENED,
    PAGE,
    PLAN,
    names_in,
)
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome
from safety_harness.scenario.model import EDITION

MOST_NAMED = 10  # faults of an examination; a last line counts the rest


@dataclass(frozen=True)
class Examination:
    """The subject of a check, and the faults that the check found.

    ``notes`` has remarks that are not faults. ``unchecked`` has the points that the check could not decide.
    Each of these points may hide a fault.
    """

    name: str
    looked_at: str
    faults: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    unchecked: tuple[str, ...] = ()

    @property
    def stands(self) -> bool:
        """True if the check found no fault."""
        return not self.faults


def few(faults: Sequence[str]) -> tuple[str, ...]:
    """Return the first few of ``faults``, and a text with the number of the remaining faults."""
    more = len(faults) - MOST_NAMED
    return (*faults[:MOST_NAMED], *([f"and {more} more"] if more > 0 else []))


REQUIRED = (PAGE, JSON, JUNIT, LEDGER)


def check_files(folder: Path, hashes: dict[str, str]) -> Examination:
    """Check that the manifest's ``hashes`` match the files in ``folder``, and that no file lacks a hash."""
    faults = [f"{name} is not in the manifest" for name in REQUIRED if name not in hashes]
    for name, digest in hashes.items():
        try:
            if not (folder / name).is_file():
                faults.append(f"{name} is missing")
            elif name.endswith(".trace") and (folder / name).stat().st_size > LARGEST_TRACE_BYTES:
                raise InputError(
                    place=Place(file=folder / name),
                    expected=f"a trace of at most {LARGEST_TRACE_BYTES:,} bytes",
                    got=f"{(folder / name).stat().st_size:,} bytes",
                )
            elif sha256_of(folder / name) != digest:
                faults.append(f"{name} is not the file that was written")
        except OSError as error:
            faults.append(f"{name} cannot be read: {error.strerror}")
    there = set(names_in(folder))
    faults += [f"{name} is not in the manifest" for name in sorted(there - hashes.keys() - set(REQUIRED))]
    paths = sorted(folder.rglob("*"))
    linked = [path for path in paths if path.is_symlink() or not (path.is_file() or path.is_dir())]
    faults += [f"{path.relative_to(folder)} is a link or a device, and no file" for path in linked]
    unseen = [path.relative_to(folder) for path in paths if path.name.startswith(".") and path.is_file()]
    log = folder / LOG
    if log.exists() and (not log.is_file() or log.stat().st_size > 0):
        faults.append(f"{LOG}: changes that the ledger lacks")
    mark = sha256_of(folder / MANIFEST)[:16]  # two people compare it to know that they have the same report
    text = f"{len(hashes)} files and their hashes, {MANIFEST} {mark}"
    hidden = [f"{name}: a hidden file, which verify does not read" for name in unseen]
    return Examination("files", text, few(faults), unchecked=few(hidden))


def check_plan(folder: Path, known: Plan, ledger: Ledger) -> Examination:
    """Check that the ledger's files match its declaration and the folder, and that its tables match the plan.

    Args:
        folder: The report's folder.
        known: The plan, as read from the ledger's files.
        ledger: The open ledger.

    """
    changes = ledger.declared.identity.changes(known.identity)
    own = tuple(change for change in changes if change.startswith("the file "))
    faults = [f"{change}: the ledger declares another" for change in own]
    files = {f"{PLAN}/{file.name}": file.sha256 for file in ledger.files}
    for name, digest in files.items():
        path = folder / name
        if not path.is_file() or sha256_of(path) != digest:
            faults.append(f"{name} is not the ledger's")
    there = {name for name in names_in(folder) if name.startswith(f"{PLAN}/")}
    faults += [f"{name} is no file of the ledger's plan" for name in sorted(there - files.keys())]
    of_programs = {f"{OPENED}/{sha256}" for sha256 in ledger.opened.values()}
    opened = {name for name in names_in(folder) if name.startswith(f"{OPENED}/")}
    faults += [f"{name} was opened by no program" for name in sorted(opened - of_programs)]
    faults += [f"{key}: the ledger and its plan disagree" for key in _contradictions(known, ledger)]
    faults += _wrongly_stopped(known, ledger)
    notes = tuple(f"since the report: {change}" for change in changes if change not in own)
    if (edition := edition_of(ledger.declared.identity)) < EDITION:
        note = (
            f"its claims have edition {edition}: a hand without a stated speed comes at {WALKING_MPS:g} m/s"
        )
        notes += (note,)
        if not any(change.startswith("the source of this package") for change in changes):
            faults.append(f"{note}, but this version of the source writes edition {EDITION}")
    return Examination("plan", f"the plan as it was declared, {len(files)} files", few(faults), notes)


@dataclass(frozen=True, eq=False)
class ReportFolder:
    """A report that ``verify`` checks: folder, manifest's hashes, evidence, plan and ledger."""

    folder: Path
    hashes: dict[str, str]
    recorded: Evidence
    plan: Plan
    ledger: Ledger

    @property
    def same(self) -> bool:
        """True if source, libraries, networks and platform are unchanged.

        The plan's files may differ.
        """
        changes = self.ledger.declared.identity.changes(self.plan.identity)
        return all(change.startswith("the file ") for change in changes)

    @property
    def same_words(self) -> bool:
        """True if the source of this package is unchanged.

        The texts and pages depend only on this source.
        """
        source = "the source of this package"
        return not any(
            item.startswith(source) for item in self.ledger.declared.identity.changes(self.plan.identity)
        )


def _contradictions(known: Plan, ledger: Ledger) -> Iterator[str]:
    """Yield the name of each value in the ledger that differs from the plan."""
    declared = ledger.declared
    hazards, spaces = (
        tuple(text for (text,) in ledger.all(f"SELECT {column} FROM {table} ORDER BY id"))
        for column, table in (("hazard", "claim"), ("space", "stratum"))
    )
    pairs = {
        "title": (known.title, declared.title),
        "seed": (known.seed, declared.seed),
        "world": (known.world.label, declared.world.label),
        "confidence": (known.confidence, declared.confidence),
        "stop early": (known.stop_early, declared.stop_early),
        "strata": (tuple(item.name for item in known.strata), declared.strata),
        "runs": (tuple(item.runs for item in known.strata), declared.planned),
        "claims": (tuple(item.sentence for item in known.claims), declared.claims),
        "units": (tuple(item.unit for item in known.claims), declared.units),
        "targets": (tuple(item.target for item in known.claims), declared.targets),
        "hazards": (tuple(item.hazard for item in known.claims), hazards),
        "spaces": (tuple(item.space.name for item in known.strata), spaces),
    }
    yield from (name for name, (item, noted) in pairs.items() if item != noted)


def _wrongly_stopped(known: Plan, ledger: Ledger) -> Iterator[str]:
    """Yield each stratum that ended early although its runs do not decide all claims."""
    stopped = [ledger.stopped_after(place) for place in range(len(ledger.declared.strata))]
    if any(count is not None for count in stopped):
        decided = Stopping(known, ledger).decided
        for place, count in enumerate(stopped):
            if count is not None and decided.get(place) != count:
                yield f"{ledger.declared.strata[place]}: stopped after {count} runs, which do not decide it"


def check_rows(ledger: Ledger) -> Examination:
    """Check that every row of ``ledger`` belongs to a declared run, has the right types, and occurs once.

    This check precedes all computations, because they rely on the rows.
    """
    faults = list(_odd_rows(ledger))
    ((made,),) = ledger.all("SELECT count(*) FROM episode")
    if not made:
        faults.append("there is no run in it")
    return Examination(
        "ledger", f"{made} runs in the ledger, each of them declared, and judged by all claims", few(faults)
    )


def _odd_rows(ledger: Ledger) -> Iterator[str]:
    """Yield each kind of wrong row with the number of such rows."""

    def counted(label: str, question: str, *values: object) -> Iterator[str]:
        yield from (f"{count} {label}" for (count,) in ledger.all(question, *values) if count)

    for label, question in _ODD.items():
        yield from counted(label, question)
    if ledger.asks_again:
        yield from counted("sessions of asking again with values of another kind", _REPEATED)
    for (began,) in ledger.all("SELECT began FROM session"):
        try:
            datetime.fromisoformat(began)
        except (TypeError, ValueError):
            yield "a session that began at no time"
    strata, claims = len(ledger.declared.strata), len(ledger.declared.claims)
    for name, table in (("run", "episode"), ("judgement", "judgement"), ("trace", "trace")):
        foreign = f"SELECT count(*) FROM {table} t LEFT JOIN stratum s ON s.id = t.stratum WHERE "
        foreign += "s.id IS NULL OR t.episode NOT BETWEEN 0 AND ifnull(s.stopped_after, s.planned) - 1"
        yield from counted(f"rows of the table {name} are of no declared run", foreign)
    numbered = "SELECT count(*), ifnull(min(id), 0), ifnull(max(id), -1) FROM "
    for table, expected in (("stratum", strata), ("claim", claims)):
        if list(ledger.all(numbered + table)) != [(expected, 0, expected - 1)]:
            yield f"the table {table} does not count from 0"
    both = "SELECT count(*) FROM (SELECT stratum, episode FROM {} EXCEPT SELECT stratum, episode FROM {})"
    for here, there in (("judgement", "episode"), ("episode", "judgement"), ("trace", "episode")):
        yield from counted(f"runs are in the table {here} and not in {there}", both.format(here, there))
    uneven = "SELECT count(*) FROM (SELECT 1 FROM judgement GROUP BY stratum, episode HAVING count(*) <> ?)"
    yield from counted("runs are not judged by every claim once", uneven, claims)


def _not(table: str, **kinds: str) -> str:
    """Return an SQL query that counts the rows of ``table`` in which a column has a wrong type.

    For each column, ``kinds`` has the allowed SQLite types, separated by spaces.
    """
    tests = (
        f"typeof({column}) NOT IN ({', '.join(map(repr, kind.split()))})" for column, kind in kinds.items()
    )
    return f"SELECT count(*) FROM {table} WHERE {' OR '.join(tests)}"


_REPEATED = (
    _not("repeated", **dict.fromkeys(("questions", "asked", "differing", "apart"), "integer"), words="text")
    + " OR differing NOT BETWEEN 0 AND asked OR asked > questions"
)
_COUNTS = (
    *("stratum", "episode", "seed", "draws", "decisions"),
    *("proposed", "opposite", "stopped", "faults", "late", *COUNTS),
)
_ODD = {
    "runs with values of another kind": _not(
        "episode",
        **dict.fromkeys(_COUNTS, "integer"),
        cell="integer null",
        mishap="text null",
        failure="text null",
        seconds="real",
        worker="text",
    ),
    "judgements with values of another kind": _not(
        "judgement",
        **dict.fromkeys(("stratum", "claim", "episode", "outcome", "exercised"), "integer"),
        margin="real null",
        worst_time_s="real null",
    ),
    "traces with values of another kind": _not(
        "trace", **dict.fromkeys(("stratum", "episode", "violation"), "integer"), data="blob"
    ),
    "cells with values of another kind": _not("cell", id="integer", words="text"),
    "strata with values of another kind": _not(
        "stratum", name="text", space="text", planned="integer", stopped_after="integer null"
    ),
    "claims with values of another kind": _not(
        "claim", sentence="text", unit="text", target="real null", hazard="text"
    ),
    "sessions with values of another kind": _not("session", began="text", workers="text", machine="text"),
    "files with values of another kind": _not("file", name="text", data="blob"),
    "impossible counts": "SELECT count(*) FROM episode WHERE draws NOT BETWEEN 0 AND "
    f"{MAX_REJECTION_RATIO} OR min(proposed, opposite, stopped, faults, late, {', '.join(COUNTS)}) < 0 "
    "OR overruled_replaced > opposite OR overruled_stopped > stopped "
    "OR proposals <> proposed + overruled_replaced + overruled_stopped "
    "OR seconds NOT BETWEEN 0 AND 1e12",
    "traces of runs that were never drawn": "SELECT count(*) FROM trace t JOIN episode e "
    "ON e.stratum = t.stratum AND e.episode = t.episode WHERE e.draws < 1",
    "unknown outcomes": "SELECT count(*) FROM judgement WHERE outcome NOT BETWEEN 0 AND "
    f"{int(max(EpisodeOutcome))}",
    "failures without a reason": "SELECT count(*) FROM judgement j JOIN episode e ON e.stratum = j.stratum "
    f"AND e.episode = j.episode WHERE j.outcome = {int(EpisodeOutcome.FAILED)} AND e.failure IS NULL",
}


def kept(known: Plan, ledger: Ledger) -> Iterator[str]:
    """Yield each wrong seed in ``ledger``, and each trace that is missing or wrongly marked.

    ``known`` is the declared plan.
    """
    distinct = "SELECT DISTINCT stratum, episode FROM judgement WHERE outcome = ?"
    violating = set(ledger.all(distinct, int(EpisodeOutcome.VIOLATED)))
    every = "SELECT stratum, episode FROM judgement GROUP BY 1, 2 HAVING min(outcome) = ?"
    failed = set(ledger.all(every, int(EpisodeOutcome.FAILED)))
    traces = {(where, episode): violation for where, episode, violation in ledger.traces()}
    for (where, episode), violation in traces.items():
        if violation != ((where, episode) in violating):
            yield f"{known.strata[where].name}, run {episode}: its trace is not marked as its outcomes say"
    for place, stratum in enumerate(known.strata):
        made = dict(ledger.all("SELECT episode, seed FROM episode WHERE stratum = ?", place))
        first = sorted(episode for where, episode in violating if where == place)[: known.violations_kept]
        random = random_episodes(known, place) & made.keys()
        for episode in sorted({*first, *(item for item in random if (place, item) not in failed)}):
            if (place, episode) not in traces:
                yield f"{stratum.name}, run {episode}: the ledger lacks its trace, which the plan keeps"
        for episode, seed in made.items():
            if seed != root_seed(known, place, episode):
                yield f"{stratum.name}, run {episode}: its seed is not the plan's"
