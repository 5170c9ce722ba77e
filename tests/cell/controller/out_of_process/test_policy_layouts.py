"""Policies with the names of their exporters; axes that do not fit the scenario are refused before a run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
from examples import VISIT, scenario

from safety_harness.admission.admit import Admitted, Admitter, admit
from safety_harness.admission.avoiders import with_avoider
from safety_harness.admission.trial import run_kinematic
from safety_harness.base.exceptions import InadmissibleError, ModelError
from safety_harness.cell.controller.out_of_process.onnx_policy import OnnxPolicy
from safety_harness.scenario.model import NO_AVOIDER, Driver
from safety_harness.seams.contract import Move
from safety_harness.trace.records import TRACKS_PER_HAND
from tests.cell.controller.out_of_process.test_onnx_policy import TCP, VELOCITY, begun, moved, policy, seen

JOINTS, ROWS = "joint_position_rad", "hands"


def write(
    folder: Path, inputs: dict[str, tuple[object, ...]], outputs: dict[str, tuple[object, ...]]
) -> Path:
    """A file whose outputs are half of its first input."""
    nodes = [("Mul", [next(iter(inputs)), "half"], [name]) for name in outputs]
    (folder / "mine.onnx").write_bytes(policy(nodes, inputs, outputs))
    return folder / "mine.onnx"


def admitted(file: Path, layout: str = "") -> Admitted:
    reference = f"{file}:{layout}" if layout else str(file)
    return admit(with_avoider(scenario(VISIT, VISIT, duration_s=0.1), Driver(reference)))


def test_the_names_of_ml_agents_are_laid_out(tmp_path: Path) -> None:
    file = write(
        tmp_path, {"obs": ("batch", 3)}, {"continuous_actions": ("batch", 3), "version": ("batch", 3)}
    )
    layout = f"obs={TCP},continuous_actions={VELOCITY},version=unused"
    made = admitted(file, layout)
    trace = run_kinematic(made)
    assert trace.complete
    assert str(trace.system.controller.name) == f"ONNX policy mine.onnx:{layout}"


def test_a_link_by_the_name_of_a_policy_is_read_as_one(tmp_path: Path) -> None:
    """As download caches have it: the file that it leads to has no suffix."""
    write(tmp_path, {TCP: (1, 3)}, {VELOCITY: (1, 3)}).rename(tmp_path / "blob")
    (tmp_path / "mine.onnx").symlink_to(tmp_path / "blob")
    named = replace(scenario(duration_s=0.04), controller=str(tmp_path / "mine.onnx"), avoider=NO_AVOIDER)
    assert run_kinematic(Admitter().admit(named)).complete


def test_arrays_are_the_columns_of_one_input_and_outputs_are_taken_apart() -> None:
    """Three of the TCP, and all rows of hands: half of them are a velocity, and a rate of turning."""
    nodes = [("Mul", ["obs", "half"], ["whole"]), ("Slice", ["whole", "first", "last", "axis"], ["action"])]
    model = onnx.load_from_string(policy(nodes, {"obs": (1, "n")}, {"action": (1, 6)}))
    for name, value in (("first", 0), ("last", 6), ("axis", 1)):
        model.graph.initializer.append(onnx.helper.make_tensor(name, onnx.TensorProto.INT64, [1], [value]))
    made = begun(model.SerializeToString(), f"obs={TCP},{ROWS},action={VELOCITY},tcp_angular_velocity_radps")
    assert made.sees == ("joints", "hands")
    feed = made._file.fed(made._observed(seen(made.sees)))["obs"]
    assert feed.shape == (1, 3 + 3 * TRACKS_PER_HAND)
    assert feed[0, :6].tolist() == [0.7, -0.1, 0.3, 0.5, -0.2, 0.3]
    action = made.act(seen(made.sees))
    assert moved(action) == [0.35, -0.05, 0.15]
    assert isinstance(action, Move)
    assert action.tcp_angular_velocity_radps is not None
    assert action.tcp_angular_velocity_radps.tolist() == [0.25, -0.1, 0.15]


def test_an_output_that_nobody_knows_is_refused(tmp_path: Path) -> None:
    file = write(tmp_path, {TCP: (1, 3)}, {VELOCITY: (1, 3), "protective_stop": (1, 3)})
    with pytest.raises(ModelError, match=r"onnx: protective_stop: expected .* stop .*got .*protective_stop"):
        begun(file.read_bytes())


@pytest.mark.parametrize(
    ("inputs", "outputs", "why"),
    [
        ({JOINTS: (1, 7)}, {"joint_velocity_radps": (1, 7)}, "joint_position_rad.* Got: 6 Expected: 7"),
        ({ROWS: (1, 2, 3)}, {VELOCITY: (1, 2, 3)}, "hands.* Got: [48] Expected: 2"),
        ({TCP: (1, 3)}, {"joint_velocity_radps": (1, 3)}, r"radps has the shape \(1, 3\); .* \(1, 6\)"),
    ],
    ids=["seven joints", "one hand", "three joint speeds"],
)
def test_fixed_axes_that_do_not_fit_are_refused_before_a_run(
    tmp_path: Path, inputs: dict[str, tuple[object, ...]], outputs: dict[str, tuple[object, ...]], why: str
) -> None:
    with pytest.raises(InadmissibleError, match=why) as caught:
        admitted(write(tmp_path, inputs, outputs))
    assert caught.value.place.field == "--controller"
    assert "a policy that answers for the arm" in caught.value.expected


def test_asking_once_leaves_nothing_behind(tmp_path: Path) -> None:
    """Two admissions, one of which was tried, give the same run."""
    data = policy(
        [("Add", ["count", "one"], ["next_count"]), ("Mul", [TCP, "next_count"], ["much"])]
        + [("Mul", ["much", "half"], [VELOCITY])],
        {"count": (1, 1), TCP: (1, 3)},
        {"next_count": (1, 1), VELOCITY: (1, 3)},
    )
    (tmp_path / "mine.onnx").write_bytes(data)
    trace = run_kinematic(admitted(tmp_path / "mine.onnx"))
    first = OnnxPolicy(tmp_path / "mine.onnx", data)
    assert first.sees == ("joints",)
    again = run_kinematic(admitted(tmp_path / "mine.onnx"))
    assert np.array_equal(trace.ticks["joint_position_rad"], again.ticks["joint_position_rad"])
    made = begun(data)
    assert [moved(made.act(seen(made.sees)))[0] for _ in range(2)] == [0.35, 0.7]


@pytest.mark.filterwarnings("ignore")  # of exporters about themselves
def test_a_policy_of_stable_baselines_drives_under_its_exporter_s_names(tmp_path: Path) -> None:
    """One observation of nine numbers, as its documentation exports a policy, and a velocity."""
    torch, spaces = pytest.importorskip("torch"), pytest.importorskip("gymnasium.spaces")
    policies = pytest.importorskip("stable_baselines3.common.policies")
    torch.manual_seed(0)
    box = {"low": -1.0, "high": 1.0, "dtype": np.float32}
    trained = policies.ActorCriticPolicy(
        spaces.Box(shape=(9,), **box), spaces.Box(shape=(3,), **box), lambda _: 1e-3, net_arch=[8]
    ).eval()

    class Exported(torch.nn.Module):  # type: ignore[misc, name-defined]
        def __init__(self) -> None:
            super().__init__()
            self.policy = trained

        def forward(self, observation: object) -> object:
            features = trained.extract_features(observation)
            return trained.action_net(trained.mlp_extractor.forward_actor(features))

    file = tmp_path / "mine.onnx"
    names = {"input_names": ["obs"], "output_names": ["continuous_actions"]}
    torch.onnx.export(Exported(), (torch.zeros(1, 9),), file, dynamo=False, **names)
    layout = f"obs={TCP},features,continuous_actions={VELOCITY}"
    made = begun(file.read_bytes(), layout)
    action = made.act(seen(made.sees))
    observation = torch.tensor([[0.7, -0.1, 0.3, 0, 0, 0, 0, 0, 0]], dtype=torch.float32)
    assert moved(action) == pytest.approx(Exported()(observation)[0].tolist(), abs=1e-6)
    assert run_kinematic(admitted(file, layout)).complete
