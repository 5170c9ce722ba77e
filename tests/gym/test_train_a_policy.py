"""The example that trains a policy: what it writes is a controller."""

from __future__ import annotations

from pathlib import Path

import pytest
from examples import VISIT, scenario

from safety_harness.admission.admit import admit
from safety_harness.admission.avoiders import with_avoider
from safety_harness.admission.trial import run_kinematic
from safety_harness.scenario.model import Driver

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")  # of the batch, which is larger than what so short a training has
def test_a_policy_of_a_few_actions_drives_the_arm(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    import train_a_policy  # type: ignore[import-not-found]

    trained = train_a_policy.train(256, lanes=2)
    train_a_policy.write_onnx(trained, tmp_path / "policy.onnx")
    tried = with_avoider(scenario(VISIT, duration_s=0.4), Driver(tmp_path / "policy.onnx"))
    trace = run_kinematic(admit(tried))
    assert trace.complete
    assert trace.system.controller.name == "learned policy"
    assert trace.ticks["demanded_joint_velocity_radps"].any()
    session = pytest.importorskip("onnxruntime").InferenceSession(tmp_path / "policy.onnx")
    assert session.get_modelmeta().custom_metadata_map["ticks"] == "5"
