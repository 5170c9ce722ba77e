"""The ledger: one row an episode, whole batches, and every way in which a file can be no ledger."""

from __future__ import annotations

import json
import math
import os
import sqlite3
import subprocess
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from safety_harness.admission.repeatability import DrivenAgain, RepeatabilityResult
from safety_harness.base.exceptions import LedgerError, OutputError, StatisticsError
from safety_harness.extensions.assurance.campaign import opening
from safety_harness.extensions.assurance.campaign.episodes import failed_row
from safety_harness.extensions.assurance.campaign.identity import Identity
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.opening import only_runner
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.campaign.rows import ClaimJudgement, Row
from safety_harness.extensions.assurance.campaign.summary import fingerprint_of, tally_of
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome
from tests.assurance.campaign.plans import ledger_in, plan_in


@pytest.fixture
def plan(tmp_path: Path) -> Plan:
    return plan_in(tmp_path)


def row(episode: int, stratum: int = 0, *, margin: float = 0.1, trace: bytes | None = None) -> Row:
    outcome = EpisodeOutcome.VIOLATED if margin < 0.0 else EpisodeOutcome.HOLDS
    judgements = (ClaimJudgement(outcome, margin, 0.2, 3), ClaimJudgement(EpisodeOutcome.UNTESTED))
    return Row(
        stratum=stratum,
        episode=episode,
        seed=11 + episode,
        judgements=judgements,
        draws=1,
        cell="a",
        trace=trace,
    )


def filled(tmp_path: Path, plan: Plan) -> Path:
    with ledger_in(tmp_path, plan) as ledger:
        ledger.record(row(k) for k in range(30))
        return ledger.path


def test_what_is_recorded_is_there_again_to_the_last_bit(tmp_path: Path, plan: Plan) -> None:
    margin = 0.1 + 2**-50
    with ledger_in(tmp_path, plan) as ledger:
        ledger.record([row(0, margin=margin, trace=b"abc"), row(2, margin=-1.0), row(0, 1)])
    with Ledger.open(tmp_path / "ledger.sqlite") as ledger:
        episodes, outcomes, margins = ledger.outcomes(0, 0)
        assert episodes.tolist() == [0, 2]
        assert outcomes.tolist() == [EpisodeOutcome.HOLDS, EpisodeOutcome.VIOLATED]
        assert margins.tolist() == [margin, -1.0]
        assert all(map(math.isnan, ledger.outcomes(0, 1)[2]))
        assert ledger.trace(0, 0) == b"abc"
        assert ledger.trace(0, 2) is None
        assert ledger.declared.claims == tuple(claim.sentence for claim in plan.claims)
        assert ledger.files == plan.files
        assert list(ledger.missing(0)) == [range(1, 2), range(3, 30)]
        assert list(ledger.missing(1)) == [range(1, 20)]


def test_an_episode_is_there_once_and_a_batch_whole_or_not_at_all(tmp_path: Path, plan: Plan) -> None:
    with ledger_in(tmp_path, plan) as ledger:
        ledger.record([row(1)])
        with pytest.raises(LedgerError, match="UNIQUE"):
            ledger.record([row(0), row(1)])
        assert ledger.outcomes(0, 0)[0].tolist() == [1]


def test_others_read_while_one_writes(tmp_path: Path, plan: Plan) -> None:
    with ledger_in(tmp_path, plan) as writer, Ledger.open(writer.path) as reader:
        writer.record([row(0)])
        with writer.transaction():
            writer.connection.execute("DELETE FROM judgement")
            assert tally_of(reader).done == 1
            assert len(reader.outcomes(0, 0)[0]) == 1


def test_the_tally_counts_outcomes_and_finds_the_worst_margin(tmp_path: Path, plan: Plan) -> None:
    with ledger_in(tmp_path, plan) as ledger:
        ledger.record([row(0), row(1, margin=-0.5), row(2, margin=-0.2), failed_row(plan, 0, 3, "why")])
        tally = tally_of(ledger)
        one = tally.of_claim(0)
        assert one.counts[EpisodeOutcome.VIOLATED] == 2
        assert one.counts[EpisodeOutcome.FAILED] == 1
        assert (one.worst, one.worst_episode) == (-0.5, 1)
        assert (tally.strata[0].failed, tally.done, tally.planned) == (1, 4, 50)
        by_hand = tally_of(ledger)
        by_hand.strata[0].add(row(4, margin=-0.9))
        ledger.record([row(4, margin=-0.9)])
        assert tally_of(ledger) == by_hand


