"""Worlds held against a recorded cell whose truth is known: they find what was planted, and nothing else."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cells_made import CELL, write_log
from typer.testing import CliRunner

from safety_harness.admission.admit import Admitted
from safety_harness.admission.trial import judge
from safety_harness.base.exceptions import InputError
from safety_harness.cli.main import app
from safety_harness.extensions.field.recorded import compare
from safety_harness.extensions.field.recorded.apart import Estimate, fit_of
from safety_harness.extensions.field.recorded.compare import (
    FILE,
    ClaimOfBoth,
    WorldBeside,
    beside,
    read_comparison,
)
from safety_harness.extensions.field.recorded.scenario import FromLog, read_part, scenario_from
from safety_harness.scenario.model import Verdict
from safety_harness.scenario.read import parse_scenario
from safety_harness.trace.trace import Trace

CLAIMS = ("hand distance never below 150 mm: violated", "hand distance never below 20 mm: holds")
OFFSET_RAD = np.array([0.004, -0.002, 0.001, 0.0, 0.003, -0.005])


def from_log(trace: Trace, folder: Path, **planted: object) -> FromLog:
    log = write_log(trace, folder, *CLAIMS, **planted)  # type: ignore[arg-type]
    return scenario_from(read_part(log), parse_scenario(CELL))


def compared(trace: Trace, folder: Path, **planted: object) -> WorldBeside:
    """The very run beside its log, in which something was planted."""
    made = from_log(trace, folder, **planted)
    simulated = replace(trace, scenario=replace(trace.scenario, claims=made.scenario.claims))
    return beside(made.trace, simulated, judge(made.trace), judge(simulated), world="kinematic")


def holds(found: Estimate, planted: float, *, within: float) -> bool:
    assert found.low is not None
    assert found.high is not None
    assert found.high - found.low < 2.0 * within
    return abs(found.value - planted) <= within


def test_all_worlds_lie_where_they_were_recorded(log: Path, cell: Path, tmp_path: Path) -> None:
    given = ["compare-worlds", str(log), "--scenario", str(cell), "--out", str(tmp_path)]
    found = CliRunner().invoke(app, given)
    assert found.exit_code == 0, found.output
    read = read_comparison(tmp_path / FILE)
    assert [world.world for world in read.worlds] == ["PyBullet", "kinematic", "MuJoCo"]
    for world, most in zip(read.worlds, (1e-4, 1e-9, 1e-9), strict=True):
        assert len(world.joints) == 6
        assert max(one.largest for one in world.joints) < most
        assert world.tcp is not None
        assert world.tcp.largest < most
        (near,) = world.closest
        assert near.recorded_least_m is not None
        assert near.recorded_least_m <= near.simulated_m <= near.recorded_most_m
        assert [claim.decided for claim in world.claims] == [True, True]
        assert world.contradicted == 0
    names = [name for name, _ in read.files]
    assert [Path(name).name for name in names] == [
        *("joints.csv", "hands.csv", "LOG.yaml", "cell.yaml", "LOG-right-hand.csv")
    ]


def test_what_is_recorded_late_and_off_is_found(happened: Trace, tmp_path: Path) -> None:
    found = compared(happened, tmp_path / "planted", late_s=0.024, offset_rad=OFFSET_RAD)
    assert found.fit is not None
    assert found.fit.late is not None
    assert holds(found.fit.late, 0.024, within=1e-4)
    for estimate, planted in zip(found.fit.offsets, OFFSET_RAD, strict=True):
        assert holds(estimate, planted, within=1e-5)
    assert found.fit.left < 1e-5 < 1e-3 < found.fit.before
    for joint, planted in zip(found.joints, OFFSET_RAD, strict=True):
        assert joint.largest >= abs(planted) - 1e-9


def test_nothing_is_found_where_nothing_was_planted(happened: Trace, tmp_path: Path) -> None:
    found = compared(happened, tmp_path / "plain")
    assert found.fit is not None
    assert found.fit.late is not None
    assert abs(found.fit.late.value) < 1e-9
    assert max(abs(one.value) for one in found.fit.offsets) < 1e-9
    assert max(one.largest for one in (*found.joints, *found.distances)) < 1e-5


def test_intervals_hold_what_was_planted_as_often_as_they_say() -> None:
    time_s = np.arange(0.0, 8.0, 0.008)
    true = 0.4 * np.sin(np.outer(time_s, [0.9, 1.7, 2.3]))
    held = np.zeros(4)
    runs = 40
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        noise = 2e-3 * rng.standard_normal((len(time_s) + 4, 3))
        noise = sum(noise[k : k + len(time_s)] for k in range(5))  # of samples that follow each other closely
        late = np.column_stack([np.interp(time_s - 0.017, time_s, column) for column in true.T])
        found = fit_of(time_s, late + 0.003 + noise, time_s, true)
        assert found is not None
        assert found.late is not None
        for k, (one, planted) in enumerate([(found.late, 0.017), *((off, 0.003) for off in found.offsets)]):
            held[k] += one.low <= planted <= one.high  # type: ignore[operator]
    assert (held >= 0.85 * runs).all(), held
    assert held.sum() < 4 * runs  # they are no wider than they have to be


def test_an_arm_that_stands_shows_no_delay() -> None:
    time_s = np.arange(0.0, 2.0, 0.008)
    still = np.zeros((len(time_s), 2))
    found = fit_of(time_s, still + 0.01, time_s, still)
    assert found is not None
    assert found.late is None
    assert "hardly change" in found.why
    assert [one.value for one in found.offsets] == pytest.approx([0.01, 0.01])


def test_a_run_in_which_a_claim_holds_that_was_violated_is_optimistic() -> None:
    def claim(recorded: Verdict, simulated: Verdict) -> ClaimOfBoth:
        margins = {"recorded_margin": "-", "simulated_margin": "-"}
        return ClaimOfBoth(sentence="one", recorded=recorded, simulated=simulated, **margins)

    worse = claim(Verdict.VIOLATED, Verdict.HOLDS)
    assert (worse.differs, worse.optimistic) == (True, True)
    better = claim(Verdict.HOLDS, Verdict.VIOLATED)
    assert (better.differs, better.optimistic) == (True, False)
    unknown = claim(Verdict.INCONCLUSIVE, Verdict.HOLDS)
    assert (unknown.decided, unknown.differs) == (False, False)


def test_a_contradicted_verdict_ends_with_1(
    happened: Trace, cell: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The recorded arm was turned away from the hand, and the simulated one is not."""
    away = np.array([0.2, 0.0, 0.0, 0.0, 0.0, 0.0])
    log = write_log(happened, tmp_path / "off", "hand distance never below 20 mm: holds", offset_rad=away)
    monkeypatch.setattr(compare, "run_trial", lambda admitted, world: again(happened, admitted))
    given = ["compare-worlds", str(log), "--scenario", str(cell), "--out", str(tmp_path)]
    found = CliRunner().invoke(app, given)
    assert found.exit_code == 1, found.output
    assert found.stdout.count("DIFF hand distance never below 20 mm: recorded holds") == 3
    assert [world.contradicted for world in read_comparison(tmp_path / FILE).worlds] == [1, 1, 1]


def again(trace: Trace, admitted: Admitted) -> Trace:
    return replace(trace, scenario=replace(trace.scenario, claims=admitted.scenario.claims))


def test_what_is_no_comparison_is_refused(tmp_path: Path) -> None:
    file = tmp_path / FILE
    file.write_text('{"format": "safety-harness recorded cell 1", "log": 3}')
    with pytest.raises(InputError, match="log"):
        read_comparison(file)
