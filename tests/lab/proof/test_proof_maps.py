"""A map shows which share of each cell is undecided and refuted, and nothing where nothing is claimed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from safety_harness.extensions.lab.proof.box_kernel import OUTSIDE, PROVEN, REFUTED, UNDECIDED
from safety_harness.extensions.lab.proof.certificate import Proof
from safety_harness.extensions.lab.proof.claims import ClaimKind, DecisionClaim
from safety_harness.extensions.lab.proof.maps import CELLS, BoxMap, maps_of
from safety_harness.extensions.lab.proof.plan import PlannedProof
from safety_harness.extensions.lab.proof.tree import BoxTree
from tests.lab.proof.regions import SEEN_REGION

CLAIM = DecisionClaim(ClaimKind.AT_MOST, 0.15)


def maps(*levels: list[int]) -> dict[tuple[str, str, str], BoxMap]:
    tree = BoxTree([np.array(level, np.uint8) for level in levels])
    proof = Proof(PlannedProof(CLAIM, replace(SEEN_REGION, name="a")), tree)
    return {(one.who, one.seen, one.what): one for one in maps_of(proof)}


def test_halves_are_seen_where_they_are() -> None:
    found = maps([0], [PROVEN, 4], [REFUTED, UNDECIDED])  # by the hand's x, then above by the TCP's y
    right = "0" * (CELLS // 2) + "4" * (CELLS // 2)
    assert set(found["hand", "from above", "undecided"].rows) == {right}
    assert set(found["hand", "from the side", "refuted"].rows) == {right}
    tcp = found["TCP", "from above", "refuted"]
    assert tcp.rows == ("4" * CELLS,) * 10 + ("0" * CELLS,) * 10
    assert (tcp.classes[:, :10] == 4).all()
    assert (tcp.low_m, tcp.high_m) == (SEEN_REGION.tcp_low_m[:2], SEEN_REGION.tcp_high_m[:2])


def test_what_is_not_claimed_counts_nowhere() -> None:
    found = maps([1], [OUTSIDE, PROVEN])["hand", "from above", "undecided"]
    assert found.rows == ("-" * CELLS,) * 10 + ("0" * CELLS,) * 10
    assert (found.classes[:, :10] == -1).all()


def test_a_leaf_narrower_than_a_cell_is_a_share_of_it() -> None:
    levels = [[2]] + [[2, PROVEN]] * 6 + [[UNDECIDED, PROVEN]]  # 1/128 of the height, of a cell 1/20
    found = maps(*levels)["hand", "from the side", "undecided"]
    assert found.rows[0] == "3" * CELLS  # 15.6 %
    assert set(found.rows[1:]) == {"0" * CELLS}
