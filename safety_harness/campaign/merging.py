"""Ledgers of parts of one plan, made on several machines, become one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from safety_harness.campaign.ledger import Ledger
from safety_harness.campaign.opening import explained, only_runner
from safety_harness.campaign.session import plan_of
from safety_harness.exceptions import LedgerError, OutputError, Place
from safety_harness.whole_file import replacing

_EPISODE = "seed, draws, decisions, proposed, opposite, stopped, faults, late, mishap, failure"
_JUDGEMENT = "outcome, margin, worst_time_s, exercised"


def merge(into: Path, ledgers: Sequence[Path]) -> int:
    """A ledger at ``into``, where there must be none, of all episodes of ``ledgers``; how many there are.

    What several of them have must agree to the last bit.  LedgerError for ledgers of different plans, of one
    that stops early (which needs its episodes in their order), and for one that disagrees, which names the
    episode; nothing is written then.
    """
    with Ledger.open(ledgers[0]) as first, only_runner(into):
        if into.exists():
            raise LedgerError(place=Place(file=into), expected="no file there yet", got="one")
        if first.declared.stop_early:
            raise LedgerError(
                place=Place(file=ledgers[0]), expected="a plan of fixed length", got="one that may stop early"
            )
        try:
            with replacing(into) as unfinished:
                return _merged(unfinished, first, ledgers)
        except OSError as error:
            raise OutputError.of(into, error) from error


def _merged(unfinished: Path, first: Ledger, ledgers: Sequence[Path]) -> int:
    """How many episodes there are in all; nothing is left beside the file."""
    try:
        with plan_of(first) as plan, Ledger.create(unfinished, plan) as whole:
            for path in ledgers:
                with Ledger.open(path) as part:
                    part.refuse_other(whole.declared.identity)
                _take_over(whole, path)
            return int(next(whole.all("SELECT count(*) FROM episode"))[0])
    finally:
        for suffix in ("-wal", "-shm"):
            unfinished.with_name(unfinished.name + suffix).unlink(missing_ok=True)


def _take_over(whole: Ledger, path: Path) -> None:
    """All of one ledger, in one transaction."""
    with explained(path), whole.attached(path, "part"), whole.transaction():
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
        whole.execute("INSERT OR IGNORE INTO cell (words) SELECT words FROM part.cell")
        whole.execute(
            "INSERT OR IGNORE INTO episode "
            "SELECT e.stratum, e.episode, e.seed, e.draws, e.decisions, e.proposed, e.opposite, "
            "e.stopped, e.faults, e.late, c.id, e.mishap, e.failure, e.seconds, e.worker "
            "FROM part.episode e LEFT JOIN part.cell p ON p.id = e.cell LEFT JOIN cell c ON c.words = p.words"
        )
        whole.execute("INSERT OR IGNORE INTO judgement SELECT * FROM part.judgement")
        whole.execute("INSERT OR IGNORE INTO trace SELECT * FROM part.trace")
        whole.execute(
            "INSERT INTO session (began, workers, machine) SELECT began, workers, machine FROM part.session"
        )
