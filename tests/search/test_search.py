"""The loop: what is counted, what ends it, and that nothing found is lost."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np
import pytest

from safety_harness.base.exceptions import InadmissibleError
from safety_harness.claims.properties.against import SCALES
from safety_harness.claims.properties.base import Unit
from safety_harness.search.cube import Column, Cube, Points
from safety_harness.search.findings import Findings, Goal, Outcomes
from safety_harness.search.sampling import UniformSampling
from safety_harness.search.search import MAX_REJECTION_RATIO, find_violations

CUBE = Cube((Column(), Column(), Column((0.0, 0.5, 1.0), flat=True)))
GOALS = (Goal("first", 0.1), Goal("second", 1.0))


class World:
    """Two claims: the first violated for u0 < 0.1, the second where u1 > 0.9; u0 > 0.8 is refused."""

    def __init__(self) -> None:
        self.firsts: list[int] = []

    def __call__(self, points: Points, first: int) -> Outcomes:
        self.firsts.append(first)
        margins = np.column_stack([points[:, 0] - 0.1, 0.9 - points[:, 1]])
        refused = ["too far" if u > 0.8 else "" for u in points[:, 0]]
        none, kinds = [""] * len(points), ["right" if u < 0.5 else "left" for u in points[:, 1]]
        return Outcomes(margins, np.isfinite(margins), refused, none, kinds, [None] * len(points))


def searched(evaluate: object = None, *, budget: int = 300, batch: int = 7, seed: int = 0) -> Findings:
    searcher = UniformSampling(CUBE, claims=2, seed=seed)
    world = World() if evaluate is None else evaluate
    return find_violations(CUBE, GOALS, world, searcher, budget=budget, batch=batch)  # type: ignore[arg-type]


def test_runs_are_counted_and_refusals_beside_them() -> None:
    found = searched()
    assert found.tried == 300
    assert found.refused == {"too far": found.asked - 300}
    assert found.asked > 330
    assert found.evidence.tolist() == [300, 300]


def test_points_are_numbered_over_the_whole_search() -> None:
    world = World()
    searched(world, budget=20)
    assert world.firsts[:3] == [0, 7, 14]


def test_violations_are_found_where_they_are_and_the_nearest_is_the_worst() -> None:
    found = searched()
    points = np.concatenate([[group.worst.point for group in found.of_claim(claim)] for claim in (0, 1)])
    assert np.all((points[:, 0] < 0.1) | (points[:, 1] > 0.9))
    for claim in (0, 1):
        nearest = found.nearest[claim]
        assert nearest is not None
        assert nearest.margins[claim] == found.of_claim(claim)[0].worst_margin()
        assert sum(group.count for group in found.of_claim(claim)) == found.violated[claim]
        assert 0 < found.first_violation[claim] < 100


def test_violations_of_other_kinds_alternatives_and_places_are_kept_apart() -> None:
    groups = searched(budget=2000).of_claim(0)
    assert {(group.kind, group.leader[2] > 0.5) for group in groups} == {
        (kind, side) for kind in ("right", "left") for side in (False, True)
    }
    assert len(groups) < 20


def test_the_same_seed_finds_the_same() -> None:
    first, second, other = searched(seed=1), searched(seed=1), searched(seed=2)
    assert [group.worst.number for group in first.groups] == [group.worst.number for group in second.groups]
    assert [group.worst.number for group in first.groups] != [group.worst.number for group in other.groups]


def test_ctrl_c_keeps_what_was_found() -> None:
    world = World()

    def interrupted(points: Points, first: int) -> Outcomes:
        if first >= 150:
            raise KeyboardInterrupt
        return world(points, first)

    found = searched(interrupted)
    assert found.interrupted
    assert 100 < found.tried <= 154
    assert found.found_any


def test_a_space_of_which_nothing_can_be_tried_is_given_up_with_the_reason() -> None:
    def refusing(points: Points, first: int) -> Outcomes:
        outcomes = World()(points, first)
        reasons = ["out of reach" if u < 0.9 else "out of view" for u in points[:, 0]]
        return Outcomes(
            outcomes.margins, outcomes.conclusive, reasons, outcomes.mishaps, outcomes.kinds, outcomes.cells
        )

    with pytest.raises(InadmissibleError, match="one point in 200 can run; got 0 of 2"):
        searched(refusing)


def test_it_is_not_given_up_while_one_point_in_two_hundred_can_be_tried() -> None:
    def seldom(points: Points, first: int) -> Outcomes:
        outcomes = World()(points, first)
        reasons = [
            "" if (first + k) % (MAX_REJECTION_RATIO // 2) == 0 else "out of reach"
            for k in range(len(points))
        ]
        return Outcomes(
            outcomes.margins, outcomes.conclusive, reasons, outcomes.mishaps, outcomes.kinds, outcomes.cells
        )

    assert searched(seldom, budget=5).tried == 5


def test_a_space_in_which_nothing_can_be_violated_and_one_in_which_everything_is() -> None:
    safe = searched(lambda points, first: Outcomes.of_margins(np.full((len(points), 2), 0.3)))
    assert not safe.found_any
    assert safe.first_violation.tolist() == [0, 0]
    margins = np.array([-0.1, 0.3])
    always = searched(lambda points, first: Outcomes.of_margins(np.tile(margins, (len(points), 1))))
    assert [always.always_violated(claim) for claim in (0, 1)] == [True, False]
    assert not searched().always_violated(0)


def test_a_margin_that_is_no_number_is_neither_a_violation_nor_evidence() -> None:
    for value in (np.nan, np.inf, -np.inf):
        found = searched(lambda points, first, v=value: Outcomes.of_margins(np.full((len(points), 2), v)))
        assert not found.found_any
        assert found.evidence.tolist() == [0, 0]
        assert found.nearest == [None, None]


def test_a_margin_without_a_verdict_leads_but_is_no_evidence() -> None:
    def inconclusive(points: Points, first: int) -> Outcomes:
        outcomes = World()(points, first)
        nowhere = np.zeros(outcomes.conclusive.shape, bool)
        margins = np.abs(outcomes.margins)
        return Outcomes(
            margins, nowhere, [""] * len(points), [""] * len(points), [""] * len(points), outcomes.cells
        )

    found = searched(inconclusive)
    assert found.evidence.tolist() == [0, 0]
    assert found.nearest[0] is not None


def test_mishaps_are_findings_told_apart_by_their_words() -> None:
    def crashing(points: Points, first: int) -> Outcomes:
        margins = np.full((len(points), 2), 0.5)
        mishaps = ["it raised" if u < 0.1 else "it hung" if u > 0.95 else "" for u in points[:, 0]]
        none = [""] * len(points)
        return Outcomes(margins, np.isfinite(margins), none, mishaps, none, [None] * len(points))

    found = searched(crashing)
    assert {group.kind for group in found.of_claim(None)} == {"it raised", "it hung"}
    assert found.mishaps == sum(group.count for group in found.groups)
    assert found.found_any


def test_margins_are_told_over_their_scales() -> None:
    class Listens(UniformSampling):
        told: Points

        def learn(self, points: Points, scores: Points, cells: Sequence[Hashable]) -> None:
            self.told = scores

    searcher = Listens(CUBE, claims=2, seed=0)
    margins = np.array([[0.02, 3.0]])
    find_violations(CUBE, GOALS, lambda points, first: Outcomes.of_margins(margins), searcher, budget=1)
    assert searcher.told.tolist() == [[0.02 / 0.1, 3.0]]


def test_every_unit_of_a_margin_has_a_scale() -> None:
    assert set(SCALES) == set(Unit)
    assert all(scale > 0.0 for scale in SCALES.values())


@pytest.mark.parametrize(("budget", "batch"), [(0, 1), (1, 0)])
def test_a_search_for_nothing_is_refused(budget: int, batch: int) -> None:
    with pytest.raises(ValueError, match="at least 1"):
        searched(budget=budget, batch=batch)
