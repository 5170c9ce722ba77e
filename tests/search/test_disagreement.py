"""A finding that PyBullet does not show comes with the run of either world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from safety_harness.admission.admit import Admitted
from safety_harness.scenario.model import OffsetStart, Scenario
from safety_harness.search.confirm import Complaint
from safety_harness.search.cube import Column, Cube
from safety_harness.search.disagreement import disagreement_of
from safety_harness.search.findings import Findings, Group
from safety_harness.search.outcomes import Goal, Outcomes
from safety_harness.search.trials import in_kinematic
from safety_harness.space.read import parse_space
from safety_harness.trace.trace import Trace
from tests.search.short_space import TEXT


@pytest.fixture(scope="module")
def found() -> Scenario:
    return replace(parse_space(TEXT).draw(1, 0), avoider="opposite pose")


def group() -> Group:
    findings = Findings((Goal("hand distance never below 150 mm", 0.1),), Cube((Column(),)), "default")
    findings.add(np.array([[0.5]]), Outcomes.of_margins(np.array([[-0.1]])))
    return findings.groups[0]


def far_away(admitted: Sequence[Admitted]) -> list[Trace | Exception]:
    """A world in which hands are a metre farther away."""
    runs = []
    for run in in_kinematic(admitted):
        assert isinstance(run, Trace)
        ticks = run.ticks.copy()
        ticks["hand_distance_m"] += 1.0
        runs.append(replace(run, ticks=ticks))
    return runs


def test_both_runs_are_of_the_same_scenario_and_only_one_shows_it(found: Scenario) -> None:
    claim = next(claim for claim in found.claims if "hand distance" in claim.sentence)
    complaint = Complaint(claim)
    one = disagreement_of(group(), complaint, found, in_kinematic, far_away)
    for run in (one.searched, one.confirming):
        assert isinstance(run, Trace)
        assert run.scenario.claims == (claim,)
        assert run.scenario.hands == found.hands
    assert complaint.is_in(one.searched)
    assert one.searched is not one.confirming


def test_a_scenario_that_can_no_longer_be_tried_has_the_reason_in_place_of_runs(found: Scenario) -> None:
    below = replace(found, start=OffsetStart(offset_in_base_m=(0.0, 0.0, -0.5)))
    one = disagreement_of(group(), Complaint(found.claims[0]), below, in_kinematic, in_kinematic)
    assert isinstance(one.searched, Exception)
    assert isinstance(one.confirming, Exception)
    assert "tcp start" in str(one.searched)
