"""Check that stored traces and repeated runs give the same results as the ledger."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby

from safety_harness.admission.admit import admit
from safety_harness.admission.avoiders import executes, is_executed
from safety_harness.admission.trial import run_trial
from safety_harness.base.exceptions import CampaignError, InputError, SafetyHarnessError, described
from safety_harness.base.seeds import Branch, generator
from safety_harness.cell.simulation.worlds import (
    KINEMATIC,
    SIMULATOR,
    engine_elsewhere,
    is_simulator,
    world_of_trace,
)
from safety_harness.claims.signals.true_motion import refuse_contradictions
from safety_harness.extensions.assurance.campaign.episodes import EpisodeRunner, trace_of
from safety_harness.extensions.assurance.campaign.identity import SIMULATOR as OF_SIMULATOR
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.campaign.rows import ClaimJudgement, Row
from safety_harness.extensions.assurance.campaign.watch import AvoiderWatch
from safety_harness.extensions.assurance.certification.altered import Turn, chance_to_miss, runs_to_see
from safety_harness.extensions.assurance.certification.gather import GatheredEvidence
from safety_harness.extensions.assurance.certification.verdicts import percent
from safety_harness.extensions.assurance.certification.verify_files import Examination, few, kept
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome
from safety_harness.scenario.nodes import references_in
from safety_harness.scenario.write import write_scenario
from safety_harness.trace.compare import CLOSE, first_difference
from safety_harness.trace.overruling import COUNTS as OVERRULED
from safety_harness.trace.trace import Trace

MOST_AGAIN = 1000  # repeated runs, unless --runs asks for more; they take some minutes in PyBullet
MOST_TOGETHER = 32
COUNTS = ("seed", "draws", "decisions", "proposed", "opposite", "stopped", "faults", "late", "theorem")


@dataclass(frozen=True, kw_only=True)
class Drawing:
    """The number of runs to repeat.

    The number is ``runs``, or is chosen so that altered rows are missed with probability ``miss``. ``miss``
    is the probability of missing all altered rows, if a forger altered the fewest rows that change the
    weakest verdict. The runs are drawn with ``seed``, which the maker of the report cannot know. ``programs``
    is true if programs in the report may run.
    """

    runs: int | None
    miss: float
    seed: int
    programs: bool = False
    on_progress: Callable[[str], None] = lambda text: None

    def number(self, there: int, turns: Sequence[Turn]) -> int:
        """Return how many of ``there`` runs must be repeated.

        If ``runs`` is None, the number is at most ``MOST_AGAIN``. ``turns`` has a turn for each verdict,
        beginning with the verdict that is changed most easily.
        """
        if self.runs is not None:
            return min(self.runs, there)
        return min(_needed(there, turns, self.miss), MOST_AGAIN)

    def miss_chances(
        self, there: int, again: int, turns: Sequence[Turn], each_s: float
    ) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return how many altered rows change each verdict, and with which probability the check misses them.

        Also return the open points.

        Args:
            there: The number of runs in the ledger.
            again: The number of repeated runs.
            turns: The turns of all verdicts, beginning with the verdict that is changed most easily.
            each_s: The time that a repeated run took (s). It serves to estimate the time of more runs.

        Returns:
            Notes, and points that stay unchecked because the probability exceeds ``miss``.

        """
        lines = [
            f"{turn.claim}, {turn.stratum}: {_rows(turn.rows)} would turn {turn.standing.value!r}, and "
            f"{again} of {there} runs miss all of them with a chance of "
            f"{percent(chance_to_miss(there, turn.rows, again))}"
            for turn in turns
        ]
        missed = chance_to_miss(there, turns[0].rows, again) if turns else 0.0
        if missed <= self.miss:
            return few(lines), ()
        needed = _needed(there, turns, self.miss)
        return few(lines), (
            f"altered rows that turn a verdict stay unseen with a chance of up to {percent(missed)}; for "
            f"{percent(self.miss)} it needs --runs {needed}, some {_span(needed * each_s)}",
        )


