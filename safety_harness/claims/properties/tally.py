"""Count how often the runs of a suite exercised each claim.

A claim that was never exercised is not evidence.
"""

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

_NOT_COVERED = (
    "contact forces and pressures: what happens once something touches is not modelled, so nothing here is "
    "about power and force limiting",
    "fingers: a hand is a sphere and its forearm a capsule",
    "the person's torso and head",
    "people whom no scenario has: their hands, and any hand beyond the eighth",
    "the tool and the workpiece, friction and flexibility of the arm",
    "the robot maker's own safety functions: none is relied on, and no performance level is claimed",
)
_ARM = "the arm's model: it is that of its URDF, and its capsules enclose every triangle of its meshes"
_ASSUMED = (
    "how hands move and are distributed: as the scenario spaces say; the plan's author answers for both",
    "how the arm brakes: as its maker's worst-case stop times say",
    _ARM,
)
_SENSORS = "real sensors and their failures: noise, delay, dropout and faults are as a scenario states"
_INDEPENDENT = "runs are independent: each has seeds of its own, from the plan's seed and its number"
EXCLUSIONS, ASSUMPTIONS = (*_NOT_COVERED, _SENSORS), (*_ASSUMED, _INDEPENDENT)
UNWATCHED = (*EXCLUSIONS, *_ASSUMED)
"""What nothing watches in a simulated run; up to a colon each has its name."""
UNWATCHED_IN_LOGS = (*_NOT_COVERED, "what LOG.yaml says of sensors, clocks and frames", _ARM)
A_LOG, NO_WORLD = "a log", "no world"


def basis(
    worlds: Iterable[str], exercised: Iterable[tuple[int, int]] | str, unwatched: Iterable[str] = UNWATCHED
) -> str:
    """Return a sentence that describes the basis of verdicts.

    The sentence states the worlds, how many runs exercised the claims, and the assumptions that no run
    checked.

    Args:
        worlds: Names such as "PyBullet".
        exercised: For each claim, the number of runs that exercised it and the number of all its runs; or a
            text on the runs.
        unwatched: The assumptions that no run checked; the sentence contains their names.

    """
    if not isinstance(exercised, str):
        counts = sorted(exercised, key=lambda pair: (pair[0] / max(pair[1], 1), pair))
        exercised = "no claim was exercised"
        if counts:
            (least, least_runs), (most, runs) = counts[0], counts[-1]
            least_words = f"{least} to " if least_runs == runs else f"{least} of {least_runs} to "
            exercised = f"claims exercised in {least_words * (counts[0] != counts[-1])}{most} of {runs} runs"
    places = " and in ".join(dict.fromkeys(worlds))
    names = ", ".join(dict.fromkeys(text.partition(":")[0] for text in unwatched))
    return f"Basis: in {places}; {exercised}; nothing watched: {names}"


def short_basis(basis: str) -> str:
    """Return the sentence ``basis`` without the list of unwatched assumptions."""
    head, watched, _ = basis.partition("; nothing watched: ")
    return head + ("; what nothing watched: see the report, or -v" if watched else "")


def made_in(trace: Trace) -> str:
    """Return the name of the world in which a trace was made: "PyBullet", or "a log" for a real cell."""
    name = trace.provenance.world
    return (
        A_LOG if trace.known.recorded else next((str(world) for world in WORLDS if world.name == name), name)
    )


def basis_of_tallies(worlds: Iterable[str], tallies: Iterable[ClaimTally]) -> str:
    """Return the sentence that ``basis`` writes for judged runs.

    The worlds determine which assumptions no run checked.
    """
    distinct = list(dict.fromkeys(worlds))
    simulated = UNWATCHED if not distinct or set(distinct) != {A_LOG} else ()
    of_logs = UNWATCHED_IN_LOGS if A_LOG in distinct else ()
    counts = [(tally.exercised, tally.runs) for tally in tallies if tally.applicable]
    return basis(distinct or [NO_WORLD], counts, (*simulated, *of_logs))


BASIS_OF_ANSWERS = basis([NO_WORLD], "no run was made", ("what a run does with the answers", *UNWATCHED))
"""What a verdict rests on that is about answers to questions, and about no run."""


@dataclass(frozen=True, kw_only=True)
class Judged:
    """The outcome of one claim in one run.

    ``run`` is the name of the run's scenario; ``expected`` is the verdict that the author of the claim
    expects.
    """

    run: str
    evaluation: Evaluation
    expected: Verdict = Verdict.HOLDS


