"""Trained networks as files: safetensors with one JSON text, read without executing anything.

Tensors are named "{member}/{name}", the name as in a PyTorch state dict of the architecture that
``tensor_shapes`` spells out.  Everything a user can get wrong is refused with the field at fault;
what ``save_model`` writes, ``load_model`` takes.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, deserialize
from safetensors.numpy import save

from safety_harness.avoidance.json_fields import NOT_NEGATIVE, POSITIVE, JsonFields, NumberRange, refuse
from safety_harness.exceptions import ModelError, OutputError, Place
from safety_harness.scenario.decision_times import LONGEST_S
from safety_harness.scenario.files import read_bytes
from safety_harness.settings import Settings, Vector3
from safety_harness.whole_file import replacing

FORMAT = "safety-harness model 1"
KIND = "regression resnet"
KEY = "safety_harness"  # of the metadata
LARGEST_BYTES = 64 * 2**20
LARGEST_DROPOUT = 0.9
MOST_PASSES = 1000
MOST_MEMBERS = 100
CARD_TIME = "decision_time_s"  # of the card: what a decision costs in simulated time
FARTHEST_M = 10.0  # a seen space beyond it is not in metres, or not around a robot's base

INPUTS = 7  # hand (3) and TCP (3) in the base frame, normalised, and the constant 1
OUTPUTS = 3
WIDTH = 32
STAGES = 3
BLOCKS = 3  # a stage: one dense block, then identity blocks

Floats = tuple[float, ...]


class Dropout(Enum):
    """Where units are dropped at prediction time: nowhere, after each stage, before every layer."""

    NONE = "none"
    INTER = "inter"
    FULL = "full"


@dataclass(frozen=True, kw_only=True)
class SeenSpace:
    """The boxes that the training data filled: corners in the base frame [m]."""

    hand_low_m: Vector3
    hand_high_m: Vector3
    tcp_low_m: Vector3
    tcp_high_m: Vector3


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """What held-out seen TCPs said: how wide an interval must be, and which spread is too large.

    ``more`` holds whatever else the calibration recorded; nothing here reads it.
    """

    interval_multiplier: float
    spread_threshold_m: float
    residual_std_m: Vector3
    samples: int
    more: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False, kw_only=True)
class Model:
    """A regression ResNet (or an ensemble of them) with all that is needed to use it.

    The network sees x = (input - input_mean) / input_std (6,) and the constant 1; its answer y
    means the position target_mean + target_std y (3,) in the base frame.  Means and deviations are
    in metres; ``tensors`` are read-only float32 arrays, one set for each member.
    """

    dropout: Dropout
    dropout_probability: float
    members: int
    passes: int
    input_mean: Floats
    input_std: Floats
    target_mean: Floats
    target_std: Floats
    seen: SeenSpace
    calibration: Calibration | None
    card: Mapping[str, Any]
    tensors: Mapping[str, NDArray[np.float32]]


def tensor_shapes() -> dict[str, tuple[int, ...]]:
    """Name and shape of every tensor of one member, in the order of the layers (figures 3 and 4)."""
    shapes: dict[str, tuple[int, ...]] = {}

    def layer(prefix: str, number: str, inputs: int) -> None:
        shapes[f"{prefix}.fc{number}.weight"] = (WIDTH, inputs)
        shapes[f"{prefix}.fc{number}.bias"] = (WIDTH,)
        norm(f"{prefix}.bn{number}")

    def norm(prefix: str) -> None:
        for part in ("weight", "bias", "running_mean", "running_var"):
            shapes[f"{prefix}.{part}"] = (WIDTH,)

    for stage in range(STAGES):
        for block in range(BLOCKS):
            inputs = INPUTS if stage == block == 0 else WIDTH
            prefix = f"stages.{stage}.{block}"
            layer(prefix, "1", inputs)
            layer(prefix, "2", WIDTH)
            layer(prefix, "3", WIDTH)
            if block == 0:
                layer(prefix, "s", inputs)
    norm("bn_out")
    shapes["fc_out.weight"] = (OUTPUTS, WIDTH)
    shapes["fc_out.bias"] = (OUTPUTS,)
    return shapes


def load_model(path: Path) -> Model:
    """Read and check a model file; ModelError says what is wrong with it and where."""
    return _parse(model_bytes(path, "a model file", most=LARGEST_BYTES), path)


def model_bytes(path: Path, kind: str, *, most: int) -> bytes:
    """The whole of a regular file of at most ``most`` bytes; ModelError for anything else."""
    data = read_bytes(path, most=most, place=Place(file=path), error=ModelError)
    if len(data) > most:
        refuse(path, None, f"{kind} of at most {most} bytes", "a larger one")
    return data


def save_model(model: Model, path: Path) -> None:
    """Write ``model`` to ``path`` in one step: there is the old file or the new one, never a part.

    ModelError if ``load_model`` would refuse it; then nothing is written.  OutputError if it cannot be.
    """
    tensors = {name: np.ascontiguousarray(tensor) for name, tensor in model.tensors.items()}
    try:
        data = save(tensors, metadata={KEY: json.dumps(metadata_of(model), sort_keys=True)})
    except (TypeError, ValueError, SafetensorError) as error:
        refuse(path, None, "a model of numbers and plain texts", str(error))
    _parse(data, path)
    try:
        with replacing(path) as unfinished:
            unfinished.write_bytes(data)
    except OSError as error:
        raise OutputError(
            place=Place(file=path), expected="a file that can be written", got=error.strerror or str(error)
        ) from error


def refuse_foreign_seen_space(seen: SeenSpace, settings: Settings, path: Path) -> None:
    """ModelError if a model never saw the cell's own desired TCP or its nominal hand position."""
    nominal_hand_m = settings.avoidance.nominal_hand_position_in_base_m
    for name, low_m, high_m, point_m in (
        ("tcp", seen.tcp_low_m, seen.tcp_high_m, settings.cell.desired_tcp_position_in_base_m),
        ("hand", seen.hand_low_m, seen.hand_high_m, nominal_hand_m),
    ):
        if not all(low <= x <= high for low, x, high in zip(low_m, point_m, high_m, strict=True)):
            refuse(
                path,
                f"seen.{name}_low_m to seen.{name}_high_m",
                f"a seen space with the cell's {name} position {list(point_m)} in it",
                f"{list(low_m)} to {list(high_m)}",
                hint="the model was trained for another workspace",
            )


