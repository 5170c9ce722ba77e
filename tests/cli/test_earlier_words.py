"""Files in the words of earlier releases mean the same as files in today's words."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from safety_harness import Verdict
from safety_harness.admission.claims import property_of
from safety_harness.base.exceptions import Place, ScenarioError
from safety_harness.claims.properties.base import FIELD
from safety_harness.claims.properties.catalogue import CATALOGUE, in_words_of_today
from safety_harness.cli.fmt import format_files
from safety_harness.scenario.model import Claim
from safety_harness.scenario.read import parse_scenario

EARLIER = """\
scenario: a hand reaches  # gives way within 100 ms of a true hand
duration: 12 s
tcp start:
  offset: [40 mm, -120 mm, 60 mm]
hands:
  - hand: right hand
    starts at: [1100 mm, -700 mm, 300 mm]
    elbow towards: [1600 mm, -1200 mm, 300 mm]
    moves:
      - reach for tcp: 2 m/s
        until: 20 mm  # of the skin
        at most: 2 s
      - {reach for object: 1 m/s, until: 90 mm, at most: 1 s}
claims:
  "gives way within 100 ms of a true hand": holds
  never gives way without a hand within 60 cm: holds
  Gives way at most 1 time: holds
  task never starved longer than 10 s: inconclusive
"""
TODAY = (
    EARLIER.replace("        until:", "        stop at distance:")
    .replace("at most: 2 s", "give up after: 2 s")
    .replace("until: 90 mm, at most: 1 s", "stop at distance: 90 mm, give up after: 1 s")
    .replace('"gives way within 100 ms of a true hand"', "starts retreating within 100 ms of a true hand")
    .replace("never gives way without", "never retreats without")
    .replace("Gives way at most 1 time", "retreats at most 1 time")
    .replace("never starved longer than", "pauses at most")
)
CLAIMS = [entry.example for entry in CATALOGUE]


def test_a_file_in_earlier_words_is_the_scenario_in_todays() -> None:
    earlier, today = parse_scenario(EARLIER), parse_scenario(TODAY)
    assert earlier.hands == today.hands
    for old, new in zip(earlier.claims, today.claims, strict=True):
        assert property_of(old, earlier) == property_of(new, today)


def test_fmt_rewrites_earlier_words_only_when_asked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (file := tmp_path / "reach.yaml").write_text(EARLIER)
    assert format_files([file], check=False) == 0
    assert "until: 20 mm" in file.read_text()
    assert format_files([file], check=True, modernise=True) == 1
    assert "until: 20 mm" in file.read_text()
    assert format_files([file], check=False, modernise=True) == 0
    assert file.read_text() == TODAY
    capsys.readouterr()
    assert format_files([file], check=False, modernise=True) == 0
    assert "changed" not in capsys.readouterr().out


def test_two_names_of_one_key_are_refused() -> None:
    text = EARLIER.replace("until: 20 mm", "until: 20 mm\n        stop at distance: 30 mm")
    with pytest.raises(ScenarioError, match='got the key "until"'):
        parse_scenario(text)


@pytest.mark.parametrize("words", [words for entry in CATALOGUE for words in entry.former])
def test_each_earlier_claim_is_the_property_of_todays(words: str) -> None:
    scenario = parse_scenario(TODAY)
    values = {"": "3", "ms": "100 ms", "mm": "600 mm", "s": "10 s"}
    sentence = FIELD.sub(lambda field: values[field[2]], words).replace("(s)", "s")
    today = in_words_of_today(sentence)
    assert today in CLAIMS
    claim = Claim(sentence=sentence, expected=Verdict.HOLDS, place=Place())
    assert property_of(claim, scenario) == property_of(replace(claim, sentence=today), scenario)


@pytest.mark.parametrize("sentence", [*CLAIMS, "always hand distance > 50 mm", "a hand gives way", ""])
def test_any_other_sentence_stays(sentence: str) -> None:
    assert in_words_of_today(sentence) == sentence


@pytest.mark.parametrize("sentence", ["retreat poses reachable", "proposed retreat poses reachable"])
def test_retreat_poses_are_the_papers_repulsive_poses(sentence: str) -> None:
    scenario = parse_scenario(TODAY)
    claim = Claim(sentence=sentence, expected=Verdict.HOLDS, place=Place())
    paper = replace(claim, sentence=sentence.replace("retreat", "repulsive"))
    assert property_of(claim, scenario) == property_of(paper, scenario)
