"""Draw, admit, run and judge episode k of a stratum, with the same result on any machine and in any order."""

from __future__ import annotations

import math
import os
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from hashlib import blake2b
from pathlib import Path
from types import FunctionType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.admit import Admitted, Admitter
from safety_harness.admission.avoiders import executes
from safety_harness.admission.claims import property_of
from safety_harness.admission.repeatability import driven_in
from safety_harness.admission.spaces import MAX_REJECTION_RATIO, why_refused
from safety_harness.admission.trial import run_all
from safety_harness.base.exceptions import CampaignError, InputError, described
from safety_harness.base.extension_points import load, warn
from safety_harness.base.seeds import Branch, generator
from safety_harness.base.seeds import seed as leaf
from safety_harness.cell.avoidance.flaky import asked_in
from safety_harness.claims.properties.answered import fault_of, unanswered
from safety_harness.claims.properties.base import Evaluation
from safety_harness.claims.properties.finite import bad_decisions, bad_ticks
from safety_harness.claims.properties.touching import theorem_bits
from safety_harness.extensions.assurance.campaign.opening import added_columns
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.campaign.rows import ClaimJudgement, Row
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome
from safety_harness.scenario.model import Scenario, Verdict
from safety_harness.seams.isolation.opened import noted
from safety_harness.search.coverage import cell_of
from safety_harness.trace.answer_times import AnswersTook
from safety_harness.trace.consistency import first_inconsistency
from safety_harness.trace.overruling import Overruling
from safety_harness.trace.records import Check
from safety_harness.trace.records import DecisionOutcome as Decided
from safety_harness.trace.store import load_trace, save_trace
from safety_harness.trace.trace import Trace, history
from safety_harness.trace.unmeasured import refuse_not_simulated

_Done = TypeVar("_Done")


def root_seed(plan: Plan, stratum: int, episode: int) -> int:
    """Return the seed from which all random numbers of an episode derive."""
    return _root_seed(plan.seed, plan.strata[stratum].number, episode)


@lru_cache(maxsize=256)
def _root_seed(seed: int, number: int, episode: int) -> int:
    return leaf(seed, Branch.CAMPAIGN, number, episode)


def random_episodes(plan: Plan, stratum: int) -> frozenset[int]:
    """Return the episodes of a stratum whose traces the ledger keeps regardless of their outcome."""
    declared = plan.strata[stratum]
    count = min(plan.random_traces, declared.runs)
    rng = generator(plan.seed, Branch.CAMPAIGN, declared.number)
    return frozenset(rng.choice(declared.runs, count, replace=False).tolist()) if count else frozenset()


def failed_row(plan: Plan, stratum: int, episode: int, failure: str, *, draws: int = 0) -> Row:
    """Return the row of an episode that could not run, with the outcome FAILED for each claim."""
    return Row(
        stratum=stratum,
        episode=episode,
        seed=root_seed(plan, stratum, episode),
        judgements=(ClaimJudgement(EpisodeOutcome.FAILED),) * len(plan.claims),
        draws=draws,
        failure=failure,
    )


@dataclass(frozen=True)
class Drawn:
    """An episode, its admitted draw, and the number of draws that were made to obtain the admitted draw."""

    episode: int
    draws: int
    admitted: Admitted


