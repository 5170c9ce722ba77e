"""What was edited by hand is refused or inconclusive, and never a traceback."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples import VISIT, TowardsTheHand, run, scenario

from safety_harness.admission.claims import property_of
from safety_harness.admission.trial import judge
from safety_harness.base.exceptions import TraceError
from safety_harness.claims.properties.catalogue import CATALOGUE
from safety_harness.claims.signals.true_motion import first_untruth
from safety_harness.cli.console import BAD_INPUT
from safety_harness.cli.scenario_commands import judge as judge_again
from safety_harness.scenario.model import Claim, Verdict
from safety_harness.trace.records import DECISION, TICK
from safety_harness.trace.store import save_trace
from safety_harness.trace.trace import Trace

EVERY = tuple(Claim(sentence=entry.example, expected=Verdict.HOLDS) for entry in CATALOGUE)


@pytest.fixture(scope="module")
def claimed() -> Trace:
    """A short visit with every claim of the catalogue."""
    return run(replace(scenario(VISIT, duration_s=1.5), claims=EVERY))


def with_tick(trace: Trace, field: str, index: int, value: object) -> Trace:
    ticks = trace.ticks.copy()
    ticks[field][index] = value
    return replace(trace, ticks=ticks)


def test_the_truth_of_a_run_agrees_with_itself(claimed: Trace) -> None:
    assert first_untruth(claimed) is None
    assert first_untruth(run(scenario(duration_s=0.1))) is None
    assert len(judge(claimed)) == len(EVERY)


@pytest.mark.parametrize(
    ("field", "change", "named"),
    [
        ("joint_position_rad", 1e-6, "transform_tcp_to_base"),
        ("joint_position_rad", np.nan, "transform_tcp_to_base"),
        ("joint_velocity_radps", 1e-6, "tcp_speed_mps"),
        ("transform_tcp_to_base", 1e-6, "transform_tcp_to_base"),
        ("tcp_speed_mps", -1e-6, "tcp_speed_mps"),
        ("hand_distance_m", 1e-6, "hand_distance_m"),
        ("hand_position_in_base_m", 1e-3, "hand_distance_m"),
        ("elbow_position_in_base_m", 1e-3, "hand_position_in_base_m"),  # not the nearest part of the hand
    ],
)
def test_a_truth_that_was_edited_is_refused_with_field_and_tick(
    field: str, change: float, named: str, claimed: Trace
) -> None:
    changed = with_tick(claimed, field, 40, claimed.ticks[field][40] + change)
    with pytest.raises(TraceError) as caught:
        judge(changed, file=Path("edited.trace"))
    assert (caught.value.place.file, caught.value.place.field) == (
        Path("edited.trace"),
        f"{named} at tick 40",
    )


def test_hands_that_the_scenario_moves_elsewhere_are_refused(claimed: Trace) -> None:
    """Everything else is recomputed to fit: only the scenario tells."""
    other = run(replace(claimed.scenario, hands=(replace(VISIT, starts_at_in_base_m=(1.1, -0.75, 0.21)),)))
    swapped = replace(other, scenario=claimed.scenario)
    with pytest.raises(TraceError, match="hand_position_in_base_m at tick 0"):
        judge(swapped)
    distance = property_of(EVERY[0], claimed.scenario).evaluate(swapped)
    assert distance.verdict is Verdict.INCONCLUSIVE


def test_a_capsule_that_there_is_not_is_refused_and_no_index_error(claimed: Trace) -> None:
    nearest = int(np.argmin(claimed.ticks["hand_distance_m"][:, 0]))
    changed = with_tick(claimed, "hand_distance_capsule", nearest, [99, -1])
    with pytest.raises(TraceError, match=f"hand_distance_capsule at tick {nearest}"):
        judge(changed)
    for claim in EVERY:
        property_of(claim, changed.scenario).evaluate(changed)


@pytest.mark.filterwarnings("default")  # of arithmetic on nonsense
def test_whatever_is_in_a_record_no_property_raises_or_gives_an_infinite_margin(claimed: Trace) -> None:
    """Single values replaced by nonsense, each judged by the whole catalogue."""
    rng = np.random.default_rng(11)
    properties = [property_of(claim, claimed.scenario) for claim in EVERY]
    nonsense = (np.nan, np.inf, -np.inf, 1e300, -(2**62), 2**62, -1, 77)
    for number in range(150):
        what, layout = (("ticks", TICK), ("decisions", DECISION))[number % 2]
        records = getattr(claimed, what).copy()
        names = [name for name in layout.names or () if layout[name].base.kind in "fi"]
        name = names[rng.integers(len(names))]
        kind = layout[name].base.kind
        value = nonsense[rng.integers(len(nonsense)) if kind == "f" else rng.integers(4, 8)]
        flat = records[name].reshape(len(records), -1).copy()
        flat[rng.integers(len(records)), rng.integers(flat.shape[1])] = value
        records[name] = flat.reshape(records[name].shape)
        changed = replace(claimed, **{what: records})
        for prop in properties:
            evaluation = prop.evaluate(changed)
            assert evaluation.margin is None or np.isfinite(evaluation.margin)


def test_the_command_line_says_what_was_edited_and_ends_with_2(
    claimed: Trace, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its hashes are written anew: only what it says gives it away, on reading or on judging."""
    for field, value in (("mode", 9), ("tcp_speed_mps", 0.0)):
        file = tmp_path / f"{field}.trace"
        save_trace(with_tick(claimed, field, 60, value), file)
        assert judge_again([file]) == BAD_INPUT
        assert f"{field} at tick 60" in capsys.readouterr().err


def test_a_broken_avoider_in_a_true_trace_is_still_judged() -> None:
    trace = run(replace(scenario(VISIT, duration_s=1.0), claims=EVERY), avoider=TowardsTheHand())
    assert len(judge(trace)) == len(EVERY)
