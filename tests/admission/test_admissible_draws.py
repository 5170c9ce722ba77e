"""Draws that can be tried: what admission refuses is counted by its reason, and hope has an end."""

from __future__ import annotations

from pathlib import Path

import pytest

from safety_harness import admit, parse_space, read_space
from safety_harness.admission.spaces import MAX_REJECTION_RATIO, draw_admissible
from safety_harness.base.exceptions import InadmissibleError, ModelError

FOLDER = Path(__file__).parents[2] / "scenarios/spaces"
TEXT = """\
scenario space: a start somewhere
duration: 5 s
avoider: opposite pose
tcp start:
  offset: START
claims: {gain switch reached: holds}
"""


def test_a_space_within_reach_is_taken_as_it_is() -> None:
    space = read_space(FOLDER / "nominal.yaml")
    draws = draw_admissible(space, seed=4, count=10)
    assert draws.scenarios == tuple(space.draws(4, 10))
    assert (draws.drawn, draws.refused, draws.acceptance_rate) == (10, {}, 1.0)


def test_what_cannot_be_tried_is_drawn_again_and_counted() -> None:
    space = read_space(FOLDER / "unseen-tcp.yaml")
    draws = draw_admissible(space, seed=1, count=20)
    assert len(draws.scenarios) == 20
    assert draws.drawn == 20 + sum(draws.refused.values()) > 20
    (reason,) = draws.refused
    assert reason == "tcp start: expected a TCP start with the whole object in the camera's view"
    assert str(draws) == f"20 of {draws.drawn} draws can run ({20 / draws.drawn:.0%}); " + (
        f"{draws.refused[reason]} refused: {reason}"
    )


def test_each_of_them_is_admitted_and_keeps_the_number_of_its_draw() -> None:
    space = read_space(FOLDER / "unseen-tcp.yaml")
    for scenario in draw_admissible(space, seed=1, count=8).scenarios:
        admit(scenario)
        assert scenario == space.draw(1, int(scenario.name.partition("#")[2]))


def test_a_hopeless_space_is_refused_with_the_most_frequent_reason() -> None:
    space = parse_space(TEXT.replace("START", "{box: [[3 m, 3 m, 0 m], [4 m, 4 m, 1 m]]}"), Path("far.yaml"))
    told: list[int] = []
    with pytest.raises(InadmissibleError, match=f"0 of {MAX_REJECTION_RATIO} draws") as caught:
        draw_admissible(space, seed=1, count=3, on_draw=told.append)
    assert told == list(range(1, MAX_REJECTION_RATIO + 1))
    assert (
        f"{MAX_REJECTION_RATIO} times it was tcp start: expected a TCP start that the arm can reach"
        in caught.value.hint
    )
    assert caught.value.place.line == 4


def test_a_space_that_is_hopeless_but_for_a_rare_draw_is_refused_in_bounded_time() -> None:
    rare = "{one of: [[0 mm, 0 mm, 0 mm], [3 m, 3 m, from 0 m to 1 m]], chances: [1, 100000]}"
    space = parse_space(TEXT.replace("START", rare))
    with pytest.raises(InadmissibleError, match="at least one draw in 200"):
        draw_admissible(space, seed=1, count=1)


def test_values_that_the_reader_refuses_together_are_counted_too() -> None:
    space = parse_space(
        TEXT.replace("START", "[0 mm, 0 mm, from 0 mm to 10 mm]")
        + """\
settings:
  avoidance: {restart delay: from 500 ms to 700 ms}
  braking: {stop time base: from 350 ms to 500 ms}
"""
    )
    draws = draw_admissible(space, seed=1, count=10)
    assert any(reason.startswith("settings.avoidance.restart delay") for reason in draws.refused)


def test_a_missing_avoider_is_no_matter_of_chance(tmp_path: Path) -> None:
    space = parse_space(
        TEXT.replace("START", "[0 mm, 0 mm, from 0 mm to 10 mm]").replace(
            "opposite pose", "none.safetensors"
        ),
        tmp_path / "a.yaml",
    )
    with pytest.raises((InadmissibleError, ModelError), match="no such file"):
        draw_admissible(space, seed=1, count=1)


def test_an_unknown_claim_is_no_matter_of_chance() -> None:
    text = TEXT.replace("START", "[0 mm, 0 mm, from 0 mm to 10 mm]").replace("gain switch", "gian switch")
    with pytest.raises(InadmissibleError, match="a claim of the catalogue"):
        draw_admissible(parse_space(text), seed=1, count=1)


def test_nothing_is_not_drawn() -> None:
    with pytest.raises(ValueError, match="at least 1"):
        draw_admissible(read_space(FOLDER / "nominal.yaml"), seed=1, count=0)
