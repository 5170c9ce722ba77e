"""Forgeries by somebody who did not build ``verify``: each is a fault, open, or what the page discloses.

The forger makes every hash anew with this package's own code, on the same machine; all runs are repeated.
"""

from __future__ import annotations

import json
import os
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from once import replayed_once  # noqa: F401

from safety_harness.base.exceptions import InputError
from safety_harness.extensions.assurance.campaign.episodes import trace_bytes, trace_of
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.session import LEDGER, plan_of
from safety_harness.extensions.assurance.certification import whose_fault
from safety_harness.extensions.assurance.certification.folder import MANIFEST, stored_files, write_manifest
from safety_harness.extensions.assurance.certification.lodged import declaration_of
from safety_harness.extensions.assurance.certification.verify import verify
from safety_harness.extensions.assurance.certification.verify_report import differences, verdicts_in
from safety_harness.trace.trace import Trace
from tests.assurance.certification.forging import (
    SEARCHED,
    Touch,
    hashed_anew,
    in_ledger,
    other_software,
    report_in,
    said,
    write,
    written,
)

PAGE, FOUND = "evidence.html", f"{SEARCHED}/findings.json"
RUN = "WHERE stratum = 0 AND episode = 5"


@pytest.fixture(scope="module", autouse=True)
def no_causes(replayed_once: None) -> Iterator[None]:  # noqa: F811
    """The causes of violations are no row; ``test_verify.py`` alters them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(whose_fault, "attribute", lambda *_: ())
        yield


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    report = report_in(tmp_path_factory.mktemp("further"))
    for beside in ("-wal", "-shm"):
        report.joinpath(LEDGER + beside).unlink(missing_ok=True)
    return report


@pytest.fixture
def report(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "report"))


def judgement(change: str, claim: int = 1) -> Touch:
    return in_ledger(f"UPDATE judgement SET {change} {RUN} AND claim = {claim}")


def episode(change: str) -> Touch:
    return in_ledger(f"UPDATE episode SET {change} {RUN}")


def put(name: str, data: bytes = b"All is well.") -> Touch:
    """Another file in the folder."""

    def touch(report: Path) -> None:
        (report / name).parent.mkdir(exist_ok=True)
        (report / name).write_bytes(data)
        hashed_anew(report)

    return touch


def traced(change: Callable[[Trace], Trace]) -> Touch:
    """Another stored trace of the first run."""

    def touch(report: Path) -> None:
        with Ledger.open(report / LEDGER) as ledger, plan_of(ledger) as plan:
            data = trace_bytes(change(trace_of(plan, 0, ledger.trace(0, 0) or b"")))
        with closing(sqlite3.connect(report / LEDGER)) as connection, connection:
            connection.execute("UPDATE trace SET data = ? WHERE stratum = 0 AND episode = 0", (data,))
        write(report)

    return touch


def made_by(**other: Any) -> Touch:
    return traced(lambda trace: replace(trace, provenance=replace(trace.provenance, **other)))


def searched(**other: Any) -> Touch:
    """Other findings of the search, and the whole report made of them."""

    def touch(report: Path) -> None:
        findings = json.loads((report / FOUND).read_text()) | other
        (report / FOUND).write_text(json.dumps(findings))
        write(report)

    return touch


def text_of(name: str, change: Callable[[str], str]) -> Touch:
    """A file that is made of nothing else, edited."""

    def touch(report: Path) -> None:
        (report / name).write_text(change((report / name).read_text()))
        if name != MANIFEST:
            write_manifest(report, stored_files(report))

    return touch


def exchanged(report: Path) -> None:
    """The traces of two counterexamples, each under the other's name."""
    one, other = sorted((report / "counterexamples").glob("*.trace"))
    first, second = one.read_bytes(), other.read_bytes()
    one.write_bytes(second)
    other.write_bytes(first)
    hashed_anew(report)


def schema(name: str, before: str, after: str) -> Touch:
    """Another text in the schema, which SQLite then takes for what a table or view is."""
    update = f"UPDATE sqlite_master SET sql = replace(sql, '{before}', '{after}') WHERE name = '{name}'"
    return in_ledger("PRAGMA writable_schema = ON", update)


