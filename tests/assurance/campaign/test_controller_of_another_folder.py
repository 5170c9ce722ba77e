"""A plan's controller may lie in another folder than the space: its stored runs still name it."""

from __future__ import annotations

from pathlib import Path

import pytest

from safety_harness.admission.admit import admit
from safety_harness.extensions.assurance.campaign.episodes import EpisodeRunner, trace_of
from safety_harness.extensions.assurance.campaign.plan import read_plan
from tests.assurance.campaign.plans import PLAN
from tests.search.short_space import TEXT

STAND = """\
from safety_harness import Stop


class Stand:
    name, sees = "stand", ()

    def reset(self, **begins):
        pass

    def act(self, seen):
        return Stop()
"""


def test_a_stored_run_names_the_controller_as_the_plan_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A trace drops folders that only this machine has; the plan knows where its controller is."""
    monkeypatch.setattr(Path, "home", lambda: tmp_path / "somebody")
    for folder in ("plans", "spaces"):
        (tmp_path / folder).mkdir()
    (tmp_path / "plans" / "ctrl.py").write_text(STAND)
    (tmp_path / "spaces" / "short.yaml").write_text(TEXT)
    text = PLAN.replace("avoider: opposite pose", "controller: ctrl.py:Stand")
    text = text.replace("space: short.yaml", "space: ../spaces/short.yaml")
    file = tmp_path / "plans" / "plan.yaml"
    file.write_text(text.replace("random traces: 2", "random traces: 20"))
    plan = read_plan(file)
    (row,) = EpisodeRunner(plan, programs=True).run(0, [0])
    assert row.trace
    scenario = trace_of(plan, 0, row.trace).scenario
    assert scenario.controller == "../plans/ctrl.py:Stand"
    assert admit(scenario).scenario.driven
