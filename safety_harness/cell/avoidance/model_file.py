"""Read and write trained networks as safetensors files with JSON metadata.

Reading a file never executes code from it. Each tensor has a name of the form "{member}/{name}", in which
"name" is the tensor's name in a PyTorch state dict. ``tensor_shapes`` describes the architecture of this
state dict. An error states the field that is wrong. ``load_model`` accepts every file that ``save_model``
writes.

This module reads the metadata of an ONNX file from its bytes, without a runtime or any computation. An ONNX
model is a message of protocol buffers (onnx.proto, ModelProto). The model has a field with the number 14 for
each metadata entry. This field contains a message, in which field 1 is the key and field 2 is the value. The
encoding of fields: https://protobuf.dev/programming-guides/encoding
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from enum import Enum
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, NoReturn, TypeVar

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray
from safetensors import SafetensorError, deserialize
from safetensors.numpy import save

from safety_harness.base.exceptions import InputError, ModelError, OutputError, Place
from safety_harness.base.settings import Settings, Vector3
from safety_harness.base.whole_file import replacing
from safety_harness.scenario.decision_times import LONGEST_S
from safety_harness.scenario.files import read_bytes
from safety_harness.scenario.kinds import FileKind, refuse_other_kind
from safety_harness.scenario.robots import Robot
from safety_harness.scenario.typed_json import of_format, parsed, plain, typed

FORMAT = "safety-harness model 1"
RESNET, PERCEPTRON = "regression resnet", "relu perceptron"  # the kinds
KEY = "safety_harness"  # of the metadata
LARGEST_BYTES = 64 * 2**20
# Choices that bound the work which a foreign file can ask for. At a dropout of 0.9 the kept units already
# grow tenfold.
LARGEST_DROPOUT = 0.9
MOST_PASSES = 1000
MOST_MEMBERS = 100
CARD_TIME = "decision_time_s"  # of the card: the cost of a decision in simulated time
CARD_ARM = "arm"  # of the card: the training data come from this arm's cell
LARGEST_ONNX_BYTES = 256 * 2**20
# Field numbers of ONNX's ModelProto: graph and metadata_props.
GRAPH, METADATA = 7, 14
MOST_FIELDS = 10_000  # further fields are not read: a file may have millions of useless fields
FIXED = {1: 8, 5: 4}  # bytes of a value by its wire type
PARTS = (("weight", 2), ("bias", 1))  # the tensors of a layer, and the number of dimensions of each
FARTHEST_M = 10.0  # a seen space beyond this is not in metres, or not around a robot's base

INPUTS = 7  # hand (3) and TCP (3) in the base frame, normalised, and the constant 1
OUTPUTS = 3
# The published regression ResNet has three stages (Chen et al., 2020). The width is our choice.
WIDTH = 32
STAGES = 3
BLOCKS = 3  # a stage: one dense block, then identity blocks
STAGE_LAYERS = 3 * BLOCKS + 1  # the dense block of a stage has one layer more, in its shortcut
LAYERS = STAGES * STAGE_LAYERS
PERCEPTRON_INPUTS = INPUTS - 1  # no constant: its layers have biases
HIDDEN_LAYERS = 2
SIZES = {RESNET: (STAGES, BLOCKS), PERCEPTRON: (HIDDEN_LAYERS, 1)}  # stages, and blocks in a stage
NORM = ("weight", "bias", "running_mean", "running_var")  # of a batch norm

Corner = Annotated[float, Meta(ge=-FARTHEST_M, le=FARTHEST_M)]
NotNegative = Annotated[float, Meta(ge=0.0)]
Positive = Annotated[float, Meta(gt=0.0)]
OfInputs = Meta(min_length=INPUTS - 1, max_length=INPUTS - 1)
OfOutputs = Meta(min_length=OUTPUTS, max_length=OUTPUTS)


class Dropout(Enum):
    """The positions of dropout at prediction time: nowhere, after each stage, or before every layer."""

    NONE = "none"
    INTER = "inter"
    FULL = "full"


PLACES = {Dropout.NONE: 0, Dropout.INTER: STAGES, Dropout.FULL: LAYERS + 1}  # of masks in one pass


@dataclass(frozen=True, kw_only=True)
class SeenSpace:
    """The two boxes that contain the training data, as corners in the base frame [m]."""

    hand_low_m: tuple[Corner, Corner, Corner]
    hand_high_m: tuple[Corner, Corner, Corner]
    tcp_low_m: tuple[Corner, Corner, Corner]
    tcp_high_m: tuple[Corner, Corner, Corner]

    @property
    def boxes(self) -> dict[str, tuple[Vector3, Vector3]]:
        """The low and the high corner of each box, with the keys "hand" and "tcp"."""
        return {"hand": (self.hand_low_m, self.hand_high_m), "tcp": (self.tcp_low_m, self.tcp_high_m)}

    def __post_init__(self) -> None:
        for name, (low_m, high_m) in self.boxes.items():
            if not all(low < high for low, high in zip(low_m, high_m, strict=True)):
                raise ValueError(f"{name}_low_m below {name}_high_m in every axis")


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """The calibration of a network on held-out TCPs of the seen space.

    The calibration has an interval multiplier and the largest usable spread. The file may contain further
    records of the calibration. The harness stores these records in ``more``, and does not interpret them.
    """

    interval_multiplier: Positive
    spread_threshold_m: NotNegative
    residual_std_m: tuple[NotNegative, NotNegative, NotNegative]
    samples: Annotated[int, Meta(ge=1)]
    more: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False, kw_only=True)
class NetworkUse:
    """A network's dropout, seen space, calibration and card, in any kind of network file."""

    dropout: Dropout
    dropout_probability: Annotated[float, Meta(ge=0.0, le=LARGEST_DROPOUT)]
    passes: Annotated[int, Meta(ge=1, le=MOST_PASSES)]
    seen: SeenSpace
    calibration: Calibration | None
    card: Mapping[str, Any] = field(default_factory=dict)

    @property
    def spread_threshold_m(self) -> float | None:
        """The largest spread [m] of a usable proposal, or None without a calibration."""
        return None if self.calibration is None else self.calibration.spread_threshold_m

    @property
    def decision_time_s(self) -> float:
        """The simulated time [s] that the card declares for a decision, or 0 if it declares no time."""
        return float(self.card.get(CARD_TIME, 0.0))

    @property
    def made_for(self) -> str:
        """The arm for whose cell the training data were drawn, or the UR10 if the card states no arm."""
        return str(self.card.get(CARD_ARM, Robot.UR10.label))