def twice(report: Path) -> None:
    """The interpreter as a first part of the identity, before the one that was noted."""
    with closing(sqlite3.connect(report / LEDGER)) as connection, connection:
        connection.execute(
            "UPDATE about SET value = '[[\"Python\", \"2.7\"], ' || substr(value, 2) WHERE key = 'identity'"
        )
    hashed_anew(report)


def linked(report: Path) -> None:
    (report / "certificate").symlink_to("/tmp")
    hashed_anew(report)


def piped(report: Path) -> None:
    os.mkfifo(report / "certificate")
    hashed_anew(report)


def both(first: Touch, part: str) -> Touch:
    """And the report names other software."""

    def touch(report: Path) -> None:
        first(report)
        other_software(report, part)

    return touch


SOURCE, NUMPY = "the source of this package", "the library numpy"
SWAPPED = "UPDATE judgement SET {0} = {0} + 9", "UPDATE judgement SET {0} = 10 - {0}"
PAGES = "evidence.html and evidence.json disagree"
BADGES = "its verdicts do not follow"
TABLES = "expected a ledger's own tables"

ROWS: dict[str, tuple[Touch, str]] = {
    "another number of a run": (episode("run = run + 1"), "the ledger has"),
    "one number for two runs": (
        in_ledger("UPDATE episode SET run = 7 WHERE stratum = 0 AND episode IN (3, 4)"),
        "the ledger has 7 for",
    ),
    "no number of any run": (in_ledger("UPDATE episode SET run = 0"), "the ledger has no number for"),
    "a negative number of a run": (episode("run = -5"), "impossible counts"),
    "an audited file that was opened": (
        in_ledger(f"INSERT INTO opened VALUES ('audited-by-a-test-house.pdf', '{'a' * 64}')"),
        "its plan has no module",
    ),
    "two claims swapped": (in_ledger(*(one.format("claim") for one in SWAPPED)), "holds then, violated now"),
    "two strata swapped": (
        in_ledger(
            *(f"{one} WHERE episode < 6".format("stratum") for one in SWAPPED),
        ),
        "a margin of",
    ),
    "the outcomes of two runs swapped": (
        in_ledger(
            "UPDATE judgement SET episode = episode + 90 WHERE stratum = 1 AND episode IN (1, 2)",
            "UPDATE judgement SET episode = 93 - episode WHERE stratum = 1 AND episode IN (91, 92)",
        ),
        "nearer, run 1, hand distance never below 150 mm",
    ),
    "every cell of the coverage": (in_ledger("UPDATE episode SET cell = 6"), "cell or mishap differ"),
    "an infinite margin": (judgement("margin = 9e999"), "a margin of +inf"),
    "a margin of minus infinity": (judgement("margin = -9e999"), "then, +105.3"),
    "no margin": (judgement("margin = NULL"), "then, +105.3"),
    "a margin as large as a number can be": (judgement("margin = 1e308"), "then, +105.3"),
    "fewer occasions than none": (judgement("exercised = -3"), "occasions or worst moment"),
    "fewer draws than none": (episode("draws = -1"), "impossible counts"),
    "more decisions than there can be": (episode("decisions = 9223372036854775807"), "integer overflow"),
    "a proposal that was never overruled": (
        episode("overruled_replaced = overruled_replaced + 1, proposals = proposals + 1, opposite = 1"),
        "cell or mishap differ",
    ),
    "another reason of the gate": (episode("overruled_table = 1 - overruled_table"), "cell or mishap"),
    "a violation that was no run": (
        in_ledger(
            f"UPDATE judgement SET outcome = 4, margin = NULL {RUN}",
            f"UPDATE episode SET failure = 'x' {RUN}",
        ),
        "failed then, violated now",
    ),
    "a violation that was no test": (judgement("outcome = 2", claim=0), "untested then, violated now"),
    "a failure beside a verdict": (episode("failure = 'the engine broke'"), "cell or mishap differ"),
    "an end before the last violations": (
        in_ledger(
            "UPDATE stratum SET stopped_after = 4 WHERE id = 1",
            "DELETE FROM episode WHERE stratum = 1 AND episode > 3",
            "DELETE FROM judgement WHERE stratum = 1 AND episode > 3",
        ),
        "stopped after 4 runs",
    ),
    "a trigger": (
        in_ledger("CREATE TRIGGER t AFTER UPDATE ON episode BEGIN DELETE FROM judgement; END"),
        TABLES,
    ),
    "a computed column": (in_ledger("ALTER TABLE claim ADD COLUMN verdict AS ('shown')"), TABLES),
    "a view in a table's place": (
        in_ledger("ALTER TABLE cell RENAME TO other", "CREATE VIEW cell AS SELECT * FROM other"),
        TABLES,
    ),
    "an index of an expression": (in_ledger("CREATE INDEX z ON judgement (abs(margin))"), TABLES),
    "SQLite's own statistics": (in_ledger("ANALYZE"), TABLES),
    "another type, by the schema itself": (
        schema("judgement", "exercised INTEGER", "exercised TEXT"),
        TABLES,
    ),
    "a default, by the schema itself": (
        schema("judgement", "margin REAL", "margin REAL DEFAULT 1.0"),
        TABLES,
    ),
    "a collation, by the schema itself": (
        schema("judgement", "margin REAL", "margin REAL COLLATE NOCASE"),
        TABLES,
    ),
    "a check, by the schema itself": (
        schema("judgement", "exercised INTEGER NOT NULL", "exercised INTEGER NOT NULL CHECK (exercised > 1)"),
        TABLES,
    ),
    "a conflict clause, by the schema itself": (
        schema("stratum", "name TEXT NOT NULL UNIQUE", "name TEXT NOT NULL UNIQUE ON CONFLICT IGNORE"),
        TABLES,
    ),
    "a view, by the schema itself": (
        schema("results", "THEN ''violated''", "THEN ''holds''"),
        TABLES,
    ),
    "a part of the identity twice": (twice, "a part occurs twice"),
    "a trace of another system": (
        traced(lambda trace: replace(trace, system=Trace.system)),
        "another system under test",
    ),
    "a trace that ended otherwise": (
        traced(lambda trace: replace(trace, ended="stopped by its guard")),
        "failed now",
    ),
}  # fmt: skip

