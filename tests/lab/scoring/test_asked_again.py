"""What does not repeat is noticed in the way that it is asked, and what does is not."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from doubted import Array, Changed, near_questions, subject

from safety_harness.extensions.lab.scoring.asking import asked_together
from safety_harness.extensions.lab.scoring.repeats import Subject, compared, repeats
from safety_harness.extensions.lab.scoring.scorecard import AskedAgain, WayOfAsking


def ways(make: Callable[[], Changed]) -> dict[WayOfAsking, AskedAgain]:
    on_trial = Subject.made_by(make, "on trial")
    sample = near_questions(120)
    first = asked_together(on_trial.avoider, sample)
    return {one.way: one for one in repeats(on_trial, sample, first, 60)}


def test_a_function_of_its_questions_answers_alike_in_every_way() -> None:
    found = ways(Changed)
    assert set(found) == set(WayOfAsking) - {WayOfAsking.ALONE, WayOfAsking.LATER}
    assert all(one.largest_m < 1e-12 for one in found.values())
    assert found[WayOfAsking.INTERLEAVED].questions == 60


def test_a_counter_is_noticed_when_asked_again() -> None:
    def make() -> Changed:
        count = [0]

        def counts(optimum: Array, hands: Array, tcps: Array) -> tuple[Array, Array]:
            numbers = count[0] + np.arange(len(optimum))
            count[0] += len(optimum)
            return optimum + (numbers % 50 == 49)[:, None] * 0.01, 0.0 * optimum

        return Changed(counts)

    found = ways(make)[WayOfAsking.AGAIN]
    assert found.differ > 0
    assert found.largest_m == pytest.approx(0.01)
    assert found.first is not None


def test_what_looks_at_its_neighbours_in_a_batch_is_noticed_in_another_order() -> None:
    def blurred(optimum: Array, hands: Array, tcps: Array) -> tuple[Array, Array]:
        return 0.9 * optimum + 0.1 * np.roll(optimum, 1, axis=0), 0.0 * optimum

    found = ways(lambda: Changed(blurred))
    assert found[WayOfAsking.ORDER].differ > 100
    assert found[WayOfAsking.AGAIN].differ == 0


def test_a_coarse_cache_is_noticed_after_nearly_the_same_question() -> None:
    def make() -> Changed:
        known: dict[bytes, Array] = {}

        def cached(optimum: Array, hands: Array, tcps: Array) -> tuple[Array, Array]:
            keys = np.round(np.hstack([hands, tcps]) / 0.02)
            rows = [known.setdefault(key.tobytes(), one) for key, one in zip(keys, optimum, strict=True)]
            return np.array(rows), 0.0 * optimum

        return Changed(cached)

    found = ways(make)
    assert found[WayOfAsking.AFTER_OTHERS].differ > 0
    assert found[WayOfAsking.AGAIN].differ == 0


def test_a_hand_that_is_left_over_at_the_same_tcp_is_noticed() -> None:
    def make() -> Changed:
        last: list[Array] = []

        def two_hands(optimum: Array, hands: Array, tcps: Array) -> tuple[Array, Array]:
            answers = optimum.copy()
            for k, tcp in enumerate(tcps):
                if last and np.array_equal(tcp, last[0]):
                    answers[k, 1] += 0.004
                last[:] = [tcp.copy()]
            return answers, 0.0 * optimum

        return Changed(two_hands)

    found = ways(make)[WayOfAsking.AFTER_OTHERS]
    assert found.differ == 30  # one question in four comes after another hand at its TCP
    assert found.largest_m == pytest.approx(0.004)


def test_one_that_is_made_otherwise_every_time_is_noticed() -> None:
    made = [0]

    def make() -> Changed:
        made[0] += 1
        offset_m = 0.001 * made[0]
        return Changed(lambda optimum, hands, tcps: (optimum + offset_m, 0.0 * optimum))

    assert ways(make)[WayOfAsking.FRESH].differ == 120


def test_an_answer_that_is_missing_the_second_time_differs_without_bounds() -> None:
    sample = near_questions(4)
    avoider = subject().avoider
    first = asked_together(avoider, sample)
    nothing = asked_together(Changed(lambda o, h, t: (o * np.nan, o)), sample)
    found = compared(WayOfAsking.AGAIN, sample, first, nothing)
    assert found.differ == 4
    assert found.largest_m == np.inf


@pytest.mark.parametrize("threshold_m", [0.02, np.nan])
def test_a_threshold_that_is_another_the_second_time_differs_and_none_both_times_does_not(
    threshold_m: float,
) -> None:
    sample = near_questions(3)
    first = asked_together(subject().avoider, sample)
    assert np.isnan(first.thresholds_m).all()
    moved = replace(first, positions_in_base_m=np.nextafter(first.positions_in_base_m, np.inf))
    found = compared(WayOfAsking.AGAIN, sample, first, replace(moved, thresholds_m=np.full(3, threshold_m)))
    assert found.differ == 3
    assert (found.largest_m == np.inf) == np.isfinite(threshold_m)
    assert np.isfinite(threshold_m) or found.largest_m < 1e-12
