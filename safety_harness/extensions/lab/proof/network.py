"""Any ReLU network as layers, each an affine map of earlier layers, with bounds of its program's rounding.

A layer is z = b + sum_s W_s a_s, followed by a = relu(z).  The sources a_s are the question (s = 0) or
earlier layers, *with the values that the program computed*.  The last layer is the answer, without a ReLU.
W contains everything between two ReLUs (batch norm, residual sums, normalisation).  ``AffineForm`` carries an
error bound E_s for each W_s: the program's value deviates by at most sum_s E_s |a_s|.  A ReLU does not round,
so errors do not add up over layers here.  The kernel that bounds the network treats them as slack.

If a program with the unit roundoff u adds n terms, its error is at most gamma times the terms' magnitudes.
Here gamma = n u / (1 - n u).  This holds in any order, with or without fused operations (Higham 2002, 3.1).
``GUARD`` more terms cover any folding of weights by a runtime, and the rounding of W and E in this module.
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
SINGLE, DOUBLE = 2.0**-24, 2.0**-53
SHALLOW = 8  # layers
GUARD, TINY = 16, 1e-30  # added terms; the largest loss by products below float32's least number
LARGEST = 1e12  # the largest coefficient: with units below 1e8 no float32 sum overflows


class ReluNetwork(NamedTuple):
    """A network of m members with the same shape, in contiguous arrays for compiled code.

    Row i of ``blocks`` (n, 3) is (layer, source, start).  The matrix (inputs, outputs) of this block begins
    at ``start`` in ``weight`` and ``error`` (m, N), row by row.  An empty ``error`` means 0.  Layers count
    from 0 and sources from 1; source 0 is the question.  ``rounding`` times magnitudes bounds the rounding
    errors of float64 in the bounds.
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
    """A value of the program as an affine form of its sources: ``CONSTANT``, the question and layers.

    ``value`` has a matrix (inputs, width) for each source.  The program's value deviates by at most
    ``error``, of the same shape, times the sources' magnitudes.  If members differ, a matrix is (m, inputs,
    width).
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
        """Whether all members have the same form, whatever their masks."""
        return all(value.ndim == 2 or len(value) == 1 for value in self.value.values())

    @property
    def sizes(self) -> dict[int, Floats]:
        """The largest magnitudes (inputs, width) of the coefficients by source, with their error."""
        return {s: np.abs(value) + self.error[s] for s, value in self.value.items()}

    def linear(self, weight: Floats, bias: Floats, unit: float) -> AffineForm:
        """Return the form after a layer with ``weight`` (width, outputs) and ``bias`` (outputs,).

        Args:
            weight: The weights, with an axis of members in front if members differ.
            bias: The bias, with an axis of members in front if members differ.
            unit: The unit roundoff of the program.

        """
        size, bias = np.abs(weight), bias[..., None, :]
        part = gamma(weight.shape[-2] + 1, unit)
        value = {s: own @ weight for s, own in self.value.items()}
        error = {s: self.error[s] @ size + part * (own @ size) for s, own in self.sizes.items()}
        value[CONSTANT] = value.get(CONSTANT, 0.0) + bias
        error[CONSTANT] = error.get(CONSTANT, 0.0) + part * np.abs(bias) + TINY
        return AffineForm(value, error)

    def scaled(self, factors: Floats, unit: float) -> AffineForm:
        """Return the form times ``factors`` (width,) or (m, width), rounded with the roundoff ``unit``."""
        width = factors.shape[-1]
        return self.linear(factors[..., None] * np.eye(width), np.zeros(width), unit)

    def plus(self, second: AffineForm, unit: float) -> AffineForm:
        """Return the sum with ``second``, of the same width, rounded with the roundoff ``unit``."""
        part, value, error = gamma(2, unit), dict(self.value), dict(self.error)
        for s, own in self.sizes.items():
            error[s] = error[s] + part * own
        for s, own in second.sizes.items():
            value[s] = value.get(s, 0.0) + second.value[s]
            error[s] = error.get(s, 0.0) + second.error[s] + part * own
        return AffineForm(value, error)


def gamma(terms: int, unit: float) -> float:
    """Return the relative rounding bound of a sum of ``terms`` products: twice the checker's bound."""
    part = 2.0 * (terms + GUARD) * unit
    return part / (1.0 - part)


def joined(forms: Sequence[AffineForm]) -> AffineForm:
    """Return one form with the outputs of all ``forms`` side by side."""
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
    """Return the form of hand and TCP [m], rounded to numbers with the unit roundoff ``unit``."""
    return AffineForm({QUESTION: np.eye(PERCEPTRON_INPUTS)}, {QUESTION: unit * np.eye(PERCEPTRON_INPUTS)})


@dataclass(eq=False)
class Layers:
    """The ReLU layers of a network so far; layers of the same network in ``known`` are not computed again."""

    forms: list[AffineForm] = field(default_factory=list)
    known: dict[int, AffineForm] = field(default_factory=dict)

    def relu(self, make: Callable[[], AffineForm]) -> AffineForm:
        """Add a ReLU layer with the input that ``make`` returns, and return its outputs as a form."""
        form = self.known.get(len(self.forms)) or make()
        if form.is_shared:
            self.known[len(self.forms)] = form
        self.forms.append(form)
        own = np.eye(form.width)
        return AffineForm({len(self.forms): own}, {len(self.forms): 0.0 * own})


def packed(layers: Sequence[AffineForm], members: int = 1) -> ReluNetwork:
    """Return the network of ``layers``, of which the last is the answer [m].

    All ``members`` share a form that has no axis of members.
    """
    pairs = [(k, s) for k, form in enumerate(layers) for s in sorted(form.value) if s != CONSTANT]
    sizes = [layers[k].value[s].shape[-2] * layers[k].width for k, s in pairs]
    starts = np.cumsum([0, *sizes])[:-1]

    def flat(parts: Iterable[Floats]) -> Floats:
        """Return the parts (members, N) one after another, row by row."""
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
    """Return the network of a model file; passes of dropout are members, with the masks of ``seed``.

    A perceptron computes in float64, like the bounds, so that ``rounding`` also covers its own rounding.
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
    """Return the folded network, and a store for the layers that no mask changes."""
    return fold(model), {}


def _resnet(model: Model, seed: int) -> ReluNetwork:
    """Return the network as ``cell.avoidance.resnet_kernel`` computes it in float32.

    The result has the same layers, shortcuts and dropout.
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
        if own.places == STAGES and inner == BLOCKS - 1:
            x = x.scaled(drop[stage], SINGLE)
    scale = own.scale_out.astype(float)[..., None] * np.eye(WIDTH)
    x = x.linear(scale, own.shift_out.astype(float), SINGLE)
    if own.places == FULL_PLACES:
        x = x.scaled(drop[LAYERS], SINGLE)
    answer = x.linear(own.weight_out.astype(float), own.bias_out.astype(float), SINGLE)
    answer = answer.linear(np.diag(own.target_std), own.target_mean, DOUBLE)
    return packed([*layers.forms, answer], model.members * passes)