def test_of_equal_margins_the_first_episode_is_the_worst_whatever_its_outcome(
    tmp_path: Path, plan: Plan
) -> None:
    with ledger_in(tmp_path, plan) as ledger:
        ledger.record([row(3, margin=0.0), row(2, margin=0.0), row(1, margin=np.nan), row(4, margin=0.5)])
        found = tally_of(ledger).of_claim(0)
        assert (found.worst, found.worst_episode) == (0.0, 2)


def test_an_outcome_that_there_is_not_is_not_left_out_of_the_counts(tmp_path: Path, plan: Plan) -> None:
    with ledger_in(tmp_path, plan) as ledger:
        ledger.record([row(0), row(1)])
        with ledger.transaction():
            ledger.connection.execute("UPDATE judgement SET outcome = 7 WHERE episode = 1")
        with pytest.raises(LedgerError, match="outcomes from 0 to 4"):
            tally_of(ledger)


def test_a_sample_is_the_whole_stream_or_none(tmp_path: Path, plan: Plan) -> None:
    with ledger_in(tmp_path, plan) as ledger:
        ledger.record(row(k) for k in range(29))
        with pytest.raises(StatisticsError, match="incomplete"):
            ledger.sample("near", plan.claims[0].sentence)
        ledger.record([row(29, margin=-0.1)])
        sample = ledger.sample("near", plan.claims[0].sentence)
        assert (sample.trials, sample.violations) == (30, 1)
        assert sample.declaration.plan_sha256 == plan.identity.sha256
        assert sample.declaration.model_only
        with pytest.raises(KeyError, match="is not in"):
            ledger.sample("far", plan.claims[0].sentence)


def test_what_was_asked_again_is_kept_of_all_sessions_and_one_difference_is_not_forgotten(
    tmp_path: Path, plan: Plan
) -> None:
    with ledger_in(tmp_path, plan) as ledger:
        ledger.record(row(k) for k in range(30))
        claim = plan.claims[0].sentence
        ledger.note_repeated(RepeatabilityResult(questions=20, asked=9, apart=True))
        assert ledger.repeated == RepeatabilityResult(questions=20, asked=9, apart=True)
        assert ledger.sample("near", claim).trials == 30
        ledger.note_repeated(RepeatabilityResult(questions=5, asked=5, words="it could not be asked"))
        assert (ledger.repeated.line, ledger.dependent) == ("it could not be asked", "")
        ledger.note_repeated(RepeatabilityResult(questions=5, asked=5, differing=2, words="it remembers"))
        ledger.note_repeated(RepeatabilityResult(questions=70, asked=61))
        assert ledger.repeated.line == "it remembers; 2 of 80 answers differ"
        with pytest.raises(StatisticsError, match=r"no bound is stated .it remembers; 2 of 80"):
            ledger.sample("near", claim)


@pytest.mark.parametrize("beside", [(), ("predictor",), ("safety filter", "predictor")])
def test_the_parts_that_drove_again_are_kept(beside: tuple[str, ...], tmp_path: Path, plan: Plan) -> None:
    result = DrivenAgain(questions=4, asked=2, of_avoider=True, beside=beside)
    with ledger_in(tmp_path, plan) as ledger:
        ledger.note_repeated(result)
        assert ledger.repeated == result
        assert f"by a fresh {' and '.join(('avoider', *beside))}: " in ledger.repeated.line


def test_the_ledger_of_a_program_that_never_asked_again_is_still_read(tmp_path: Path, plan: Plan) -> None:
    with ledger_in(tmp_path, plan) as ledger:
        ledger.record([row(0)])
        ledger.connection.execute("DROP TABLE repeated")
    with Ledger.open(ledger.path, alone=True) as old:
        assert old.repeated == RepeatabilityResult(questions=0)
        assert not old.dependent


