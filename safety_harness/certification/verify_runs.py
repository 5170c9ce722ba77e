"""Do stored traces and runs that are made again give what the ledger says of them?"""

from __future__ import annotations

import math
from collections.abc import Iterator

from safety_harness.admission.avoiders import is_a_program
from safety_harness.avoidance.avoider import described
from safety_harness.campaign.episodes import Bench
from safety_harness.campaign.files import references_in
from safety_harness.campaign.ledger import Ledger
from safety_harness.campaign.plan import Plan, PlannedWorld
from safety_harness.campaign.rows import Judgement, Row
from safety_harness.certification.check import Check, few
from safety_harness.certification.stored import trace_of
from safety_harness.certification.verify_files import kept
from safety_harness.exceptions import CampaignError, InputError
from safety_harness.properties.consistency import refuse_contradictions
from safety_harness.scenario.write import write_scenario
from safety_harness.seeds import Branch, generator
from safety_harness.simulation.pybullet_world import PyBulletWorld
from safety_harness.statistics.sample import Outcome
from safety_harness.trace.trace import Trace

COUNTS = ("seed", "draws", "decisions", "proposed", "opposite", "stopped", "faults")


def programs_in(plan: Plan) -> list[str]:
    """Python files that a run of the plan may execute, wherever its spaces name them."""
    texts = [plan.avoider or ""]
    for stratum in plan.strata:
        texts += [stratum.space.simplest.avoider, *references_in(stratum.space.tree)]
    return sorted({text for text in texts if is_a_program(text)})


class Compared:
    """Rows beside those of the ledger: outcomes may never differ, the rest only with other software."""

    def __init__(self, plan: Plan, ledger: Ledger, *, same: bool) -> None:
        self.plan, self.ledger, self.same = plan, ledger, same
        self.faults: list[str] = []
        self.moved = self.otherwise = 0

    def add(self, row: Row) -> None:
        """Take a run in."""
        faults = list(self._faults(row))
        self.faults += faults
        if faults:
            return
        counts = next(self.ledger.all(_COUNTS, row.stratum, row.episode))
        if counts != (*(getattr(row, name) for name in COUNTS), row.cell or None, bool(row.failure)):
            self.otherwise += 1
            if self.same:
                where = self.where(row.stratum, row.episode)
                self.faults.append(f"{where}: its draws, decisions or cell come out otherwise")
        pairs = ((self._recorded(row, k), now) for k, now in enumerate(row.judgements))
        self.moved += not all(then is not None and _same(then, now) for then, now in pairs)

    def where(self, stratum: int, episode: int) -> str:
        """Words for a run."""
        return f"{self.plan.strata[stratum].name}, run {episode}"

    @property
    def notes(self) -> tuple[str, ...]:
        """What is no fault."""
        words = "with the same outcomes, but not the same"
        return tuple(
            f"{count} {words} {what}"
            for count, what in (
                (self.moved, "margins to the last bit"),
                (0 if self.same else self.otherwise, "decisions"),
            )
            if count
        )

    def _faults(self, row: Row) -> Iterator[str]:
        """Claims of which the outcome is another now."""
        for number, (claim, now) in enumerate(zip(self.plan.claims, row.judgements, strict=True)):
            then = self._recorded(row, number)
            if then is None or then.outcome is not now.outcome:
                was = "nothing" if then is None else then.outcome.name.lower()
                where = self.where(row.stratum, row.episode)
                yield f"{where}: {claim.sentence}: {was} then, {now.outcome.name.lower()} now"
            elif not _near(then.margin, now.margin):
                where = self.where(row.stratum, row.episode)
                unit = claim.unit
                was, new = unit.margin_text(then.margin), unit.margin_text(now.margin)
                if self.same:
                    yield f"{where}: {claim.sentence}: a margin of {was} then, {new} now"

    def _recorded(self, row: Row, claim: int) -> Judgement | None:
        question = (
            "SELECT outcome, margin, worst_time_s, exercised FROM judgement "
            "WHERE stratum = ? AND claim = ? AND episode = ?"
        )
        for outcome, margin, worst_s, exercised in self.ledger.all(question, row.stratum, claim, row.episode):
            return Judgement(Outcome(outcome), _number(margin), _number(worst_s), exercised)
        return None


