from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_models import random_inputs, random_model

from safety_harness.base.exceptions import AvoiderError
from safety_harness.cell.avoidance.avoider import checked, spread_threshold_of
from safety_harness.cell.avoidance.learned import LearnedAvoider
from safety_harness.cell.avoidance.model_file import Calibration, Dropout

KINDS = [(Dropout.NONE, 1), (Dropout.NONE, 5), (Dropout.INTER, 1), (Dropout.FULL, 1)]


@pytest.mark.parametrize(("dropout", "members"), KINDS)
def test_one_proposal_and_a_batch_of_them_are_the_same_bits(dropout: Dropout, members: int) -> None:
    avoider = LearnedAvoider.from_model(random_model(dropout, members=members))
    hands, tcps, seeds = random_inputs(33, seed=1)
    positions, spreads = avoider.propose_many(hands, tcps, seeds)
    for n in range(33):
        proposal = avoider.propose(
            hand_position_in_base_m=hands[n], tcp_position_in_base_m=tcps[n], seed=int(seeds[n])
        )
        assert checked(proposal) is not None
        assert np.array_equal(proposal.position_in_base_m, positions[n])
        assert np.array_equal(proposal.spread_m, spreads[n])


def test_the_layout_of_what_is_given_does_not_matter_and_it_is_left_alone() -> None:
    avoider = LearnedAvoider.from_model(random_model(Dropout.INTER))
    hands, tcps, seeds = random_inputs(8, seed=2)
    expected = avoider.propose_many(hands, tcps, seeds)
    for array in (hands, tcps, seeds):
        array.setflags(write=False)
    as_stored = avoider.propose_many(np.asfortranarray(hands), np.repeat(tcps, 2, axis=0)[::2], list(seeds))  # type: ignore[arg-type]
    assert np.array_equal(as_stored, expected)
    assert np.array_equal(avoider.propose_many(hands, tcps, seeds), expected)


def test_no_decision_at_all_is_a_batch_too() -> None:
    positions, spreads = LearnedAvoider.from_model(random_model(Dropout.INTER)).propose_many(
        *random_inputs(0, seed=3)
    )
    assert positions.shape == spreads.shape == (0, 3)


@pytest.mark.parametrize(
    ("hands", "tcps", "seeds"),
    [((3,), (3,), 3), ((2, 3), (3, 3), 3), ((2, 2), (2, 2), 2), ((4, 3), (4, 3), 3)],
)
def test_arrays_that_do_not_belong_together_are_refused(
    hands: tuple[int, ...], tcps: tuple[int, ...], seeds: int
) -> None:
    with pytest.raises(ValueError, match="expected hands"):
        LearnedAvoider.from_model(random_model(Dropout.INTER)).propose_many(
            np.zeros(hands), np.zeros(tcps), np.zeros(seeds, dtype=np.uint64)
        )


def test_a_hand_that_is_not_a_number_is_a_fault_and_no_proposal() -> None:
    proposal = LearnedAvoider.from_model(random_model(Dropout.FULL)).propose(
        hand_position_in_base_m=np.array([0.8, np.nan, 0.1]),
        tcp_position_in_base_m=np.array([0.7, 0.0, 0.3]),
        seed=1,
    )
    with pytest.raises(AvoiderError, match="not finite"):
        checked(proposal)


def test_names_tell_the_kinds_apart() -> None:
    names = [LearnedAvoider.from_model(random_model(kind, members=m)).name for kind, m in KINDS]
    assert len(set(names)) == len(KINDS)


def test_the_spread_threshold_is_that_of_the_calibration() -> None:
    model = random_model(Dropout.INTER)
    assert spread_threshold_of(LearnedAvoider.from_model(model)) is None
    calibration = Calibration(
        interval_multiplier=3.0, spread_threshold_m=0.02, residual_std_m=(0.01, 0.01, 0.01), samples=100
    )
    assert spread_threshold_of(LearnedAvoider.from_model(replace(model, calibration=calibration))) == 0.02
