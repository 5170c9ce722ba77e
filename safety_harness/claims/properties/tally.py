"""How often each claim of a suite was really put to the test: what never was is no evidence of anything."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import inf, isfinite, nan

from safety_harness.cell.simulation.worlds import WORLDS
from safety_harness.claims.properties.base import Evaluation, far_words
from safety_harness.scenario.model import Verdict
from safety_harness.trace.trace import Trace

HEADINGS = (
    "claim",
    "runs",
    "exercised",
    "occasions",
    "holds",
    "violated",
    "inconclusive",
    "worst margin",
)

_BEYOND = (
    "contact forces and pressures: what happens once something touches is not modelled, so nothing here is "
    "about power and force limiting",
    "fingers: a hand is a sphere and its forearm a capsule",
    "the person's torso and head",
    "people whom no scenario has: their hands, and any hand beyond the eighth",
    "the tool and the workpiece, friction and flexibility of the arm",
    "the robot maker's own safety functions: none is relied on, and no performance level is claimed",
)
_ARM = "the arm's model: it is that of its URDF, and its capsules enclose every triangle of its meshes"
_TAKEN = (
    "how hands move and are distributed: as the scenario spaces say; the plan's author answers for both",
    "how the arm brakes: as its maker's worst-case stop times say",
    _ARM,
)
_SENSORS = "real sensors and their failures: noise, delay, dropout and faults are as a scenario states"
_INDEPENDENT = "runs are independent: each has seeds of its own, from the plan's seed and its number"
EXCLUSIONS, ASSUMPTIONS = (*_BEYOND, _SENSORS), (*_TAKEN, _INDEPENDENT)
UNWATCHED = (*EXCLUSIONS, *_TAKEN)
"""What nothing watches in a simulated run; up to a colon each has its name."""
UNWATCHED_IN_LOGS = (*_BEYOND, "what LOG.yaml says of sensors, clocks and frames", _ARM)
A_LOG, NO_WORLD = "a log", "no world"


def basis(
    worlds: Iterable[str], exercised: Iterable[tuple[int, int]] | str, unwatched: Iterable[str] = UNWATCHED
) -> str:
    """Say in one sentence what verdicts rest on: world, exercised runs, and what nothing watched.

    ``worlds`` are names such as "PyBullet"; ``exercised`` has for each claim in how many of how many runs it
    was exercised, or is words on the runs; ``unwatched`` are assumptions, whose names are shown.
    """
    if not isinstance(exercised, str):
        counts = sorted(exercised, key=lambda one: (one[0] / max(one[1], 1), one))
        exercised = "no claim was exercised"
        if counts:
            (least, of), (most, runs) = counts[0], counts[-1]
            least_words = f"{least} to " if of == runs else f"{least} of {of} to "
            exercised = f"claims exercised in {least_words * (counts[0] != counts[-1])}{most} of {runs} runs"
    places = " and in ".join(dict.fromkeys(worlds))
    names = ", ".join(dict.fromkeys(one.partition(":")[0] for one in unwatched))
    return f"Basis: in {places}; {exercised}; nothing watched: {names}"


def short_basis(basis: str) -> str:
    """Return the sentence on what verdicts rest on, without the names of what nothing watched."""
    head, watched, _ = basis.partition("; nothing watched: ")
    return head + ("; what nothing watched: see the report, or -v" if watched else "")


def made_in(trace: Trace) -> str:
    """Return the world in words in which a trace was made: "PyBullet", "a log" for one of a cell."""
    name = trace.provenance.world
    return A_LOG if trace.known.recorded else next((str(one) for one in WORLDS if one.name == name), name)


def basis_of_tallies(worlds: Iterable[str], tallies: Iterable[ClaimTally]) -> str:
    """Say it of judged runs: what nothing watched follows from the ``worlds``."""
    found = list(dict.fromkeys(worlds))
    simulated = UNWATCHED if not found or set(found) != {A_LOG} else ()
    of_logs = UNWATCHED_IN_LOGS if A_LOG in found else ()
    counts = [(one.exercised, one.runs) for one in tallies if one.applicable]
    return basis(found or [NO_WORLD], counts, (*simulated, *of_logs))


BASIS_OF_ANSWERS = basis([NO_WORLD], "no run was made", ("what a run does with the answers", *UNWATCHED))
"""What a verdict rests on that is about answers to questions, and about no run."""


@dataclass(frozen=True, kw_only=True)
class Judged:
    """One claim's outcome in one run.

    ``run`` is what people call the run (its scenario's name); ``expected`` is the verdict that the
    author of the claim expects.
    """

    run: str
    evaluation: Evaluation
    expected: Verdict = Verdict.HOLDS


@dataclass(frozen=True, kw_only=True)
class ClaimTally:
    """One sentence over all runs of a suite.

    In ``unmeasured`` of them it is inconclusive since columns that it reads were not measured: those are no
    tests, on whatever occasions.
    ``runs`` judged it, in ``exercised`` of them it was put to the test, on ``occasions`` altogether;
    ``worst`` is the outcome with the least margin, None where no run gave one.  ``untested``: some author
    expected a verdict that says something (holds or violated), and in none of those runs was there
    anything to say; ``nearest`` is then the one of them with the least margin, else the first by name.
    A violation counts as a test, whatever the occasions.
    """

    sentence: str
    runs: int
    exercised: int
    occasions: int
    holds: int
    violated: int
    inconclusive: int
    unmeasured: int
    applicable: bool
    worst: Judged | None
    nearest: Judged | None = None

    @property
    def untested(self) -> bool:
        """Was it expected to tell something, and never exercised?"""
        return self.nearest is not None

    @property
    def never(self) -> str:
        """What was lacking where it is ``untested``: measurement, or an occasion."""
        unmeasured = self.nearest is not None and self.nearest.evaluation.unmeasured
        return "not measured" if unmeasured else "never exercised"

    @property
    def worst_words(self) -> str:
        """The least margin with its moment and run, or a dash."""
        if self.worst is None:
            return "-" if self.applicable else "not applicable"
        time_s = self.worst.evaluation.worst_time_s
        when = "" if time_s is None else f" at {time_s:.3f} s"
        return f"{self.worst.evaluation.margin_text()}{when}, {self.worst.run}"


def tally_claims(judged: Iterable[Judged]) -> tuple[ClaimTally, ...]:
    """One tally for each sentence, in the order in which they first occur."""
    by_sentence: dict[str, list[Judged]] = {}
    for one in judged:
        by_sentence.setdefault(one.evaluation.sentence, []).append(one)
    return tuple(_tally(sentence, found) for sentence, found in by_sentence.items())


def _tally(sentence: str, found: Sequence[Judged]) -> ClaimTally:
    evaluations = [one.evaluation for one in found]
    verdicts = [evaluation.verdict for evaluation in evaluations]
    conclusive = [
        one for one in found if one.expected is not Verdict.INCONCLUSIVE and one.evaluation.applicable
    ]
    untested = bool(conclusive) and not any(_tested(one.evaluation) for one in conclusive)
    finite = [one for one in found if isfinite(_margin(one))]
    return ClaimTally(
        sentence=sentence,
        runs=len(found),
        exercised=sum(occasions > 0 for occasions in map(_occasions, evaluations)),
        occasions=sum(map(_occasions, evaluations)),
        holds=verdicts.count(Verdict.HOLDS),
        violated=verdicts.count(Verdict.VIOLATED),
        inconclusive=verdicts.count(Verdict.INCONCLUSIVE),
        applicable=any(evaluation.applicable for evaluation in evaluations),
        unmeasured=sum(bool(evaluation.unmeasured) for evaluation in evaluations),
        worst=min(finite, key=_margin, default=None),
        nearest=min(conclusive, key=_nearness) if untested else None,
    )


def _tested(evaluation: Evaluation) -> bool:
    return _occasions(evaluation) > 0 or evaluation.verdict is Verdict.VIOLATED


def _occasions(evaluation: Evaluation) -> int:
    return 0 if evaluation.unmeasured else evaluation.exercised


def _margin(one: Judged) -> float:
    return nan if one.evaluation.margin is None else one.evaluation.margin


def _nearness(one: Judged) -> tuple[float, str, str, str, str]:
    """Sorts outcomes by their margins, if they have one, and others by what they say."""
    found = one.evaluation
    margin = _margin(one) if isfinite(_margin(one)) else inf
    return margin, one.run, found.reason, found.verdict.value, one.expected.value


def far_lines(tallies: Sequence[ClaimTally]) -> list[str]:
    """A note on every claim that held, and whose limit no run came near to."""
    worst = [tally.worst.evaluation for tally in tallies if tally.worst is not None]
    found = [
        (one.sentence, far_words(one.close, one.margin)) for one in worst if one.verdict is Verdict.HOLDS
    ]
    return [f"note: {sentence}: {words}" for sentence, words in found if words]


def untested_lines(tallies: Sequence[ClaimTally]) -> list[str]:
    """How many claims were never exercised or not measured, and of each what the nearest run lacked."""
    lines = []
    for never in ("never exercised", "not measured"):
        untested = [(t.sentence, t.nearest) for t in tallies if t.nearest is not None and t.never == never]
        if untested:
            count = f"{len(untested)} of {len(tallies)} {'claim was' if len(tallies) == 1 else 'claims were'}"
            lines.append(f"{count} {never}, and nothing is shown of:")
        for sentence, nearest in untested:
            lines += [f"  {sentence}", f"    {nearest.run}: {nearest.evaluation.reason}"]
    return lines


def table_lines(tallies: Sequence[ClaimTally], most: int | None = None) -> list[str]:
    """The tallies as a ``table``; what was never put to the test is marked."""
    return table(HEADINGS, map(_cells, tallies), most, named_by=1, right=range(1, 7))


def _cells(tally: ClaimTally) -> tuple[str, ...]:
    counts = (tally.runs, tally.exercised, tally.occasions, tally.holds, tally.violated)
    inconclusive = f"{tally.inconclusive}{f' ({tally.unmeasured} not measured)' * bool(tally.unmeasured)}"
    never = "NOT MEASURED" if tally.never == "not measured" else "NEVER PUT TO THE TEST"
    worst = never if tally.untested else tally.worst_words
    return (tally.sentence, *(str(count) for count in counts), inconclusive, worst)


def table(
    head: Sequence[str],
    rows: Iterable[Sequence[str]],
    most: int | None = None,
    *,
    named_by: int = 2,
    right: range = range(0),
) -> list[str]:
    """Columns as wide as they need be, those in ``right`` to the right; no lines without rows.

    Where they are wider than ``most`` characters, each row is what it is ``named_by``, its first cells, and
    below it a list of the others.
    """
    cells = [tuple(head), *map(tuple, rows)]
    if len(cells) == 1:
        return []
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    if most is not None and sum(widths) + 2 * len(widths) - 2 > most:
        return [line for row in cells[1:] for line in _block(head, row, named_by)]
    return [
        "  ".join(
            f"{cell:{'>' if column in right else '<'}{width}}"
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in cells
    ]


def _block(head: Sequence[str], row: Sequence[str], named_by: int) -> tuple[str, str]:
    others = zip(head[named_by:], row[named_by:], strict=True)
    return ", ".join(row[:named_by]), f"  {'; '.join(f'{name} {cell}'.strip() for name, cell in others)}"