def drawn(there: int, again: int, seed: int) -> list[int]:
    """Return the numbers of the runs to repeat, drawn with ``seed``.

    Each set of ``again`` runs out of ``there`` is equally likely.
    """
    rng = generator(seed, Branch.CAMPAIGN, 1)
    return sorted(rng.choice(there, again, replace=False).tolist())


def _needed(there: int, turns: Sequence[Turn], miss: float) -> int:
    """Return how many runs must be repeated so that altered rows are missed with probability ``miss``.

    Return the number of all runs if no verdict can change.
    """
    return runs_to_see(there, turns[0].rows, miss) if turns else there


def _rows(count: int) -> str:
    return "one altered row" if count == 1 else f"{count} altered rows"


def _span(time_s: float) -> str:
    return f"{time_s:.0f} s" if time_s < 100.0 else f"{time_s / 60.0:.0f} min"


def programs_in(plan: Plan) -> list[str]:
    """Return the programs that a run of the plan may execute.

    The plan or any of its spaces may refer to such a program.
    """
    texts = [plan.avoider or ""]
    simulators = {plan.world.label} if plan.world.program else set()
    for stratum in plan.strata:
        texts += [*stratum.space.simplest.parts_under_test, *references_in(stratum.space.tree)]
    return sorted(simulators | {text for text in texts if is_executed(text)})


SAMPLED = "repulsive ways clear of"  # begins claims on samples of a path


