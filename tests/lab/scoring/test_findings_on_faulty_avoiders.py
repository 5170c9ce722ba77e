"""What a quick scoring says of avoiders with a fault, a class each, and of sound ones.

The whole table, of every fault at three magnitudes and with the default counts, is benchmarks/EVALUATE.md.
"""

from __future__ import annotations

from collections.abc import Callable

import pytest
from faulty_avoiders import avoider_named

from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.asking import BatchAvoider
from safety_harness.extensions.lab.scoring import score as scoring
from safety_harness.extensions.lab.scoring.findings import findings
from safety_harness.extensions.lab.scoring.regions import named_regions
from safety_harness.extensions.lab.scoring.repeats import Subject
from safety_harness.extensions.lab.scoring.scorecard import Kind
from safety_harness.space.regions import paper_seen

SEEN = named_regions(paper_seen(DEFAULTS), DEFAULTS)[:1]
FEW = scoring.Counts(first=2_000, segments=100, alone=50, sample=100)
Named = Callable[[str], set[Kind]]


@pytest.fixture(scope="module")
def named() -> Named:
    """The kinds of the findings on an avoider, by its name."""
    against = scoring.yardsticks(SEEN, seed=1, counts=FEW)

    def of(name: str) -> set[Kind]:
        def make() -> BatchAvoider:
            return avoider_named(name)

        card = scoring.score(Subject.made_by(make, name), SEEN, seed=1, counts=FEW)
        return {one.kind for one in findings(card, against)}

    return of


@pytest.fixture(autouse=True)
def _at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """No fault here changes with the time."""
    monkeypatch.setattr(scoring, "LATER_S", 0.0)


@pytest.mark.parametrize(
    "name",
    [
        "sound_on_network",
        "sound_on_optimum",
        "sound_with_spread_on_optimum",
        "cached_on_network",
    ],
)
def test_nothing_is_said_of_a_sound_avoider(name: str, named: Named) -> None:
    assert named(name) == set()


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("wrong_near_a_tcp_2_on_network", Kind.WORST_CASE),
        ("turned_base_1_on_network", Kind.FAR_OFF),
        ("pulled_to_the_hand_1_on_optimum", Kind.HAND_PULL),
        ("collapsed_1_on_optimum", Kind.BIASED),
        ("two_modes_1_on_network", Kind.JUMPS),
        ("overconfident_1_on_network", Kind.SPREAD_MISSES),
        ("inverted_spread_1_on_network", Kind.SPREAD_UNRANKED),
        ("stale_hand_1_on_optimum", Kind.NOT_REPEATED),
        ("mean_of_two_hands_1_on_network", Kind.NOT_REPEATED),
        ("unseeded_1_on_optimum", Kind.NOT_REPEATED),
        ("another_in_each_process_1_on_optimum", Kind.NOT_REPEATED),
        ("sorted_batch_1_on_network", Kind.NOT_REPEATED),
        ("declared_late_1_on_optimum", Kind.SLOW),
        ("nan_near_a_hand_3_on_optimum", Kind.NO_ANSWER),
        ("raises_near_a_tcp_2_on_network", Kind.NO_ANSWER),
    ],
)
def test_a_slight_fault_is_named(name: str, kind: Kind, named: Named) -> None:
    assert kind in named(name)
