"""The learned policy that ships: what it is called and hashed as, where it goes, what it needs."""

from __future__ import annotations

import hashlib
import sys

import numpy as np
import pytest
from examples import VISIT, scenario

from safety_harness.admission.admit import admit
from safety_harness.admission.avoiders import with_avoider
from safety_harness.admission.trial import run_kinematic
from safety_harness.base.exceptions import MissingPackageError
from safety_harness.cell.controller.named import LEARNED_FILE
from safety_harness.scenario.model import Driver
from safety_harness.scenario.references import LEARNED
from safety_harness.trace.trace import Trace


def driven(*hands: object, duration_s: float = 1.5) -> Trace:
    tried = with_avoider(scenario(*hands, duration_s=duration_s), Driver(LEARNED))  # type: ignore[arg-type]
    return run_kinematic(admit(tried))


def way_m(trace: Trace) -> np.ndarray:
    desired = trace.scenario.settings.cell.desired_tcp_position_in_base_m
    return np.linalg.norm(trace.ticks["transform_tcp_to_base"][:, :3, 3] - np.array(desired), axis=1)


def test_it_goes_to_the_desired_position_and_stays_there() -> None:
    trace = driven()
    assert way_m(trace)[0] > 0.1
    assert way_m(trace)[-50:].max() < 0.02
    assert trace.complete


def test_its_file_is_hashed_in_the_system_under_test_and_its_runtime_is_known() -> None:
    trace = driven(VISIT, duration_s=0.1)
    own = trace.system.controller
    assert own.name == LEARNED
    assert own.sha256 == hashlib.sha256(LEARNED_FILE.read_bytes()).hexdigest()
    assert "onnxruntime" in dict(trace.provenance.libraries)


def test_a_run_repeats_itself_and_is_another_where_a_hand_comes() -> None:
    first, again, alone = driven(VISIT), driven(VISIT), driven()
    np.testing.assert_array_equal(first.ticks["joint_position_rad"], again.ticks["joint_position_rad"])
    assert not np.array_equal(first.ticks["joint_position_rad"], alone.ticks["joint_position_rad"])


def test_it_takes_any_number_of_hands() -> None:
    session = pytest.importorskip("onnxruntime").InferenceSession(LEARNED_FILE)
    rows = {"predicted_hands": (3,), "predicted_hands_there": (), "predicted_hands_velocity_mps": (3,)}
    for count in (2, 4, 16):
        fed = {name: np.zeros((1, count, *shape), np.float32) for name, shape in rows.items()}
        fed["tcp_position_in_base_m"] = np.zeros((1, 3), np.float32)
        assert session.run(["tcp_velocity_mps"], fed)[0].shape == (1, 3)


def test_without_onnxruntime_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(MissingPackageError, match=r"learned policy: needs onnxruntime, .*\[onnx\]"):
        driven()