class Compared:
    """A comparison of repeated runs with the rows of the ledger.

    Outcomes must be equal, and margins must be equal within a tolerance. Everything else must be equal if the
    software is the same.

    A ``program`` may import files that no hash covers. Therefore, runs of a program must agree only in the
    outcomes and in the number of unanswered queries. Verdicts depend only on these results. Further
    differences are reported as unchecked.
    """

    def __init__(self, plan: Plan, ledger: Ledger, *, same: bool, program: bool = False) -> None:
        self.plan, self.ledger, self.program = plan, ledger, program
        self.same, self.answers = same and not program, same
        self.faults: list[str] = []
        self._runs: dict[tuple[int, int], tuple[int, int]] = {}  # by number now: episode, number then
        self.moved = self.otherwise = self.far = self.other_traces = self.close_traces = 0

    def add(self, row: Row) -> None:
        """Compare the repeated run in ``row`` with the ledger."""
        then = {
            claim: ClaimJudgement(
                EpisodeOutcome(outcome),
                math.nan if margin is None else margin,
                math.nan if worst_s is None else worst_s,
                exercised,
            )
            for claim, outcome, margin, worst_s, exercised in self.ledger.all(
                _JUDGEMENTS, row.stratum, row.episode
            )
        }
        faults = [*self._faults(row, then), *self._hidden_copies(row)]
        self.faults += faults
        if faults:
            return
        counts = next(self.ledger.all(_COUNTS, row.stratum, row.episode))
        if "theorem" not in self.ledger.counts:  # an older program wrote the ledger
            row = replace(row, theorem=0)
        now = (*(getattr(row, name) for name in COUNTS), *row.overruling.counts)
        where, silent = self.where(row.stratum, row.episode), COUNTS.index("faults")
        if self.answers and counts[silent] != now[silent]:
            self.faults.append(
                f"{where}: {counts[silent]} questions without an answer then, {now[silent]} now"
            )
            return
        exercised = [then[k].exercised == now.exercised for k, now in enumerate(row.judgements)]
        times = [_same(then[k].worst_time_s, now.worst_time_s) for k, now in enumerate(row.judgements)]
        ours = (*now, row.cell or None, row.run_error or None, bool(row.failure))
        if counts != ours or not all((*exercised, *times)):
            self.otherwise += 1
            if self.same:
                part = "draws, decisions, cell or mishap" if counts != ours else "occasions or worst moment"
                self.faults.append(f"{where}: its {part} differ")
        pairs = [
            (claim.sentence, then[k].margin, now.margin)
            for k, (claim, now) in enumerate(zip(self.plan.claims, row.judgements, strict=True))
        ]
        moved = not all(_same(was, new) for _, was, new in pairs)
        self.moved += moved
        if moved and self.same and self.plan.world is KINEMATIC:
            self.faults.append(f"{where}: its margins differ in their last bits, which no machine changes")
        self.far += not all(_is_close(*pair) for pair in pairs)

    def add_trace(self, stored: Trace, row: Row) -> None:
        """Compare a stored trace with the trace of the repeated run in ``row``, bit by bit.

        On another machine, the last bits of a physics engine's trace may differ.
        """
        if row.trace is None:  # the repeated run failed, as its row shows
            return
        again = trace_of(self.plan, row.stratum, row.trace)
        difference: object = first_difference(stored, again)
        if difference is not None and engine_elsewhere(stored.provenance, again.provenance):
            difference = first_difference(stored, again, CLOSE)
            self.close_traces += difference is None
        if stored.system != again.system:
            difference = difference or "another system under test"
        self.other_traces += difference is not None or stored.provenance != again.provenance
        if difference is not None and self.same:
            self.faults.append(f"{self.where(row.stratum, row.episode)}, its stored trace: {difference}")

    def where(self, stratum: int, episode: int) -> str:
        """Return a name for a run, which consists of the name of its stratum and the number ``episode``."""
        return f"{self.plan.strata[stratum].name}, run {episode}"

    @property
    def notes(self) -> tuple[str, ...]:
        """The number of differences of each kind that are not faults."""
        prefix = "with the same outcomes, but not the same"
        moved = self.moved - self.far if self.answers else self.moved
        otherwise = 0 if self.answers else self.otherwise
        pairs = ((moved, "margins to the last bit"), (otherwise, "decisions"))
        return tuple(f"{count} {prefix} {kind}" for count, kind in pairs if count)

    @property
    def unchecked(self) -> tuple[str, ...]:
        """The number of differences of each kind that may be faults.

        The cause may be another version of a program, or altered rows.
        """
        pairs = ((self.otherwise, "decisions"), (self.far, "margins")) if self.answers else ()
        why = "what the program imports is another here, or rows were altered"
        lines = [f"{count} runs with other {kind} than the ledger's: {why}" for count, kind in pairs if count]
        if self.other_traces:
            why = "another machine, other software, or they were altered"
            lines.append(f"{self.other_traces} stored traces differ from the repeated runs: {why}")
        if self.close_traces:
            why = "another machine made them, or they were altered by less"
            lines.append(f"{self.close_traces} stored traces equal repeated runs to {CLOSE:g} only: {why}")
        return tuple(lines)

    def _hidden_copies(self, row: Row) -> Iterator[str]:
        """Yield a fault if the ledger distinguishes two equal runs, or has a wrong number for the run."""
        ((then,),) = self.ledger.all(_RUN, row.stratum, row.episode)
        episode, recorded = self._runs.setdefault((row.stratum, row.run), (row.episode, then))
        if row.run and then != recorded:
            where = self.where(row.stratum, row.episode)
            yield f"{where}: the same run as {episode}, and the ledger tells them apart"
        elif row.run != then and (self.same or (self.answers and not then)):
            where, number = self.where(row.stratum, row.episode), then or "no number"
            yield f"{where}: the ledger has {number} for {row.run}"

    def _faults(self, row: Row, recorded: Mapping[int, ClaimJudgement]) -> Iterator[str]:
        """Yield a line for each claim whose result differs from ``recorded``.

        Outcomes must be equal, and margins must be equal within the tolerance.
        """
        where = self.where(row.stratum, row.episode)
        for number, (claim, now) in enumerate(zip(self.plan.claims, row.judgements, strict=True)):
            then = recorded.get(number)
            if then is None or then.outcome is not now.outcome:
                was = "nothing" if then is None else then.outcome.name.lower()
                yield f"{where}, {claim.sentence}: {was} then, {now.outcome.name.lower()} now"
            elif not self.program and not _is_close(claim.sentence, then.margin, now.margin):
                was, new = (claim.unit.margin_text(judgement.margin) for judgement in (then, now))
                yield f"{where}, {claim.sentence}: a margin of {was} then, {new} now"


_JUDGEMENTS = (
    "SELECT claim, outcome, margin, worst_time_s, exercised FROM judgement WHERE stratum = ? AND episode = ?"
)
_RUN = "SELECT run FROM episode WHERE stratum = ? AND episode = ?"
_COUNTS = (
    f"SELECT {', '.join(f'e.{name}' for name in (*COUNTS, *OVERRULED))}, c.words, "
    "e.mishap, e.failure IS NOT NULL FROM episode e LEFT JOIN cell c ON c.id = e.cell "
    "WHERE e.stratum = ? AND e.episode = ?"
)