U = TypeVar("U", bound=NetworkUse)


@dataclass(frozen=True, eq=False, kw_only=True)
class ModelMetadata(NetworkUse):
    """The metadata of a model: everything except its tensors.

    The network gets x = (input - input_mean) / input_std, shape (6,), and the constant 1. The network's
    output y has the shape (3,). This output represents the position target_mean + target_std y in the base
    frame. Means and standard deviations are in metres. A perceptron does not get the constant. A perceptron
    has two stages, and each stage has one layer.
    """

    format: str = FORMAT
    kind: Annotated[str, Meta(pattern=f"^({RESNET}|{PERCEPTRON})$")] = RESNET
    width: Annotated[int, Meta(ge=WIDTH, le=WIDTH)] = WIDTH
    stages: int = STAGES
    blocks: int = BLOCKS
    members: Annotated[int, Meta(ge=1, le=MOST_MEMBERS)]
    input_mean: Annotated[tuple[float, ...], OfInputs]
    input_std: Annotated[tuple[Positive, ...], OfInputs]
    target_mean: Annotated[tuple[float, ...], OfOutputs]
    target_std: Annotated[tuple[Positive, ...], OfOutputs]


@dataclass(frozen=True, eq=False, kw_only=True)
class Model(ModelMetadata):
    """A network or an ensemble with its metadata and its tensors.

    ``tensors`` are read-only float32 arrays, one set for each member.
    """

    tensors: Mapping[str, NDArray[np.float32]]