def metadata_of(model: Model) -> dict[str, Any]:
    """All of a model but its tensors, as JSON has it."""
    calibration = None
    if model.calibration is not None:
        own = asdict(model.calibration)
        calibration = own.pop("more") | own
    return {
        "format": FORMAT,
        "kind": KIND,
        "width": WIDTH,
        "stages": STAGES,
        "blocks": BLOCKS,
        "dropout": model.dropout.value,
        "dropout_probability": model.dropout_probability,
        "members": model.members,
        "passes": model.passes,
        "input_mean": list(model.input_mean),
        "input_std": list(model.input_std),
        "target_mean": list(model.target_mean),
        "target_std": list(model.target_std),
        "seen": asdict(model.seen),
        "calibration": calibration,
        "card": dict(model.card),
    }


def _parse(data: bytes, path: Path) -> Model:
    """The model in the bytes of a safetensors file; ModelError for the first thing that is wrong."""
    try:
        stored = dict(deserialize(data))  # type: ignore[no-untyped-call]  # checks every offset and length against the file's size
    except SafetensorError as error:
        refuse(path, None, "a safetensors file", str(error))
    header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
    text = (header.get("__metadata__") or {}).get(KEY)
    if text is None:
        refuse(path, KEY, "the metadata of a model of this package", "none")
    fields = JsonFields(path, text)
    for name, only in (("format", FORMAT), ("kind", KIND)):
        fields.one_of(name, (only,))
    for name, size in (("width", WIDTH), ("stages", STAGES), ("blocks", BLOCKS)):
        fields.whole(name, size, size)
    dropout = Dropout(fields.one_of("dropout", [one.value for one in Dropout]))
    drops = dropout is not Dropout.NONE
    # An ensemble's spread is over its members, and one pass has no spread: it would look certain.
    members = fields.whole("members", 1, 1 if drops else MOST_MEMBERS)
    model = Model(
        dropout=dropout,
        dropout_probability=fields.number(
            "dropout_probability", NumberRange(0.0, LARGEST_DROPOUT, open=drops)
        ),
        members=members,
        passes=fields.whole("passes", 2 if drops else 1, MOST_PASSES),
        input_mean=fields.vector("input_mean", INPUTS - 1),
        input_std=fields.vector("input_std", INPUTS - 1, POSITIVE),
        target_mean=fields.vector("target_mean", OUTPUTS),
        target_std=fields.vector("target_std", OUTPUTS, POSITIVE),
        seen=seen_of(fields),
        calibration=calibration_of(fields),
        card=fields.table("card"),
        tensors=_tensors(stored, members, path),
    )
    card_time_of(fields)
    fields.no_others(None, metadata_of(model))
    return model


