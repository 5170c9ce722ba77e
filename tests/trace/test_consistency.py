"""A trace that no run can have written is refused when it is read, with the field and the record."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples import run, scenario

from safety_harness.base.exceptions import TraceError
from safety_harness.scenario.faults import AvoiderLate, CameraBlind
from safety_harness.trace.consistency import CHECKS, first_inconsistency
from safety_harness.trace.store import load_trace, save_trace
from safety_harness.trace.trace import Trace


def edited(trace: Trace, what: str, field: str, index: int, value: object) -> Trace:
    """A copy with one value changed in ``ticks`` or ``decisions``."""
    records = getattr(trace, what).copy()
    records[field][index] = value
    return replace(trace, **{what: records})


def test_real_traces_are_consistent_whole_and_cut_short(visit: Trace) -> None:
    assert first_inconsistency(visit) is None
    quiet = run(scenario(duration_s=0.1))
    assert first_inconsistency(quiet) is None
    cut = replace(
        visit, ticks=visit.ticks[:30].copy(), decisions=visit.decisions[:0].copy(), ended="interrupted"
    )
    assert first_inconsistency(cut) is None
    assert first_inconsistency(replace(cut, ticks=visit.ticks[:0].copy())) is None


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("time_s", 0.0561),
        ("time_s", np.nan),
        ("time_s", np.inf),
        ("hand_present", [True, True]),
        ("hand_present", [False, False]),
        ("hand_distance_capsule", [-1, -1]),
        ("hand_distance_capsule", [0, 3]),
        ("sse", -1e-9),
        ("mode", 4),
        ("mode", -1),
        ("limits", 32),
        ("limits", -1),
        ("faults", 1),
        ("faults", -1),
        ("decision", 0),
        ("decision", -2),
    ],
)
def test_a_tick_that_no_run_writes_is_named(field: str, value: object, visit: Trace) -> None:
    found = first_inconsistency(edited(visit, "ticks", field, 7, value))
    assert found is not None
    assert found.where == f"{field} at tick 7"


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("tick", -1),
        ("tick", 10**6),
        ("time_s", 0.5),
        ("time_s", np.nan),
        ("trigger", 3),
        ("outcome", 3),
        ("outcome", -1),
        ("proposed_failed", 1 << 20),
        ("opposite_failed", -1),
    ],
)
def test_a_decision_that_no_run_writes_is_named(field: str, value: object, visit: Trace) -> None:
    found = first_inconsistency(edited(visit, "decisions", field, 0, value))
    assert found is not None
    assert found.where == f"{field} at decision 0"


def test_a_flag_that_is_neither_0_nor_1_is_named(visit: Trace) -> None:
    ticks = visit.ticks.copy()
    ticks["object_visible"].view(np.uint8)[7] = 2
    found = first_inconsistency(replace(visit, ticks=ticks))
    assert found is not None
    assert found.where == "object_visible at tick 7"


def test_each_check_of_the_ticks_has_a_bit_of_its_own_and_is_told_by_it(visit: Trace) -> None:
    """A tick that fails them one after another: what is told is in the order of the checks, none twice."""
    wrong: list[tuple[str, object]] = [
        ("time_s", -1.0),
        ("hand_present", 2),
        ("object_visible", 2),
        ("track_valid", 2),
        ("hand_present", 0),
        ("hand_distance_capsule", [-1, -1]),
        ("tcp_speed_mps", -1.0),
        ("sse", -1.0),
        ("predicted_distance_m", -1.0),
        ("mode", 99),
        ("limits", 1 << 20),
        ("faults", 1 << 20),
        ("decision", 10**6),
    ]
    assert len(wrong) == CHECKS
    for k, (field, _) in enumerate(wrong):
        ticks = visit.ticks.copy()
        for later, (other, worse) in enumerate(wrong[k:]):
            records = ticks[other].view(np.uint8) if ticks[other].dtype == np.bool_ else ticks[other]
            records[20 - later] = worse  # the others fail earlier in the run, and are told later
        found = first_inconsistency(replace(visit, ticks=ticks))
        assert found is not None
        assert found.where == f"{field} at tick 20", (k, str(found))


def test_a_fault_acts_within_its_time_and_a_late_avoider_until_the_deadline(visit: Trace) -> None:
    faults = (CameraBlind(from_s=0.16, until_s=0.32), AvoiderLate(delay_s=0.05, from_s=0.16, until_s=0.32))
    judged = replace(visit, scenario=replace(visit.scenario, faults=faults))
    assert first_inconsistency(judged) is None
    for tick, bits, good in (
        (20, 3, True),
        (19, 1, False),
        (39, 1, True),
        (40, 1, False),
        (19, 2, False),
        (52, 2, True),
        (54, 2, False),
        (30, 4, False),
    ):
        found = first_inconsistency(edited(judged, "ticks", "faults", tick, bits))
        assert (found is None) is good, (tick, bits)
        assert found is None or found.where == f"faults at tick {tick}"


def test_text_that_is_no_text_is_named(visit: Trace) -> None:
    for code in (0x110000, 0xD800):
        decisions = visit.decisions.copy()
        decisions["fault"].view(np.uint32)[0] = code
        found = first_inconsistency(replace(visit, decisions=decisions))
        assert found is not None
        assert found.where == "fault at decision 0"


def test_decisions_out_of_order_moved_left_out_or_added_are_noticed(visit: Trace) -> None:
    moved = visit.decisions.copy()
    moved["tick"] += 1
    moved["time_s"] = visit.time_s[moved["tick"]]
    assert first_inconsistency(replace(visit, decisions=moved)) is not None
    for decisions in (visit.decisions[:0].copy(), np.concatenate([visit.decisions, visit.decisions])):
        assert first_inconsistency(replace(visit, decisions=decisions)) is not None
    twice = first_inconsistency(replace(visit, decisions=np.concatenate([visit.decisions] * 2)))
    assert twice is not None
    assert (twice.field, twice.what, twice.index) == ("tick", "decision", len(visit.decisions))


def test_a_run_that_says_it_is_complete_has_every_tick(visit: Trace) -> None:
    short = replace(visit, ticks=visit.ticks[:-1].copy())
    found = first_inconsistency(short)
    assert found is not None
    assert found.where == "ticks"
    long = replace(visit, scenario=replace(visit.scenario, duration_s=1.0), ended="interrupted")
    assert first_inconsistency(long) is not None


@pytest.mark.parametrize(
    ("what", "field", "value", "where"),
    [
        ("ticks", "mode", 99, "mode at tick 7"),
        ("ticks", "time_s", 0.2, "time_s at tick 7"),
        ("decisions", "tick", 10**9, "tick at decision 0"),
    ],
)
def test_an_edited_trace_with_new_hashes_is_refused_with_field_and_record(
    what: str, field: str, value: object, where: str, visit: Trace, tmp_path: Path
) -> None:
    file = tmp_path / "edited.trace"
    save_trace(edited(visit, what, field, 7 if what == "ticks" else 0, value), file)  # hashes it anew
    with pytest.raises(TraceError) as caught:
        load_trace(file)
    assert (caught.value.place.file, caught.value.place.field) == (file, where)
