"""What estimates may be made of: a declared stream of independent episodes, all of it.

A search finds, it does not estimate: its runs are no sample of anything.  So every estimator of this package
takes an ``IndependentSample`` and nothing else, and the only way to one is ``of_stream``, which wants a
declaration made beforehand and every episode from the first on, once each, with a seed of its own.
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
    """What one episode says of one claim.  The numbers are stored: never reuse one."""

    HOLDS = 0
    VIOLATED = 1
    UNTESTED = 2  # the run never exercised the claim: no trial
    INCONCLUSIVE = 3  # exercised, and no verdict
    FAILED = 4  # the run could not be finished


JUDGED = (EpisodeOutcome.HOLDS, EpisodeOutcome.VIOLATED)
PERHAPS = (EpisodeOutcome.INCONCLUSIVE, EpisodeOutcome.FAILED)  # may have been violations, or none


@dataclass(frozen=True, kw_only=True)
class Declaration:
    """What was said before the first episode was run.

    ``plan_sha256`` stands for the plan and all that its results depend on, ``draws_sha256`` for what draws
    its scenarios, whoever avoids; ``planned`` is the number of episodes, ``world`` where they run.
    ``stop_early`` says that the runs may be looked at and stopped at any time, which only bounds that
    hold at every time (``sequential``) allow.
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
        """Whether the episodes ran in a simplified world, so that they say nothing of the reference."""
        return self.world.model_only


@dataclass(frozen=True, kw_only=True, eq=False)
class IndependentSample:
    """One claim's outcomes, margins and seeds (n,) in the order of the episodes; made by ``of_stream`` only.

    Margins are SI, NaN where there is none.  The arrays are read-only.
    """

    declaration: Declaration
    outcomes: Ints
    margins: Floats
    seeds: Ints
    claim: str = ""
    _made_by: InitVar[object] = None

    def __post_init__(self, _made_by: object) -> None:
        if _made_by is not _OF_STREAM:
            raise TypeError(
                "an IndependentSample is made by IndependentSample.of_stream, and by nothing else"
            )

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
        """The stream's episodes (n,) in any order, with the outcome and margin (n,) of each.

        ``seeds`` (n,) are the roots of the episodes' draws, ``exercised`` (n,) says on how many occasions
        each exercised the claim.  StatisticsError unless they are the episodes 0 to n - 1, once each,
        all that were planned (fewer only if the declaration allows to stop early), with a seed of its own
        each, and no outcome is contradicted by its margin or its occasions.
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
        """How many episodes came out like that."""
        return int(np.count_nonzero(self.outcomes == outcome))

    @property
    def judged(self) -> Flags:
        """(n,) has the claim a verdict on the episode?  A margin without one says nothing."""
        return np.isin(self.outcomes, JUDGED)

    @property
    def trials(self) -> int:
        """Episodes that exercised the claim, or may have: all but the untested."""
        return len(self.outcomes) - self.count(EpisodeOutcome.UNTESTED)

    @property
    def violations(self) -> int:
        """Episodes that violate the claim for certain: what a lower bound counts."""
        return self.count(EpisodeOutcome.VIOLATED)

    @property
    def at_worst(self) -> int:
        """Violations, and whatever may have been one: what an upper bound counts."""
        return self.violations + sum(map(self.count, PERHAPS))

    @property
    def name(self) -> str:
        """Stratum and claim, for messages."""
        return f"{self.declaration.stratum}: {self.claim}" if self.claim else self.declaration.stratum


def independent(sample: object) -> IndependentSample:
    """The sample itself; TypeError for anything else, above all for what a search chose."""
    if not isinstance(sample, IndependentSample):
        raise TypeError(
            f"estimates are made of an IndependentSample, a declared stream of independent episodes; "
            f"got {type(sample).__name__}"
        )
    return sample


def fixed_length(sample: object) -> IndependentSample:
    """An IndependentSample whose length was fixed beforehand; StatisticsError for one that may stop early."""
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
    """Outcomes, margins and seeds (n,), or (n, k) in two dimensions, in the order of the episodes (n,).

    They are read-only.  StatisticsError for what is no whole stream; see ``IndependentSample.of_stream``.
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
    """Episodes 0 to n - 1, once each, and as many as the declaration says."""
    n, planned = len(numbers), declaration.planned
    where = f"of stratum {declaration.stratum!r}"
    wanted = f"the {planned} planned episodes {where}"
    if n == 0:
        raise refusal("episodes", f"at least one episode {where}", "none")
    if n > planned:
        raise refusal("episodes", wanted, str(n), "more were run than declared")
    found = np.unique(numbers)
    if len(found) < n:
        twice = int(numbers.size - found.size)
        raise refusal("episodes", f"every episode {where} once", f"{twice} more than once")
    if found[0] != 0 or found[-1] != n - 1:
        wanted, got = f"episodes 0 to {n - 1} {where}", f"{n} episodes from {found[0]} to {found[-1]}"
        raise refusal("episodes", wanted, got, "some are missing: a choice was made")
    if n < planned and not declaration.stop_early:
        raise refusal("episodes", wanted, f"{n}: incomplete", "run the rest")


