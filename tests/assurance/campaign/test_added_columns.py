"""A package adds a column to ledgers, and a section to the page of the evidence."""

from __future__ import annotations

import csv
import json
import sqlite3
from pathlib import Path

import pytest
from toy_package import called, install

from safety_harness.extensions.assurance.campaign.ledger import Ledger
from tests.assurance.campaign.plans import PLAN, ledger_in, plan_in

FEW = (
    PLAN.replace("runs: 30", "runs: 2")
    .replace("runs: 20", "runs: 1")
    .replace("    violated in at most: 50 %\n", "")
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plan that was certified with the toy installed."""
    folder = install(tmp_path_factory.mktemp("toy"))
    plan_in(folder, FEW)
    done = called(folder, "certify", "plan.yaml", "--out", "out", "--workers", "1")
    assert done.returncode in (0, 1), done.stderr
    return folder


def asked(folder: Path, question: str) -> list[dict[str, object]]:
    done = called(folder, "campaign", "query", "out/ledger.sqlite", question, "--json")
    assert done.returncode == 0, done.stderr
    rows: list[dict[str, object]] = json.loads(done.stdout)["result"]["rows"]
    return rows


def test_the_toys_column_is_in_the_ledger_and_one_that_fails_is_empty(folder: Path) -> None:
    rows = asked(folder, "SELECT toy_height, toy_broken, seed FROM episodes")
    assert len(rows) == 3
    heights, broken, seeds = zip(
        *(row.values() if isinstance(row, dict) else row for row in rows), strict=True
    )
    assert all(0.0 < float(one) < 2.0 for one in heights)
    assert {*broken} == {None}
    assert all(isinstance(one, int) for one in seeds)  # whose name is not taken
    assert len({*heights}) == 3


def test_the_toys_column_is_exported(folder: Path) -> None:
    done = called(folder, "campaign", "export", "out/ledger.sqlite", "out.csv")
    assert done.returncode == 0, done.stderr
    with (folder / "out.csv").open(newline="") as file:
        (*_, row) = csv.DictReader(file)
    assert 0.0 < float(row["toy_height"]) < 2.0
    assert row["toy_broken"] == ""


def test_the_toys_section_is_in_the_evidence_which_verify_makes_anew(folder: Path) -> None:
    page = (folder / "out" / "evidence.html").read_text()
    assert '<h2 id="added-0">Toy &lt;wheels&gt;</h2>' in page
    assert "entry point safety_harness.page_sections evidence of toy 1.0" in page
    assert called(folder, "verify", "out").returncode == 0


def test_columns_are_read_where_the_package_is_not_installed(folder: Path) -> None:
    with Ledger.open(folder / "out" / "ledger.sqlite", alone=True) as ledger:
        ((known, all_),) = ledger.all("SELECT count(toy_height), count(*) FROM episodes")
        assert (known, all_) == (3, 3)


def test_a_ledger_without_added_columns_has_no_table_of_them(tmp_path: Path) -> None:
    with ledger_in(tmp_path, plan_in(tmp_path, FEW)) as ledger:
        assert not [*ledger.all("SELECT 1 FROM sqlite_master WHERE name = 'added'")]


def test_a_strangers_column_is_no_sql(folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "ledger.sqlite"
    copy.write_bytes((folder / "out" / "ledger.sqlite").read_bytes())
    with sqlite3.connect(copy) as connection:
        for name in ("x' OR '1", "seed", "Upper"):
            connection.execute("INSERT INTO added VALUES (?, 0, 0, 1.0)", (name,))
    connection.close()
    with Ledger.open(copy) as ledger:
        names = [row[1] for row in ledger.all("PRAGMA temp.table_info(episodes)")]
    assert names[-2:] == ["toy_broken", "toy_height"]
    assert names.count("seed") == 1
