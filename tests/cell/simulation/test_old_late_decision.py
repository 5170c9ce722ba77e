"""Traces of the format before this one: read as they were, and late by the wall's clock where they were."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples import VISIT, hand, scenario

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_kinematic
from safety_harness.base.exceptions import TraceError
from safety_harness.cell.avoidance.asking import Answer, late_fault
from safety_harness.cell.avoidance.avoider import Avoider, Proposal
from safety_harness.cell.avoidance.gate import Gate, GateDecision, Query
from safety_harness.scenario.faults import AvoiderLate, AvoiderSilent, Fault
from safety_harness.scenario.moves import MoveTo, Wait
from safety_harness.trace.compare import first_difference
from safety_harness.trace.records import Check, DecisionOutcome
from safety_harness.trace.store import DECISION_3, load_trace, save_trace
from safety_harness.trace.trace import Trace

STAYS = hand(MoveTo(position_in_base_m=(0.79, -0.27, 0.3), speed_mps=1.0), Wait(duration_s=9.0))


class Upwards:
    name = "upwards"

    def propose(self, *, tcp_position_in_base_m: np.ndarray, **rest: object) -> Proposal:
        return Proposal(tcp_position_in_base_m + [0.0, 0.0, 0.1])


class OnTheClock(Gate):
    """As the gate was: the first answer is thrown away at once, since the clock says so."""

    def rule(self, avoider: Avoider, query: Query) -> GateDecision:
        if query.seed != FIRST["seed"]:
            return super().rule(avoider, query)
        return self.rule_on(Answer(fault=late_fault(0.1), late=True), query)


FIRST: dict[str, int] = {}


def in_the_old_format(trace: Trace, path: Path) -> Path:
    """The file that the version before would have written."""
    save_trace(trace, path)
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    decisions = np.zeros(len(trace.decisions), DECISION_3)
    for name in DECISION_3.names or ():
        decisions[name] = trace.decisions[name]
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, decisions, allow_pickle=False)
    parts["decisions.npy"] = buffer.getvalue()
    lines = parts["scenario.yaml"].decode().splitlines()
    kept = [line for line in lines if "decision time" not in line and "wall limit" not in line]
    assert len(kept) == len(lines) - 2
    parts["scenario.yaml"] = "\n".join(kept).encode()
    header = json.loads(parts.pop("trace.json"))
    header["format"] = "safety-harness trace 3"
    header["sha256"] = {name: hashlib.sha256(data).hexdigest() for name, data in parts.items()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in {**parts, "trace.json": json.dumps(header).encode()}.items():
            archive.writestr(name, data)
    return path


@pytest.fixture(scope="module")
def late() -> Trace:
    """A run in which the wall's clock threw the first answer away, as runs of the version before could."""
    admitted = admit(scenario(VISIT, duration_s=1.6), avoider=Upwards())
    FIRST["seed"] = int(run_kinematic(admitted).decisions["seed"][0])
    controller = admitted.controller()
    controller.gate = OnTheClock(**vars(controller.gate))
    return run_kinematic(admitted, controller=controller)


def test_a_replay_is_late_where_an_old_record_is(late: Trace, tmp_path: Path) -> None:
    first = late.decisions[0]
    assert (first["proposed_failed"], first["outcome"]) == (Check.LATE, DecisionOutcome.OPPOSITE)
    stored = load_trace(in_the_old_format(late, tmp_path / "late.trace"))
    assert first_difference(late, stored) is None
    repeated = run_kinematic(admit(stored.scenario, avoider=Upwards()), recorded=stored)
    assert first_difference(stored, repeated) is None


def test_without_the_record_the_answer_counts(late: Trace) -> None:
    admitted = admit(scenario(VISIT, duration_s=1.6), avoider=Upwards())
    assert first_difference(late, run_kinematic(admitted)) is not None


@pytest.mark.parametrize("faults", [(AvoiderLate(delay_s=0.05),), (AvoiderSilent(until_s=2.0),), ()])
def test_when_the_avoider_was_asked_is_found_again_in_an_old_trace(
    faults: tuple[Fault, ...], tmp_path: Path
) -> None:
    trace = run_kinematic(admit(replace(scenario(STAYS, duration_s=3.0), faults=faults)))
    assert len(trace.decisions) > 1
    stored = load_trace(in_the_old_format(trace, tmp_path / "old.trace"))
    assert first_difference(trace, stored) is None


def test_an_old_trace_of_nonsense_is_refused_in_words(late: Trace, tmp_path: Path) -> None:
    decisions = late.decisions.copy()
    decisions["tick"][0] = 10**6
    with pytest.raises(TraceError, match="tick at decision 0"):
        load_trace(in_the_old_format(replace(late, decisions=decisions), tmp_path / "bad.trace"))


def test_latencies_are_stored_with_the_trace(late: Trace, tmp_path: Path) -> None:
    save_trace(late, tmp_path / "late.trace")
    stored = load_trace(tmp_path / "late.trace")
    assert len(stored.decision_latency_s) == len(stored.decisions)
    np.testing.assert_array_equal(stored.decision_latency_s, late.decision_latency_s)
