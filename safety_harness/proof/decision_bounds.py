"""What a network can answer for any hand within a box: affine forms through all passes of one decision.

A unit's value is c + sum_k g_k e_k + r e', every e in [-1, 1]: the first three e are the hand's place in its box,
the others what ReLUs may add.  An affine layer keeps this form exactly.  A ReLU of l <= z <= u, l < 0 < u, lies
between s z and s z + m with s = u / (u - l), m = -s l (Singh et al. 2018, DeepZ).  Forms, unlike intervals, know
that two units, and two passes, depend on the same hand; so mean and spread are bounded from all of them together.

They enclose what the *program* computes.  A sum of n products is off by gamma_n (|b| + sum |w| |x|) at most,
gamma_n = n u / (1 - n u), in any order (Higham 2002, section 3.1); u is 2^-24 for the ResNet's float32, 2^-53 for
the perceptron's float64, and 2^-53 once more for the forms themselves.  That joins a unit's slack r; at the end of
a block r becomes a form's e, or it would grow by |w| from layer to layer.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from safety_harness.avoidance.masks import fill_factors
from safety_harness.avoidance.model_file import BLOCKS, LAYERS, OUTPUTS, STAGE_LAYERS, STAGES, WIDTH
from safety_harness.avoidance.perceptron_kernel import Perceptron
from safety_harness.avoidance.resnet_kernel import FULL_PLACES, FoldedNetwork

Floats = NDArray[np.float64]

SINGLE, DOUBLE = 2.0**-24, 2.0**-53  # unit roundoffs
TERMS = WIDTH + 8  # of any sum of products here, and to spare
UP, DOWN = 1.0 + 1e-12, 1.0 - 1e-12  # around a sum of 1,000 magnitudes in float64
LEAST = 1e-30  # where float32 underflows
HAND = 3  # the first symbols


class Form(NamedTuple):
    """The units of one layer in each of p passes; every pass has the same symbols, some of them zero."""

    centre: Floats  # (p, units)
    symbols: Floats  # (k, p, units)
    slack: Floats  # (p, units)

    @property
    def radius(self) -> Floats:
        """(p, units): how far from its centre a unit can be."""
        found: Floats = (np.abs(self.symbols).sum(axis=0) + self.slack) * UP
        return found

    @property
    def size(self) -> Floats:
        """(p, units): the greatest magnitude that a unit can have."""
        return np.abs(self.centre) + self.radius


@dataclass(frozen=True, eq=False)
class AnswerBounds:
    """Answers to any hand in the box: centre + hand . e + shared . e' +- rest, by axis [m]; read with ``low``.

    ``hand`` (3, 3) is [axis of the box, axis of the answer], ``shared`` (k, 3) of symbols that passes share.
    """

    centre: Floats  # (3,)
    hand: Floats  # (3, 3)
    shared: Floats  # (k, 3)
    rest: Floats  # (3,)
    spread_low_m: Floats  # (3,)
    spread_high_m: Floats  # (3,)

    @property
    def radius(self) -> Floats:
        """(3,) how far an answer can be from the centre on each axis [m]."""
        found: Floats = (np.abs(self.hand).sum(axis=0) + np.abs(self.shared).sum(axis=0) + self.rest) * UP
        return found


def answer_bounds(
    network: FoldedNetwork | Perceptron, hand: Floats, half: Floats, tcp: Floats, seed: int
) -> AnswerBounds:
    """Bounds of what ``LearnedAvoider`` says to a TCP and seed, and any hand within ``half`` of ``hand``.

    ``hand`` (3,), ``half`` (3,) and ``tcp`` (3,) in the base frame [m].
    """
    if isinstance(network, Perceptron):
        inputs = _inputs(hand, half, tcp, np.zeros(6), np.ones(6), 0.0)
        answers = [_perceptron(network, member, inputs) for member in range(len(network.weight1))]
        return _summary(answers, HAND, np.zeros(3), np.ones(3))
    inputs = _inputs(hand, half, tcp, network.input_mean, network.input_std, SINGLE)
    rows = network.passes if network.places > 0 else 1
    factors = np.empty((network.places, rows, WIDTH), np.float32)
    if network.places > 0:
        fill_factors(np.uint64(seed), network.probability, factors)
    found = [
        _resnet(network, member, inputs, factors.astype(np.float64)) for member in range(len(network.weight))
    ]
    shared = found[0][1] if len(found) == 1 else HAND
    return _summary([form for form, _ in found], shared, network.target_mean, network.target_std)


def _inputs(hand: Floats, half: Floats, tcp: Floats, mean: Floats, std: Floats, unit: float) -> Form:
    """Hand and TCP, normalised as the program does it, and the ResNet's constant 1 where ``unit`` is its."""
    units = 7 if unit else 6
    centre, symbols, slack = np.ones((1, units)), np.zeros((HAND, 1, units)), np.zeros((1, units))
    centre[0, :6] = (np.concatenate([hand, tcp]) - mean) / std
    symbols[range(3), 0, range(3)] = half / std[:3]
    size = (np.abs(np.concatenate([hand, tcp])) + np.concatenate([half, np.zeros(3)]) + np.abs(mean)) / std
    slack[0, :6] = (unit + 8.0 * DOUBLE) * size + LEAST
    return Form(centre, symbols, slack)


