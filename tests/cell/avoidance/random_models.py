"""Models with random weights and batch norms that look trained, and a plain numpy oracle for them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.cell.avoidance.model_file import (
    BLOCKS,
    PERCEPTRON,
    RESNET,
    SIZES,
    STAGES,
    Dropout,
    Model,
    SeenSpace,
    tensor_shapes,
)

PASSES = 10
SEEN = SeenSpace(
    hand_low_m=(0.54, -0.65, -0.295),
    hand_high_m=(1.14, -0.05, 0.305),
    tcp_low_m=(0.64, -0.15, 0.25),
    tcp_high_m=(0.76, 0.15, 0.45),
)


def random_perceptron(*, members: int = 1, seed: int = 0) -> Model:
    return random_model(Dropout.NONE, members=members, seed=seed, passes=1, kind=PERCEPTRON)


def random_model(
    dropout: Dropout, *, members: int = 1, seed: int = 0, passes: int = PASSES, kind: str = RESNET
) -> Model:
    rng = np.random.default_rng(seed)
    return Model(
        kind=kind,
        stages=SIZES[kind][0],
        blocks=SIZES[kind][1],
        dropout=dropout,
        dropout_probability=0.1,
        members=members,
        passes=passes,
        input_mean=(0.84, -0.35, 0.005, 0.70, 0.0, 0.35),
        input_std=(0.17, 0.17, 0.17, 0.035, 0.087, 0.058),
        target_mean=(0.68, 0.06, 0.41),
        target_std=(0.034, 0.075, 0.051),
        seen=SEEN,
        calibration=None,
        card={"data": "random weights"},
        tensors={
            f"{k}/{name}": _tensor(name, shape, rng)
            for k in range(members)
            for name, shape in tensor_shapes(kind).items()
        },
    )


def _tensor(name: str, shape: tuple[int, ...], rng: np.random.Generator) -> NDArray[np.float32]:
    if name.endswith("running_var"):
        values = rng.uniform(0.3, 3.0, shape)
    elif name.endswith("running_mean"):
        values = rng.normal(0.0, 0.5, shape)
    elif "bn" in name:
        values = rng.normal(1.0 if name.endswith("weight") else 0.0, 0.2, shape)
    else:
        values = rng.normal(0.0, 1.0 / np.sqrt(shape[-1]), shape)
    return values.astype(np.float32)


def random_inputs(
    count: int, seed: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint64]]:
    """Hands (n, 3), TCPs (n, 3) in the seen space and seeds (n,)."""
    rng = np.random.default_rng(seed)
    return (
        rng.uniform(SEEN.hand_low_m, SEEN.hand_high_m, (count, 3)),
        rng.uniform(SEEN.tcp_low_m, SEEN.tcp_high_m, (count, 3)),
        rng.integers(0, 2**64, count, dtype=np.uint64),
    )


def normalised_input(
    model: Model, hand: NDArray[np.float64], tcp: NDArray[np.float64]
) -> NDArray[np.float64]:
    return np.append((np.append(hand, tcp) - model.input_mean) / model.input_std, 1.0)  # (7,)


def one_pass(
    model: Model, member: int, x: NDArray[np.float64], masks: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """The normalised answer (3,) of figures 3 and 4 in float64, layer by layer; masks (places, 32)."""
    at = {name.removeprefix(f"{member}/"): t.astype(np.float64) for name, t in model.tensors.items()}
    remaining = list(masks)

    def drop(x: NDArray[np.float64], kind: Dropout) -> NDArray[np.float64]:
        if model.dropout is not kind:
            return x
        return x * remaining.pop(0)[: len(x)] / (1.0 - model.dropout_probability)

    def connect(x: NDArray[np.float64], layer: str) -> NDArray[np.float64]:
        return at[f"{layer}.weight"] @ drop(x, Dropout.FULL) + at[f"{layer}.bias"]

    def norm(x: NDArray[np.float64], layer: str) -> NDArray[np.float64]:
        deviation = np.sqrt(at[f"{layer}.running_var"] + 1e-5)
        scaled: NDArray[np.float64] = (x - at[f"{layer}.running_mean"]) / deviation
        return at[f"{layer}.weight"] * scaled + at[f"{layer}.bias"]

    for stage in range(STAGES):
        for block in range(BLOCKS):
            name = f"stages.{stage}.{block}"
            h = np.maximum(norm(connect(x, f"{name}.fc1"), f"{name}.bn1"), 0.0)
            h = np.maximum(norm(connect(h, f"{name}.fc2"), f"{name}.bn2"), 0.0)
            h = norm(connect(h, f"{name}.fc3"), f"{name}.bn3")
            shortcut = norm(connect(x, f"{name}.fcs"), f"{name}.bns") if block == 0 else x
            x = np.maximum(h + shortcut, 0.0)
        x = drop(x, Dropout.INTER)
    answer = connect(norm(x, "bn_out"), "fc_out")
    assert not remaining  # every mask has been used
    return answer