def test_the_fingerprint_is_that_of_the_results_and_of_nothing_else(tmp_path: Path, plan: Plan) -> None:
    def of(name: str, rows: list[Row]) -> str:
        with ledger_in(tmp_path / name, plan) as ledger:
            for one in rows:
                ledger.record([one])
            return fingerprint_of(ledger)

    rows = [row(k, margin=0.1 * k) for k in range(4)]
    same = of("a", rows)
    assert same == of("b", [replace(one, seconds=9.0, worker="other") for one in reversed(rows)])
    last = replace(
        rows[3], judgements=(ClaimJudgement(EpisodeOutcome.HOLDS, math.nextafter(0.3, 1.0), 0.2, 3),) * 2
    )
    assert same != of("c", [*rows[:3], last])
    assert same != of("d", rows[:3])


def test_a_change_since_is_named(tmp_path: Path, plan: Plan) -> None:
    with ledger_in(tmp_path, plan) as ledger:
        ledger.refuse_other(plan.identity)
        parts = plan.identity.parts
        other = Identity(tuple((name, "x" if name == "Python" else value) for name, value in parts))
        with pytest.raises(LedgerError, match="Python changed"):
            ledger.refuse_other(other)


def test_a_ledger_is_not_overwritten(tmp_path: Path, plan: Plan) -> None:
    path = filled(tmp_path, plan)
    with pytest.raises(LedgerError, match="a path without a file"):
        Ledger.create(path, plan)


@pytest.mark.parametrize("keep", [0, 50, 100, 5000, 20_000, -1])
def test_a_truncated_ledger_is_refused(tmp_path: Path, plan: Plan, keep: int) -> None:
    path = filled(tmp_path, plan)
    data = path.read_bytes()
    assert len(data) > 20_000
    path.write_bytes(data[:keep])
    with pytest.raises(LedgerError):
        Ledger.open(path)


def test_damage_within_is_found(tmp_path: Path, plan: Plan) -> None:
    path = filled(tmp_path, plan)
    data = bytearray(path.read_bytes())
    data[-4096 * 3 : -4096] = b"\xff" * 4096 * 2
    path.write_bytes(data)
    with pytest.raises(LedgerError, match=r"damage|malformed|whole"):
        Ledger.open(path)


def test_what_is_no_ledger_is_refused(tmp_path: Path, plan: Plan) -> None:
    other = tmp_path / "other.sqlite"
    connection = sqlite3.connect(other)
    connection.execute("CREATE TABLE t (a)")
    connection.close()
    text = tmp_path / "text.sqlite"
    text.write_text("no ledger " * 100)
    newer = filled(tmp_path, plan)
    older = tmp_path / "older.sqlite"
    older.write_bytes(newer.read_bytes())
    for path, version in ((newer, opening.VERSION + 1), (older, opening.VERSION - 1)):
        with closing(sqlite3.connect(path)) as connection:
            connection.execute(f"PRAGMA user_version = {version}")
    for path, words in (
        (other, "another SQLite database"),
        (text, "another file"),
        (tmp_path / "none", "no such file"),
        (tmp_path, "a folder"),
        (newer, f"version {opening.VERSION + 1}, of a newer program"),
        (older, f"version {opening.VERSION - 1}, of an older program"),
    ):
        with pytest.raises(LedgerError, match=words):
            Ledger.open(path)


def test_a_damaged_schema_is_refused_though_its_message_cannot_be_read(tmp_path: Path, plan: Plan) -> None:
    path = filled(tmp_path, plan)
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA journal_mode = DELETE")
    data = path.read_bytes().replace(b"viewepisodes", b"view\xa0pisodes")
    path.write_bytes(data.replace(b"CREATE VIEW episodes", b"CRXATE VIEW episodes"))
    with pytest.raises(LedgerError, match="not UTF-8"):
        Ledger.open(path)