def _affine(weight: Floats, bias: Floats, unit: float, x: Form) -> Form:
    """bias + x weight (inputs, outputs), as a program of that roundoff computes it."""
    gamma = TERMS * unit / (1.0 - TERMS * unit) + 2.0 * TERMS * DOUBLE
    inputs, outputs = weight.shape
    symbols = (x.symbols.reshape(-1, inputs) @ weight).reshape(*x.symbols.shape[:2], outputs)
    steep = np.abs(weight)
    slack = x.slack @ steep + gamma * (x.size @ steep + np.abs(bias)) + LEAST
    return Form(bias + x.centre @ weight, symbols, slack * UP)


def _scaled(factors: Floats, shift: Floats | float, unit: float, x: Form) -> Form:
    """Factors (p, units) times x, and a shift, each rounded once."""
    steep, least = np.abs(factors), np.where(factors == 0.0, 0.0, LEAST)
    rounding = 2.0 * (unit + 4.0 * DOUBLE) * (x.size * steep + np.abs(shift))
    slack = (x.slack * steep + rounding + least) * UP
    return Form(x.centre * factors + shift, x.symbols * factors, slack)


def _added(x: Form, shortcut: Form, unit: float) -> Form:
    """x + shortcut, rounded once; x has every symbol of the shortcut, and more after them."""
    symbols = x.symbols.copy()
    symbols[: len(shortcut.symbols)] += shortcut.symbols
    whole = Form(x.centre + shortcut.centre, symbols, x.slack + shortcut.slack)
    return whole._replace(slack=(whole.slack + (unit + 4.0 * DOUBLE) * whole.size) * UP)


def _rectified(x: Form, *, settle: bool = False) -> Form:
    """ReLU: a new symbol for each unit that it bends in some pass; ``settle``: of every slack as well."""
    radius = x.radius
    low, high = x.centre - radius, x.centre + radius
    bent = (low < 0.0) & (high > 0.0)
    slope = np.where(bent, high / np.where(bent, high - low, 1.0), np.where(high > 0.0, 1.0, 0.0))
    middle = np.where(bent, np.maximum(-slope * low, (1.0 - slope) * high) / 2.0, 0.0)
    centre = slope * x.centre + middle
    rounding = 8.0 * DOUBLE * (np.abs(centre) + slope * radius + middle)
    slack = (slope * x.slack + np.where(slope > 0.0, rounding, 0.0)) * UP
    added = middle * UP + (slack if settle else 0.0)
    units = np.flatnonzero((added > 0.0).any(axis=0))
    fresh = np.zeros((len(units), *centre.shape))
    fresh[np.arange(len(units)), :, units] = added[:, units].T
    return Form(centre, np.concatenate([x.symbols * slope, fresh]), np.zeros_like(slack) if settle else slack)


