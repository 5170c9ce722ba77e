"""Operations on several ledgers: merge parts of one plan, and compare the results of two avoiders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from safety_harness.base.exceptions import LedgerError, Place
from safety_harness.base.whole_file import replacing, writing
from safety_harness.claims.properties.base import Unit
from safety_harness.extensions.assurance.campaign.identity import SIMULATOR
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.opening import (
    ADDED,
    COUNTS,
    explained,
    only_runner,
    refuse_any_file,
    unusable,
)
from safety_harness.extensions.assurance.campaign.session import plan_of
from safety_harness.extensions.assurance.campaign.summary import root_of, tally_of
from safety_harness.extensions.assurance.statistics.paired import PairedComparison, compare
from safety_harness.extensions.assurance.statistics.sample import PERHAPS

_NUMBERS = ("seed", "draws", "decisions", "proposed", "opposite", "stopped", "faults", "late", *COUNTS)
_EPISODE = ", ".join((*_NUMBERS, "mishap", "failure"))
_JUDGEMENT = "outcome, margin, worst_time_s, exercised"
# Pairs judgement a in this ledger with b in the attached ledger "first": same stratum, claim and episode.
PAIRS = (
    "FROM judgement a JOIN stratum s ON s.id = a.stratum JOIN claim c ON c.id = a.claim "
    "JOIN first.stratum t ON t.name = s.name JOIN first.claim d ON d.sentence = c.sentence "
    "JOIN first.judgement b ON b.stratum = t.id AND b.claim = d.id AND b.episode = a.episode"
)


def merge(into: Path, ledgers: Sequence[Path]) -> int:
    """Write all episodes of ``ledgers`` to a new ledger at ``into``, and return their number.

    Two results of the same episode must agree to the last bit. If a path is listed twice, the ledger is read
    once. Raise LedgerError, and write no new ledger, if ``into`` exists, if the plans differ, or if two
    results differ. Raise it also if the plan may stop early, because such a plan needs its episodes in order.
    """
    with Ledger.open(ledgers[0]) as first, only_runner(into):
        refuse_any_file(into)
        if first.declared.stop_early:
            raise unusable(ledgers[0], "a plan of fixed length", "one that may stop early")
        with writing(into), replacing(into) as unfinished:
            return _merged(unfinished, first, ledgers)


def _merged(unfinished: Path, first: Ledger, ledgers: Sequence[Path]) -> int:
    """Merge ``ledgers`` into the file ``unfinished``, and return the number of episodes.

    The function leaves no other file beside the ledger.
    """
    try:
        with plan_of(first) as plan, Ledger.create(unfinished, plan) as whole:
            for path in {path.resolve(): path for path in ledgers}.values():
                with Ledger.open(path) as part:
                    part.refuse_other(whole.declared.identity, hint=f"{first.path} is of another plan")
                _take_over(whole, path)
            return int(next(whole.all("SELECT count(*) FROM episode"))[0])
    finally:
        for suffix in ("-wal", "-shm"):
            unfinished.with_name(unfinished.name + suffix).unlink(missing_ok=True)


def _take_over(whole: Ledger, path: Path) -> None:
    """Copy the whole ledger at ``path`` into ``whole`` in one transaction."""
    with explained(path), whole.attached(path, "part"), whole.transaction():
        # First, results that both ledgers have must agree; then ``OR IGNORE`` below drops only equal rows.
        for table, columns, key in (
            ("episode", _EPISODE, ("stratum", "episode")),
            ("judgement", _JUDGEMENT, ("stratum", "claim", "episode")),
        ):
            same = " AND ".join(f"a.{name} = b.{name}" for name in key)
            differs = " OR ".join(f"a.{name} IS NOT b.{name}" for name in columns.split(", "))
            question = (
                f"SELECT a.stratum, a.episode FROM {table} a JOIN part.{table} b ON {same} WHERE {differs}"
            )
            for stratum, episode in whole.all(f"{question} LIMIT 1"):
                raise LedgerError(
                    place=Place(file=path, field=whole.declared.strata[stratum]),
                    expected=f"the result that another ledger has for episode {episode}",
                    got="another one",
                    hint="machines of different kinds, or an avoider that does not repeat itself",
                )
        whole.take_opened([*whole.all("SELECT name, sha256 FROM part.opened")])
        # Each ledger numbers its cells itself, so episodes find their cells by the words.
        whole.connection.execute("INSERT OR IGNORE INTO cell (words) SELECT words FROM part.cell")
        whole.connection.execute(
            "INSERT OR IGNORE INTO episode "
            f"SELECT e.stratum, e.episode, e.{', e.'.join(_NUMBERS)}, c.id, e.mishap, e.failure, "
            "e.seconds, e.worker "
            "FROM part.episode e LEFT JOIN part.cell p ON p.id = e.cell LEFT JOIN cell c ON c.words = p.words"
        )
        whole.connection.execute("INSERT OR IGNORE INTO judgement SELECT * FROM part.judgement")
        whole.connection.execute("INSERT OR IGNORE INTO trace SELECT * FROM part.trace")
        whole.connection.execute("INSERT INTO answering SELECT * FROM part.answering")
        if [*whole.all("SELECT 1 FROM part.sqlite_master WHERE name = 'added'")]:
            whole.connection.execute(ADDED)
            whole.connection.execute("INSERT OR IGNORE INTO added SELECT * FROM part.added")
        columns = "questions, asked, differing, words, apart"
        whole.connection.execute(
            f"INSERT INTO repeated ({columns}) SELECT {columns} FROM part.repeated ORDER BY id"
        )
        whole.connection.execute(
            "INSERT INTO session (began, workers, machine) SELECT began, workers, machine FROM part.session"
        )


@dataclass(frozen=True)
class Worse:
    """An episode that violates a claim with the second avoider, but not with the first.

    The margins of the episode are in SI units.
    """

    stratum: str
    episode: int
    claim: str
    unit: Unit
    before: float | None
    after: float | None


def compare_ledgers(first: Ledger, second: Ledger) -> tuple[PairedComparison, ...]:
    """Return exact bounds of the difference ``second`` minus ``first`` for each common claim and stratum.

    All bounds hold simultaneously with the confidence of ``first`` (Bonferroni). Raise LedgerError if
    episodes are missing, if spaces or scenarios differ, or if no claim or no stratum is common. Raise
    StatisticsError if two streams differ.
    """
    refuse_incomparable(first, second)
    refuse_other_scenarios(first, second)
    strata = [name for name in first.declared.strata if name in second.declared.strata]
    claims = [claim for claim in first.declared.claims if claim in second.declared.claims]
    if not strata or not claims:
        raise unusable(second.path, "a stratum and a claim that both ledgers have", "none")
    pairs = [(stratum, claim) for stratum in strata for claim in claims]
    confidence = 1.0 - (1.0 - first.declared.confidence) / len(pairs)
    return tuple(compare(second.sample(*pair), first.sample(*pair), confidence) for pair in pairs)


def began_at(ledger: Ledger) -> list[str]:
    """Return the start times of all sessions of ``ledger`` in ascending order, as ISO 8601 in UTC."""
    return [began for (began,) in ledger.all("SELECT began FROM session ORDER BY began")]


def refuse_itself(first: Ledger, second: Ledger) -> None:
    """Raise LedgerError if both ledgers have the same sessions and the same rows."""
    if began_at(first) == began_at(second) and root_of(first) == root_of(second):
        got = f"{first.path}, which has the same runs: a comparison with itself"
        raise unusable(second.path, "a ledger of other runs", got)


def refuse_incomparable(first: Ledger, second: Ledger) -> None:
    """Raise LedgerError if the campaigns have different spaces, or if episodes are missing."""
    if first.draws_sha256 != second.draws_sha256:  # only the same spaces give common random numbers
        expected = f"a campaign over the same spaces as {first.path}"
        raise unusable(second.path, expected, "spaces with another text")
    simulators = [dict(ledger.declared.identity.parts).get(SIMULATOR) for ledger in (first, second)]
    if simulators[0] != simulators[1]:
        raise unusable(second.path, f"a campaign in the simulator of {first.path}", "another simulator")
    for ledger in (first, second):
        if not (tally := tally_of(ledger)).complete:
            got = f"{tally.done} of {tally.planned} episodes: resume it, or merge its parts"
            raise unusable(ledger.path, "a complete campaign", got)


def without_a_decided_run(ledger: Ledger) -> list[tuple[str, str]]:
    """Return each pair (stratum, claim) for which every run failed or had no verdict."""
    pairs = [(stratum, claim) for stratum in ledger.declared.strata for claim in ledger.declared.claims]
    samples = {pair: ledger.sample(*pair) for pair in pairs}
    return [pair for pair, sample in samples.items() if np.isin(sample.outcomes, PERHAPS).all()]


_DRAWN = (
    "FROM episode a JOIN stratum s ON s.id = a.stratum JOIN first.stratum t ON t.name = s.name "
    "JOIN first.episode b ON b.stratum = t.id AND b.episode = a.episode"
)


def refuse_other_scenarios(first: Ledger, second: Ledger) -> None:
    """Raise LedgerError if an episode has a different scenario in each ledger.

    The scenarios differ if admission refused different draws in the two campaigns.
    """
    with second.attached(first.path, "first"):
        (pairs, differing), *_ = second.all(f"SELECT count(*), total(a.draws <> b.draws) {_DRAWN}")
    if differing:
        got = f"{int(differing)} of {pairs} pairs whose scenarios differ: admission refused other draws"
        raise unusable(second.path, f"the same scenario in each episode as {first.path}", got)


def worse_episodes(first: Ledger, second: Ledger, most: int = 20) -> list[Worse]:
    """Return at most ``most`` episodes that violate a claim in ``second`` but not in ``first``.

    The episode with the largest loss of margin comes first.
    """
    with second.attached(first.path, "first"):
        rows = second.all(
            f"SELECT s.name, a.episode, c.sentence, c.unit, b.margin, a.margin {PAIRS} "
            "WHERE a.outcome = 1 AND b.outcome <> 1 "
            "ORDER BY ifnull(b.margin, 0) - a.margin DESC, s.name, c.sentence, a.episode LIMIT ?",
            most,
        )
        return [
            Worse(stratum, episode, claim, Unit[unit], *margins)
            for stratum, episode, claim, unit, *margins in rows
        ]