def refuse(path: Path, name: str | None, expected: str, got: str, hint: str = "") -> NoReturn:
    """Raise a ``ModelError`` about a file.

    Args:
        path: The file.
        name: The field that is wrong. None means that the whole file is wrong.
        expected: The expected value, in words.
        got: The actual value in the file, in words.
        hint: Advice for the user, or an empty text.

    """
    raise ModelError(place=Place(file=path, field=name), expected=expected, got=got, hint=hint)


def layer_names() -> list[tuple[str, str]]:
    """Return the block and the number of every layer before fc_out.

    Tensors and masks have the same order.
    """
    return [
        (f"stages.{stage}.{block}", number)
        for stage in range(STAGES)
        for block in range(BLOCKS)
        for number in (("1", "2", "3", "s") if block == 0 else ("1", "2", "3"))
    ]


def tensor_shapes(kind: str = RESNET) -> dict[str, tuple[int, ...]]:
    """Return the name and the shape of every tensor of a member, in the order of the layers.

    Figures 3 and 4 of the paper show the layers of a ResNet.
    """
    if kind == PERCEPTRON:
        sizes = {"fc1": (WIDTH, PERCEPTRON_INPUTS), "fc2": (WIDTH, WIDTH), "fc_out": (OUTPUTS, WIDTH)}
        return {f"{name}.{part}": size[:n] for name, size in sizes.items() for part, n in PARTS}
    shapes: dict[str, tuple[int, ...]] = {}
    for block, number in layer_names():
        inputs = INPUTS if block == "stages.0.0" and number in ("1", "s") else WIDTH
        shapes[f"{block}.fc{number}.weight"] = (WIDTH, inputs)
        shapes[f"{block}.fc{number}.bias"] = (WIDTH,)
        shapes |= {f"{block}.bn{number}.{part}": (WIDTH,) for part in NORM}
    shapes |= {f"bn_out.{part}": (WIDTH,) for part in NORM}
    return shapes | {"fc_out.weight": (OUTPUTS, WIDTH), "fc_out.bias": (OUTPUTS,)}


def load_model(path: Path) -> Model:
    """Read and check a model file.

    Raise a ``ModelError`` that states the fault and the field.
    """
    refuse_other_kind(path, FileKind.MODEL, error=ModelError)
    return _parse(model_bytes(path, "a model file", most=LARGEST_BYTES), path)


def model_bytes(
    path: Path, kind: str, *, most: int, place: Place | None = None, error: type[InputError] = ModelError
) -> bytes:
    """Return the bytes of a regular file.

    Raise ``error`` if the file is unreadable, too large or not a regular file.

    Args:
        path: The file.
        kind: The kind of file, in words for the error's text.
        most: The largest number of bytes.
        place: The place that the error states. None means the file.
        error: The class of the error.

    """
    place = place or Place(file=path)
    data = read_bytes(path, most=most, place=place, error=error)
    if len(data) > most:
        raise error(place=place, expected=f"{kind} of at most {most} bytes", got="a larger one")
    return data


def save_model(model: Model, path: Path) -> None:
    """Write ``model`` to ``path`` in one step, so that ``path`` never holds a part of a file.

    If ``load_model`` would refuse the model, raise ``ModelError`` and write no file. Raise ``OutputError`` if
    the file cannot be written.
    """
    tensors = {name: np.ascontiguousarray(tensor) for name, tensor in model.tensors.items()}
    try:
        data = save(tensors, metadata={KEY: json.dumps(metadata_of(model), sort_keys=True, allow_nan=False)})
    except (TypeError, ValueError, SafetensorError) as error:
        refuse(path, None, "a model of numbers and plain texts", str(error))
    _parse(data, path)
    with writing_to(path), replacing(path) as unfinished:
        unfinished.write_bytes(data)


@contextmanager
def writing_to(path: Path) -> Iterator[None]:
    """Raise ``OutputError`` if the code in the block cannot write the file ``path``."""
    try:
        yield
    except OSError as error:
        raise OutputError.of_file(path, "a file that can be written", error.strerror or str(error)) from error


