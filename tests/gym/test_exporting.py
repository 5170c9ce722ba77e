"""A policy of Stable-Baselines3 becomes a file that acts in the harness as the model acts in training."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from safety_harness.base.exceptions import InadmissibleError
from safety_harness.cell.controller.out_of_process.onnx_policy import OnnxPolicy
from safety_harness.extensions.gym.stable_baselines import StableBaselinesEnv
from safety_harness.extensions.gym.vector import HarnessVectorEnv
from safety_harness.space.read import parse_space

pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.vec_env import VecFrameStack, VecMonitor, VecNormalize

from safety_harness.extensions.gym import exporting
from safety_harness.extensions.gym.exporting import export_policy

SPACE = parse_space(
    """
scenario space: a hand comes near and leaves
duration: 0.4 s
tcp start:
  offset: [from -40 mm to 40 mm, -60 mm, 60 mm]
hands:
  - hand: right hand
    starts at: [860 mm, -350 mm, 350 mm]
    elbow towards: [1600 mm, -1200 mm, 300 mm]
    moves: [{move to: [840 mm, -250 mm, 350 mm], speed: 1 m/s}]
claims:
  hand distance never below 50 mm: holds
"""
)
QUICK = {("tcp velocity", PPO), ("joint velocity", SAC), ("tcp twist", TD3)}
FIELDS = ("tcp_position_in_base_m", "joint_position_rad")


def environment(action: str = "tcp velocity") -> StableBaselinesEnv:
    lanes = HarnessVectorEnv(2, space=SPACE, sees=("joints",), action=action, rewards={"progress": 1.0})
    return StableBaselinesEnv(lanes, FIELDS, ticks=3)


def model_of(kind: Any, made: Any, steps: int = 32, **options: Any) -> Any:
    small = {"n_steps": 8, "batch_size": 16} if kind is PPO else {"learning_starts": 8, "buffer_size": 64}
    model = kind("MultiInputPolicy", made, seed=0, device="cpu", **small, **options)
    return model.learn(steps)


# At night every kind with every action; before that each of both once.
@pytest.mark.parametrize(
    ("action", "kind"),
    [
        pytest.param(action, kind, marks=[pytest.mark.long] * ((action, kind) not in QUICK))
        for action in ("tcp velocity", "tcp twist", "joint velocity")
        for kind in (PPO, SAC, TD3)
    ],
)
def test_the_file_gives_the_actions_of_the_model_in_si_units(kind: Any, action: str, tmp_path: Path) -> None:
    made = VecNormalize(VecMonitor(environment(action)), clip_obs=2.0)
    model = model_of(kind, made)
    file = export_policy(model, made, tmp_path / "policy.onnx", name="mine", training="32 steps")
    import onnxruntime

    session = onnxruntime.InferenceSession(file.read_bytes())
    wanted = {"tcp velocity": ["tcp_velocity_mps"], "joint velocity": ["joint_velocity_radps"]}.get(
        action, ["tcp_velocity_mps", "tcp_angular_velocity_radps"]
    )
    assert [output.name for output in session.get_outputs()] == wanted
    metadata = session.get_modelmeta().custom_metadata_map
    assert (metadata["name"], metadata["ticks"], metadata["training"]) == ("mine", "3", "32 steps")
    seen = {
        "tcp_position_in_base_m": [[0.7, -0.1, 0.4]],
        "joint_position_rad": [[0.1, -1.0, 1.2, -1.7, -1.5, 0.2]],
    }
    observed = {name: np.array(rows, np.float32) for name, rows in seen.items()}
    (acted,) = model.predict(made.normalize_obs(observed), deterministic=True)[0]
    made.training = False
    most = made.venv.venv.largest_action
    answered = np.concatenate(session.run(None, observed), axis=1)[0]
    assert answered == pytest.approx(acted * most, abs=1e-5 * most.max())
    assert OnnxPolicy(file, file.read_bytes()).name == "mine"


def test_a_wrapper_that_changes_observations_is_refused(tmp_path: Path) -> None:
    made = environment()
    model = model_of(PPO, made)
    with pytest.raises(InadmissibleError, match="VecFrameStack"):
        export_policy(model, VecFrameStack(made, 2), tmp_path / "policy.onnx")
    assert not any(tmp_path.iterdir())


def test_another_environment_than_that_of_the_training_is_refused(tmp_path: Path) -> None:
    made = VecNormalize(environment("tcp twist"))
    model, file = model_of(PPO, made), tmp_path / "policy.onnx"
    other = VecNormalize(environment("joint velocity"))
    slower = environment("tcp twist")
    slower.ticks = 1
    for given, words in (
        (made.venv, "another normalisation"),
        (VecNormalize(made), "normalised once"),
        (other, "kind of action"),
        (VecNormalize(slower), "ticks 3"),
        (VecNormalize(environment()), "other actions"),
        (VecNormalize(environment("tcp twist")), "another normalisation"),  # of nothing seen yet
    ):
        with pytest.raises(InadmissibleError, match=words):
            export_policy(model, given, file)
    with pytest.raises(InadmissibleError, match="a model of Stable-Baselines3"):
        export_policy("model.zip", made, file)  # type: ignore[arg-type]
    assert not any(tmp_path.iterdir())


def test_separate_feature_extractors_are_exported(tmp_path: Path) -> None:
    made = environment()
    model = model_of(PPO, made, policy_kwargs={"share_features_extractor": False})
    assert export_policy(model, made, tmp_path / "policy.onnx").is_file()


def test_a_file_that_answers_otherwise_than_the_model_is_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = VecNormalize(environment(), clip_obs=2.0)
    model = model_of(PPO, made)
    monkeypatch.setattr(exporting, "_normalisation", lambda normaliser, fields: {})  # the mistake to notice
    with pytest.raises(InadmissibleError, match="the same actions in the file as in the model"):
        export_policy(model, made, tmp_path / "policy.onnx")
    assert not any(tmp_path.iterdir())
