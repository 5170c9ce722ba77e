"""Every question is answered as if it were asked alone, whatever else in its batch fails."""

import numpy as np
from doubted import Array, Changed, near_questions

from safety_harness.extensions.lab.scoring.asking import CHUNK, asked_alone, asked_together


def test_many_are_asked_in_chunks_and_answered_in_order() -> None:
    avoider, questions = Changed(), near_questions(CHUNK + 5)
    together = asked_together(avoider, questions)
    assert avoider.asked == [CHUNK, 5]
    few = questions[CHUNK - 2 : CHUNK + 3]
    alone, times_s = asked_alone(avoider, few)
    assert np.allclose(
        together[CHUNK - 2 : CHUNK + 3].positions_in_base_m, alone.positions_in_base_m, atol=1e-12
    )
    assert len(times_s) == 5
    assert min(times_s) > 0.0


def test_of_a_batch_that_raises_only_the_culprits_have_no_answer() -> None:
    questions = near_questions(300)
    culprits = {17, 250}
    struck = questions.hands_in_base_m[sorted(culprits)]

    def raises(optimum: Array, hands: Array, tcps: Array) -> tuple[Array, Array]:
        if (hands[:, None] == struck).all(axis=2).any():
            raise ArithmeticError("singular")
        return optimum, np.zeros_like(optimum)

    answers = asked_together(Changed(raises), questions)
    assert set(answers.faults) == culprits
    assert set(np.flatnonzero(~answers.given)) == culprits
    assert "singular" in answers.faults[17]


def test_nan_infinity_negative_spreads_and_other_shapes_are_no_answers() -> None:
    questions = near_questions(40)
    for bad in (np.nan, np.inf):
        answers = asked_together(Changed(lambda o, h, t, bad=bad: (o * bad, o * 0.0)), questions)
        assert len(answers.faults) == 40
    assert len(asked_together(Changed(lambda o, h, t: (o, o * 0.0 - 1.0)), questions).faults) == 40
    assert len(asked_together(Changed(lambda o, h, t: (o[:, :2], o[:, :2])), questions).faults) == 40


def test_some_of_the_answers_keep_their_faults() -> None:
    questions = near_questions(6)
    first = questions.hands_in_base_m[4]
    answers = asked_together(Changed(lambda o, h, t: (np.where(h == first, np.nan, o), o * 0.0)), questions)
    assert list(answers.faults) == [4]
    assert list(answers[3:].faults) == [1]
    assert not answers[:4].faults
