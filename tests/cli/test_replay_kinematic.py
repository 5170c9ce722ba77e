"""A trace is repeated in the world that it comes from."""

from __future__ import annotations

from pathlib import Path

import pytest
from examples import VISIT, scenario

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_many
from safety_harness.cli.console import AS_EXPECTED
from safety_harness.cli.scenario_commands import replay
from safety_harness.trace.store import save_trace


def test_a_kinematic_trace_is_repeated_in_the_kinematic_world(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (trace,) = run_many([admit(scenario(VISIT, duration_s=1.4, avoider="mc-dropout"))])
    assert len(trace.decisions) > 0
    save_trace(trace, tmp_path / "visit.trace")
    assert replay(tmp_path / "visit.trace") == AS_EXPECTED
    assert "identical: example" in capsys.readouterr().out
