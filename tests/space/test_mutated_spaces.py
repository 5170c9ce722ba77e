"""Spaces with mistakes in them: each is a clear error or a space that can be drawn from, no traceback."""

from __future__ import annotations

import re
from contextlib import suppress

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from spaces import HEAD

from safety_harness.base.exceptions import InputError
from safety_harness.space.read import parse_space
from safety_harness.space.space import ScenarioSpace

TEXT = (
    HEAD.replace("5 s", "from 2 s to 4 s").replace("[0 mm, 0 mm, 0 mm]", "{in: seen tcp}")
    + """\
choices:
  side: one of right, left
hands:
  - hand: h
    starts at: {by: side, right: [1.2 m, -0.7 m, 0.3 m], left: [1.2 m, 0.7 m, 0.3 m]}
    elbow towards: [1.6 m, 0 m, 0.3 m]
    moves:
      - repeat: from 1 to 2 times
        moves:
          - {one of: [{wait: 'one of 1 s, 2 s'}, {withdraw: from 1 m/s to 2 m/s}], chances: [1, 2]}
          - {move to: {shell: [1 m, 0 m, 0.5 m], from: 100 mm, to: 200 mm}, speed: 1 m/s}
          - move to: {box: [[0 m, 0 m, 0 m], [1 m, 1 m, 1 m]]}
            speed: normal 1 m/s +- 1 m/s from 1 m/s to 2 m/s
"""
)
TOKENS = re.findall(r"\w+|[^\w\s]|\s+", TEXT)
WORDS = sorted(
    {
        *TOKENS,
        "the side",
        "one of",
        "by",
        "in",
        "box",
        "shell",
        "repeat",
        "from 1 to 3",
        "",
        "-1",
        "1e400",
        "nan",
    }
)


@given(
    edits=st.lists(
        st.tuples(st.integers(0, len(TOKENS) - 1), st.sampled_from(WORDS), st.sampled_from("+-=")),
        min_size=1,
        max_size=3,
    )
)
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_a_mutated_space_is_refused_or_works(edits: list[tuple[int, str, str]]) -> None:
    tokens = list(TOKENS)
    for place, word, how in edits:
        tokens[place] = {"+": tokens[place] + word, "-": "", "=": word}[how]
    space = space_or_error("".join(tokens))
    if isinstance(space, InputError):
        assert space.expected
        assert space.got
        return
    with suppress(InputError):  # of values that only together are impossible
        assert space.draw(1, 1) in space


def space_or_error(text: str) -> ScenarioSpace | InputError:
    try:
        return parse_space(text)
    except InputError as error:
        return error


def test_the_space_itself_works() -> None:
    assert parse_space(TEXT).dimension == 1 + 3 + 1 + 1 + 2 * (1 + 1 + 1 + 3 + 3 + 1)