_COUNTS = (
    f"SELECT {', '.join(f'e.{name}' for name in COUNTS)}, c.words, e.failure IS NOT NULL FROM episode e "
    "LEFT JOIN cell c ON c.id = e.cell WHERE e.stratum = ? AND e.episode = ?"
)


def _number(value: float | None) -> float:
    return math.nan if value is None else value


def _same(then: Judgement, now: Judgement) -> bool:
    return then.margin == now.margin or (math.isnan(then.margin) and math.isnan(now.margin))


def _near(then: float, now: float) -> bool:
    """Within what another processor's last bits may come to in a run: a tenth of a millimetre, say."""
    if math.isnan(then) or math.isnan(now):
        return math.isnan(then) and math.isnan(now)
    return math.isclose(then, now, rel_tol=1e-3, abs_tol=1e-4)


def check_traces(plan: Plan, ledger: Ledger, *, same: bool) -> Check:
    """All that were to be kept, each of the run that it is stored for, judged with the present code."""
    faults, count = list(kept(plan, ledger)), 0
    compared, bench = Compared(plan, ledger, same=same), Bench(plan, programs=False)
    source = dict(ledger.declared.identity.parts).get("the source of this package")
    others = 0
    for stratum, episode, _ in ledger.traces():
        where = compared.where(stratum, episode)
        ((draws,),) = ledger.all(
            "SELECT draws FROM episode WHERE stratum = ? AND episode = ?", stratum, episode
        )
        try:
            trace = trace_of(plan, stratum, ledger.trace(stratum, episode) or b"")
            refuse_contradictions(trace)  # claims believe poses, speeds and distances
            drawn = bench.scenario(stratum, episode, draws - 1)
            other = write_scenario(trace.scenario, all_settings=True) != write_scenario(
                drawn, all_settings=True
            )
            count += 1
            compared.add(bench.row_of(stratum, episode, draws, trace))
        except InputError as error:
            faults.append(f"{where}: {error.place.field or 'its trace'}: got {error.got}")
            continue
        except Exception as error:  # whatever a stranger's trace does to what judges it
            faults.append(f"{where}: its trace cannot be judged: {described(error)}")
            continue
        others += other
        if other and same:
            faults.append(f"{where}: its trace is of another scenario than the plan draws for it")
        if trace.provenance.source_hash != source or _world(trace) is not plan.world:
            faults.append(f"{where}: its trace was made by other software, or in another world")
    notes = compared.notes
    if others and not same:
        notes += (f"{others} traces are of scenarios that the present software draws or writes otherwise",)
    text = f"{count} stored traces, judged with the present code"
    return Check("stored traces", text, few([*faults, *compared.faults]), notes)


def _world(trace: Trace) -> PlannedWorld:
    pybullet = trace.provenance.world == PyBulletWorld.name
    return PlannedWorld.PYBULLET if pybullet else PlannedWorld.KINEMATIC


def check_runs(plan: Plan, ledger: Ledger, count: int, seed: int, *, same: bool, programs: bool) -> Check:
    """Some of the runs that verdicts rest on, drawn by whoever verifies."""
    made = list(ledger.all("SELECT DISTINCT stratum, episode FROM judgement ORDER BY stratum, episode"))
    if count < 1:
        return Check("runs", "no run was made again", unchecked=("whether runs give their outcomes again",))
    rng = generator(seed, Branch.CAMPAIGN, 1)
    chosen = sorted(rng.choice(len(made), min(count, len(made)), replace=False).tolist())
    bench, compared = Bench(plan, programs=programs), Compared(plan, ledger, same=same)
    for stratum, episode in (made[k] for k in chosen):
        try:
            compared.add(next(iter(bench.run(stratum, [episode], keep_violations=False))))
        except CampaignError as error:
            compared.faults.append(f"{compared.where(stratum, episode)}: {error}")
    text = f"{len(chosen)} of {len(made)} runs made again, drawn with seed {seed}"
    return Check("runs", text, few(compared.faults), compared.notes)