@dataclass(eq=False)
class EpisodeRunner:
    """A runner that runs the episodes of a plan in this process.

    The runner makes each avoider of a user's file only once. If such an avoider remembers earlier runs, its
    episodes depend on each other and on the process in which they run.

    If ``programs`` is False, the runner executes no Python file, and raises CampaignError for a draw that
    refers to such a file.
    """

    plan: Plan
    worker: str = ""
    programs: bool = True
    _admitter: Admitter = field(default_factory=Admitter, init=False)
    _random: dict[int, frozenset[int]] = field(default_factory=dict)
    _noted: int = 0  # bytes read so far of the journal of opened files

    def run(self, stratum: int, episodes: Sequence[int], *, keep_violations: bool = True) -> Iterator[Row]:
        """Yield a row for each of ``episodes``, in their order.

        Raise InputError if the plan's text causes an error. If ``keep_violations`` is true, the row of a
        violating episode includes its trace.
        """
        # A world with batches runs all episodes together; otherwise each row is yielded before the next run.
        for group in [episodes] if self.plan.world.batch else [[episode] for episode in episodes]:
            begun_s = time.perf_counter()
            space, seeds = self.plan.strata[stratum].space, [root_seed(self.plan, stratum, k) for k in group]
            first = zip(group, space.values_of_draws(seeds, 0), strict=True)
            drawn = [self._guarded(stratum, k, partial(self.draw, stratum, k, values)) for k, values in first]
            runs = run_all([entry.admitted for entry in drawn if isinstance(entry, Drawn)], self.plan.world)
            rows = [
                entry if isinstance(entry, Row) else self._judged(stratum, entry, next(runs), keep_violations)
                for entry in drawn
            ]
            each_s = (time.perf_counter() - begun_s) / max(len(rows), 1)
            files, self._noted = noted(self._noted)
            here, own = self.plan.file.resolve().parent, {file.sha256 for file in self.plan.files}
            opened = tuple((os.path.relpath(path, here), sha) for module, path, sha in files if module in own)
            yield from (replace(row, seconds=each_s, opened=opened if row is rows[0] else ()) for row in rows)

    def scenario(
        self, stratum: int, episode: int, draw: int, values: NDArray[np.float64] | None = None
    ) -> Scenario:
        """Return the scenario of an episode that results from draw number ``draw``.

        The scenario has the claims and the avoider of the plan. ``values`` of shape (d,) is passed to
        ``space.draw``.
        """
        space = self.plan.strata[stratum].space
        scenario = space.draw(root_seed(self.plan, stratum, episode), draw, values)
        claims = tuple(planned.claim for planned in self.plan.claims)
        scenario = replace(scenario, name=f"{space.name}#{episode}", claims=claims)
        return self.plan.with_avoider(scenario)

    def draw(self, stratum: int, episode: int, first: NDArray[np.float64] | None = None) -> Drawn | Row:
        """Return the first draw that admission accepts.

        After ``MAX_REJECTION_RATIO`` refused draws, return a failed row instead. ``first`` of shape (d,) has
        the values of draw 0, or is None if the caller has not computed these values.
        """
        refused: Counter[str] = Counter()
        for k in range(MAX_REJECTION_RATIO):
            try:
                scenario = self.scenario(stratum, episode, k, first if k == 0 else None)
                if not self.programs and (executes(scenario) or self.plan.world.program):
                    raise CampaignError(f"{scenario.name} names a program, which is not to be executed")
                return Drawn(episode, k + 1, self._admitter.admit(scenario))
            except InputError as error:
                refused[why_refused(error)] += 1
        reason, count = refused.most_common(1)[0]
        failure = f"none of {MAX_REJECTION_RATIO} draws can be tried; {count} times: {reason}"
        return failed_row(self.plan, stratum, episode, failure, draws=MAX_REJECTION_RATIO)

    def _judged(self, stratum: int, drawn: Drawn, run: Trace | Exception, keep_violations: bool) -> Row:
        work = partial(self._row, stratum, drawn, run, keep_violations)
        return self._guarded(stratum, drawn.episode, work)

    def _guarded(self, stratum: int, episode: int, work: Callable[[], _Done]) -> _Done | Row:
        """Return the result of ``work``, which is tried at most twice.

        If both attempts raise an error, return a failed row. More attempts would not help, because every
        worker would meet the same error. Three kinds of error are raised again at once: InputError (the plan
        is wrong), MemoryError (this process has no memory left) and CampaignError (a program must not run).
        """
        for _ in range(2):
            try:
                return work()
            except (InputError, MemoryError, CampaignError):
                raise
            except Exception as error:
                failure = f"an error of the harness itself: {described(error)}{_where(error)}"
        return failed_row(self.plan, stratum, episode, failure)

    def _row(self, stratum: int, drawn: Drawn, run: Trace | Exception, keep_violations: bool) -> Row:
        if isinstance(run, Exception):
            failure = f"the run failed: {described(run)}"
            return failed_row(self.plan, stratum, drawn.episode, failure, draws=drawn.draws)
        row = self.row_of(stratum, drawn.episode, drawn.draws, run)
        wanted = drawn.episode in self._kept_whatever(stratum) or (keep_violations and row.violates)
        return replace(row, trace=trace_bytes(run)) if wanted else row

    def row_of(self, stratum: int, episode: int, draws: int, run: Trace) -> Row:
        """Return the row of ``run``, judged by the plan's claims."""
        broken = why_broken(run)
        judgements = tuple(
            judgement_of(property_of(planned.claim, run.scenario).evaluate(run), run, broken)
            for planned in self.plan.claims
        )
        cell = cell_of(run, self._admitter.seen_of(run.scenario))
        return Row(
            stratum=stratum,
            episode=episode,
            seed=root_seed(self.plan, stratum, episode),
            judgements=judgements,
            draws=draws,
            **_decided(run),
            overruling=Overruling.from_traces([run]),
            run=number_of(run),
            theorem=theorem_bits(run),
            cell="" if cell is None else str(cell),
            run_error=fault_of(run),
            failure=broken,
            worker=self.worker,
            asked=() if run.scenario.driven else tuple(asked_in(run)),
            driven=driven_in(run),
            times=AnswersTook.from_trace(run),
            added=tuple(_added(run)),
        )

    def _kept_whatever(self, stratum: int) -> frozenset[int]:
        if stratum not in self._random:
            self._random[stratum] = random_episodes(self.plan, stratum)
        return self._random[stratum]


def _added(run: Trace) -> Iterator[tuple[str, float]]:
    """Yield the name of each column that a package adds, and the column's value for ``run``.

    If the package raises an error, warn and yield NaN.
    """
    for part in added_columns():
        measure = load(part, FunctionType)
        try:
            yield part.name, math.nan if measure is None else float(measure(run))
        except Exception as error:  # another package may raise anything
            warn(part, described(error))
            yield part.name, math.nan