def _check_seeds(declaration: Declaration, numbers: NDArray[np.integer], seeds: NDArray[np.integer]) -> None:
    """One seed, one run: a run that is counted twice says no more than once."""
    found, times = np.unique(seeds, return_counts=True)
    if len(found) < seeds.size:
        twice = found[np.argmax(times > 1)]
        who = np.sort(numbers[np.argwhere(seeds == twice)[:, 0]])[:2]
        many = f"{seeds.size - len(found)} of {seeds.size} runs with another's"
        got = f"{many}, such as {twice} in episodes {who[0]} and {who[1]}"
        expected = f"a seed of its own for every run of stratum {declaration.stratum!r}"
        raise refusal("seeds", expected, got, "the same runs again are no further evidence")


def _check_outcomes(declaration: Declaration, codes: Ints, margins: Floats) -> None:
    """Known outcomes, and ``margins`` (n,) or (m, k) whose sign is theirs."""
    where = f"in stratum {declaration.stratum!r}"
    unknown = ~np.isin(codes, [int(outcome) for outcome in EpisodeOutcome])
    if unknown.any():
        k = _first(unknown)
        raise refusal("outcomes", f"an outcome's number {where}", f"{codes[k]} for episode {k[0]}")
    infinite = np.isinf(margins)
    if infinite.any():
        k = _first(infinite)
        expected = f"finite margins, NaN where there is none, {where}"
        raise refusal("margins", expected, f"{margins[k]} for episode {k[0]}")
    without = np.isin(codes, JUDGED) & np.isnan(margins)
    if without.any():
        k = _first(without)
        got = f"NaN for episode {k[0]}, which {EpisodeOutcome(int(codes[k])).name.lower()}"
        raise refusal("margins", f"a margin wherever there is a verdict {where}", got)
    wrong = ((codes == EpisodeOutcome.HOLDS) & (margins < 0.0)) | (
        (codes == EpisodeOutcome.VIOLATED) & (margins > 0.0)
    )
    if wrong.any():
        k = _first(wrong)
        got = f"{margins[k]:+g} for episode {k[0]}, which {EpisodeOutcome(int(codes[k])).name.lower()}"
        expected = f"a margin below 0 where the claim is violated and nowhere else {where}"
        raise refusal("margins", expected, got)


def _check_occasions(declaration: Declaration, codes: Ints, occasions: NDArray[np.integer]) -> None:
    """Untested is what had no occasion; nothing holds without one."""
    tested = occasions > 0
    for wrong, expected in (
        (occasions < 0, "numbers of occasions"),
        ((codes == EpisodeOutcome.UNTESTED) & tested, "no occasion in an untested run: it is inconclusive"),
        (
            (codes == EpisodeOutcome.HOLDS) & ~tested,
            "an occasion in every run that holds: without one it is untested",
        ),
    ):
        if wrong.any():
            k = _first(wrong)
            got = f"{occasions[k]} in episode {k[0]}, {EpisodeOutcome(int(codes[k])).name.lower()}"
            raise refusal("exercised", f"{expected} (stratum {declaration.stratum!r})", got)


def _first(having: Flags) -> tuple[int, ...]:
    """The index of the first that has it."""
    return tuple(int(k) for k in np.argwhere(having)[0])


def refusal(field: str, expected: str, got: str, hint: str = "") -> StatisticsError:
    """What is refused at ``field``, with what was expected there and what came."""
    return StatisticsError(place=Place(field=field), expected=expected, got=got, hint=hint)