def seen_of(fields: JsonFields) -> SeenSpace:
    """The seen space in a model's metadata."""
    corners: dict[str, Vector3] = {}
    for name in ("hand", "tcp"):
        for corner in (f"{name}_low_m", f"{name}_high_m"):
            x, y, z = fields.vector(f"seen.{corner}", 3, NumberRange(-FARTHEST_M, FARTHEST_M))
            corners[corner] = x, y, z
        low, high = corners[f"{name}_low_m"], corners[f"{name}_high_m"]
        if not all(a < b for a, b in zip(low, high, strict=True)):
            fields.refuse(f"seen.{name}_low_m", f"a corner below {list(high)} in every axis", list(low))
    fields.no_others("seen", corners)
    return SeenSpace(**corners)


def calibration_of(fields: JsonFields) -> Calibration | None:
    """The calibration in a model's metadata, if there is one."""
    if fields.get("calibration") is None:
        return None
    more = fields.table("calibration")
    x, y, z = fields.vector("calibration.residual_std_m", 3, NOT_NEGATIVE)
    calibration = Calibration(
        interval_multiplier=fields.number("calibration.interval_multiplier", POSITIVE),
        spread_threshold_m=fields.number("calibration.spread_threshold_m", NOT_NEGATIVE),
        residual_std_m=(x, y, z),
        samples=fields.whole("calibration.samples", 1),
    )
    own = ("interval_multiplier", "spread_threshold_m", "residual_std_m", "samples")
    return replace(calibration, more={key: value for key, value in more.items() if key not in own})


def card_time_of(fields: JsonFields) -> float:
    """What the card in a model's metadata declares that a decision costs [s]; 0 where it does not."""
    name = f"card.{CARD_TIME}"
    return fields.number(name, NumberRange(0.0, LONGEST_S)) if name in fields else 0.0


def _tensors(
    stored: Mapping[str, Mapping[str, Any]], members: int, path: Path
) -> dict[str, NDArray[np.float32]]:
    """Every tensor of every member, read-only; ``stored`` maps a name to its dtype, shape and bytes."""
    shapes = {f"{k}/{name}": shape for k in range(members) for name, shape in tensor_shapes().items()}
    for name in stored:
        if name not in shapes:
            refuse(path, name, f"only tensors of a {KIND} with {members} member(s)", "this one too")
    tensors = {}
    for name, shape in shapes.items():
        if name not in stored:
            refuse(path, name, f"a tensor of shape {list(shape)}", "none")
        one = stored[name]
        if one["dtype"] != "F32" or tuple(one["shape"]) != shape:
            refuse(path, name, f"F32 numbers of shape {list(shape)}", f"{one['dtype']} of {one['shape']}")
        tensor = np.frombuffer(bytes(one["data"]), dtype="<f4").reshape(shape)
        bad = np.argwhere(~np.isfinite(tensor))
        if len(bad):
            refuse(path, name, "finite numbers", f"{tensor[tuple(bad[0])]} at {bad[0].tolist()}")
        if name.endswith("running_var") and tensor.min() < 0.0:
            refuse(path, name, "variances of at least 0", f"{tensor.min():g}")
        tensors[name] = tensor
    return tensors
