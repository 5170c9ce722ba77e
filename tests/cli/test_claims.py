"""``safety-harness claims`` lists and explains the catalogue, and docs/reference/claims.md says the same."""

from __future__ import annotations

from pathlib import Path

import pytest

from safety_harness.claims.properties.base import Unit
from safety_harness.claims.properties.catalogue import CATALOGUE
from safety_harness.claims.properties.entry import entry_fields
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT
from safety_harness.cli.scenario_commands import claims as explain_claims

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "reference" / "claims.md").read_text()


def test_without_words_every_claim_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert explain_claims([]) == AS_EXPECTED
    assert capsys.readouterr().out.splitlines() == [entry.example for entry in CATALOGUE]


@pytest.mark.parametrize("entry", CATALOGUE, ids=lambda entry: entry.example)
def test_a_claim_is_explained_whole(entry: object, capsys: pytest.CaptureFixture[str]) -> None:
    found = next(one for one in CATALOGUE if one is entry)
    assert explain_claims(found.example.upper().split()) == AS_EXPECTED
    out = " ".join(capsys.readouterr().out.split())
    for name, text in entry_fields(found):
        assert f"{name} {' '.join(text.split())}" in out


def test_a_limit_of_ones_own_is_understood(capsys: pytest.CaptureFixture[str]) -> None:
    assert explain_claims(["hand distance never below 7 cm"]) == AS_EXPECTED
    assert capsys.readouterr().out.startswith("hand distance never below 50 mm\n")


def test_some_words_explain_every_claim_that_has_them_all(capsys: pytest.CaptureFixture[str]) -> None:
    assert explain_claims(["gain", "switch"]) == AS_EXPECTED
    out = capsys.readouterr().out
    heads = [line for line in out.splitlines() if line and not line.startswith(" ")]
    assert heads == [e.example for e in CATALOGUE if e.example.startswith("gain switch")]
    assert len(heads) == 3


def test_words_of_no_claim_are_bad_input_with_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    assert explain_claims(["hand distance always below 50 mm"]) == BAD_INPUT
    err = capsys.readouterr().err
    assert 'did you mean "hand distance never below 50 mm"' in err


def test_every_unit_has_its_word() -> None:
    assert {unit for unit in Unit if not unit.symbol} == {Unit.COUNT}  # "a number"


def test_the_page_says_of_every_claim_what_its_entry_says() -> None:
    for entry in CATALOGUE:
        section = PAGE.split(f"### {entry.example}\n", 1)[1].split("\n#", 1)[0]
        for name, text in entry_fields(entry):
            assert f"- *{name}*: {text}\n" in section + "\n"
