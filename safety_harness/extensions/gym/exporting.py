"""Export a policy of Stable-Baselines3 as an ONNX file that the harness runs as a controller."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import InadmissibleError
from safety_harness.base.extras import LEARNING, ONNX, POLICIES
from safety_harness.base.whole_file import writing
from safety_harness.extensions.gym.stable_baselines import StableBaselinesEnv

with LEARNING.needed("the export of policies"):
    import torch
    from torch import nn
with POLICIES.needed("the export of policies"):
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.policies import ActorCriticPolicy
    from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

QUESTIONS, TOLERANCE = 64, 1e-4  # of the comparison of the file with the model; a part of the largest action


def export_policy(
    model: BaseAlgorithm, environment: Any, file: str | Path, *, name: str = "policy", training: str = ""
) -> Path:
    """Write the deterministic policy of a ``model`` to ``file``, and return its path.

    The file contains the normalisation of observations and the scale of actions, and repeats each action as
    long as in training. The file's answers are compared with the model's before it is written.

    Args:
        model: A trained PPO, A2C, SAC, TD3 or DDPG.
        environment: The environment of the training, a ``StableBaselinesEnv``, perhaps within ``VecMonitor``
            and ``VecNormalize``. Its normalisation is that of the file.
        file: The file to write, FILE.onnx.
        name: The policy's name in reports.
        training: The training data and method, for evidence reports.

    Raises:
        InadmissibleError: Another wrapper changes observations or actions, the model is of another kind, or
            the file answers otherwise than the model.

    """
    file, normaliser, inner = Path(file), None, environment
    while isinstance(inner, VecMonitor | VecNormalize):
        if isinstance(inner, VecNormalize) and inner.norm_obs:
            normaliser = inner
        inner = inner.venv
    if not isinstance(inner, StableBaselinesEnv):
        expected = "a StableBaselinesEnv, perhaps within VecMonitor and VecNormalize"
        raise InadmissibleError.of_option("environment", expected, type(inner).__name__)
    policy = _Policy(model.policy, inner, normaliser)
    data = _onnx(policy, inner, name, training)
    _refuse_unlike(model, inner, normaliser, policy, data)
    with writing(file):
        file.write_bytes(data)
    return file


class _Policy(nn.Module):
    """The mean action [SI] for named observations."""

    def __init__(self, policy: Any, environment: StableBaselinesEnv, normaliser: Any) -> None:
        super().__init__()
        self.of, self.fields = policy, environment.fields
        self.most = torch.tensor(environment.largest_action, dtype=torch.float32)
        self.by_joints = environment.environments.setting.by_joints
        self.normalised = {} if normaliser is None else _normalisation(normaliser, self.fields)

    def actions(self, seen: Sequence[torch.Tensor]) -> torch.Tensor:
        """Return the actions (n, a) for observations by field, each with n rows."""
        observed = dict(zip(self.fields, seen, strict=True))
        for field, (mean, deviation, most) in self.normalised.items():
            observed[field] = ((observed[field] - mean) / deviation).clamp(-most, most)
        return self.most * self._mean(observed).clamp(-1.0, 1.0)

    def _mean(self, observed: dict[str, torch.Tensor]) -> torch.Tensor:
        policy = self.of
        if isinstance(policy, ActorCriticPolicy):
            features = policy.extract_features(observed, policy.pi_features_extractor)
            mean: torch.Tensor = policy.action_net(policy.mlp_extractor.forward_actor(features))  # type: ignore[arg-type]
            return torch.tanh(mean) if policy.squash_output else mean
        if hasattr(policy.actor, "get_action_dist_params"):  # of SAC, before its tanh
            return torch.tanh(policy.actor.get_action_dist_params(observed)[0])
        action: torch.Tensor = policy.actor(observed)  # of TD3 and DDPG
        return action

    def forward(self, *seen: torch.Tensor) -> Any:
        """Return the actions by output."""
        actions = self.actions(seen)
        return actions if self.by_joints or actions.shape[1] == 3 else (actions[:, :3], actions[:, 3:])


def _normalisation(normaliser: Any, fields: Sequence[str]) -> dict[str, tuple[torch.Tensor, ...]]:
    """Return mean, deviation and largest value of each normalised field."""
    made = {}
    for field in normaliser.norm_obs_keys or fields:
        statistics = normaliser.obs_rms[field]
        deviation = np.sqrt(statistics.var + normaliser.epsilon)
        numbers = (statistics.mean, deviation, np.full_like(deviation, normaliser.clip_obs))
        made[field] = tuple(torch.tensor(part, dtype=torch.float32) for part in numbers)
    return made


def _onnx(policy: _Policy, environment: StableBaselinesEnv, name: str, training: str) -> bytes:
    """Return the policy as the bytes of an ONNX file."""
    shapes = [environment.observation_space[field].shape for field in policy.fields]  # type: ignore[index]
    twist = ["tcp_velocity_mps", "tcp_angular_velocity_radps"][: len(policy.most) // 3]
    with warnings.catch_warnings(action="ignore", category=FutureWarning):  # from within the exporter
        program = torch.onnx.export(
            policy.eval(),
            tuple(torch.zeros(1, *shape) for shape in shapes),
            input_names=list(policy.fields),
            output_names=["joint_velocity_radps"] if policy.by_joints else twist,
            dynamo=True,
            verbose=False,
        )
    assert program is not None
    notes = {"name": name, "ticks": str(environment.ticks)} | ({"training": training} if training else {})
    program.model.metadata_props.update(notes)
    data: bytes = program.model_proto.SerializeToString()
    return data


def _refuse_unlike(
    model: BaseAlgorithm, environment: StableBaselinesEnv, normaliser: Any, policy: _Policy, data: bytes
) -> None:
    """Compare the file's answers with those of the model to random observations."""
    ONNX.require("the comparison of the file with the model")
    import onnxruntime

    session = onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"])
    random = np.random.default_rng(0)
    for _ in range(QUESTIONS):
        seen = {
            field: random.normal(size=(1, *environment.observation_space[field].shape)).astype(np.float32)  # type: ignore[index]
            for field in policy.fields
        }
        shown = seen if normaliser is None else normaliser.normalize_obs(seen)
        wanted = environment.largest_action * model.predict(shown, deterministic=True)[0]
        answered = np.concatenate(session.run(None, seen), axis=1)
        difference: NDArray[np.float64] = np.abs(answered - wanted) / environment.largest_action
        if not difference.max() <= TOLERANCE:
            got = f"{answered.tolist()} in the file, {wanted.tolist()} in the model"
            raise InadmissibleError.of_option("model", "the same actions in the file as in the model", got)