def refuse_foreign_cell(network: NetworkUse, settings: Settings, path: Path) -> None:
    """Raise ``ModelError`` if the cell's desired TCP or nominal hand is outside of the network's seen space.

    Args:
        network: The network, with its seen space.
        settings: The settings of the cell.
        path: The network's file.

    """
    for name, point_m in (
        ("tcp", settings.cell.desired_tcp_position_in_base_m),
        ("hand", settings.avoidance.nominal_hand_position_in_base_m),
    ):
        low_m, high_m = network.seen.boxes[name]
        if not all(low <= x <= high for low, x, high in zip(low_m, point_m, high_m, strict=True)):
            refuse(
                path,
                f"seen.{name}_low_m to seen.{name}_high_m",
                f"a seen space with the cell's {name} position {list(point_m)} in it",
                f"{list(low_m)} to {list(high_m)}",
                hint=f"it was trained for another workspace, of the arm {network.made_for}; "
                "`safety-harness train --robot SCENARIO` makes one for this",
            )


def metadata_of(model: Model) -> dict[str, Any]:
    """Return the metadata of a model as JSON objects."""
    metadata = {item.name: plain(getattr(model, item.name)) for item in fields(ModelMetadata)}
    if model.calibration is not None:
        del metadata["calibration"]["more"]
        metadata["calibration"] = dict(model.calibration.more) | metadata["calibration"]
    return metadata | {"card": dict(model.card)}


def _parse(data: bytes, path: Path) -> Model:
    """Return the model that the bytes of a safetensors file contain.

    Raise ``ModelError`` at the first fault.
    """
    try:
        stored = dict(deserialize(data))  # type: ignore[no-untyped-call]  # checks every offset and length against the file's size
    except SafetensorError as error:
        refuse(path, None, "a safetensors file", str(error))
    header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
    text = (header.get("__metadata__") or {}).get(KEY)
    if text is None:
        refuse(path, KEY, "the metadata of a model of this package", "none")
    document = of_format(parsed(text, path, "metadata", ModelError), FORMAT, path, ModelError)
    metadata = network_use(document, ModelMetadata, path)
    # The spread of an ensemble is between its members.  A single pass would give spread 0 and look certain.
    if metadata.dropout is not Dropout.NONE and metadata.members > 1:
        refuse(path, "members", "1 with dropout", str(metadata.members))
    for name, got, size in zip(
        ("stages", "blocks"), (metadata.stages, metadata.blocks), SIZES[metadata.kind], strict=True
    ):
        if got != size:
            refuse(path, name, f"{size} of a {metadata.kind}", str(got))
    if metadata.kind == PERCEPTRON and metadata.dropout is not Dropout.NONE:
        refuse(path, "dropout", f"'none' of a {PERCEPTRON}", repr(metadata.dropout.value))
    return Model(**vars(metadata), tensors=_tensors(stored, metadata, path))


def network_use(document: Any, kind: type[U], path: Path, *, unknown_fields: bool = False) -> U:
    """Return the metadata of a model as an object of the class ``kind``.

    Raise ``ModelError`` if a field is wrong.

    Args:
        document: The JSON object of the metadata.
        kind: The class of the result.
        path: The file, for errors.
        unknown_fields: Whether to accept additional fields, which an exported file may have.

    """
    if isinstance(document, dict) and isinstance(document.get("calibration"), dict):
        given, own = document["calibration"], {item.name for item in fields(Calibration)}
        more = {name: value for name, value in given.items() if name not in own}
        parts = {"more": more} | {name: value for name, value in given.items() if name in own}
        document = document | {"calibration": parts}
    made = typed(document, kind, path, further_fields=unknown_fields, error=ModelError)
    if made.dropout is not Dropout.NONE and made.passes < 2:
        refuse(path, "passes", "at least 2 with dropout", str(made.passes))
    if made.dropout is not Dropout.NONE and made.dropout_probability == 0.0:
        refuse(path, "dropout_probability", "above 0 with dropout", "0")
    time_s = made.card.get(CARD_TIME, 0.0)
    if type(time_s) not in (int, float) or not 0.0 <= time_s <= LONGEST_S:
        refuse(path, f"card.{CARD_TIME}", f"a time from 0 s to {LONGEST_S:g} s", repr(time_s)[:80])
    if not (made.made_for.isprintable() and 0 < len(made.made_for) <= 100):
        refuse(path, f"card.{CARD_ARM}", "the name of an arm", repr(made.made_for)[:80])
    return made


