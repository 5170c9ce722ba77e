"""The search at its own speed with a user's file that hangs for good, or ends its process, in one corner."""

from __future__ import annotations

from pathlib import Path

import pytest

from safety_harness.search.cube import Cube
from safety_harness.search.default import Default
from safety_harness.search.search import find_violations
from safety_harness.search.trials import Trials, in_kinematic
from tests.search.broken_avoiders import SPACE

FILE = """\
import os, time
from tests.search.broken_avoiders import Hangs
from safety_harness import Proposal
class Mine(Hangs):
    def propose(self, *, hand_position_in_base_m, **others):
        while hand_position_in_base_m[0] > 0.84 and hand_position_in_base_m[2] < 0.3:
            try:
                BAD
            except BaseException:
                pass
        return super().propose(hand_position_in_base_m=hand_position_in_base_m, **others)
"""


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        ("time.sleep(60)", "the run failed: NoAnswerError: the avoider 'hangs' gave no answer within"),
        ("os._exit(3)", "its process ended with exit status 3"),
    ],
)
def test_it_is_found_and_the_search_goes_on(bad: str, words: str, tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text(FILE.replace("BAD", bad))
    cube = Cube.from_space(SPACE)
    trials = Trials(SPACE, in_kinematic, seed=0, avoider=f"{file}:Mine")
    found = find_violations(
        cube,
        trials.goals,
        trials,
        Default(cube, claims=len(trials.goals), seed=0),
        budget=300,
        enough=lambda findings: bool(findings.of_claim(None)),
    )
    (group,) = found.of_claim(None)
    assert words in group.kind
    assert found.evidence.max() >= found.tried - 20  # the others have their margins
