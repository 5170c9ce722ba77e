"""Samples for estimates.

A sample is the complete declared stream of independent episodes. The runs of a search are no sample, because
the search chooses its runs. Therefore each estimator of this package requires an ``IndependentSample``. Only
``of_stream`` constructs such a sample. This constructor requires a declaration that is older than the runs,
and a complete series of episodes that begins with episode 0. Each episode must appear once and have its own
seed.
"""

from __future__ import annotations

import re
from dataclasses import InitVar, dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from safety_harness.base.exceptions import Place, StatisticsError
from safety_harness.cell.simulation.worlds import REFERENCE, WorldEntry

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

_SHA256 = re.compile("[0-9a-f]{64}")
_OF_STREAM = object()


class EpisodeOutcome(IntEnum):
    """The result of one episode for one claim. Files store the numbers, so never reuse a number."""

    HOLDS = 0
    VIOLATED = 1
    UNTESTED = 2  # the run never exercised the claim: no trial
    INCONCLUSIVE = 3  # exercised, and no verdict
    FAILED = 4  # the run could not be finished


JUDGED = (EpisodeOutcome.HOLDS, EpisodeOutcome.VIOLATED)
PERHAPS = (EpisodeOutcome.INCONCLUSIVE, EpisodeOutcome.FAILED)  # possible violations


@dataclass(frozen=True, kw_only=True)
class Declaration:
    """The terms of a stream of episodes, fixed before its first run.

    ``plan_sha256`` identifies the plan and everything on which its results depend. ``draws_sha256``
    identifies everything that determines the scenarios, regardless of the avoider. ``planned`` is the number
    of episodes, and ``world`` is the world of the runs.

    ``stop_early`` states that the runs may stop at any time. Such a stream needs bounds that hold at every
    time (``sequential``).

    Raises:
        StatisticsError: No episode is planned, or a hash is no SHA-256.

    """

    plan_sha256: str
    draws_sha256: str
    stratum: str
    seed: int
    planned: int
    world: WorldEntry = REFERENCE
    stop_early: bool = False

    def __post_init__(self) -> None:
        if self.planned < 1:
            raise refusal("planned", "at least one episode", str(self.planned))
        for field in ("plan_sha256", "draws_sha256"):
            text = getattr(self, field)
            if not _SHA256.fullmatch(text):
                raise refusal(field, "a SHA-256, 64 hexadecimal digits", repr(text))

    @property
    def model_only(self) -> bool:
        """Whether the episodes ran in a simplified world, which gives no evidence on the reference world."""
        return self.world.model_only


@dataclass(frozen=True, kw_only=True, eq=False)
class IndependentSample:
    """The outcomes, margins and seeds of one claim, each of shape (n,), in the order of the episodes.

    Only ``of_stream`` makes a sample. A margin is in SI units, and NaN if there is no margin. The arrays are
    read-only.

    Raises:
        TypeError: The caller is not ``of_stream``.

    """

    declaration: Declaration
    outcomes: Ints
    margins: Floats
    seeds: Ints
    claim: str = ""
    _made_by: InitVar[object] = None

    def __post_init__(self, _made_by: object) -> None:
        if _made_by is not _OF_STREAM:
            raise TypeError("only IndependentSample.of_stream makes an IndependentSample")

    @classmethod
    def of_stream(
        cls,
        declaration: Declaration,
        episodes: ArrayLike,
        outcomes: ArrayLike,
        margins: ArrayLike,
        *,
        seeds: ArrayLike,
        exercised: ArrayLike,
        claim: str = "",
    ) -> IndependentSample:
        """Return the sample of a declared stream, after checking that the stream is complete.

        Args:
            declaration: The terms of the stream.
            episodes: The numbers of the episodes (n,), in any order.
            outcomes: The ``EpisodeOutcome`` of each episode (n,).
            margins: The margin of each episode (n,) in SI units, or NaN if there is no margin.
            seeds: The root seed of each episode (n,).
            exercised: The number of occasions on which each episode exercised the claim (n,).
            claim: The claim, for messages and comparisons.

        Raises:
            StatisticsError: An episode from 0 to n - 1 is missing or repeated. The number of episodes is not
                the planned number (with ``stop_early``, it may be smaller). Two episodes share a seed. An
                outcome contradicts its margin or its occasions.

        """
        codes, signed, roots = checked_stream(declaration, episodes, outcomes, margins, seeds, exercised)
        return cls(
            declaration=declaration,
            outcomes=codes,
            margins=signed,
            seeds=roots,
            claim=claim,
            _made_by=_OF_STREAM,
        )

    def count(self, outcome: EpisodeOutcome) -> int:
        """Return the number of episodes with the result ``outcome``."""
        return int(np.count_nonzero(self.outcomes == outcome))

    @property
    def judged(self) -> Flags:
        """For each episode, whether it has a verdict, shape (n,).

        The margin of an episode without a verdict is ignored.
        """
        return np.isin(self.outcomes, JUDGED)

    @property
    def trials(self) -> int:
        """The number of episodes that exercised the claim or may have done so.

        Only untested episodes are excluded.
        """
        return len(self.outcomes) - self.count(EpisodeOutcome.UNTESTED)

    @property
    def violations(self) -> int:
        """The number of certain violations, for lower bounds."""
        return self.count(EpisodeOutcome.VIOLATED)

    @property
    def at_worst(self) -> int:
        """The number of certain and possible violations, for upper bounds."""
        return self.violations + sum(map(self.count, PERHAPS))

    @property
    def name(self) -> str:
        """The stratum and the claim, for messages."""
        return f"{self.declaration.stratum}: {self.claim}" if self.claim else self.declaration.stratum


