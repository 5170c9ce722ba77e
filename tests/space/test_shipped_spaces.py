"""The shipped spaces: what they are about, that they can be drawn from, and what comes of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from spaces import FILES, FOLDER

from safety_harness import admit, judge, read_space, run_trial
from safety_harness.admission.spaces import draw_admissible
from safety_harness.base.settings import DEFAULTS
from safety_harness.scenario.model import OffsetStart, RecordedHand, Verdict
from safety_harness.space.distributions import InRegion
from safety_harness.space.regions import region_named, seen_by


def test_there_are_six() -> None:
    assert {file.stem for file in FILES} == {
        "nominal",
        "unseen-hand",
        "unseen-tcp",
        "unseen-both",
        "reaching-hands",
        "recorded-variations",
    }


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_its_draws_can_be_tried_and_what_is_to_hold_is_not_violated_at_once(file: Path) -> None:
    space = read_space(file)
    draws = draw_admissible(space, seed=2, count=2)
    assert draws.acceptance_rate > 0.3
    for scenario in draws.scenarios:
        for claim, evaluation in zip(scenario.claims, judge(run_trial(admit(scenario))), strict=True):
            assert claim.expected is not Verdict.INCONCLUSIVE
            assert claim.expected is Verdict.VIOLATED or evaluation.verdict is not Verdict.VIOLATED, (
                evaluation
            )


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_it_claims_the_hand_distance_and_what_the_avoider_proposes(file: Path) -> None:
    claims = [claim.sentence for claim in read_space(file).simplest.claims]
    for words in ("hand distance never below 50 mm", "proposals lead away", "of proposals overruled"):
        assert any(words in sentence for sentence in claims), words


@pytest.mark.parametrize(
    ("name", "hand_is_seen", "tcp_is_seen"),
    [
        ("nominal", True, True),
        ("unseen-hand", False, True),
        ("unseen-tcp", True, False),
        ("unseen-both", False, False),
    ],
)
def test_table_3_is_what_its_name_says(name: str, hand_is_seen: bool, tcp_is_seen: bool) -> None:
    space = read_space(FOLDER / f"{name}.yaml")
    seen = seen_by("mc-dropout", folder=None, settings=DEFAULTS)
    assert space.notes == ("the seen space is that of mc-dropout",)
    regions = [p.distribution.name for p in space.parameters if isinstance(p.distribution, InRegion)]
    assert len(regions) == 2
    for scenario in space.draws(1, 50):
        assert isinstance(scenario.start, OffsetStart)
        x, y, z = scenario.settings.cell.desired_tcp_position_in_base_m
        dx, dy, dz = scenario.start.offset_in_base_m
        assert seen.tcp.contains(np.array([x + dx, y + dy, z + dz])) == tcp_is_seen
        place = np.array(scenario.hands[0].moves[1].position_in_base_m)  # type: ignore[union-attr]
        assert seen.hand.contains(place) == hand_is_seen
        if not hand_is_seen:
            assert region_named("unseen hand", seen, DEFAULTS).contains(place)


def test_one_choice_of_the_side_moves_hand_elbow_and_the_other_hand() -> None:
    for scenario in read_space(FOLDER / "reaching-hands.yaml").draws(1, 30):
        reaching, resting = scenario.hands
        y = reaching.starts_at_in_base_m[1]
        assert y * reaching.elbow_towards_in_base_m[1] > 0.0  # type: ignore[index]
        assert y * resting.starts_at_in_base_m[1] < 0.0


def test_the_recorded_motion_varies_in_place_turn_and_speed() -> None:
    space = read_space(FOLDER / "recorded-variations.yaml")
    hands = [scenario.hands[0] for scenario in space.draws(1, 10)]
    for of_hand in ("starts_at_in_base_m", "turn_rad", "speed_factor"):
        assert len({getattr(hand, of_hand) for hand in hands}) == 10
    assert len({hand.motion.sha256 for hand in hands if isinstance(hand, RecordedHand)}) == 1
