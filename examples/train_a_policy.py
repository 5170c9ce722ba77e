"""A small policy, trained in ten minutes on the CPU by Stable-Baselines3, written as policy.onnx.

python train_a_policy.py [ACTIONS] [FILE.onnx]

It sees the TCP and the predicted hands, and says how the TCP should move; docs/how-to/environments.md.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize
from torch import nn

from safety_harness import DEFAULTS
from safety_harness.gym.stable_baselines import StableBaselinesEnv
from safety_harness.gym.vector import HarnessVectorEnv

SPACE = "shipped:reaching-hands"
REWARDS = {"progress": 20.0, "always hand distance > 150 mm": 40.0}
SEED, TICKS = 0, 5
FIELDS = (
    "tcp_position_in_base_m",
    "predicted_hands",
    "predicted_hands_there",
    "predicted_hands_velocity_mps",
)
DESIRED_M = torch.tensor(DEFAULTS.cell.desired_tcp_position_in_base_m, dtype=torch.float32)


class HandsAndTarget(BaseFeaturesExtractor):
    """Of each hand its way from the TCP and its velocity, the largest over all hands; and the way to go.

    It is the same for hands in any order, and for any number of them.
    """

    def __init__(self, space: spaces.Dict) -> None:
        super().__init__(space, 64 + 3)
        self.of_hand = nn.Sequential(nn.Linear(9, 64), nn.Tanh(), nn.Linear(64, 64), nn.ReLU())

    def forward(self, seen: dict[str, torch.Tensor]) -> torch.Tensor:
        """(n, 67) features."""
        tcp, hands, there, velocity = (seen[name] for name in FIELDS)
        to_target = (DESIRED_M - tcp) / 0.1
        way = (hands - tcp[:, None]) / 0.3
        each = torch.cat((way, velocity, to_target[:, None].expand_as(way)), dim=2)
        strongest = (self.of_hand(each) * there[:, :, None]).max(dim=1).values
        return torch.cat((strongest, to_target), dim=1)


class Policy(nn.Module):
    """The trained mean action, as the harness takes policies: named inputs, and a velocity in m/s."""

    def __init__(self, trained: PPO, most_mps: np.ndarray) -> None:
        super().__init__()
        self.of = trained.policy
        self.most_mps = torch.tensor(most_mps, dtype=torch.float32)

    def forward(self, *seen: torch.Tensor) -> torch.Tensor:
        """(n, 3) velocities of the TCP [m/s]."""
        features = self.of.extract_features(
            dict(zip(FIELDS, seen, strict=True)), self.of.pi_features_extractor
        )
        mean = self.of.action_net(self.of.mlp_extractor.forward_actor(features))
        return self.most_mps * mean.clamp(-1.0, 1.0)


class Said(BaseCallback):
    """Says what an episode is worth by now."""

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        lately = [one["r"] for one in self.model.ep_info_buffer or ()]
        if lately:
            sys.stderr.write(f"{self.num_timesteps} actions: reward of an episode {np.mean(lately):.3f}\n")


def train(actions: int, *, lanes: int = 128) -> PPO:
    """PPO on that space, with so many actions."""
    environments = HarnessVectorEnv(lanes, space=SPACE, sees=("joints", "predicted hands"), rewards=REWARDS)
    vectorised = StableBaselinesEnv(environments, FIELDS, ticks=TICKS)
    vectorised.seed(SEED)
    model = PPO(
        "MultiInputPolicy",
        VecNormalize(VecMonitor(vectorised), norm_obs=False, gamma=0.98),
        n_steps=128,
        batch_size=4096,
        n_epochs=6,
        gamma=0.98,
        gae_lambda=0.95,
        learning_rate=lambda left: 1e-3 * left,
        seed=SEED,
        device="cpu",
        policy_kwargs={
            "features_extractor_class": HandsAndTarget,
            "net_arch": [64, 64],
            "log_std_init": -1.0,
        },
    )
    return model.learn(actions, callback=Said())


def write_onnx(trained: PPO, path: Path) -> None:
    """The policy in ONNX, for any number of hands; it holds an action as long as in training."""
    most_mps = np.full(3, DEFAULTS.motion.max_tcp_speed_mps)
    example = tuple(torch.zeros(1, *shape) for shape in ((3,), (4, 3), (4,), (4, 3)))
    hands = {1: torch.export.Dim("hands", min=1, max=64)}
    program = torch.onnx.export(
        Policy(trained, most_mps).eval(),
        example,
        input_names=list(FIELDS),
        output_names=["tcp_velocity_mps"],
        dynamic_shapes=(({}, hands, hands, hands),),
        dynamo=True,
    )
    program.model.metadata_props.update(name="learned policy", ticks=str(TICKS))
    program.save(path, include_initializers=True)


if __name__ == "__main__":
    actions, file = (*sys.argv[1:], *("1500000", "policy.onnx")[len(sys.argv) - 1 :])
    write_onnx(train(int(actions)), Path(file))