def _decided(run: Trace) -> dict[str, Any]:
    """Return the number of decisions of each kind, or an empty dict if the run has no decision."""
    if len(run.decisions) == 0:
        return {}
    outcome, failed = run.decisions["outcome"], run.decisions["proposed_failed"]
    return {
        "decisions": len(outcome),
        "proposed": int(np.count_nonzero(outcome == Decided.PROPOSED)),
        "opposite": int(np.count_nonzero(outcome == Decided.OPPOSITE)),
        "stopped": int(np.count_nonzero(outcome == Decided.STOP)),
        "faults": int(np.count_nonzero(unanswered(run))),
        "late": int(np.count_nonzero(failed & Check.LATE)),
    }


def number_of(run: Trace) -> int:
    """Return a 63-bit hash that identifies ``run``, or 0 for a run without ticks.

    The hash covers the actions of arm, hands and avoider, but not the seed. Thus two draws that lead to the
    same actions give the same hash. To save time, the hash covers sensors only at every 16th tick.
    """
    if len(run.ticks) == 0:
        return 0
    digest = blake2b(digest_size=8)
    for name in _AT_EVERY_TICK:
        digest.update(history(run, name).tobytes("F"))
    for records, names in ((run.ticks[::_SOMETIMES], _SOMETIMES_SEEN), (run.decisions, _DECIDED)):
        for name in names:
            digest.update(records[name].tobytes())
    # Without the highest bit, because SQLite's integers have a sign; 0 means a run without ticks.
    return max(int.from_bytes(digest.digest(), "big") >> 1, 1)


_AT_EVERY_TICK, _SOMETIMES = ("joint_position_rad", "hand_distance_m"), 16  # see ``number_of``
_SOMETIMES_SEEN = ("hand_position_in_base_m", "predicted_hand_in_base_m", "features")
_DECIDED = ("tick", "outcome", "proposed_position_in_base_m", "proposed_spread_m")


def why_broken(trace: Trace) -> str:
    """Return the reason why ``trace`` does not record a complete run, or "" if it records a complete run."""
    if not trace.complete:
        return f"the run was cut short: {trace.ended}"
    odd = first_inconsistency(trace)
    if odd is not None:
        return f"the trace contradicts itself: {odd}"
    if bad_ticks(trace).any() or bad_decisions(trace).any():
        return "the trace has numbers that are none"
    return ""


def judgement_of(evaluation: Evaluation, trace: Trace, broken: str) -> ClaimJudgement:
    """Return the judgement of one claim on one run, in the form that the estimates need.

    The outcome is UNTESTED in two cases: a complete run did not exercise the claim, or did not measure all
    inputs of the claim. The upper bounds treat a broken run as a violation, even if its verdict differs.
    """
    if evaluation.verdict is Verdict.VIOLATED:
        outcome = EpisodeOutcome.VIOLATED
    elif broken and not trace.complete:
        outcome = EpisodeOutcome.FAILED
    elif broken:
        outcome = EpisodeOutcome.INCONCLUSIVE
    elif evaluation.verdict is Verdict.HOLDS:
        outcome = EpisodeOutcome.HOLDS
    elif evaluation.exercised and not evaluation.unmeasured:
        outcome = EpisodeOutcome.INCONCLUSIVE
    else:
        outcome = EpisodeOutcome.UNTESTED
    margin, worst_s = evaluation.margin, evaluation.worst_time_s
    return ClaimJudgement(
        outcome,
        np.nan if margin is None else float(margin),
        np.nan if worst_s is None else float(worst_s),
        0 if evaluation.unmeasured else int(evaluation.exercised),
    )


def trace_bytes(trace: Trace) -> bytes:
    """Return ``trace`` as the bytes that ``save_trace`` writes."""
    with tempfile.TemporaryDirectory(prefix="safety-harness-") as folder:
        file = Path(folder) / "one.trace"
        save_trace(trace, file)
        return file.read_bytes()


def trace_of(plan: Plan, stratum: int, data: bytes) -> Trace:
    """Return the trace stored in ``data``.

    The scenario of the returned trace refers to the files of the plan's space. Raise TraceError unless the
    trace comes from a simulation. The system under test comes from the plan, because a stored reference may
    lack its folder (see ``portable``).
    """
    with tempfile.TemporaryDirectory(prefix="safety-harness-") as folder:
        file = Path(folder) / "stored.trace"
        file.write_bytes(data)
        trace = load_trace(file)
    refuse_not_simulated(trace)
    space = plan.strata[stratum].space
    return replace(trace, scenario=plan.with_avoider(replace(trace.scenario, file=space.file)))


def _where(error: Exception) -> str:
    """Return the file and the line where ``error`` was raised.

    The row needs this text, because a ledger stores no traceback.
    """
    frames = traceback.extract_tb(error.__traceback__)
    return f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""
