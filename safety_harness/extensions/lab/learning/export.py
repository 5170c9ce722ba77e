"""Export a trained model to an ONNX file for other programs.

The file contains one function, whose inputs and outputs are in metres.  The function includes the
normalisation, all passes or members, and the formulas for their mean and standard deviation.  Inputs and
outputs are float64 and have the shape (n, 3).  The network itself computes in float32, as in this package.
If the model has dropout, the masks are an input of the function.  The caller can therefore choose the masks,
for example the masks that this package draws.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from safety_harness.base.exceptions import ModelError, OutputError, Place
from safety_harness.base.extras import quiet_export
from safety_harness.base.whole_file import replacing
from safety_harness.cell.avoidance.learned import LearnedAvoider
from safety_harness.cell.avoidance.model_file import KEY, Dropout, Model, metadata_of, writing_to
from safety_harness.cell.avoidance.onnx_file import open_session
from safety_harness.cell.avoidance.onnx_model import EXPORT_FORMAT, drawn_masks
from safety_harness.cell.avoidance.onnx_names import HAND, MASKS, POSITION, SPREAD, TCP
from safety_harness.extensions.lab.learning.networks import Network, load_tensors, network_of
from safety_harness.scenario.references import ONNX_SUFFIX

ROWS = 256  # questions of the comparison in the seen boxes, and as many in larger boxes
# Measured: float32 sums in another order differ by 1e-7 m, or by 4e-7 m if the network uses raw millimetres.
MOST_DIFFERENT_M = 1e-6
FARTHER = 1.5  # the size of the larger boxes, relative to the seen boxes

Arrays = tuple[NDArray[np.float64], ...]
Function = Callable[[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_] | None], Arrays]


class WholeFunction(nn.Module):
    """The function from hands and TCPs to positions and spreads, all of shape (n, 3) [m].

    A network with dropout also takes masks (n, passes, places, width).  The position is the mean over the
    passes or members.  The spread is their standard deviation, with the number of passes or members in the
    denominator.
    """

    def __init__(self, model: Model) -> None:
        super().__init__()
        self.members = nn.ModuleList(_network(model, member) for member in range(model.members))
        self.passes = model.passes
        for name in ("input_mean", "input_std", "target_mean", "target_std"):
            self.register_buffer(name, torch.tensor(getattr(model, name), dtype=torch.float64))
        self.eval()

    def forward(self, hand: Tensor, tcp: Tensor, masks: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Return float64 positions and spreads for ``hand``, ``tcp`` and ``masks``, shape (n, 3) each [m]."""
        inputs = torch.cat([hand, tcp], dim=1)
        x = (inputs - self.get_buffer("input_mean")) / self.get_buffer("input_std")
        x = torch.cat([x, torch.ones_like(x[:, :1])], dim=1).float()  # (n, 7)
        if masks is None:
            answers = torch.stack([member(x) for member in self.members], dim=1)  # (n, members, 3)
        else:
            by_place = masks.permute(2, 0, 1, 3).flatten(1, 2)  # (places, n passes, width)
            every = self.members[0](x.repeat_interleave(self.passes, dim=0), by_place)
            answers = every.unflatten(0, (-1, self.passes))  # (n, passes, 3)
        answers = answers.double()
        std = self.get_buffer("target_std")
        mean = answers.mean(dim=1)
        # The ReLU of a runtime may turn NaN into 0; this sum makes the answer NaN if an input is not finite.
        doubt = 0.0 * inputs.sum(dim=1, keepdim=True)
        spread = std * ((answers - mean[:, None]) ** 2).mean(dim=1).sqrt()
        return self.get_buffer("target_mean") + std * mean + doubt, spread + doubt


def _network(model: Model, member: int) -> Network:
    """Return one member of the model, in evaluation mode."""
    network = network_of(model.kind, model.dropout, model.dropout_probability)
    prefix = f"{member}/"
    tensors = {n.removeprefix(prefix): t for n, t in model.tensors.items() if n.startswith(prefix)}
    load_tensors(network, tensors)
    return network.eval().requires_grad_(False)


