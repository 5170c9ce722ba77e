"""Detect frozen streams.

A frozen stream repeats its values bit for bit, although the sensor has noise. If a recorder loses its sensor
or a driver hangs, the last values are repeated. Values are also repeated if the body is at rest and the noise
is less than the resolution of the stream. The check therefore applies only to streams whose numbers fluctuate
by more than their resolution even while the body hardly moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from safety_harness.claims.properties.base import runs_of
from safety_harness.extensions.field.logs.streams import NS, LogSamples
from safety_harness.scenario.fields import Fields

Values = NDArray[np.float64]
BLOCK, NOISY_BLOCKS = 10, 3  # samples in a block, and the fewest blocks with noise that make a stream noisy
FEWEST, BY_CHANCE = 4, 1e-3  # the fewest repetitions in a row, and the largest probability of so many
TURNS = (
    0.2  # least share of the squared steps by which successive steps turn back; noise without motion has 0.5
)
RESOLUTIONS = 2.5  # least root mean square of the steps in a block, in terms of its smallest step
LEAST_NOISE = 1e-7  # rad or m; the rounding of a computation is smaller
INTERVALS_TOLD = 3
REPEATS, AT_REST = "repeats", "at rest"


def at_rest(keys: Fields) -> bool:
    """Return True if LOG.yaml states that repeated values come from a body at rest."""
    field = keys.optional(REPEATS)
    return field is not None and field.one_of({AT_REST: True})


def noisy(blocks: Values) -> NDArray[np.bool_]:
    """Return whether noise is visible in each of the ``blocks`` (b, BLOCK, k), shape (b,).

    Noise is visible if it exceeds the motion within the block and the resolution of the numbers.
    """
    # Noise turns back at every other step, and a motion goes on, so the products of successive steps tell
    # them apart.
    steps = np.diff(blocks, axis=1)
    size = np.abs(steps)
    least = np.where(size > 0.0, size, np.inf).min(axis=1)
    squares, turns = (steps**2).sum(axis=1), -(steps[:, 1:] * steps[:, :-1]).sum(axis=1)
    noise = np.maximum(RESOLUTIONS * least, LEAST_NOISE) ** 2 * (BLOCK - 1)
    changes = np.all(size.any(axis=2), axis=1)
    return np.asarray(changes & ((turns > TURNS * squares) & (squares >= noise)).any(axis=1))


def _is_frozen(row: int, repeated: int, blocks: int, samples: int) -> bool:
    """Return whether ``row`` successive repetitions are too many to be a coincidence.

    The stream has ``repeated`` repetitions in total. The probability of one repetition is estimated from
    other samples at which the body hardly moves. These samples are the remaining repetitions, and the samples
    in the noisy ``blocks``.
    """
    share = (repeated - row + 1) / (BLOCK * blocks + repeated - row + 1)
    # Bonferroni over the samples: the row may begin at any of them.
    return row >= FEWEST and blocks >= NOISY_BLOCKS and samples * share**row < BY_CHANCE


def frozen(values: Values) -> NDArray[np.bool_]:
    """Return which samples of ``values`` (n, k) are frozen, shape (n,).

    A sample is frozen if it belongs to a series of repetitions that is too long for a sensor with noise.
    """
    same, flags = np.zeros((2, len(values)), np.bool_)
    same[1:] = np.all(values[1:] == values[:-1], axis=1)
    whole = len(values) // BLOCK * BLOCK
    blocks = int(noisy(values[:whole].reshape(-1, BLOCK, values.shape[1])).sum())
    (begins, ends), repeated = runs_of(same), int(same.sum())
    for k in np.flatnonzero(ends - begins >= FEWEST) if blocks >= NOISY_BLOCKS else ():
        row = int(ends[k] - begins[k])
        flags[begins[k] : ends[k]] = _is_frozen(row, repeated, blocks, len(values))
    return flags


def with_frozen(samples: LogSamples, things: Sequence[Values], keys: Fields) -> LogSamples:
    """Return the samples, with frozen samples marked and with a note about them.

    A sample is frozen if any of ``things`` (n, k) is frozen at this sample. If LOG.yaml states in ``keys``
    that the body was at rest, the samples get the note without the marks.
    """
    flags = np.any([frozen(thing) for thing in things], axis=0)
    if not flags.any():
        return samples
    begins, ends = runs_of(flags)
    times = zip(samples.time_ns[begins - 1] / NS, samples.time_ns[ends - 1] / NS, strict=True)
    where = ", ".join([f"{begin:.3f} to {end:.3f} s" for begin, end in times][:INTERVALS_TOLD])
    where += f" and {len(begins) - INTERVALS_TOLD} times more" * (len(begins) > INTERVALS_TOLD)
    note = f"repeats its values to the last bit from {where} of its clock, though it has noise elsewhere: "
    if at_rest(keys):
        return samples.noted(note + "at rest, as the file says")
    note += f'not measured then; the key "{REPEATS}: {AT_REST}" says that it stood still'
    return replace(samples, frozen=flags).noted(note)


@dataclass
class Repeats:
    """A check like ``frozen`` for a live stream, which takes one sample at a time."""

    _block: list[tuple[float, ...]] = field(default_factory=list)
    _last: tuple[float, ...] = ()
    _noisy: int = 0
    _samples: int = 0
    _repeated: int = 0
    _row: int = 0
    _since_ns: int = 0
    _longest: tuple[int, int] = 0, 0  # the longest row that was not reported yet, and its begin

    def since(self, time_ns: int, values: tuple[float, ...]) -> int | None:
        """Add ``values`` at ``time_ns``.

        Return the time since which the stream is frozen, or None if it is not. The noise of a stream becomes
        known only after some samples. A later call reports values that the stream repeated before that time.
        """
        self._samples += 1
        if values == self._last:
            self._row, self._repeated = self._row + 1, self._repeated + 1
        else:
            self._last, self._since_ns, self._row = values, time_ns, 0
        self._block.append(values)
        if len(self._block) == BLOCK:
            self._noisy += int(noisy(np.array([self._block]))[0])
            self._block.clear()
        if self._row > self._longest[0]:
            self._longest = self._row, self._since_ns
        row, since_ns = self._longest
        if row < FEWEST or not _is_frozen(row, self._repeated, self._noisy, self._samples):
            return None
        self._longest = 0, 0
        return since_ns