FILES: dict[str, tuple[Touch, str]] = {
    "two counterexamples exchanged": (exchanged, "is not the trace that the ledger keeps"),
    "a link in the folder": (linked, "certificate is a link or a device"),
    "the scenario of a counterexample that was searched for": (
        written(f"{SEARCHED}/one.yaml", r"(?m)^seed: .*$", "seed: 99"),
        "counterexample",
    ),
    "a pipe in the folder": (piped, "certificate is a link or a device"),
    "a log beside the ledger": (put(f"{LEDGER}-wal"), "changes that the ledger lacks"),
    "a plan in capitals": (put("plan/PLAN.yaml", b"plan: x"), "is no file of the ledger's plan"),
    "a field of the evidence that none has": (
        text_of("evidence.json", lambda text: text.replace("{", '{\n "approved": "by a test house",', 1)),
        "approved",
    ),
    "a field of the evidence twice": (
        text_of("evidence.json", lambda text: text.replace("{", '{\n "standing": "shown",', 1)),
        "evidence.json was edited",
    ),
    "a negative count": (said(claims__0__outcomes__0__violated=-4), "outcomes[0].violated"),
    "a failure in an XML comment": (
        written("junit.xml", "(?s)<failure(.*?)/>", r"<!--<failure\1/>-->"),
        "junit.xml and evidence.json disagree",
    ),
    "a suite twice": (
        written("junit.xml", "</testsuites>", '<testsuite name="near" tests="99"/></testsuites>'),
        "junit.xml and evidence.json disagree",
    ),
    "another argument": (written("argument.gsn.yaml", r"\A", "# reviewed\n"), "argument.gsn.yaml and"),
    "a claim as if declared": (said(record__declaration_sha256="f" * 64), "declaration_sha256"),
}  # fmt: skip