def write_export(model: Model, source: bytes, out: Path, *, seed: int) -> float:
    """Write a model as an ONNX file after a comparison with the original model.

    If the export or the comparison fails, an existing file remains unchanged.

    Args:
        model: The model.
        source: The bytes of the model's file.
        out: The file to write.
        seed: The root of the random numbers for the comparison.

    Returns:
        The largest difference [m] between ``LearnedAvoider`` and the exported function, computed by
        ``difference``.

    Raises:
        ModelError: The difference is above 1e-6 m.
        OutputError: ``out`` cannot be written or does not end in .onnx.

    """
    if out.suffix != ONNX_SUFFIX:
        raise OutputError(
            place=Place(file=out), expected=f"a file that ends in {ONNX_SUFFIX}", got=repr(out.name)
        )
    metadata = metadata_of(model) | {
        "format": EXPORT_FORMAT,
        "source_sha256": hashlib.sha256(source).hexdigest(),
    }
    data = _onnx_bytes(model, json.dumps(metadata, sort_keys=True))
    with writing_to(out), replacing(out) as unfinished:
        unfinished.write_bytes(data)
        found_m = difference(model, load_onnx(unfinished), seed=seed)
        if not found_m <= MOST_DIFFERENT_M:
            raise ModelError(
                place=Place(file=out),
                expected=f"the original's answers to {1e3 * MOST_DIFFERENT_M:g} mm",
                got=f"a difference of {1e3 * found_m:.3g} mm",
            )
    return found_m


def difference(model: Model, function: Function, *, seed: int) -> float:
    """Return the largest difference [m] between the answers of a function and of ``LearnedAvoider``.

    It is the maximum over all coordinates of positions and spreads.

    Half of the inputs are random hands and TCPs in the model's seen boxes.  The rest lie in boxes that are
    1.5 times as large.  Each input has its own seed, which determines its masks.  In one additional input,
    the hand is NaN.  If the function gives a finite answer to this input, the difference is infinite.

    Args:
        model: The model.
        function: The function to compare.
        seed: The root of the random inputs.

    """
    rng = np.random.default_rng(seed)
    hands, tcps = (
        np.concatenate(
            [rng.uniform(centre - size * half, centre + size * half, (ROWS, 3)) for size in (1.0, FARTHER)]
        )
        for centre, half in _boxes(model)
    )
    seeds = rng.integers(0, 2**64, len(hands), dtype=np.uint64)
    masks = None if model.dropout is Dropout.NONE else drawn_masks(model, seeds)
    own = LearnedAvoider.from_model(model).propose_many(hands, tcps, seeds)
    answers = function(hands, tcps, masks)
    # A runtime must not turn a missing hand into a finite answer.
    no_answer = function(hands[:1] * np.nan, tcps[:1], None if masks is None else masks[:1])
    if np.isfinite(no_answer).any() or any(a.shape != b.shape for a, b in zip(own, answers, strict=True)):
        return float("inf")
    greatest = float(np.abs(np.array(answers) - np.array(own)).max())
    return greatest if np.isfinite(greatest) else float("inf")


def _boxes(model: Model) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Yield the centre and the half size of the box of seen hands, then of the box of seen TCPs."""
    for low, high in map(np.array, model.seen.boxes.values()):
        yield (low + high) / 2, (high - low) / 2


def _onnx_bytes(model: Model, metadata: str) -> bytes:
    """Return the bytes of a self-contained ONNX file.

    The function removes the local file paths that PyTorch adds.
    """
    # Two rows: PyTorch would treat a single row as a constant size.
    point = torch.zeros((2, 3), dtype=torch.float64)
    question = {HAND: point, TCP: point.clone()}
    if model.dropout is not Dropout.NONE:
        question[MASKS] = torch.from_numpy(drawn_masks(model, np.arange(2, dtype=np.uint64)))
    rows = torch.export.Dim("n")
    with quiet_export():  # ``difference`` tests the result
        program = torch.onnx.export(
            WholeFunction(model),
            tuple(question.values()),
            dynamo=True,
            dynamic_shapes=({0: rows},) * len(question),
            input_names=list(question),
            output_names=[POSITION, SPREAD],
            external_data=False,
            verbose=False,
        )
    assert program is not None  # an export with dynamo always returns a program
    proto = program.model_proto
    proto.graph.ClearField("value_info")  # PyTorch's shapes of transposed weights contradict inferred ones
    for part in (*proto.graph.node, *proto.graph.input, *proto.graph.output):
        part.ClearField("doc_string")
        part.ClearField("metadata_props")
    # These fields contain the stack traces of the export, with the paths of this machine.
    proto.graph.ClearField("metadata_props")
    proto.ClearField("metadata_props")
    proto.metadata_props.add(key=KEY, value=metadata)
    data: bytes = proto.SerializeToString(deterministic=True)
    return data


def load_onnx(path: Path) -> Function:
    """Return a function that evaluates an exported ONNX file with onnxruntime."""
    session = open_session(path, path.read_bytes())  # the file that was just written

    def function(
        hands: NDArray[np.float64], tcps: NDArray[np.float64], masks: NDArray[np.bool_] | None
    ) -> Arrays:
        feed = {HAND: hands, TCP: tcps} | ({} if masks is None else {MASKS: masks})
        return tuple(session.run((POSITION, SPREAD), feed))

    return function
