"""The detection of frozen streams, which repeat their values to the last bit although they have noise.

A recorder that lost its sensor repeats the last values, and so does a driver that hangs. A stream without
noise, or with noise below its resolution, may also repeat them at rest. So the check applies only to a stream
whose numbers rise and fall by more than their resolution, even while they hardly move.
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
    """Return whether LOG.yaml states that repeated values come from a body at rest."""
    field = keys.optional(REPEATS)
    return field is not None and field.one_of({AT_REST: True})


def noisy(blocks: Values) -> NDArray[np.bool_]:
    """Return in which (b,) of ``blocks`` (b, BLOCK, k) the noise exceeds the motion and the resolution."""
    steps = np.diff(blocks, axis=1)
    size = np.abs(steps)
    least = np.where(size > 0.0, size, np.inf).min(axis=1)
    squares, turns = (steps**2).sum(axis=1), -(steps[:, 1:] * steps[:, :-1]).sum(axis=1)
    noise = np.maximum(RESOLUTIONS * least, LEAST_NOISE) ** 2 * (BLOCK - 1)
    changes = np.all(size.any(axis=2), axis=1)
    return np.asarray(changes & ((turns > TURNS * squares) & (squares >= noise)).any(axis=1))


def _is_frozen(row: int, repeated: int, blocks: int, samples: int) -> bool:
    """Return whether ``row`` repetitions in a row, of ``repeated`` in all, are too many for chance.

    The probability of one repetition is estimated from the samples that hardly move, without this row. These
    are the other repetitions and the samples of noisy ``blocks``.
    """
    share = (repeated - row + 1) / (BLOCK * blocks + repeated - row + 1)
    return row >= FEWEST and blocks >= NOISY_BLOCKS and samples * share**row < BY_CHANCE


def frozen(values: Values) -> NDArray[np.bool_]:
    """Return where (n,) ``values`` (n, k) repeat the previous sample too often for their noise."""
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
    """Return the samples with a mark and a note where any of ``things``, each (n, k), is frozen.

    If ``keys`` state that the body was at rest, there is only a note.
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
    """The check of ``frozen`` for a live stream, one sample at a time."""

    _block: list[tuple[float, ...]] = field(default_factory=list)
    _last: tuple[float, ...] = ()
    _noisy: int = 0
    _samples: int = 0
    _repeated: int = 0
    _row: int = 0
    _since_ns: int = 0
    _longest: tuple[int, int] = 0, 0  # the longest row that was not reported yet, and its begin

    def since(self, time_ns: int, values: tuple[float, ...]) -> int | None:
        """Add ``values`` at ``time_ns``; return the time since which the stream is frozen, or None.

        If the stream repeated values before its noise was known, the first call afterwards reports it once.
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