def test_only_one_runner_works_on_a_ledger(tmp_path: Path) -> None:
    path = tmp_path / "ledger.sqlite"
    code = (
        "import sys; from pathlib import Path\n"
        "from safety_harness.extensions.assurance.campaign.opening import only_runner\n"
        "with only_runner(Path(sys.argv[1])): print('locked', flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "locked\n"
        with pytest.raises(LedgerError, match=f"the process {other.pid}"), only_runner(path):
            pass
        other.kill()
        other.wait()
        with only_runner(path):  # the lock of a dead process is none
            pass


def test_a_ledger_that_another_program_keeps_locked_is_said_to_be(
    tmp_path: Path, plan: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("safety_harness.extensions.assurance.campaign.opening.BUSY_MS", 50)
    with ledger_in(tmp_path, plan) as ledger:
        other = sqlite3.connect(ledger.path, isolation_level=None)
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(LedgerError, match="locked"):
            ledger.record([row(0)])
        other.execute("ROLLBACK")
        other.close()
        ledger.record([row(0)])


def test_a_full_disk_keeps_what_was_committed(tmp_path: Path, plan: Plan) -> None:
    """In a process of its own, whose files may not grow beyond a limit."""
    ledger_in(tmp_path, plan).close()
    path = tmp_path / "ledger.sqlite"
    code = (
        "import resource, sys\nfrom pathlib import Path\n"
        "from safety_harness.extensions.assurance.campaign.ledger import Ledger\n"
        "from safety_harness.base.exceptions import OutputError\n"
        "from tests.assurance.campaign.test_ledger import row\n"
        "ledger = Ledger.open(Path(sys.argv[1]), write=True)\n"
        "ledger.record([row(0)])\n"
        "size = 200_000\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))\n"
        "try:\n"
        "    for k in range(1, 30): ledger.record([row(k, trace=bytes(40_000))])\n"
        "except OutputError as error: print('full', error.got)\n"
    )
    shown = subprocess.run(
        [sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True, cwd=os.getcwd()
    )
    assert shown.stdout.startswith("full")
    with Ledger.open(path, write=True) as ledger:
        done = ledger.outcomes(0, 0)[0].tolist()
        assert done == list(range(len(done)))
        assert 1 <= len(done) < 29
        assert all(ledger.trace(0, k) == bytes(40_000) for k in done[1:])
        ledger.record(row(k) for k in range(len(done), 30))
        assert not list(ledger.missing(0))


def test_a_folder_that_cannot_be_made_is_an_output_error(tmp_path: Path, plan: Plan) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError):
        Ledger.create(tmp_path / "file" / "ledger.sqlite", plan)


def test_no_part_of_an_identity_is_named_twice() -> None:
    """Of two the later one would count, and whoever reads the text might look at the other."""
    twice = json.dumps([["Python", "3.11"], ["Python", "3.10"]])
    with pytest.raises(ValueError, match="occurs twice"):
        Identity.from_json(twice)


def test_nothing_is_left_beside_a_ledger_that_was_run_and_read(tmp_path: Path, plan: Plan) -> None:
    with ledger_in(tmp_path, plan) as made:
        path = made.path
    with only_runner(path), Ledger.open(path, write=True):
        assert path.with_name(f"{path.name}.lock").exists()
    with Ledger.open(path) as first:
        with Ledger.open(path):
            assert path.with_name(f"{path.name}-wal").exists()
        assert path.with_name(f"{path.name}-wal").exists()  # the first still reads
        assert first.declared
    assert [file.name for file in tmp_path.glob(f"{path.name}?*")] == []


def test_a_refused_campaign_leaves_no_folder_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "made" / "ledger.sqlite"
    with pytest.raises(ValueError, match="refused"), only_runner(path):
        raise ValueError("refused")
    assert list(tmp_path.iterdir()) == []
    path.parent.mkdir()  # this folder is the user's
    with pytest.raises(ValueError, match="refused"), only_runner(path):
        raise ValueError("refused")
    assert list(tmp_path.iterdir()) == [path.parent]
    assert list(path.parent.iterdir()) == []


def test_a_runner_whose_lock_was_just_removed_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "ledger.sqlite"
    lock = path.with_name(f"{path.name}.lock")
    flock = opening.fcntl.flock

    def removed_meanwhile(stream: object, operation: int) -> None:
        flock(stream, operation)  # type: ignore[arg-type]
        lock.unlink()

    monkeypatch.setattr(opening.fcntl, "flock", removed_meanwhile)
    with pytest.raises(LedgerError, match="without another runner"), only_runner(path):
        pass