def _same(then: float, now: float) -> bool:
    return then == now or (math.isnan(then) and math.isnan(now))


def _is_close(sentence: str, then: float, now: float) -> bool:
    """Return True if two margins (SI) of a claim differ by no more than rounding on another machine.

    On emulated machines, a margin moves by at most 1e-12. The margin of a ``SAMPLED`` claim moves by up to
    0.13 mm, because its path ends at a sample. Samples are 2.5 mm apart, and a rounding error decides which
    sample is the end. The tolerances are a tenth of a millimetre (1e-4 in SI units), and 2.5 mm for a
    ``SAMPLED`` claim.
    """
    if math.isnan(then) or math.isnan(now):
        return math.isnan(then) and math.isnan(now)
    return math.isclose(then, now, rel_tol=1e-3, abs_tol=2.5e-3 if sentence.startswith(SAMPLED) else 1e-4)


def check_traces(plan: Plan, ledger: Ledger, *, same: bool) -> Examination:
    """Check that each stored trace belongs to its run, and that the present code judges it in the same way.

    Args:
        plan: The plan.
        ledger: The open ledger.
        same: True if software, libraries, networks and platform are the same as for the report.

    """
    faults, count = list(kept(plan, ledger)), 0
    # Stored traces are judged only, so no program needs to run.
    compared, bench = Compared(plan, ledger, same=same), EpisodeRunner(plan, programs=False)
    declared = dict(ledger.declared.identity.parts)
    source, python = declared.get("the source of this package"), declared.get("Python")
    foreign = 0
    if ledger.opened and not any(file.name.endswith(".py") for file in plan.files):
        faults.append("the ledger names files that a module opened, and its plan has no module")
    for stratum, episode, _ in ledger.traces():
        where = compared.where(stratum, episode)
        ((draws,),) = ledger.all(
            "SELECT draws FROM episode WHERE stratum = ? AND episode = ?", stratum, episode
        )
        try:
            trace = trace_of(plan, stratum, ledger.trace(stratum, episode) or b"")
            refuse_contradictions(trace)  # claims rely on poses, speeds and distances
            drawn = bench.scenario(stratum, episode, draws - 1)
            differs = write_scenario(trace.scenario, all_settings=True) != write_scenario(
                drawn, all_settings=True
            )
            count += 1
            compared.add(bench.row_of(stratum, episode, draws, trace))
        except InputError as error:
            faults.append(f"{where}, {error.place.field or 'its trace'}: got {error.got}")
            continue
        except Exception as error:  # a stranger's trace may make a claim raise anything
            faults.append(f"{where}, its trace cannot be judged: {described(error)}")
            continue
        foreign += differs
        if differs and same:
            faults.append(f"{where}: its trace is of another scenario than the plan draws for it")
        made = trace.provenance
        if (made.source_hash, made.python, made.world) != (source, python, plan.world.name):
            faults.append(f"{where}: its trace comes from other software, or from another world")
        if (sha256 := declared.get(OF_SIMULATOR, "")) not in dict(made.libraries).get(SIMULATOR, ""):
            faults.append(f"{where}: its simulator is not the declared one: {sha256}")
    notes = compared.notes
    if foreign and not same:
        notes += (f"{foreign} traces are of scenarios that the present software draws or writes otherwise",)
    text = f"{count} stored traces, judged with the present code"
    return Examination("stored traces", text, few([*faults, *compared.faults]), notes)


