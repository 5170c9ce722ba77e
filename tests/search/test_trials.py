"""Points of a space become runs: margins, refusals, mishaps, kinds and cells of coverage."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from partly_measured import partly_measured

from safety_harness.admission import trial
from safety_harness.admission.admit import Admitted, admit
from safety_harness.admission.trial import judge, run_many, run_trial
from safety_harness.base.exceptions import InadmissibleError, ScenarioError, SimulationError
from safety_harness.cell.simulation.worlds import WorldEntry
from safety_harness.scenario.model import Scenario, Verdict
from safety_harness.search.confirm import Complaint, Confirm, OtherDraws
from safety_harness.search.counterexample import circumstances, seen_of
from safety_harness.search.coverage import AXES, Coverage, CoverageCell, cell_of
from safety_harness.search.findings import Outcomes
from safety_harness.search.trials import Trials, in_kinematic, in_pybullet, least_hand_distance_m
from safety_harness.space.read import parse_space
from safety_harness.trace.known import NOT_MEASURED, Gap, Measurement
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import knowing
from tests.search.short_space import CRASHING, SHORT, TEXT

POINTS = np.array([[0.5, 0.2, 0.05], [0.5, 0.2, 0.95], [0.5, 0.9, 0.95]])  # slow, fast, fast from the front


@lru_cache
def outcomes() -> tuple[Trials, Outcomes]:
    trials = Trials(SHORT, in_pybullet, seed=3)
    return trials, trials(POINTS, 10)


@lru_cache
def fast_run() -> Trace:
    return run_trial(admit(outcomes()[0].scenario(POINTS[1], 11)))


def test_margins_are_those_that_the_scenario_gets_by_itself() -> None:
    trials, found = outcomes()
    *expected, answered = [evaluation.margin for evaluation in judge(fast_run())]
    assert found.margins[1].tolist() == expected
    assert answered == 0.0
    assert [goal.sentence for goal in trials.goals] == [claim.sentence for claim in SHORT.simplest.claims]
    assert found.margins[1, 0] < 0.0 < found.margins[0, 0]


def test_each_point_has_a_seed_of_its_own_that_its_number_gives_again() -> None:
    trials = outcomes()[0]
    seeds = [trials.scenario(POINTS[0], number).seed for number in (0, 1, 1)]
    assert seeds[0] != seeds[1]
    assert seeds[1] == seeds[2]
    assert Trials(SHORT, in_pybullet, seed=4).scenario(POINTS[0], 1).seed != seeds[1]


def test_a_point_that_admission_refuses_is_not_run_and_says_why() -> None:
    ran: list[Sequence[Admitted]] = []

    def world(admitted: Sequence[Admitted]) -> list[Trace | Exception]:
        ran.append(admitted)
        return in_pybullet(admitted)

    space = parse_space(TEXT.replace("[0 mm, from -40 mm", "[from 0 mm to 3 m, from -40 mm"))
    found = Trials(space, world)(np.array([[0.0, 0.5, 0.2, 0.5], [1.0, 0.5, 0.2, 0.5]]), 0)
    assert found.refused[0] == ""
    assert found.refused[1].startswith("tcp start")
    assert len(ran[0]) == 1
    assert np.isnan(found.margins[1]).all()
    assert not found.conclusive[1].any()


def test_a_mistake_in_the_text_is_no_refusal_of_a_point() -> None:
    with pytest.raises(InadmissibleError, match="a claim of the catalogue"):
        Trials(SHORT, in_pybullet, sentences=("hands are happy",))
    trials = Trials(SHORT, in_pybullet, avoider="nobody")
    with pytest.raises(InadmissibleError, match="nobody"):
        trials(POINTS, 0)


def test_a_space_that_claims_nothing_to_hold_cannot_be_searched() -> None:
    text = TEXT.replace(": holds", ": inconclusive")
    with pytest.raises(ScenarioError, match="a claim that holds or is violated"):
        Trials(parse_space(text), in_pybullet)


def test_a_run_that_breaks_is_a_mishap_without_margins() -> None:
    def broken(admitted: Sequence[Admitted]) -> list[Exception]:
        return [SimulationError("the world ended")] * len(admitted)

    trials = Trials(SHORT, broken)
    found = trials(POINTS, 0)
    assert set(found.mishaps) == {"the run failed: SimulationError: the world ended"}
    assert (sum(trials.coverage.counts.values()), trials.coverage.without) == (0, 0)  # of nothing is known
    assert np.isnan(found.margins).all()


def test_an_avoider_that_raises_in_a_corner_is_a_mishap_of_one_kind_whatever_its_numbers(
    tmp_path: Path,
) -> None:
    (tmp_path / "mine.py").write_text(CRASHING)
    trials = Trials(SHORT, in_pybullet, avoider=str(tmp_path / "mine.py") + ":Crashing")
    front = np.array([[0.5, 0.95, 0.95], [0.4, 0.99, 0.9]])
    found = trials(np.concatenate([POINTS[:2], front]), 0)
    assert found.mishaps[:2] == ["", ""]
    assert found.mishaps[2] == found.mishaps[3]
    assert "ZeroDivisionError: at ... (mine.py:" in found.mishaps[2]
    assert np.isfinite(found.margins[2]).all()


def test_ctrl_c_in_a_run_is_not_taken_for_a_result(monkeypatch: pytest.MonkeyPatch) -> None:
    from safety_harness.cell.simulation.pybullet_world import PyBulletWorld

    def step(world: PyBulletWorld, command: object) -> bool:
        raise KeyboardInterrupt

    monkeypatch.setattr(PyBulletWorld, "step", step)
    with pytest.raises(KeyboardInterrupt):
        Trials(SHORT, in_pybullet)(POINTS, 0)


def test_a_run_is_in_one_cell_of_the_coverage() -> None:
    trials, found = outcomes()
    assert found.cells[1] == CoverageCell("right", "to 1 m/s", "touching", "hand unseen", "proposed position")
    assert found.kinds[1] == "right, proposed position"
    assert sum(trials.coverage.counts.values()) == len(POINTS)
    assert cell_of(fast_run(), seen_of(fast_run().scenario)) == found.cells[1]


@pytest.mark.parametrize(
    "column", ["decision.outcome", "decision.tick", "hand_position_in_base_m", "transform_tcp_to_base"]
)
def test_a_run_of_which_not_all_was_measured_is_in_no_cell(column: str) -> None:
    lacking = knowing(fast_run(), {column: NOT_MEASURED})
    assert cell_of(lacking, seen_of(lacking.scenario)) is None
    others = knowing(fast_run(), {"gain": NOT_MEASURED, "limits": NOT_MEASURED})
    assert cell_of(others, seen_of(others.scenario)) is not None


def test_nothing_is_told_of_decisions_that_were_not_measured() -> None:
    assert circumstances(partly_measured(fast_run())) == ["what was decided was not measured"]
    assert len(circumstances(fast_run())) > 1


def test_the_nearest_hand_is_that_of_the_ticks_at_which_it_was_measured() -> None:
    run = fast_run()
    whole = least_hand_distance_m(run)
    tick = int(np.argmin(run.ticks["hand_distance_m"][:, 0]))
    gap = Measurement(gaps=(Gap(first=tick - 5, after=min(tick + 5, len(run.ticks))),))
    assert least_hand_distance_m(knowing(run, {"hand_distance_m": gap})) > whole
    assert least_hand_distance_m(knowing(run, {"hand_distance_m": NOT_MEASURED})) == np.inf


def test_coverage_counts_by_axis_by_two_and_says_what_is_missing() -> None:
    coverage = Coverage()
    cell = CoverageCell("left", "at rest", "farther", "seen", "no decision")
    coverage.add([cell, cell, CoverageCell("right", "at rest", "touching", "seen", "opposite pose"), None])
    assert coverage.without == 1
    assert coverage.along("direction") == dict.fromkeys(AXES["direction"], 0) | {"left": 2, "right": 1}
    assert coverage.table("direction", "outcome")["left"]["no decision"] == 2
    assert cell not in coverage.holes
    assert len(coverage.holes) == 6 * 4**4 - 2
    assert "left 2, right 1" in str(coverage)


def complaint() -> Complaint:
    return Complaint(SHORT.simplest.claims[0])


def test_confirming_runs_the_scenario_anew_and_believes_nothing() -> None:
    trials = outcomes()[0]
    confirm = Confirm(complaint(), in_pybullet)
    assert confirm(trials.scenario(POINTS[1], 11))
    assert not confirm(trials.scenario(POINTS[0], 10))


def test_a_violation_that_is_too_small_is_not_confirmed() -> None:
    trials, found = outcomes()
    by = -found.margins[1, 0]
    scenario = trials.scenario(POINTS[1], 11)
    assert Confirm(complaint(), in_pybullet, by=by)(scenario)
    assert not Confirm(complaint(), in_pybullet, by=1.001 * by)(scenario)


def test_what_cannot_be_tried_shows_no_violation() -> None:
    far = parse_space(TEXT.replace("offset: [0 mm", "offset: [3000 mm")).at([0.5, 0.2, 0.95])
    assert not Confirm(complaint(), in_pybullet)(far)


def test_a_mishap_is_confirmed_by_the_same_mishap_alone(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(CRASHING)
    trials = Trials(SHORT, in_pybullet, avoider=str(tmp_path / "mine.py") + ":Crashing")
    front = trials.scenario(np.array([0.5, 0.95, 0.95]), 0)
    seen = trials(np.array([[0.5, 0.95, 0.95]]), 0).mishaps[0]
    assert Confirm(Complaint(trials.answered, seen), in_pybullet)(front)
    assert not Confirm(Complaint(trials.answered, "something else"), in_pybullet)(front)


def test_other_draws_of_an_avoider_without_any_are_the_same_and_of_a_network_are_not() -> None:
    scenario: Scenario = outcomes()[0].scenario(POINTS[1], 11)
    assert Confirm(complaint(), in_pybullet).share_of_draws(scenario, 2) == 2
    network = admit(parse_space(TEXT.replace("opposite pose", "mc-dropout")).at([0.5, 0.2, 0.95])).avoider
    where = {
        "hand_position_in_base_m": np.array([0.8, -0.3, 0.1]),
        "tcp_position_in_base_m": np.array([0.7, 0, 0.4]),
    }
    first, second, again = (
        OtherDraws(network, stream).propose(**where, seed=5).position_in_base_m for stream in (0, 1, 0)
    )
    assert not np.array_equal(first, second)
    assert np.array_equal(first, again)
    assert OtherDraws(network, 0).spread_threshold_m == network.spread_threshold_m


def test_circumstances_say_where_it_was_and_what_was_decided() -> None:
    lines = circumstances(fast_run())
    assert lines[0].startswith("the run: right, to 1 m/s")
    assert any("decision 1 at" in line and "proposed" in line for line in lines[1:])


def test_the_verdict_decides_and_not_the_margin_alone() -> None:
    assert judge(fast_run())[0].verdict is Verdict.VIOLATED


def test_in_the_kinematic_world_all_points_together_come_out_as_each_alone() -> None:
    together = Trials(SHORT, in_kinematic, seed=3)(POINTS, 10)
    for k, point in enumerate(POINTS):
        alone = Trials(SHORT, in_kinematic, seed=3)(point[None], 10 + k)
        assert np.array_equal(together.margins[k], alone.margins[0])
        assert together.cells[k] == alone.cells[0]


def test_the_kinematic_world_leads_where_pybullet_does() -> None:
    kinematic = Trials(SHORT, in_kinematic, seed=3)(POINTS, 10)
    assert np.abs(kinematic.margins[:, 0] - outcomes()[1].margins[:, 0]).max() < 0.005


def test_what_breaks_the_batch_costs_the_others_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(admitted: Sequence[Admitted], *, world: WorldEntry) -> Iterator[Trace]:
        if len(admitted) > 1:
            raise SimulationError("the batch ended")
        return run_many(admitted, world=world)

    expected = Trials(SHORT, in_kinematic, seed=3)(POINTS, 10)
    monkeypatch.setattr(trial, "run_many", broken)
    found = Trials(SHORT, in_kinematic, seed=3)(POINTS, 10)
    assert np.array_equal(found.margins, expected.margins)
    assert set(found.mishaps) == {""}


def test_rendered_images_which_the_kinematic_world_has_not_are_run_in_pybullet() -> None:
    space = parse_space(TEXT.replace("duration: 400 ms", "duration: 16 ms\ncamera: {source: rendered}"))
    (run,) = in_kinematic([admit(space.simplest)])
    assert isinstance(run, Trace)
    assert run.provenance.world == "pybullet"
