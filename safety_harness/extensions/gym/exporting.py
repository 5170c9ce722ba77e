"""Export a policy of Stable-Baselines3 to an ONNX file, which the harness can run as a controller."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import InadmissibleError, described
from safety_harness.base.extras import LEARNING, ONNX, POLICIES, quiet_export
from safety_harness.base.whole_file import writing
from safety_harness.extensions.gym.stable_baselines import StableBaselinesEnv

with LEARNING.needed("the export of policies"):
    import torch
    from torch import nn
with POLICIES.needed("the export of policies"):
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.policies import ActorCriticPolicy
    from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

QUESTIONS, TOLERANCE = 64, 1e-4  # to both the file and the model; as a share of the largest action


def export_policy(
    model: BaseAlgorithm, environment: Any, file: str | Path, *, name: str = "policy", training: str = ""
) -> Path:
    """Write the deterministic policy of a ``model`` to ``file``, and return its path.

    The file contains the normalisation of observations and the scale of actions. It repeats each action for
    as many ticks as in training. Before the file is written, its answers are compared with the model's
    answers.

    Args:
        model: A trained PPO, A2C, SAC, TD3 or DDPG.
        environment: The environment of the training, a ``StableBaselinesEnv``, perhaps within ``VecMonitor``
            and ``VecNormalize``. Its normalisation is that of the file.
        file: The file to write, FILE.onnx.
        name: The policy's name in reports.
        training: A description of the training data and method, for evidence reports.

    Raises:
        InadmissibleError: Another wrapper changes observations or actions, the model is of another kind, or
            the file answers otherwise than the model.

    """
    file = Path(file)
    if not isinstance(model, BaseAlgorithm):
        raise InadmissibleError.of_option("model", "a model of Stable-Baselines3", repr(model)[:80])
    inner, normaliser = _unwrapped(environment)
    _refuse_another(model, inner, normaliser)
    try:
        policy = _Policy(_copy_on_cpu(model.policy), inner, normaliser)
        data = _onnx(policy, inner, name, training)
    except Exception as error:  # the exporter's errors have no common class
        got = f"{type(model).__name__}: {described(error)[:200]}"
        raise InadmissibleError.of_option("model", "a policy that PyTorch can export", got) from error
    _refuse_unlike(model, inner, normaliser, policy, data)
    with writing(file):
        file.write_bytes(data)
    return file


def _copy_on_cpu(policy: Any) -> Any:
    """Return a copy of ``policy`` on the CPU, made by storing and loading it with Stable-Baselines3."""
    stored = io.BytesIO()
    policy.save(stored)
    stored.seek(0)
    return type(policy).load(stored, device="cpu")


def _unwrapped(environment: Any) -> tuple[StableBaselinesEnv, Any]:
    """Return the innermost environment and its VecNormalize.

    The second result is None if no wrapper normalises observations.
    """
    normalisers, inner = [], environment
    while isinstance(inner, VecMonitor | VecNormalize):
        normalisers += [inner] if isinstance(inner, VecNormalize) and inner.norm_obs else []
        inner = inner.venv
    if not isinstance(inner, StableBaselinesEnv):
        expected = "a StableBaselinesEnv, perhaps within VecMonitor and VecNormalize"
        raise InadmissibleError.of_option("environment", expected, type(inner).__name__)
    if len(normalisers) > 1:
        raise InadmissibleError.of_option("environment", "observations that are normalised once", "twice")
    return inner, normalisers[0] if normalisers else None


def _refuse_another(model: BaseAlgorithm, environment: StableBaselinesEnv, normaliser: Any) -> None:
    """Raise InadmissibleError if the environment differs from the environment of the model's training.

    If the model no longer has its environment, only the spaces are compared.
    """
    expected = "the environment of the training"
    if environment.observation_space != model.observation_space:
        raise InadmissibleError.of_option("environment", expected, "other observations")
    if environment.action_space != model.action_space:
        raise InadmissibleError.of_option("environment", expected, "other actions")
    if model.get_env() is None:
        return
    own, own_normaliser = _unwrapped(model.get_env())
    if (own_normaliser is None) != (normaliser is None):
        raise InadmissibleError.of_option("environment", expected, "another normalisation of observations")
    for mine, given, part in (
        (own.ticks, environment.ticks, "ticks"),
        (own.environments.setting.by_joints, environment.environments.setting.by_joints, "kind of action"),
        (own.largest_action.tolist(), environment.largest_action.tolist(), "largest action"),
    ):
        if mine != given:
            raise InadmissibleError.of_option("environment", f"{expected}, {part} {mine}", str(given))
    if normaliser is not None and not _alike(own_normaliser, normaliser, environment.fields):
        raise InadmissibleError.of_option("environment", expected, "another normalisation of observations")


def _alike(own: Any, given: Any, fields: Sequence[str]) -> bool:
    """Return True if two normalisations map every observation to the same values."""
    first, second = _normalisation(own, fields), _normalisation(given, fields)
    return first.keys() == second.keys() and all(
        torch.equal(*pair) for field in first for pair in zip(first[field], second[field], strict=True)
    )


class _Policy(nn.Module):
    """A network that returns the mean action [SI] for observations by field."""

    def __init__(self, policy: Any, environment: StableBaselinesEnv, normaliser: Any) -> None:
        super().__init__()
        self.of, self.fields = policy, environment.fields
        self.most = torch.tensor(environment.largest_action, dtype=torch.float32)
        self.by_joints = environment.environments.setting.by_joints
        self.normalised = {} if normaliser is None else _normalisation(normaliser, self.fields)

    def actions(self, seen: Sequence[torch.Tensor]) -> torch.Tensor:
        """Return the actions (n, a); ``seen`` contains the observations of each field, with n rows."""
        observed = dict(zip(self.fields, seen, strict=True))
        for field, (mean, deviation, most) in self.normalised.items():
            observed[field] = ((observed[field] - mean) / deviation).clamp(-most, most)
        return self.most * self._mean(observed).clamp(-1.0, 1.0)

    def _mean(self, observed: dict[str, torch.Tensor]) -> torch.Tensor:
        policy = self.of
        if isinstance(policy, ActorCriticPolicy):
            if policy.share_features_extractor:
                features = policy.extract_features(observed, policy.features_extractor)
            else:
                features = policy.extract_features(observed)[0]
            mean: torch.Tensor = policy.action_net(policy.mlp_extractor.forward_actor(features))  # type: ignore[arg-type]
            return torch.tanh(mean) if policy.squash_output else mean
        if hasattr(policy.actor, "get_action_dist_params"):  # of SAC, before its tanh
            return torch.tanh(policy.actor.get_action_dist_params(observed)[0])
        action: torch.Tensor = policy.actor(observed)  # of TD3 and DDPG
        return action

    def forward(self, *seen: torch.Tensor) -> Any:
        """Return the actions as one tensor for each output."""
        actions = self.actions(seen)
        return actions if self.by_joints or actions.shape[1] == 3 else (actions[:, :3], actions[:, 3:])


def _normalisation(normaliser: Any, fields: Sequence[str]) -> dict[str, tuple[torch.Tensor, ...]]:
    """Return the mean, the standard deviation and the clipping limit of each normalised field."""
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
    with quiet_export():  # ``_refuse_unlike`` tests the result
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
    """Raise InadmissibleError if the file and the model answer random observations differently."""
    ONNX.require("the comparison of the file with the model")
    import onnxruntime

    session = onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"])
    random = np.random.default_rng(0)
    for _ in range(QUESTIONS):
        seen = {}
        for field in policy.fields:
            drawn = random.normal(size=(1, *environment.observation_space[field].shape))  # type: ignore[index]
            if field in policy.normalised:  # so that most normalised values are not clipped
                mean, deviation, _ = policy.normalised[field]
                drawn = drawn * deviation.numpy() + mean.numpy()
            seen[field] = drawn.astype(np.float32)
        shown = seen if normaliser is None else normaliser.normalize_obs(seen)
        wanted = environment.largest_action * model.predict(shown, deterministic=True)[0]
        answered = np.concatenate(session.run(None, seen), axis=1)
        difference: NDArray[np.float64] = np.abs(answered - wanted) / environment.largest_action
        if not difference.max() <= TOLERANCE:
            got = f"actions that differ by {100.0 * difference.max():.3g} % of the largest"
            raise InadmissibleError.of_option("model", "the same actions in the file as in the model", got)
