"""What is said of a search as a whole."""

from __future__ import annotations

import numpy as np
import pytest

from safety_harness.search.coverage import CoverageCell
from safety_harness.search.cube import Column, Cube
from safety_harness.search.findings import Findings, Outcomes
from safety_harness.search.result_lines import remarks
from safety_harness.search.trials import Trials, in_kinematic
from tests.search.short_space import SHORT


@pytest.mark.parametrize("distance", ["touching", "to 50 mm", "farther"])
def test_nothing_found_is_never_said_beside_a_touch(distance: str) -> None:
    trials = Trials(SHORT, in_kinematic, sentences=("joint speeds within limits",))
    findings = Findings(trials.goals, Cube((Column(),)), "default")
    findings.add(np.array([[0.5], [0.6]]), Outcomes.of_margins(np.array([[0.1], [0.2]])))
    trials.nearest_hand_m = -0.01
    trials.coverage.add([CoverageCell("front", "to 1 m/s", distance, "seen", "opposite pose"), None])
    said = "\n".join(remarks(trials, findings))
    assert ("in 1 of 2 runs a hand touched the arm" in said) == (distance == "touching")
    assert ("nothing found" in said) == (distance != "touching")


def test_how_near_hands_came_is_said_of_every_search() -> None:
    trials = Trials(SHORT, in_kinematic, sentences=("joint speeds within limits",))
    trials(np.full((1, SHORT.dimension), 0.5), 0)
    findings = Findings(trials.goals, Cube((Column(),)), "default")
    said = "\n".join(remarks(trials, findings))
    assert f"nearest hand: {trials.nearest_hand_m * 1e3:+.1f} mm" in said
