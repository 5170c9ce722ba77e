"""Two campaigns are compared in pairs only where each pair is the same scenario, and both sides decide."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from safety_harness.cli.main import app

SPACE = """scenario space: a hand comes to a place beside the wrist, which may lean there
duration: 3 s
avoider: opposite pose
choices:
  lean: from -30 deg to 30 deg
tcp start:
  offset: [0 mm, 0 mm, 40 mm]
  tilt: [the lean, 0 deg, 0 deg]
hands:
  - hand: right hand
    starts at: [1300 mm, -1000 mm, 400 mm]
    elbow towards: [1700 mm, -1300 mm, 400 mm]
    moves:
      - move to: [700 mm, -260 mm, 600 mm]
        speed: 1.6 m/s
claims:
  hand distance never below 50 mm: holds
"""
PROGRAM = """import numpy as np
from safety_harness import Move
class Still:
    name, sees = "still", ("joints",)
    def reset(self, *, settings, arm, start, seed): self.n = len(arm.joint_names)
    def act(self, seen): return Move(joint_velocity_radps=np.zeros(self.n))
class StillSeeing(Still):
    name, sees = "still, seeing", ("joints", "object")
class Failing(Still):
    name = "failing"
    def act(self, seen): raise RuntimeError("always")
"""
RUNS = 12


@pytest.fixture(scope="module")
def ledgers(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("pairs")
    (folder / "lean.yaml").write_text(SPACE)
    (folder / "still.py").write_text(PROGRAM)
    found = {}
    for name in ("Still", "StillSeeing", "Failing"):
        plan = folder / f"{name}.yaml"
        plan.write_text(
            f"plan: {name}\ncontroller: still.py:{name}\nworld: kinematic\nseed: 1\nstrata:\n"
            f"  - stratum: s\n    space: lean.yaml\n    runs: {RUNS}\nclaims:\n"
            "  - claim: hand distance never below 110 mm\n    violated in at most: 50 %\n"
        )
        found[name] = folder / f"{name}.sqlite"
        CliRunner().invoke(
            app, ["campaign", "run", str(plan), "--ledger", str(found[name]), "--workers", "1"]
        )
    return found


def compared(*words: object) -> tuple[int, str]:
    made = CliRunner().invoke(app, ["campaign", "compare", *map(str, words)])
    return made.exit_code, made.output + getattr(made, "stderr", "")


def test_pairs_of_different_scenarios_are_refused_and_counted(ledgers: dict[str, Path]) -> None:
    """Two controllers that do the same, one of which sees the object: admission draws other scenarios."""
    code, said = compared(ledgers["Still"], ledgers["StillSeeing"])
    assert code == 2
    assert f"of {RUNS} pairs whose scenarios differ" in said


def test_a_side_without_a_decided_run_is_not_comparable(ledgers: dict[str, Path]) -> None:
    code, said = compared(ledgers["Still"], ledgers["Failing"])
    assert code == 1
    assert "not comparable" in said
    assert "nan" not in said
