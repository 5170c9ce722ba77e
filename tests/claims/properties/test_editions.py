"""`protective separation kept` means 2 m/s; what was made when it meant 1.6 m/s is read with 1.6 m/s."""

from __future__ import annotations

from pathlib import Path

import pytest

from safety_harness.admission.claims import property_of
from safety_harness.claims.properties.protective_separation import ProtectiveSeparation
from safety_harness.scenario.model import EDITION, Claim, Scenario, Verdict
from safety_harness.scenario.read import parse_scenario

ROOT = Path(__file__).parents[3]
SENTENCE = "protective separation kept"
TEXT = (ROOT / "scenarios/stops-in-time.yaml").read_text()


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    """A shipped one."""
    return parse_scenario(TEXT, ROOT / "scenarios/stops-in-time.yaml")


@pytest.mark.parametrize(("edition", "speed_mps"), [(1, 1.6), (EDITION, 2.0)])
def test_the_same_sentence_takes_the_speed_of_its_edition(
    scenario: Scenario, edition: int, speed_mps: float
) -> None:
    found = property_of(Claim(sentence=SENTENCE, expected=Verdict.HOLDS, edition=edition), scenario)
    assert isinstance(found, ProtectiveSeparation)
    assert (found.sentence, found.assumed_mps) == (SENTENCE, speed_mps)


def test_a_named_speed_means_the_same_in_every_edition(scenario: Scenario) -> None:
    for edition in range(1, EDITION + 1):
        claim = Claim(sentence=f"{SENTENCE} at 0.8 m/s", expected=Verdict.HOLDS, edition=edition)
        found = property_of(claim, scenario)
        assert isinstance(found, ProtectiveSeparation)
        assert found.assumed_mps == 0.8
