"""``judge --claim``: stored traces by a claim of one's own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, DIFFERS
from safety_harness.cli.scenario_commands import judge as judge_again
from safety_harness.trace.store import save_trace
from safety_harness.trace.trace import Trace


@pytest.fixture(scope="module")
def stored(visit: Trace, tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("traces") / "visit.trace"
    save_trace(visit, file)
    return file


def test_a_formula_and_a_sentence_of_the_catalogue_can_both_be_claimed(
    stored: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sentences = ["always hand distance > 50 mm", "joint speeds within limits"]
    assert judge_again([stored], sentences) == AS_EXPECTED
    found = [line for line in capsys.readouterr().out.splitlines() if line.startswith("holds ")]
    assert sorted(sentence for sentence in sentences for line in found if sentence in line) == sentences


@pytest.mark.parametrize("sentence", ["always TCP speed < 100 mm/s", "whenever stopped then servoing"])
def test_a_claim_that_does_not_hold_ends_with_1(
    stored: Path, sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert judge_again([stored], [sentence]) == DIFFERS
    (line,) = [line for line in capsys.readouterr().out.splitlines() if sentence in line]
    assert line.split()[0] in ("VIOLATED", "INCONCLUSIVE")
    assert line.endswith("(expected holds)")


@pytest.mark.parametrize(
    ("sentence", "told"),
    [
        ("always hand distence > 50 mm", '"hand distence" at column 8'),
        ("within 1 min servoing", "which looks 60 s ahead"),
        ("the robot is kind", "the robot is kind"),
        (" ", "nothing"),
        ("x" * 300, "xxx"),
    ],
)
def test_what_cannot_be_claimed_ends_with_2_and_says_where(
    stored: Path, sentence: str, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert judge_again([stored], [sentence]) == BAD_INPUT
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("error: --claim\n")
    assert told in err


def test_a_trace_without_a_claim_is_not_as_expected_but_refused(
    visit: Trace, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "claimless.trace"
    save_trace(replace(visit, scenario=replace(visit.scenario, claims=())), file)
    assert judge_again([file]) == BAD_INPUT
    assert "nothing is judged without" in capsys.readouterr().err
    assert judge_again([file], ["joint speeds within limits"]) == AS_EXPECTED
