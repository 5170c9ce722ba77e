"""The uncertainty that a tracker states beside each sample of a body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from safety_harness.base.elementary import length
from safety_harness.extensions.field.logs.streams import LogSamples
from safety_harness.scenario.fields import Field
from safety_harness.scenario.units import NUMBER

KEYS = ("field", "times")
COVARIANCES = (9, 36)  # counts of numbers in the covariance of a position, or of a pose, row by row


@dataclass(frozen=True)
class SampleBound:
    """The bound of a sample's error: the uncertainty in the stream's ``field``, multiplied by ``times``."""

    field: str
    times: float | None
    said: Field

    def reach_m(self, numbers: Sequence[float]) -> float:
        """Return the largest error of a sample, from the ``numbers`` of its field, or NaN if it is unknown.

        The numbers are a radius, half the sides of a box, or a covariance. The largest error is ``times``
        multiplied by the radius, by the distance to the box's corner, or by the covariance's largest standard
        deviation. A covariance of zeros means an unknown error. Raise LogError if the field contains any
        other number of values.
        """
        values = np.array(numbers, np.float64)
        if len(values) in COVARIANCES:
            if self.times is None:
                expected = 'the key "times": the most standard deviations by which a sample is off'
                raise self.said.error(expected, got="a covariance without it")
            side = round(len(values) ** 0.5)
            block = values.reshape(side, side)[:3, :3]
            if not np.isfinite(block).all():
                return np.nan
            variances = np.linalg.eigvalsh((block + block.T) / 2.0)
            known = variances[-1] > 0.0 and variances[0] >= -1e-9 * variances[-1]
            return self.times * float(np.sqrt(variances[-1])) if known else np.nan
        if len(values) not in (1, 3):
            raise self.said.error("one, three, 9 or 36 numbers a sample", got=str(len(values)))
        times = 1.0 if self.times is None else self.times
        return float(length(values)) * times if (values >= 0.0).all() else np.nan


def sample_bound(known: Field) -> SampleBound:
    """Return the bound from ``{field: NAME, times: 4}``; raise LogError if a value is invalid."""
    given = known.fields(KEYS)
    times = given.optional("times")
    return SampleBound(
        field=given.required("field").sentence("a column after the track's name, or the path of a field"),
        times=None if times is None else times.quantity(NUMBER, above=0.0),
        said=known,
    )


def refuse_unbounded(samples: LogSamples) -> None:
    """Raise LogError at the first measured sample without an uncertainty."""
    assert samples.known_to_m is not None
    lacking = np.isfinite(samples.values).all(axis=1) & ~np.isfinite(samples.known_to_m)
    if lacking.any():
        raise samples.error(
            int(np.argmax(lacking)),
            "beside the position its accuracy, as numbers of at least 0",
            "an empty or negative number, or no valid covariance (zeros mean unknown)",
            "hands: {known to: 8 mm} says it of all samples",
        )
