"""The root over a ledger's rows: RFC 6962's own tree, and every row in it."""

from __future__ import annotations

import hashlib
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from safety_harness.extensions.assurance.campaign.episodes import EpisodeRunner
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.merging import merge
from safety_harness.extensions.assurance.campaign.summary import fingerprint_of, merkle_root, root_of
from tests.assurance.campaign.plans import PLAN, ledger_in, plan_in

SMALL = PLAN.replace("runs: 30", "runs: 5").replace("runs: 20", "runs: 2")

# The leaves and roots of Certificate Transparency's reference tests (merkle_tree_test.cc), sizes 1 to 8.
LEAVES = [
    bytes.fromhex(text)
    for text in (
        "",
        "00",
        "10",
        "2021",
        "3031",
        "40414243",
        "5051525354555657",
        "606162636465666768696a6b6c6d6e6f",
    )
]
ROOTS = {
    0: "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855",
    1: "6e340b9cffb37a989ca544e6bb780a2c78901d3fb33738768511a30617afa01d",
    2: "fac54203e7cc696cf0dfcb42c92a1d9dbaf70ad9e621f4bd8d98662f00e3c125",
    3: "aeb6bcfe274b70a14fb067a5e5578264db0fa9b51af5e0ba159158f329e06e77",
    7: "ddb89be403809e325750d3d263cd78929c2942b7942a34b77e122c9594a74c8c",
    8: "5dc9da79a70659a9ad559cb701ded9a2ab9d823aad2f4960cfe370eff4604328",
}


@pytest.mark.parametrize(("size", "root"), ROOTS.items())
def test_the_tree_is_that_of_certificate_transparency(size: int, root: str) -> None:
    assert merkle_root(LEAVES[:size]).hex() == root


def by_definition(leaves: list[bytes]) -> bytes:
    """RFC 6962, 2.1, word for word."""
    if not leaves:
        return hashlib.sha256(b"").digest()
    if len(leaves) == 1:
        return hashlib.sha256(b"\0" + leaves[0]).digest()
    k = 1 << ((len(leaves) - 1).bit_length() - 1)
    return hashlib.sha256(b"\1" + by_definition(leaves[:k]) + by_definition(leaves[k:])).digest()


def test_the_tree_is_the_recursion_of_the_standard_for_any_number_of_leaves() -> None:
    for size in range(70):
        leaves = [bytes([k, size]) for k in range(size)]
        assert merkle_root(leaves) == by_definition(leaves)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rows")
    plan = plan_in(folder, SMALL)
    with ledger_in(folder, plan) as ledger:
        for stratum, one in enumerate(plan.strata):
            ledger.record(EpisodeRunner(plan).run(stratum, range(one.runs)))
        return ledger.path


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE judgement SET outcome = 1 - outcome WHERE claim = 0 AND stratum = 0 AND episode = 4",
        "UPDATE judgement SET margin = margin + 1e-12 WHERE claim = 1 AND stratum = 1 AND episode = 1",
        "UPDATE judgement SET worst_time_s = NULL WHERE claim = 1 AND episode = 0",
        "UPDATE episode SET seed = seed + 1 WHERE episode = 1",
        "UPDATE episode SET mishap = 'it hung' WHERE episode = 1",
        "UPDATE episode SET cell = NULL WHERE episode = 0",
        "UPDATE episode SET overruled_uncertain = 1 WHERE episode = 0",
        "UPDATE trace SET data = x'00'",
        "DELETE FROM trace WHERE stratum = 0",
    ],
)
def test_every_row_is_in_the_root(made: Path, tmp_path: Path, statement: str) -> None:
    other = tmp_path / made.name
    other.write_bytes(made.read_bytes())
    with closing(sqlite3.connect(other)) as connection, connection:
        assert connection.execute(statement).rowcount
    with Ledger.open(made) as before, Ledger.open(other) as after:
        assert root_of(before) != root_of(after)
        assert fingerprint_of(before) != fingerprint_of(after) or "data" in statement


def test_who_ran_it_and_how_long_is_in_neither_root_nor_fingerprint_and_merging_keeps_both(
    made: Path, tmp_path: Path
) -> None:
    with Ledger.open(made) as whole:
        root, fingerprint = root_of(whole), fingerprint_of(whole)
    parts = [tmp_path / f"{k}.sqlite" for k in range(2)]
    for k, part in enumerate(parts):
        part.write_bytes(made.read_bytes())
        with closing(sqlite3.connect(part)) as connection, connection:
            for table in ("trace", "judgement", "episode"):
                connection.execute(f"DELETE FROM {table} WHERE episode % 2 = {k}")
            connection.execute("UPDATE episode SET seconds = 9.0, worker = 'elsewhere'")
    merge(tmp_path / "merged.sqlite", parts)
    with Ledger.open(tmp_path / "merged.sqlite") as merged:
        assert (root_of(merged), fingerprint_of(merged)) == (root, fingerprint)