def independent(sample: object) -> IndependentSample:
    """Check that ``sample`` is an IndependentSample, and return it.

    Args:
        sample: Any object.

    Raises:
        TypeError: The object is something else, such as the runs of a search.

    """
    if not isinstance(sample, IndependentSample):
        raise TypeError(
            f"an estimate needs an IndependentSample, a declared stream of independent episodes; "
            f"got {type(sample).__name__}"
        )
    return sample


def fixed_length(sample: object) -> IndependentSample:
    """Check that the length of ``sample`` was fixed beforehand, and return ``sample``.

    Args:
        sample: Any object.

    Raises:
        TypeError: The object is no IndependentSample.
        StatisticsError: The stream of the sample may stop early.

    """
    known = independent(sample)
    if known.declaration.stop_early:
        wanted = f"a stream of fixed length ({known.name})"
        hint = "bounds that hold at every time are in statistics.sequential"
        raise refusal("stop early", wanted, "one that may stop at any time", hint)
    return known


def checked_stream(
    declaration: Declaration,
    episodes: ArrayLike,
    outcomes: ArrayLike,
    margins: ArrayLike,
    seeds: ArrayLike,
    exercised: ArrayLike,
    *,
    dimensions: int = 1,
) -> tuple[Ints, Floats, Ints]:
    """Return the outcomes, margins and seeds of a stream as read-only arrays, in the order of its episodes.

    Args:
        declaration: The terms of the stream.
        episodes: The numbers of the episodes (n,), in any order.
        outcomes: The outcomes (n,), or (n, k) for k claims.
        margins: The margins (SI), of the same shape as the outcomes.
        seeds: The root seeds, of the same shape as the outcomes.
        exercised: The numbers of occasions, of the same shape as the outcomes.
        dimensions: The number of dimensions of the outcomes: 1 for the shape (n,), and 2 for the shape (n,
            k).

    Raises:
        StatisticsError: The stream is not complete. The conditions are those of
            ``IndependentSample.of_stream``.

    """
    numbers, codes, roots, occasions = map(np.asarray, (episodes, outcomes, seeds, exercised))
    signed = np.array(margins, np.float64)
    runs = {"outcomes": codes, "seeds": roots, "exercised": occasions}
    for name, column, ndim in (("episodes", numbers, 1), *((n, c, dimensions) for n, c in runs.items())):
        if column.ndim != ndim or (column.size and column.dtype.kind not in "iu"):
            shape = "(n,)" if ndim == 1 else "(n, k)"
            raise refusal(name, f"whole numbers {shape}", f"{column.dtype} {column.shape}")
    shapes = [column.shape for column in (*runs.values(), signed)]
    if len({numbers.shape[:1], codes.shape[:1]}) > 1 or len(set(shapes)) > 1:
        got = f"{numbers.shape}, and {', '.join(map(str, shapes))}"
        raise refusal("episodes", "as many episodes as outcomes, seeds, occasions and margins", got)
    _check_complete(declaration, numbers)
    _check_seeds(declaration, numbers, roots)
    order = np.argsort(numbers)
    codes, signed, roots = codes[order].astype(np.int64), signed[order], roots[order]
    _check_outcomes(declaration, codes, signed)
    _check_occasions(declaration, codes, occasions[order])
    codes.flags.writeable = signed.flags.writeable = roots.flags.writeable = False
    return codes, signed, roots