def check_searched(gathered: GatheredEvidence, *, same: bool, programs: bool) -> Examination:
    """Repeat the runs of the counterexamples that the search found, and compare them with their traces.

    The traces are the only record that the report has of these runs.

    Args:
        gathered: The evidence with the counterexamples.
        same: True if a difference between the traces is a fault.
        programs: True if programs in the report may run.

    """
    faults: list[str] = []
    notes: list[str] = []
    unchecked: list[str] = []
    count = 0
    for example in gathered.examples:
        if example.shown.independent:
            continue
        trace, count = example.run.trace, count + 1
        executed = executes(trace.scenario) or is_simulator(trace.provenance.world)
        if executed and not programs:
            unchecked.append(f"{example.shown.trace_file} is from a program, which verify does not execute")
            continue
        try:
            world = world_of_trace(trace.provenance.world)
            again = run_trial(admit(trace.scenario), world=world, recorded=trace)
            difference = first_difference(trace, again)
        except SafetyHarnessError as error:
            unchecked.append(f"{example.shown.trace_file} cannot be repeated: {described(error)}")
            continue
        if difference is not None:
            (faults if same else notes).append(f"{example.shown.trace_file}: {difference}")
    text = f"{count} counterexamples of the search, made again"
    return Examination("search", text, few(faults), few(notes), few(unchecked))


def check_runs(
    plan: Plan, ledger: Ledger, turns: Sequence[Turn], drawing: Drawing, *, same: bool
) -> Examination:
    """Repeat the drawn runs and all runs with a stored trace, and compare them with the ledger.

    If the runs query a program, the function sends the same queries to the program again. If the program
    remembers earlier queries, the ledger must state this.

    Args:
        plan: The plan.
        ledger: The open ledger.
        turns: The turns of all verdicts, beginning with the verdict that is changed most easily.
        drawing: The number of runs and the seed.
        same: True if software, libraries, networks and platform are the same as for the report.

    """
    made = list(ledger.all("SELECT DISTINCT stratum, episode FROM judgement ORDER BY stratum, episode"))
    count = drawing.number(len(made), turns)
    if count < 1 or not plan.world.is_installed:
        why = "" if plan.world.is_installed else f": {plan.world} is not installed"
        return Examination(
            "runs", "no repeated run", unchecked=(f"whether repeated runs give their outcomes{why}",)
        )
    stored = {(stratum, episode) for stratum, episode, _ in ledger.traces()}
    chosen = sorted({*(made[k] for k in drawn(len(made), count, drawing.seed)), *(stored & set(made))})
    program, watch = bool(programs_in(plan)), AvoiderWatch()
    bench = EpisodeRunner(plan, programs=drawing.programs)
    compared = Compared(plan, ledger, same=same, program=program)
    together = MOST_TOGETHER if plan.world.batch else 1
    begun_s, done = time.perf_counter(), 0
    # A call of ``run`` takes one stratum, and keeps the traces of violations of all its episodes or of none.
    for (stratum, keeps), group in groupby(
        sorted(chosen, key=lambda run: (run[0], run in stored)), lambda run: (run[0], run in stored)
    ):
        episodes = [episode for _, episode in group]
        for first in range(0, len(episodes), together):
            some = episodes[first : first + together]
            try:
                for row in bench.run(stratum, some, keep_violations=keeps):
                    compared.add(row)
                    if keeps:
                        data = ledger.trace(stratum, row.episode) or b""
                        compared.add_trace(trace_of(plan, stratum, data), row)
                    if program:
                        watch.add_row(
                            row, partial(bench.scenario, stratum, row.episode, max(row.draws - 1, 0))
                        )
            except CampaignError as error:
                compared.faults.append(f"{compared.where(stratum, some[0])}: {error}")
            done += len(some)
            # Report each tenth of the runs once.
            if done * 10 // len(chosen) > (done - len(some)) * 10 // len(chosen):
                drawing.on_progress(f"{done} of {len(chosen)} runs made again")
    each_s = (time.perf_counter() - begun_s) / len(chosen)
    notes, unchecked = drawing.miss_chances(len(made), count, turns, each_s)
    text = f"{count} of {len(made)} runs made again, drawn with seed {drawing.seed}"
    if stored:
        text += f", and the runs of the {len(stored)} stored traces"
    again = watch.repeatability.check() if program else None
    if again is not None and again.remembers and not ledger.dependent:
        compared.faults.append(f"{again.remembers}, and the ledger does not say so")
    notes = (*compared.notes, *notes, *([again.line] if again is not None else []))
    return Examination("runs", text, few(compared.faults), notes, (*compared.unchecked, *unchecked))
