"""The faulty avoiders of benchmarks: each is wrong, the harmless ones are not, and a name means them."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import faulty_avoiders
import numpy as np
import pytest
from faulty_avoiders import BASES, FAULTS, HARMLESS, Answers, avoider_named, base_named, names

from safety_harness.base.exceptions import InadmissibleError
from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.asking import BatchAvoider
from safety_harness.cell.avoidance.avoider import decision_time_of
from safety_harness.cell.avoidance.python_file import avoider_in

TIMING = ("late", "hiccups", "slow_for_near_hands")  # their answers are right


def answers(avoider: BatchAvoider) -> Answers:
    """To some seen questions of a run: in a batch, among them near pairs, and two hands at one TCP."""
    rng = np.random.default_rng(3)
    tcps = faulty_avoiders.DESIRED + rng.uniform(-1.0, 1.0, (3_000, 3)) * faulty_avoiders.SEEN_TCP_HALF_M
    hands = faulty_avoiders.SOME_HAND + rng.uniform(-0.05, 0.05, (3_000, 3))
    hands[:20], tcps[20:30] = faulty_avoiders.SOME_HAND, faulty_avoiders.SOME_TCP
    tcps[1::2] = tcps[::2] + rng.uniform(-0.0005, 0.0005, (1_500, 3))
    return avoider.propose_many(hands, tcps, np.arange(3_000, dtype=np.uint64))


@cache
def sound_answers(base: str, of_spread: bool) -> Answers:
    return answers(base_named(base, of_spread=of_spread))


def apart(one: Answers, other: Answers) -> float:
    """The largest difference of a position or a spread [m]; infinite where one of them is no number."""
    with np.errstate(invalid="ignore"):
        return float(np.nan_to_num(np.abs(np.subtract(one, other)), nan=np.inf).max())


@pytest.mark.parametrize("base", BASES)
@pytest.mark.parametrize("fault", [fault for fault in FAULTS.values() if fault.name not in TIMING])
def test_the_slightest_fault_answers_otherwise_than_what_is_below_it(
    fault: faulty_avoiders.Fault, base: str
) -> None:
    sound = sound_answers(base, fault.of_spread)
    faulty = avoider_named(f"{fault.name}_1_on_{base}")
    if fault.name == "raises_near_a_tcp":
        with pytest.raises(ArithmeticError):
            answers(faulty)
    elif fault.name == "declared_late":
        assert decision_time_of(faulty) > DEFAULTS.avoidance.decision_deadline_s
    elif fault.name == "drifting":
        assert apart(answers(faulty), sound) != apart(answers(faulty), sound)
    else:
        assert apart(answers(faulty), sound) > 2e-4


@pytest.mark.parametrize("base", BASES)
@pytest.mark.parametrize("change", HARMLESS)
def test_a_harmless_change_answers_alike(change: str, base: str) -> None:
    wider = change == "slightly_wider"
    sound = sound_answers(base, wider)
    positions, spreads = answers(avoider_named(f"{change}_on_{base}"))
    assert np.abs(positions - sound[0]).max() < 1e-12
    assert np.allclose(spreads, sound[1] * (1.02 if wider else 1.0))


def test_there_are_thirty_faults_of_every_class_at_three_magnitudes() -> None:
    assert len(FAULTS) >= 30
    assert len(set(names())) == len(FAULTS) * 3 * len(BASES)


def test_a_file_and_a_name_mean_them() -> None:
    path = Path(faulty_avoiders.__file__)
    named = avoider_in(path, path.read_bytes(), "sign_flip_3_on_optimum")
    assert named.name == "sign_flip_3_on_optimum"
    with pytest.raises(InadmissibleError):
        avoider_in(path, path.read_bytes(), "sign_flip_0_on_optimum")
