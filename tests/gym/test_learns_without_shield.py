"""An agent learns without a shield, and its actions count in their own tick."""

from __future__ import annotations

import pytest

from safety_harness.base.exceptions import InadmissibleError
from safety_harness.cell.simulation.worlds import KINEMATIC
from safety_harness.extensions.gym.episodes import Episodes
from safety_harness.scenario.read import parse_scenario

TEXT = """
scenario: nobody is there
duration: 1 s
tcp start: {offset: [0 mm, 0 mm, 0 mm]}
claims:
  joint speeds within limits: holds
"""


def test_an_agent_learns_without_one() -> None:
    shielded = parse_scenario(TEXT + "shield: speed and separation\n")
    with pytest.raises(InadmissibleError, match=r":7: shield: expected no shield"):
        Episodes(shielded, None, KINEMATIC)


def test_actions_that_would_count_later_are_refused() -> None:
    slow = parse_scenario(TEXT + "settings: {avoidance: {decision time: 40 ms}}\n")
    with pytest.raises(InadmissibleError, match=r"avoidance.decision time: expected no decision time"):
        Episodes(slow, None, KINEMATIC)