BANNER = r'(?s)(<div class="banner .*?</div>)'
TRICKS: dict[str, Touch] = {
    "hidden by a style": written(PAGE, '<div class="banner ', '<div style="display:none" class="banner '),
    "a template around it": written(PAGE, BANNER, r"<template>\1</template>"),
    "a comment around it": written(PAGE, BANNER, r"<!--\1--><p><strong>Shown.</strong></p>"),
    "a letter of no width": written(PAGE, "<strong>Refuted", "<strong>Re\u200bfuted"),
    "letters from right to left": written(PAGE, "<strong>Refuted", "<strong>\u202eRefuted"),
    "two tables": written(PAGE, r'(?s)(<table class="[^"]*verdicts".*?</table>)', r"\1\1"),
    "tags in capitals": written(PAGE, "<strong>Refuted.</strong>", "<STRONG>Shown.</STRONG>"),
    "a letter by its number": written(PAGE, "<strong>Refuted.", "<strong>&#83;hown."),
    "a byte that ends a text": written(PAGE, "<strong>Refuted", "<strong>\0Refuted"),
    "a sheet over the page": written(
        PAGE, "</main>", '</main><p style="position:fixed;inset:0;background:#fff">Shown.</p>'
    ),
    "a bound on top": written(
        PAGE, r'(?s)(<ul class="answers">.*?(?:at most|more than) )\d[\d.]* %', r"\g<1>0.1 %"
    ),
    "no line of a claim on top": written(PAGE, r'(?s)(<ul class="answers">)\s*<li>.*?</li>', r"\1"),
    "a bound among the results": written(PAGE, r'(?s)(id="results.*?)\d+\.\d %', r"\g<1>0.1 %"),
    "another base of all links": written(PAGE, "<head>", '<head><base href="https://example.org/">'),
}


def met(report: Path, words: str, *, kind: str = "faults", runs: int = 16) -> bool:
    """Does any check say so?  No further check is made then."""
    return any(words in one for check in verify(report, runs=runs, seed=1) for one in getattr(check, kind))


@pytest.mark.parametrize(("touch", "words"), ROWS.values(), ids=ROWS.keys())
def test_rows_and_tables_come_out_of_runs(report: Path, touch: Touch, words: str) -> None:
    touch(report)
    assert met(report, words)


@pytest.mark.parametrize(("touch", "words"), FILES.values(), ids=FILES.keys())
def test_files_are_those_of_a_report(report: Path, touch: Touch, words: str) -> None:
    touch(report)
    assert met(report, words, runs=0)


UNRULED = {"a sheet over the page", "a bound among the results", "another base of all links"}


@pytest.mark.parametrize("trick", TRICKS)
def test_a_browsers_tricks_are_other_letters(report: Path, trick: str) -> None:
    """A page is compared to the letter, hidden or not; of any version by its verdicts and what hides them."""
    page = (report / PAGE).read_bytes()
    TRICKS[trick](report)
    now = (report / PAGE).read_bytes()
    assert differences(now, page)
    assert (verdicts_in(now) == verdicts_in(page)) == (trick in UNRULED)


@pytest.mark.parametrize("trick", ["a comment around it", "hidden by a style"])
def test_a_trick_is_a_fault_by_the_version_that_made_the_page(report: Path, trick: str) -> None:
    TRICKS[trick](report)
    assert met(report, PAGES, runs=0)