def _perceptron(network: Perceptron, member: int, x: Form) -> Form:
    """The answer of one member [m]."""
    for weight, bias in ((network.weight1, network.bias1), (network.weight2, network.bias2)):
        x = _rectified(_affine(weight[member], bias[member], DOUBLE, x))
    return _affine(network.weight3[member], network.bias3[member], DOUBLE, x)


def _resnet(network: FoldedNetwork, member: int, x: Form, factors: Floats) -> tuple[Form, int]:
    """The answers (p, 3) of one member's passes, normalised, and how many symbols all of them share.

    ``factors`` (places, p, WIDTH) of dropout.
    """
    weights, biases = network.weight[member].astype(np.float64), network.bias[member].astype(np.float64)
    full, inter = len(factors) == FULL_PLACES, len(factors) == STAGES

    def connect(layer: int, x: Form) -> Form:
        if full:
            x = _scaled(factors[layer, :, : x.centre.shape[1]], 0.0, SINGLE, x)
        return _affine(weights[layer, : x.centre.shape[1]], biases[layer], SINGLE, x)

    if full:
        x = _repeated(x, factors.shape[1])
    shared = HAND
    for stage in range(STAGES):
        for block in range(BLOCKS):
            layer = stage * STAGE_LAYERS + 3 * block + (1 if block > 0 else 0)
            h = _rectified(connect(layer, x))
            h = connect(layer + 2, _rectified(connect(layer + 1, h)))
            x = _rectified(_added(h, connect(layer + 3, x) if block == 0 else x, SINGLE), settle=True)
        if inter:
            if stage == 0:  # until the first dropout all passes are the same
                shared, x = len(x.symbols), _repeated(x, factors.shape[1])
            x = _scaled(factors[stage], 0.0, SINGLE, x)
    x = _scaled(
        *(part[member].astype(np.float64) for part in (network.scale_out, network.shift_out)), SINGLE, x
    )
    if full:
        x = _scaled(factors[LAYERS], 0.0, SINGLE, x)
    last = (part[member].astype(np.float64) for part in (network.weight_out, network.bias_out))
    return _affine(*last, SINGLE, x), shared


def _repeated(x: Form, passes: int) -> Form:
    return Form(*(np.repeat(part, passes, axis=-2) for part in x))


def _summary(answers: list[Form], shared: int, target_mean: Floats, target_std: Floats) -> AnswerBounds:
    """Mean and spread over all passes of all members, in metres; only the first symbols are ``shared``."""
    centre = np.concatenate([one.centre for one in answers])  # (n, 3)
    common = np.concatenate([one.symbols[:shared] for one in answers], axis=1)  # (shared, n, 3)
    own = np.concatenate([np.abs(one.symbols[shared:]).sum(axis=0) + one.slack for one in answers]) * UP
    n = len(centre)
    mean, together, owned = centre.mean(axis=0), common.mean(axis=1), own.mean(axis=0)
    size = (np.abs(centre) + np.abs(common).sum(axis=0) + own).max(axis=0)  # (3,)
    rounding = 64.0 * n * DOUBLE * size
    # A pass's distance from the mean: its own symbols count 1 - 1/n, those of the others 1/n each.
    apart = (
        np.abs(common - together[:, None]).sum(axis=0) + own * (1.0 - 2.0 / n) + owned if n > 1 else 0.0 * own
    )
    distance, away = np.abs(centre - mean), (apart + rounding) * UP
    least = np.sqrt((np.maximum(distance - away, 0.0) ** 2).mean(axis=0))
    most = np.sqrt(((distance + away) ** 2).mean(axis=0))
    meant = 64.0 * n * DOUBLE * (np.abs(target_mean) + target_std * size)
    return AnswerBounds(
        centre=target_mean + target_std * mean,
        hand=target_std * together[:HAND],
        shared=target_std * together[HAND:],
        rest=(target_std * owned + meant) * UP,
        spread_low_m=target_std * least * DOWN,
        spread_high_m=target_std * most * UP,
    )
