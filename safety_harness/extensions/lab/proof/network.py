"""Represent a ReLU network as a list of layers, each with bounds of its rounding errors.

Before its ReLU, a layer is an affine map of earlier layers. A layer is z = b + sum_s W_s a_s, followed by a =
relu(z). The sources a_s are the input (s = 0) and earlier layers, *with the rounded values that the program
computed*. The last layer is the answer and has no ReLU. W combines all affine operations between two ReLUs
(batch normalisation, residual sums, normalisation). ``AffineForm`` contains an error bound E_s for each W_s:
the program's value of z deviates by at most sum_s E_s |a_s|. The bounds do not accumulate errors of earlier
layers, because the sources are rounded values. A ReLU adds no rounding error. The kernel that bounds the
network treats the errors as slack.

Let u be the unit roundoff of a program, and gamma = n u / (1 - n u).  If the program adds n terms, its error
is at most gamma times the sum of their magnitudes.  This bound is valid for any order of the sum, with or
without fused operations (Higham 2002, 3.1).  The module adds ``GUARD`` to n.  The larger n covers runtimes
that combine weights before the computation.  It also covers the rounding errors of W and E in this module.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from safety_harness.cell.avoidance.masks import fill_factors
from safety_harness.cell.avoidance.model_file import (
    BLOCKS,
    INPUTS,
    LAYERS,
    PERCEPTRON,
    PERCEPTRON_INPUTS,
    STAGE_LAYERS,
    STAGES,
    WIDTH,
    Model,
)
from safety_harness.cell.avoidance.perceptron_kernel import fold_perceptron
from safety_harness.cell.avoidance.resnet_kernel import FULL_PLACES, FoldedNetwork, fold

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

CONSTANT, QUESTION = -1, 0  # sources; layers count from 1
SINGLE, DOUBLE = 2.0**-24, 2.0**-53  # unit roundoffs of float32 and float64
SHALLOW = 8  # layers
GUARD, TINY = 16, 1e-30  # added terms; the largest loss by products below float32's least number
LARGEST = 1e12  # the largest coefficient: with units below 1e8 no float32 sum overflows


class ReluNetwork(NamedTuple):
    """A network of m members with the same shape, in contiguous arrays for compiled code.

    ``blocks`` has the shape (n, 3), and row i contains (layer, source, start). The matrix of this block has
    the shape (inputs, outputs). Its rows begin at ``start`` in ``weight`` and ``error``, which have the shape
    (m, N). An empty ``error`` means 0. The number of the first layer is 0, but as a source it has the number
    1, because source 0 is the input. The rounding errors of float64 in the bounds themselves are at most
    ``rounding`` times the magnitudes.
    """

    widths: Indices  # (layers,), the last of them OUTPUTS
    blocks: Indices
    weight: Floats
    error: Floats
    bias: Floats  # (m, units)
    bias_error: Floats
    rounding: float
    gathers: int  # slack becomes symbols in the last of every so many layers; 0: in no layer


@dataclass(frozen=True, eq=False)
class AffineForm:
    """A value in the program as an affine function of ``CONSTANT``, the input and earlier layers (sources).

    ``value`` has a matrix of shape (inputs, width) for each source, or of shape (m, inputs, width) if the m
    members differ.  ``error`` has matrices of the same shapes.  The value in the program deviates by at most
    ``error`` times the magnitudes of the sources.
    """

    value: Mapping[int, Floats]
    error: Mapping[int, Floats]

    def __post_init__(self) -> None:
        if not all(
            np.abs(part).max(initial=0.0) <= LARGEST for part in (self.sizes | dict(self.error)).values()
        ):
            raise ValueError(f"coefficients of at most {LARGEST:g}")

    @property
    def width(self) -> int:
        """The number of outputs."""
        return int(next(iter(self.value.values())).shape[-1])

    @property
    def is_shared(self) -> bool:
        """Whether the form is the same for all members, independently of their masks."""
        return all(value.ndim == 2 or len(value) == 1 for value in self.value.values())

    @property
    def sizes(self) -> dict[int, Floats]:
        """Bounds of the coefficients' magnitudes, including errors.

        The result has a matrix of shape (inputs, width) for each source.
        """
        return {s: np.abs(value) + self.error[s] for s, value in self.value.items()}

    def linear(self, weight: Floats, bias: Floats, unit: float) -> AffineForm:
        """Return the form of the output of a layer that multiplies by ``weight`` and adds ``bias``.

        Args:
            weight: (width, outputs) the weights, or (m, width, outputs) if the m members differ.
            bias: (outputs,) the bias, or (m, outputs) if the m members differ.
            unit: The unit roundoff of the program.

        """
        size, bias = np.abs(weight), bias[..., None, :]
        # One more term for the bias.  TINY covers products that underflow, which have no relative bound.
        part = gamma(weight.shape[-2] + 1, unit)
        value = {s: own @ weight for s, own in self.value.items()}
        error = {s: self.error[s] @ size + part * (own @ size) for s, own in self.sizes.items()}
        value[CONSTANT] = value.get(CONSTANT, 0.0) + bias
        error[CONSTANT] = error.get(CONSTANT, 0.0) + part * np.abs(bias) + TINY
        return AffineForm(value, error)

    def scaled(self, factors: Floats, unit: float) -> AffineForm:
        """Multiply the form by ``factors``, and return the product.

        ``factors`` has the shape (width,) or (m, width). The program rounds the product with the unit
        roundoff ``unit``.
        """
        width = factors.shape[-1]
        return self.linear(factors[..., None] * np.eye(width), np.zeros(width), unit)

    def plus(self, second: AffineForm, unit: float) -> AffineForm:
        """Return the sum of the form and ``second``, which has the same width.

        The program rounds the sum with the unit roundoff ``unit``.
        """
        part, value, error = gamma(2, unit), dict(self.value), dict(self.error)
        for s, own in self.sizes.items():
            error[s] = error[s] + part * own
        for s, own in second.sizes.items():
            value[s] = value.get(s, 0.0) + second.value[s]
            error[s] = error.get(s, 0.0) + second.error[s] + part * own
        return AffineForm(value, error)


def gamma(terms: int, unit: float) -> float:
    """Return a bound of the relative rounding error of a sum of ``terms`` products.

    The result is about twice the bound that the independent checker uses.
    """
    part = 2.0 * (terms + GUARD) * unit
    return part / (1.0 - part)


def joined(forms: Sequence[AffineForm]) -> AffineForm:
    """Return a form whose outputs are the concatenated outputs of all ``forms``."""
    sources = dict.fromkeys(s for form in forms for s in form.value)
    height = {s: len(form.value[s]) for form in forms for s in form.value}

    def side_by_side(parts: Sequence[Mapping[int, Floats]]) -> dict[int, Floats]:
        return {
            s: np.hstack(
                [p.get(s, np.zeros((height[s], f.width))) for p, f in zip(parts, forms, strict=True)]
            )
            for s in sources
        }

    return AffineForm(side_by_side([f.value for f in forms]), side_by_side([f.error for f in forms]))


def question(unit: float = 0.0) -> AffineForm:
    """Return the form of the input (hand and TCP) [m].

    The program rounds the input with the unit roundoff ``unit``.
    """
    return AffineForm({QUESTION: np.eye(PERCEPTRON_INPUTS)}, {QUESTION: unit * np.eye(PERCEPTRON_INPUTS)})


@dataclass(eq=False)
class Layers:
    """The ReLU layers of a network under construction.

    ``known`` contains layers of the same network that need no new computation.
    """

    forms: list[AffineForm] = field(default_factory=list)
    known: dict[int, AffineForm] = field(default_factory=dict)

    def relu(self, make: Callable[[], AffineForm]) -> AffineForm:
        """Add a ReLU layer whose input is the result of ``make``, and return its output as a form."""
        form = self.known.get(len(self.forms)) or make()
        if form.is_shared:
            self.known[len(self.forms)] = form
        self.forms.append(form)
        own = np.eye(form.width)
        return AffineForm({len(self.forms): own}, {len(self.forms): 0.0 * own})


def packed(layers: Sequence[AffineForm], members: int = 1) -> ReluNetwork:
    """Return the network that consists of ``layers``; the last layer is the answer [m].

    A form without an axis of members applies to all ``members``.
    """
    pairs = [(k, s) for k, form in enumerate(layers) for s in sorted(form.value) if s != CONSTANT]
    sizes = [layers[k].value[s].shape[-2] * layers[k].width for k, s in pairs]
    starts = np.cumsum([0, *sizes])[:-1]

    def flat(parts: Iterable[Floats]) -> Floats:
        """Return the flattened parts, concatenated to an array of shape (members, N)."""
        rows = [part.reshape(-1, part.shape[-2] * part.shape[-1]) for part in parts]
        table, end = np.empty((members, sum(row.shape[1] for row in rows))), 0
        for row in rows:
            begin, end = end, end + row.shape[1]
            table[:, begin:end] = row
        return table

    def constants(name: str) -> Floats:
        return flat(getattr(form, name).get(CONSTANT, np.zeros((1, form.width))) for form in layers)

    terms = max(sum(value.shape[-2] for s, value in form.value.items() if s != CONSTANT) for form in layers)
    error = flat(layers[k].error[s] for k, s in pairs)
    return ReluNetwork(
        widths=np.array([form.width for form in layers], np.int64),
        blocks=np.array([(k, s, at) for (k, s), at in zip(pairs, starts, strict=True)], np.int64),
        weight=flat(layers[k].value[s] for k, s in pairs),
        error=error if error.any() else np.empty((members, 0)),
        bias=constants("value"),
        bias_error=constants("error"),
        rounding=16.0 * (terms + 8) * DOUBLE,
        gathers=1 if len(layers) > SHALLOW else 0,
    )


def network_of(model: Model, seed: int = 0) -> ReluNetwork:
    """Return the network of a model.

    The passes of a network with dropout become members, whose masks ``seed`` determines.

    A perceptron computes in float64, as the bounds do, so ``rounding`` also covers the perceptron's rounding
    errors.
    """
    if model.kind != PERCEPTRON:
        return _resnet(model, seed)
    folded = fold_perceptron(model)
    parts = (
        (folded.weight1, folded.bias1),
        (folded.weight2, folded.bias2),
        (folded.weight3, folded.bias3),
    )
    forms = [
        AffineForm({CONSTANT: b[:, None], k: w}, {CONSTANT: 0.0 * b[:, None], k: 0.0 * w})
        for k, (w, b) in enumerate(parts)
    ]
    return packed(forms, model.members)


@lru_cache(maxsize=1)
def _folded(model: Model) -> tuple[FoldedNetwork, dict[int, AffineForm]]:
    """Return the network with folded weights, and an empty cache for layers that do not depend on masks."""
    return fold(model), {}


def _resnet(model: Model, seed: int) -> ReluNetwork:
    """Return a ResNet with bounds of the float32 rounding errors of ``cell.avoidance.resnet_kernel``.

    The result has the same layers, shortcuts and dropout as this kernel.
    """
    own, known = _folded(model)
    passes = own.passes if own.places else 1
    layers = Layers(known=known if passes > 1 else {})  # a single pass looks like shared layers by its shape
    factors = np.empty((own.places, passes, WIDTH), np.float32)
    fill_factors(np.uint64(seed), own.probability, factors)
    weight, bias, drop = own.weight.astype(float), own.bias.astype(float), factors.astype(float)

    def connected(form: AffineForm, layer: int) -> AffineForm:
        dropped = form.scaled(drop[layer], SINGLE) if own.places == FULL_PLACES else form
        return dropped.linear(weight[:, layer], bias[:, layer], SINGLE)

    def block(x: AffineForm, layer: int, *, inner: bool) -> AffineForm:
        h = layers.relu(lambda: connected(x, layer))
        g = layers.relu(lambda: connected(h, layer + 1))
        return layers.relu(
            lambda: connected(g, layer + 2).plus(x if inner else connected(x, layer + 3), SINGLE)
        )

    first, constant = np.eye(PERCEPTRON_INPUTS, WIDTH) / own.input_std[:, None], np.eye(WIDTH)[INPUTS - 1]
    x = question().linear(first, constant - own.input_mean @ first, SINGLE)
    for number in range(STAGES * BLOCKS):
        stage, inner = divmod(number, BLOCKS)
        x = block(x, stage * STAGE_LAYERS + 3 * inner + (inner > 0), inner=inner > 0)
        # With a mask for each stage, the dropout follows the last block of the stage.
        if own.places == STAGES and inner == BLOCKS - 1:
            x = x.scaled(drop[stage], SINGLE)
    scale = own.scale_out.astype(float)[..., None] * np.eye(WIDTH)
    x = x.linear(scale, own.shift_out.astype(float), SINGLE)
    if own.places == FULL_PLACES:
        x = x.scaled(drop[LAYERS], SINGLE)
    answer = x.linear(own.weight_out.astype(float), own.bias_out.astype(float), SINGLE)
    answer = answer.linear(np.diag(own.target_std), own.target_mean, DOUBLE)
    return packed([*layers.forms, answer], model.members * passes)
