"""``fmt``: one layout, nothing lost, the same meaning, the same again when done twice."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from scenario_strategies import scenarios
from scenario_texts import SHORTEST, VALID, parse

from safety_harness.base.exceptions import ScenarioError
from safety_harness.scenario.layout import laid_out
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.write import write_scenario

ROOT = Path(__file__).parents[2]
SHIPPED = [*sorted((ROOT / "scenarios").glob("*.yaml")), *sorted((ROOT / "scenarios/spaces").glob("*.yaml"))]


@pytest.mark.parametrize("file", SHIPPED, ids=lambda file: file.stem)
def test_every_shipped_file_is_laid_out_well(file: Path) -> None:
    assert laid_out(file.read_text(), file) == file.read_text()


UNTIDY = """\
# A file of mine.

# about the time
duration: 12 s # long
"scenario": 'what it is: this'   # title


hands: # one
# first
-   hand: "right"  # r
    # where
    starts at:
      - 1 m
      - 2 m
      - 3 m
    moves:
    - speed: 1 m/s
      # to
      move to: [1 m, # x
        2 m,
        # z
        3 m]
    - {wait: 1 s} # short
    # after the moves

    elbow towards: [2 m,2 m,   3 m]
  # end of hands
about: >- # why
   some text
   here

   more # not a comment
tcp start: {tilt: [0 deg, 0 deg, 0 deg], offset: [0 mm, 0 mm, 0 mm]}
settings:
    avoidance:
       radius: 100 mm

       critical distance: 0.3 m
    clock: {}
claims:
    gain switch reached: holds

    "a: b": violated
# foot
"""
TIDY = """\
# A file of mine.

scenario: "what it is: this"  # title
# why
about: >
  some text
  here

  more # not a comment
# about the time
duration: 12 s  # long
tcp start: {offset: [0 mm, 0 mm, 0 mm], tilt: [0 deg, 0 deg, 0 deg]}

hands:  # one
  # first
  - hand: right  # r
    # where
    starts at: [1 m, 2 m, 3 m]

    elbow towards: [2 m, 2 m, 3 m]
    moves:
      # to
      - move to:
          - 1 m  # x
          - 2 m
          # z
          - 3 m
        speed: 1 m/s
      - wait: 1 s  # short
      # after the moves
  # end of hands
settings:
  clock: {}
  avoidance:
    critical distance: 0.3 m
    radius: 100 mm
claims:
  gain switch reached: holds

  "a: b": violated
# foot
"""


def test_an_untidy_file_becomes_tidy_and_keeps_its_comments_and_units() -> None:
    assert laid_out(UNTIDY) == TIDY
    assert laid_out(TIDY) == TIDY
    assert parse(UNTIDY) == parse(TIDY)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("a: 'b'\n", "a: b\n"),
        ("a: 'b: c'\n", 'a: "b: c"\n'),
        ("a:\n    b: c\n", "a:\n  b: c\n"),
        ("a: {}\n", "a: {}\n"),
        ("a:\n", "a:\n"),
        ("a: b\r\nc: d\r\n", "a: b\nc: d\n"),
        ("---\na: b\n...\n", "a: b\n"),
        ("a:\n\n\n\n  b: c\n\n\n\n  d: e\n", "a:\n  b: c\n\n  d: e\n"),
        ("a: one\n   two\n", "a: one two\n"),
        ("a: |2\n    b\n", 'a: "  b"\n'),
        ("a: |\n     b\n      c\n", "a: |\n  b\n   c\n"),
        (
            "matrix:\n  x:\n    y: {seed: 1, duration: 1 s}\n",
            "matrix:\n  x:\n    y: {duration: 1 s, seed: 1}\n",
        ),
        ("claims: {b: holds, a: holds}\n", "claims: {b: holds, a: holds}\n"),
        ("unknown: 1\nscenario: x\n", "scenario: x\nunknown: 1\n"),
        ("scenarios: [b, a]\nsuite: s\n", "suite: s\nscenarios: [b, a]\n"),
        ("- a # b\n", "- a  # b\n"),
        ("a # b\n", "# b\na\n"),
        ("# only\na: b", "# only\na: b\n"),
        ("a:\n  - b\n  - \n", "a:\n  - b\n  -\n"),
    ],
)
def test_how_it_is_laid_out(before: str, after: str) -> None:
    assert laid_out(before) == after
    assert laid_out(after) == after


@pytest.mark.parametrize("empty", ["k:\n", "k:  # of k\n"])
def test_a_comment_beside_a_value_does_not_move_to_the_empty_one_above_it(empty: str) -> None:
    text = f"scenario: a\nstart:\n  {empty}  offset: 1  # of the offset\n"
    after = laid_out(text)
    assert "offset: 1  # of the offset" in after
    assert laid_out(after) == after


def test_a_long_list_stands_below_its_key_and_long_prose_is_folded() -> None:
    numbers = [f"{number} mm" for number in range(100, 130)]
    out = laid_out(f"a: [{', '.join(numbers)}]\nabout: {'word ' * 60}\n")
    assert out.splitlines()[0] == "about: >"
    assert "a:\n  - 100 mm\n  - 101 mm\n" in out
    assert max(map(len, out.splitlines())) <= 120
    assert laid_out(out) == out


@pytest.mark.parametrize("text", ["a: b: c\n", "a: &x b\n", "a: 1\na: 2\n", "\tx\n", ""])
def test_what_is_no_tree_is_refused(text: str) -> None:
    with pytest.raises(ScenarioError):
        laid_out(text)


@pytest.mark.parametrize("text", [VALID, SHORTEST])
def test_the_laid_out_file_reads_to_the_identical_scenario(text: str) -> None:
    assert parse(laid_out(text)) == parse(text)


@hypothesis_settings(deadline=None, max_examples=40)
@given(scenarios())
def test_any_written_scenario_can_be_laid_out(scenario: Scenario) -> None:
    text = write_scenario(scenario)
    out = laid_out(text)
    assert laid_out(out) == out
    assert parse(out) == parse(text)