def _tensors(
    stored: Mapping[str, Mapping[str, Any]], metadata: ModelMetadata, path: Path
) -> dict[str, NDArray[np.float32]]:
    """Return every tensor of every member as a read-only array.

    ``stored`` maps the name of a tensor to its dtype, shape and bytes.
    """
    kind, members = metadata.kind, metadata.members
    shapes = {f"{k}/{name}": shape for k in range(members) for name, shape in tensor_shapes(kind).items()}
    for name in stored:
        if name not in shapes:
            refuse(path, name, f"only tensors of a {kind} with {members} member(s)", "this one too")
    tensors = {}
    for name, shape in shapes.items():
        if name not in stored:
            refuse(path, name, f"a tensor of shape {list(shape)}", "none")
        own = stored[name]
        if own["dtype"] != "F32" or tuple(own["shape"]) != shape:
            refuse(path, name, f"F32 numbers of shape {list(shape)}", f"{own['dtype']} of {own['shape']}")
        tensor = np.frombuffer(bytes(own["data"]), dtype="<f4").reshape(shape)
        bad = np.argwhere(~np.isfinite(tensor))
        if len(bad):
            refuse(path, name, "finite numbers", f"{tensor[tuple(bad[0])]} at {bad[0].tolist()}")
        if name.endswith("running_var") and tensor.min() < 0.0:
            refuse(path, name, "variances of at least 0", f"{tensor.min():g}")
        tensors[name] = tensor
    return tensors


def onnx_bytes(path: Path, place: Place | None = None, error: type[InputError] = ModelError) -> bytes:
    """Return the bytes of an ONNX file.

    Raise ``error`` if the file is missing or too large.

    The error states ``place``, or the file if ``place`` is None.
    """
    return model_bytes(path, "an ONNX file", most=LARGEST_ONNX_BYTES, place=place, error=error)


def onnx_metadata(path: Path, data: bytes) -> dict[str, str]:
    """Return the metadata of an ONNX file.

    ``path`` is the file, and ``data`` its contents. Raise ``ModelError`` if the contents are not an ONNX
    file.
    """
    try:
        fields = list(islice(_fields(memoryview(data)), MOST_FIELDS))
        pairs = [dict(islice(_fields(value), 2)) for number, value in fields if number == METADATA]
        metadata = {bytes(pair.get(1, b"")).decode(): bytes(pair.get(2, b"")).decode() for pair in pairs}
    except (ValueError, IndexError):
        fields = []
    if GRAPH not in [number for number, _ in fields]:
        refuse(path, None, "an ONNX file", "something else, or a part of one")
    return metadata


def _fields(data: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Yield the number and the value of each field of a message.

    Raise ``ValueError`` or ``IndexError`` if the bytes are not a valid message.
    """
    at = 0
    while at < len(data):
        key, at = _varint(data, at)
        if key & 7 == 2:
            length, at = _varint(data, at)
        elif key & 7 == 0:
            length = _varint(data, at)[1] - at
        else:
            length = FIXED.get(key & 7, len(data))
        if at + length > len(data):
            raise ValueError("a field beyond the end")
        yield key >> 3, data[at : at + length]
        at += length


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    """Return the variable-length number at index ``at``, and the index after it.

    Each byte contains seven bits of the number, with the lowest bits first.
    """
    number = 0
    for shift in range(0, 70, 7):
        number |= (data[at + shift // 7] & 0x7F) << shift
        if data[at + shift // 7] < 0x80:
            return number, at + shift // 7 + 1
    raise ValueError("a number without an end")