@dataclass(frozen=True, kw_only=True)
class ClaimTally:
    """The results of one claim over all runs of a suite.

    ``runs`` is the number of runs that judged the claim, and ``exercised`` is the number of runs that
    exercised it. ``occasions`` is the number of occasions in all runs. ``unmeasured`` is the number of runs
    that are inconclusive because columns were not measured. Such runs never count as tests. ``worst`` is the
    outcome with the least margin, or None if no outcome has a margin. The claim is ``untested`` if an author
    expected a conclusive verdict in some runs, but no such run tested the claim. In this case, ``nearest`` is
    the outcome that has the least margin among those runs. If no such run has a margin, it is the outcome
    whose run has the first name. A violation counts as a test even without an occasion.
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
        """Return whether an author expected a conclusive verdict although no such run tested the claim."""
        return self.nearest is not None

    @property
    def never(self) -> str:
        """Return "not measured" or "never exercised", depending on why an ``untested`` claim has no test."""
        unmeasured = self.nearest is not None and self.nearest.evaluation.unmeasured
        return "not measured" if unmeasured else "never exercised"

    @property
    def worst_words(self) -> str:
        """Return the least margin, its time and its run as text, or a dash."""
        if self.worst is None:
            return "-" if self.applicable else "not applicable"
        time_s = self.worst.evaluation.worst_time_s
        when = "" if time_s is None else f" at {time_s:.3f} s"
        return f"{self.worst.evaluation.margin_text()}{when}, {self.worst.run}"


def tally_claims(judged: Iterable[Judged]) -> tuple[ClaimTally, ...]:
    """Return a tally for each sentence, in the order in which the sentences first appear."""
    by_sentence: dict[str, list[Judged]] = {}
    for outcome in judged:
        by_sentence.setdefault(outcome.evaluation.sentence, []).append(outcome)
    return tuple(_tally(sentence, outcomes) for sentence, outcomes in by_sentence.items())


def _tally(sentence: str, outcomes: Sequence[Judged]) -> ClaimTally:
    evaluations = [outcome.evaluation for outcome in outcomes]
    verdicts = [evaluation.verdict for evaluation in evaluations]
    conclusive = [
        outcome
        for outcome in outcomes
        if outcome.expected is not Verdict.INCONCLUSIVE and outcome.evaluation.applicable
    ]
    untested = bool(conclusive) and not any(_tested(outcome.evaluation) for outcome in conclusive)
    finite = [outcome for outcome in outcomes if isfinite(_margin(outcome))]
    return ClaimTally(
        sentence=sentence,
        runs=len(outcomes),
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


def _margin(outcome: Judged) -> float:
    return nan if outcome.evaluation.margin is None else outcome.evaluation.margin


def _nearness(outcome: Judged) -> tuple[float, str, str, str, str]:
    """Return a sort key that orders outcomes by their margins.

    Outcomes without margins are ordered by their texts.
    """
    evaluation = outcome.evaluation
    margin = _margin(outcome) if isfinite(_margin(outcome)) else inf
    return margin, outcome.run, evaluation.reason, evaluation.verdict.value, outcome.expected.value


def far_lines(tallies: Sequence[ClaimTally]) -> list[str]:
    """Return a note on each claim that held although no run came near its limit."""
    worst = [tally.worst.evaluation for tally in tallies if tally.worst is not None]
    far = [
        (tally.sentence, far_words(tally.close, tally.margin))
        for tally in worst
        if tally.verdict is Verdict.HOLDS
    ]
    return [f"note: {sentence}: {text}" for sentence, text in far if text]


def untested_lines(tallies: Sequence[ClaimTally]) -> list[str]:
    """Return lines on the claims that were never exercised or not measured.

    The lines include the reason of the nearest run.
    """
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
    """Return the lines of a ``table`` of ``tallies``.

    Claims that were never tested have a mark.
    """
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
    """Return the lines of a table whose columns are as wide as needed.

    Columns in ``right`` are right-aligned. A table without rows has no lines. If the table is wider than
    ``most`` characters, each row becomes two lines: its first ``named_by`` cells, and a list of the other
    cells.
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
    columns = zip(head[named_by:], row[named_by:], strict=True)
    return ", ".join(row[:named_by]), f"  {'; '.join(f'{name} {cell}'.strip() for name, cell in columns)}"
