"""What does a decision of the learned avoider cost, next to PyTorch?  Run: python benchmarks/decision.py.

All of them take turns in one process, so that a busy machine slows all; a ratio is formed within each
turn and printed as median (least to greatest).  First, that they compute the same.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import sys
import time
from collections.abc import Callable
from importlib.util import find_spec
from statistics import median
from typing import Any

if find_spec("torch") is None:
    sys.exit("this benchmark compares with PyTorch: pip install -e '.[benchmarks]'")

import numpy as np
import torch
from naive_loop import monte_carlo_mean, regression_network
from numpy.typing import NDArray
from ratios import Ratio, say

from safety_harness.cell.avoidance.learned import LearnedAvoider
from safety_harness.cell.avoidance.masks import masks
from safety_harness.cell.avoidance.model_file import INPUTS, PLACES, WIDTH, Dropout, Model, SeenSpace
from safety_harness.extensions.lab.learning.networks import RegressionResNet, to_tensors

TURNS = 9
EAGER = 20  # decisions of PyTorch in a turn
ONE = 2_000  # decisions one at a time in a turn
MANY = 100_000  # decisions in one call
PASSES = 10
COMPARED = 1_000  # decisions of each kind that are compared with PyTorch's
AIM_ONE, AIM_MANY = 200.0, 500.0
KINDS = ((Dropout.NONE, 1), (Dropout.INTER, 1), (Dropout.FULL, 1), (Dropout.NONE, 5))
SEEN = SeenSpace(
    hand_low_m=(0.54, -0.65, -0.295),
    hand_high_m=(1.14, -0.05, 0.305),
    tcp_low_m=(0.64, -0.15, 0.25),
    tcp_high_m=(0.76, 0.15, 0.45),
)
MILLIMETRES = 1e3

METHOD = f"""\
Method: every maths library on one thread, {TURNS} turns, values are median (least to greatest).
A decision is the mean of {PASSES} Monte Carlo dropout passes ("inter") of the regression ResNet, width 32,
7 to 3, float32, random weights.  Eager: PyTorch, {PASSES} passes one after the other, with nn.Dropout
(mean only; ours gives mean and spread, and includes the masks).  One batch: the same input in {PASSES} rows.
A turn: {EAGER} eager decisions, {EAGER} of one batch, {ONE} of ours one at a time, {MANY} in one call."""


def network_with_history(dropout: Dropout, seed: int) -> RegressionResNet:
    """Random weights, with batch norms whose statistics come from random inputs, as if trained."""
    torch.manual_seed(seed)
    network = RegressionResNet(dropout=dropout)
    with torch.no_grad():
        for name, parameter in network.named_parameters():
            if ".bn" in name or name.startswith("bn"):
                parameter += 0.2 * torch.randn_like(parameter)
        for _ in range(50):
            inputs = torch.randn(256, INPUTS)
            inputs[:, -1] = 1.0
            network(inputs)
    return network.eval()


def model_of(networks: list[RegressionResNet], dropout: Dropout) -> Model:
    """The model file's view of PyTorch's networks."""
    return Model(
        dropout=dropout,
        dropout_probability=0.1,
        members=len(networks),
        passes=PASSES,
        input_mean=(0.84, -0.35, 0.005, 0.70, 0.0, 0.35),
        input_std=(0.17, 0.17, 0.17, 0.035, 0.087, 0.058),
        target_mean=(0.68, 0.06, 0.41),
        target_std=(0.034, 0.075, 0.051),
        seen=SEEN,
        calibration=None,
        card={},
        tensors={
            f"{k}/{name}": tensor
            for k, network in enumerate(networks)
            for name, tensor in to_tensors(network).items()
        },
    )


def inputs_of(count: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint64]]:
    """Hands and TCPs (n, 3) in the seen space, seeds (n,)."""
    rng = np.random.default_rng(0)
    return (
        rng.uniform(SEEN.hand_low_m, SEEN.hand_high_m, (count, 3)),
        rng.uniform(SEEN.tcp_low_m, SEEN.tcp_high_m, (count, 3)),
        rng.integers(0, 2**63, count, dtype=np.uint64),
    )


def answers_of_torch(
    networks: list[RegressionResNet],
    model: Model,
    x: NDArray[np.float64],
    seeds: NDArray[np.uint64],
    dtype: Any,
) -> NDArray[np.float64]:
    """PyTorch's own passes (or members), given our masks: positions (passes, n, 3) [m]."""
    rows = torch.tensor(x, dtype=dtype)
    answers = []
    with torch.no_grad():
        if model.dropout is Dropout.NONE:
            answers = [network.to(dtype)(rows).numpy() for network in networks]
        else:
            places = PLACES[model.dropout]
            kept = np.array([masks(seed, PASSES, places, WIDTH, model.dropout_probability) for seed in seeds])
            for t in range(PASSES):
                given = torch.from_numpy(kept[:, t].transpose(1, 0, 2).copy())  # (places, n, width)
                answers.append(networks[0].to(dtype)(rows, given).numpy())
    return np.array(model.target_mean) + np.array(model.target_std) * np.array(answers, dtype=np.float64)


