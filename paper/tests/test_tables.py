"""The verdict on every table follows from its numbers: each is seen to get each of the three words."""

from __future__ import annotations

import made_up
import pytest

from safety_harness_paper import figure6, figure7, figure8, table1, table2, table3, table4, table5
from safety_harness_paper.result import ClaimState, PaperVerdict, Result
from safety_harness_paper.scale import DEFAULT

REPRODUCED, DIRECTION, NOT = PaperVerdict.REPRODUCED, PaperVerdict.DIRECTION_ONLY, PaperVerdict.NOT_REPRODUCED


def lost(result: Result) -> list[str]:
    return [claim.sentence for claim in result.claims if claim.state is not ClaimState.HOLDS]


def test_table_1_from_the_papers_own_figures_is_reproduced() -> None:
    result = table1.result(DEFAULT, made_up.main_evaluations())
    assert (result.word, lost(result)) == (REPRODUCED, [])
    assert "20 of 20 figures agree" in result.why


def test_table_1_with_other_figures_of_the_same_order_is_the_direction_only() -> None:
    result = table1.result(DEFAULT, made_up.main_evaluations(rmse=lambda mm: mm - 8.0))
    assert result.word is DIRECTION
    assert "only 15 of 20 figures agree" in result.why


def test_table_1_is_not_reproduced_if_more_passes_do_not_help() -> None:
    result = table1.result(DEFAULT, made_up.main_evaluations(rmse=lambda mm: 40.0 - mm))
    assert result.word is NOT
    assert "the RMSE is lower with 10 passes than with 5" in lost(result)


def test_table_2_in_all_three_words() -> None:
    main = made_up.main_evaluations()
    assert table2.result(DEFAULT, main | made_up.long_evaluations()).word is REPRODUCED
    other = main | made_up.long_evaluations(rmse_mm=23.9, picp_x=0.4)
    bent = made_up.main_evaluations(rmse=lambda mm: mm - 9.0) | made_up.long_evaluations(rmse_mm=15.0)
    assert table2.result(DEFAULT, other | bent).word is DIRECTION
    better = table2.result(DEFAULT, main | made_up.long_evaluations(rmse_mm=19.0))
    assert better.word is NOT
    assert lost(better) == ["the RMSE of DO-inter is lower than that of DO-full with six times the epochs"]


def test_table_3_in_all_three_words() -> None:
    more = made_up.ensemble_evaluations()
    assert table3.result(DEFAULT, made_up.main_evaluations() | more).word is REPRODUCED
    half = made_up.main_evaluations(rmse=lambda mm: mm / 2.0, dnn=lambda mm: mm / 2.0)
    assert table3.result(DEFAULT, half | more).word is DIRECTION
    robust = table3.result(DEFAULT, made_up.main_evaluations(dnn=lambda mm: mm / 2.0) | more)
    assert robust.word is NOT
    assert "with the TCP unseen the RMSE of the Bayesian DNN is lower than that of the DNN" in lost(robust)


def test_table_3_has_the_seen_row_the_ensemble_and_the_floor_beside_the_papers() -> None:
    result = table3.result(DEFAULT, made_up.main_evaluations() | made_up.ensemble_evaluations())
    assert [c.paper for c in result.comparisons if "seen, new TCPs" in c.label] == [None, None]
    names = [row[0] for row in result.tables[0].rows]
    assert "label noise alone" in names
    assert "ensemble, unseen tcp" in names


@pytest.mark.parametrize(
    ("dnn", "bayesian", "word"),
    [(22, 0, REPRODUCED), (8, 0, DIRECTION), (0, 0, NOT), (3, 9, NOT), (22, 21, NOT)],
)
def test_table_4_in_all_three_words(dnn: int, bayesian: int, word: PaperVerdict) -> None:
    assert table4.result(DEFAULT, made_up.reaches(dnn=dnn, bayesian=bayesian)).word is word


def test_one_training_that_fails_is_no_evidence_about_trainings() -> None:
    found = made_up.reaches(dnn=0) | {"reach 4": made_up.reaches(dnn=22)["reach 4"]}
    result = table4.result(DEFAULT, found)
    assert [claim.state for claim in result.claims] == [ClaimState.HOLDS, ClaimState.UNDECIDED]
    assert result.word is NOT


def test_table_4_counts_exactly() -> None:
    result = table4.result(DEFAULT, made_up.reaches(dnn=22, bayesian=1))
    assert result.tables[0].rows[0] == ("1", "22 of 50", "1 of 50", "21 / 0", "9.5e-07")
    assert table4.exact_ends(0) == pytest.approx((0.0, 7.11), abs=0.01)
    assert "0 of 250" not in str(result.tables[-1])


@pytest.mark.parametrize(
    ("bayesian", "opposite", "word"),
    [(201.3, 869.28, REPRODUCED), (100.0, 180.0, DIRECTION), (180.0, 100.0, NOT), (180.0, 180.0, NOT)],
)
def test_table_5_in_all_three_words(bayesian: float, opposite: float, word: PaperVerdict) -> None:
    assert table5.result(DEFAULT, made_up.trials(bayesian=bayesian, opposite=opposite)).word is word


def test_table_5_counts_zero_and_never_explicitly() -> None:
    result = table5.result(DEFAULT, made_up.trials())
    head, row = result.tables[0].head, result.tables[0].rows[0]
    assert dict(zip(head[3:], row[3:], strict=True)) == {
        "converged": "105",
        "of these zero": "5",
        "never converged": "5",
        "refused": "5",
    }


def test_iterations_are_compared_by_their_ratio_alone() -> None:
    result = table5.result(DEFAULT, made_up.trials())
    assert [one.agrees for one in result.comparisons] == [True, None, None]


def test_figures_6_to_8_follow_from_the_same_measurements() -> None:
    assert figure6.result(DEFAULT, made_up.main_evaluations()).word is REPRODUCED
    assert figure7.result(DEFAULT, made_up.trials()).word is REPRODUCED
    assert figure8.result(DEFAULT, made_up.trials()).word is REPRODUCED
    assert figure8.result(DEFAULT, made_up.trials(bayesian=900.0)).word is NOT


def test_a_trial_that_never_converged_is_no_whole_trial() -> None:
    found = made_up.trials()
    found["trials 0"].result["few"]["records"]["Bayesian DNN"]["switch"] = None
    assert figure7.result(DEFAULT, found).word is NOT


def test_arrivals_that_are_all_below_the_switch_have_no_ratio() -> None:
    found = made_up.trials()
    for one in found.values():
        system = one.result["many"]["systems"]["Bayesian DNN"]
        system["iterations"] = [None if n is None else 0 for n in system["iterations"]]
    result = table5.result(DEFAULT, found)
    assert all(one.paper != 4.32 for one in result.comparisons)
    assert result.word is REPRODUCED  # the claim holds, and no figure is left to compare


def test_nothing_that_converged_is_no_verdict_for_either() -> None:
    found = made_up.trials()
    for one in found.values():
        for which in ("few", "many"):
            system = one.result[which]["systems"]["Bayesian DNN"]
            system["iterations"] = [None] * len(system["iterations"])
            system["fates"] = ["never"] * len(system["fates"])
    result = table5.result(DEFAULT, found)
    assert (result.word, [claim.state for claim in result.claims]) == (NOT, [ClaimState.UNDECIDED])
