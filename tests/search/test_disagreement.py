"""A finding that PyBullet does not show comes with the run of either world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from safety_harness.admission.admit import Admitted
from safety_harness.scenario.model import OffsetStart, Scenario, Verdict
from safety_harness.search.confirm import Complaint, disagreement_of
from safety_harness.search.cube import Column, Cube
from safety_harness.search.findings import Findings, Goal, Group, Outcomes
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


def without_hands(admitted: Sequence[Admitted]) -> list[Trace | Exception]:
    """A world that no hand comes into."""
    return in_kinematic([replace(one, scenario=replace(one.scenario, hands=())) for one in admitted])


def broken(admitted: Sequence[Admitted]) -> list[Trace | Exception]:
    """A world in which nothing runs."""
    return [RuntimeError("no engine") for _ in admitted]


def test_the_scenario_is_run_in_either_world_and_judged_by_what_is_complained_about_alone(
    found: Scenario,
) -> None:
    claim = next(claim for claim in found.claims if "hand distance" in claim.sentence)
    one = disagreement_of(group(), Complaint(claim), found, in_kinematic, without_hands)
    for world, verdict in ((one.searched, Verdict.VIOLATED), (one.confirming, Verdict.INCONCLUSIVE)):
        assert world is not None
        assert isinstance(world.run, Trace)
        assert world.run.scenario.claims == (claim,)
        assert [evaluation.verdict for evaluation in world.evaluations] == [verdict]


def test_a_world_in_which_nothing_runs_has_the_reason_in_place_of_a_run(found: Scenario) -> None:
    one = disagreement_of(group(), Complaint(found.claims[0]), found, in_kinematic, broken)
    assert one.confirming is not None
    assert str(one.confirming.run) == "no engine"
    assert one.confirming.evaluations == ()


def test_a_scenario_that_can_no_longer_be_tried_has_the_reason_in_place_of_runs(found: Scenario) -> None:
    below = replace(found, start=OffsetStart(offset_in_base_m=(0.0, 0.0, -0.5)))
    one = disagreement_of(group(), Complaint(found.claims[0]), below, in_kinematic, in_kinematic)
    assert one.searched is not None
    assert isinstance(one.searched.run, Exception)
    assert "tcp start" in str(one.searched.run)
    assert one.searched.evaluations == ()