def print_differences(dropout: Dropout, members: int) -> None:
    """Largest differences between ours, PyTorch in float32 and PyTorch in float64."""
    networks = [network_with_history(dropout, seed) for seed in range(members)]
    model = model_of(networks, dropout)
    hands, tcps, seeds = inputs_of(COMPARED)
    inputs = np.concatenate([hands, tcps], axis=1)
    x = np.append((inputs - model.input_mean) / model.input_std, np.ones((COMPARED, 1)), axis=1)
    single, double = (answers_of_torch(networks, model, x, seeds, t) for t in (torch.float32, torch.float64))
    ours = LearnedAvoider.from_model(model).propose_many(hands, tcps, seeds)
    theirs = (single.mean(axis=0), single.std(axis=0))
    exact = (double.mean(axis=0), double.std(axis=0))
    print(f"  {dropout.value:7}{members:7}", end="")
    for a, b in ((ours, theirs), (ours, exact), (theirs, exact)):
        position, spread = (MILLIMETRES * float(np.abs(p - q).max()) for p, q in zip(a, b, strict=True))
        print(f"     {position:.2e} {spread:.2e}", end="")
    print(flush=True)


def seconds_each(function: Callable[[int], object], count: int) -> float:
    """Seconds a call, over ``count`` calls."""
    start = time.perf_counter()
    for n in range(count):
        function(n)
    return (time.perf_counter() - start) / count


def one_batch_mean(network: Any, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean (3,) of the passes as rows of one batch."""
    x = torch.as_tensor(values, dtype=torch.float32).expand(PASSES, -1)
    with torch.no_grad():
        mean: NDArray[np.float64] = network(x).numpy().mean(axis=0).astype(np.float64)
    return mean


def measured() -> tuple[list[float], list[float], list[float], list[float]]:
    """Microseconds a decision, in turns: eager, one batch, ours one at a time, ours in one call."""
    avoider = LearnedAvoider.from_model(model_of([network_with_history(Dropout.INTER, 0)], Dropout.INTER))
    eager_network = regression_network()
    hands, tcps, seeds = inputs_of(MANY)
    rows = np.concatenate([hands, tcps, np.ones((MANY, 1))], axis=1)

    def alone(n: int) -> None:
        avoider.propose(hand_position_in_base_m=hands[n], tcp_position_in_base_m=tcps[n], seed=n)

    eager: list[float] = []
    batch: list[float] = []
    one: list[float] = []
    many: list[float] = []
    for turn in range(TURNS + 1):
        times = (
            seconds_each(lambda n: monte_carlo_mean(eager_network, rows[n]), EAGER),
            seconds_each(lambda n: one_batch_mean(eager_network, rows[n]), EAGER),
            seconds_each(alone, ONE),
            seconds_each(lambda _: avoider.propose_many(hands, tcps, seeds), 1) / MANY,
        )
        if turn > 0:  # the first warms up
            for values, value in zip((eager, batch, one, many), times, strict=True):
                values.append(1e6 * value)
    return eager, batch, one, many


def ratios() -> list[Ratio]:
    """Ten eager passes of PyTorch over ours."""
    eager, batch, one, many = measured()
    rows = (
        ("one at a time", one, AIM_ONE),
        (f"{MANY:,} in one call", many, AIM_MANY),
        ("one batch of PyTorch instead", batch, None),
    )
    return [
        Ratio.of(
            f"a decision, eager PyTorch over ours ({name})" if aim else f"a decision, eager over {name}",
            [a / b for a, b in zip(eager, values, strict=True)],
            aim=aim,
            note=f"{median(values):.1f} us",
        )
        for name, values, aim in rows
    ]


def main() -> None:
    """Compare, then let all take turns."""
    print(METHOD)
    print(f"\nLargest difference with the same masks over {COMPARED} decisions [mm]: position, spread")
    print("  dropout members     ours - torch float32   ours - torch float64    torch 32 - torch 64")
    for dropout, members in KINDS:
        print_differences(dropout, members)
    eager, batch, one, many = measured()
    print("\nTimes")
    say("eager, pass after pass", eager, "us a decision")
    say("eager, one batch", batch, "us a decision")
    say("ours, one at a time", one, "us a decision")
    say(f"ours, {MANY:,} in one call", many, "us a decision")
    print("\nTimes faster than eager passes")
    for name, values, aim in (("one at a time", one, AIM_ONE), (f"{MANY:,} in one call", many, AIM_MANY)):
        ratios = [a / b for a, b in zip(eager, values, strict=True)]
        met = "met" if median(ratios) >= aim else "NOT MET"
        say(name, ratios, f"x (aim: {aim:g}: {met})")
    say("one batch of PyTorch", [a / b for a, b in zip(eager, batch, strict=True)], "x")


if __name__ == "__main__":
    main()