OTHERS: dict[str, tuple[Touch, str]] = {
    "compiled files": (made_by(files=(("engine.so", "0" * 64),)), "1 stored traces differ from"),
    "a platform": (made_by(platform="a robot cell"), "1 stored traces differ from"),
    "libraries": (made_by(libraries=(("numpy", "99.0"),)), "1 stored traces differ from"),
    "a hidden file": (put(".certificate.html"), ".certificate.html: a hidden file"),
    "a page among the findings": (put(f"{SEARCHED}/well.html"), "well.html: a file that no report has"),
    "a page of the search": (put(f"{SEARCHED}/fuzz.html"), "fuzz.html: verify did not make this file"),
    "a page in capitals": (put("Evidence.html"), "Evidence.html: a file that no report has"),
    "a journal of the ledger": (put(f"{LEDGER}-journal"), "ledger.sqlite-journal: a file that no report has"),
    "whose fault, by another library": (
        both(said(counterexamples__0__lines__1="whose fault: the hand"), NUMPY),
        "counterexamples[0].lines[1]: whose fault: the hand",
    ),
    "the agreement, by another source": (
        both(said(credibility__agreement__verdicts=1), SOURCE),
        "the agreement of the worlds is as the report says",
    ),
    "findings, by another source": (both(said(findings=[]), SOURCE), "findings: 0 of them in the report"),
    "exclusions, by another source": (both(said(exclusions=["none"]), SOURCE), "exclusions"),
    "a separation, by another source": (both(said(separation__0__distance_m=2.0), SOURCE), "separation[0]"),
    "emptied findings": (searched(counterexamples=[], distinct=[]), "its result is as its files say"),
    "what the avoider answered again": (
        in_ledger("UPDATE repeated SET questions = 100000, asked = 100000"),
        "the answers of the avoider to repeated questions",
    ),
    "an approval beside the ledger's facts": (
        in_ledger("INSERT INTO about VALUES ('approved', 'by a test house')"),
        "a lodged seal is missing",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("touch", "words"), OTHERS.values(), ids=OTHERS.keys())
def test_what_cannot_be_decided_is_open_by_name(report: Path, touch: Touch, words: str) -> None:
    touch(report)
    assert met(report, words, kind="unchecked")


@pytest.mark.parametrize("trick", ["a comment around it", "tags in capitals"])
def test_a_trick_is_shown_whatever_made_the_page(report: Path, trick: str) -> None:
    """Where the report names another source: a fault where a verdict is another, else open."""
    both(TRICKS[trick], SOURCE)(report)
    found = list(verify(report, runs=0, seed=1))
    said_of_it = "\n".join(one for check in found for one in (*check.faults, *check.unchecked))
    assert BADGES in said_of_it or "comes from other software, and differs" in said_of_it


@pytest.mark.parametrize("tried", [1_000_000, -7])
def test_a_search_of_impossible_runs_is_an_open_finding(report: Path, tried: int) -> None:
    searched(tried=tried)(report)
    assert "cannot be read: tried: expected 0 to 1 runs" in (report / PAGE).read_text()


def test_another_agreement_by_the_same_source_is_a_fault(report: Path) -> None:
    """Whichever library the report names: the agreement came with the source."""
    both(said(credibility__agreement__verdicts=1), NUMPY)(report)
    assert met(report, "credibility.agreement", runs=0)


def test_violating_runs_that_are_left_out_are_missing_runs(report: Path) -> None:
    """No verdict can be had by it: the page says how many are missing."""
    in_ledger(
        "DELETE FROM episode WHERE stratum = 0 AND episode > 2",
        "DELETE FROM judgement WHERE stratum = 0 AND episode > 2",
    )(report)
    assert write(report).standing.value == "runs missing"


def test_a_manifest_says_nothing_else(report: Path) -> None:
    text_of(MANIFEST, lambda text: text.replace("{", '{"approved": "by a test house",', 1))(report)
    with pytest.raises(InputError, match="format and sha256"):
        next(verify(report, seed=1))


def test_a_declaration_that_was_never_lodged_is_open(report: Path) -> None:
    """Anybody can compute it after the runs; the hash that was lodged is another thing than a seal."""
    with Ledger.open(report / LEDGER) as ledger, plan_of(ledger) as plan:
        sha256 = declaration_of(plan, ledger.declared.identity).sha256
    said(record__declaration_sha256=sha256)(report)
    found = {check.name: check for check in verify(report, runs=0, seed=1, seal=sha256)}
    assert "the seal of this report is" in found["lodged"].faults[0]
    assert "it would prove that plan, seed and targets came first" in found["lodged"].unchecked[0]


def test_the_forgeries_are_at_least_thirty() -> None:
    assert len(ROWS) + len(FILES) + len(OTHERS) + len(TRICKS) >= 60