def _check_complete(declaration: Declaration, numbers: NDArray[np.integer]) -> None:
    """Raise StatisticsError unless each episode from 0 to n - 1 occurs once, and n is as declared."""
    n, planned = len(numbers), declaration.planned
    where = f"of stratum {declaration.stratum!r}"
    wanted = f"the {planned} planned episodes {where}"
    if n == 0:
        raise refusal("episodes", f"at least one episode {where}", "none")
    if n > planned:
        raise refusal("episodes", wanted, str(n), "more were run than declared")
    distinct = np.unique(numbers)
    if len(distinct) < n:
        twice = int(numbers.size - distinct.size)
        raise refusal("episodes", f"every episode {where} once", f"{twice} more than once")
    if distinct[0] != 0 or distinct[-1] != n - 1:
        wanted, got = f"episodes 0 to {n - 1} {where}", f"{n} episodes from {distinct[0]} to {distinct[-1]}"
        raise refusal("episodes", wanted, got, "some are missing, so the sample is a selection")
    if n < planned and not declaration.stop_early:
        raise refusal("episodes", wanted, f"{n}: incomplete", "run the rest")


def _check_seeds(declaration: Declaration, numbers: NDArray[np.integer], seeds: NDArray[np.integer]) -> None:
    """Raise StatisticsError if two runs share a seed, because a repeated run gives no additional evidence."""
    distinct, times = np.unique(seeds, return_counts=True)
    if len(distinct) < seeds.size:
        twice = distinct[np.argmax(times > 1)]
        copies = np.sort(numbers[np.argwhere(seeds == twice)[:, 0]])[:2]
        share = f"{seeds.size - len(distinct)} of {seeds.size} runs with another's"
        got = f"{share}, such as {twice} in episodes {copies[0]} and {copies[1]}"
        expected = f"a seed of its own for every run of stratum {declaration.stratum!r}"
        raise refusal("seeds", expected, got, "the same runs again are no further evidence")


def _check_outcomes(declaration: Declaration, codes: Ints, margins: Floats) -> None:
    """Raise StatisticsError for unknown outcomes, or if ``margins`` contradicts the outcomes.

    The shape of the margins is (n,) or (n, k).
    """
    where = f"in stratum {declaration.stratum!r}"
    unknown = ~np.isin(codes, [int(outcome) for outcome in EpisodeOutcome])
    if unknown.any():
        k = _first(unknown)
        raise refusal("outcomes", f"an outcome's number {where}", f"{codes[k]} for episode {k[0]}")
    infinite = np.isinf(margins)
    if infinite.any():
        k = _first(infinite)
        expected = f"finite margins, or NaN for a missing margin, {where}"
        raise refusal("margins", expected, f"{margins[k]} for episode {k[0]}")
    without = np.isin(codes, JUDGED) & np.isnan(margins)
    if without.any():
        k = _first(without)
        got = f"NaN for episode {k[0]}, which {EpisodeOutcome(int(codes[k])).name.lower()}"
        raise refusal("margins", f"a margin wherever there is a verdict {where}", got)
    contradicted = ((codes == EpisodeOutcome.HOLDS) & (margins < 0.0)) | (
        (codes == EpisodeOutcome.VIOLATED) & (margins > 0.0)
    )
    if contradicted.any():
        k = _first(contradicted)
        got = f"{margins[k]:+g} for episode {k[0]}, which {EpisodeOutcome(int(codes[k])).name.lower()}"
        expected = f"a margin below 0 where the claim is violated and nowhere else {where}"
        raise refusal("margins", expected, got)


def _check_occasions(declaration: Declaration, codes: Ints, occasions: NDArray[np.integer]) -> None:
    """Raise StatisticsError if an untested run has an occasion, or if a run that holds has no occasion."""
    tested = occasions > 0
    for contradicted, expected in (
        (occasions < 0, "numbers of occasions"),
        ((codes == EpisodeOutcome.UNTESTED) & tested, "no occasion in an untested run: it is inconclusive"),
        (
            (codes == EpisodeOutcome.HOLDS) & ~tested,
            "an occasion in every run that holds: without one it is untested",
        ),
    ):
        if contradicted.any():
            k = _first(contradicted)
            got = f"{occasions[k]} in episode {k[0]}, {EpisodeOutcome(int(codes[k])).name.lower()}"
            raise refusal("exercised", f"{expected} (stratum {declaration.stratum!r})", got)


def _first(having: Flags) -> tuple[int, ...]:
    """Return the index of the first true element in ``having``."""
    return tuple(int(k) for k in np.argwhere(having)[0])


def refusal(field: str, expected: str, got: str, hint: str = "") -> StatisticsError:
    """Return a StatisticsError, which the caller raises.

    Args:
        field: The argument or declared field with the error.
        expected: A text that describes the expected value.
        got: A text that describes the actual value.
        hint: A hint for the user, or an empty string.

    """
    return StatisticsError(place=Place(field=field), expected=expected, got=got, hint=hint)
