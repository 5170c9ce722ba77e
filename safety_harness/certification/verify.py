"""Does a report stand?  Hashes, the numbers from the ledger, stored traces judged again, runs made again.

Four questions, each answered with what was looked at and what is otherwise.  A change of the software since
is named and is no fault by itself: what it changes in verdicts is.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from safety_harness.admission.avoiders import is_a_program
from safety_harness.admission.claims import property_of
from safety_harness.campaign.episodes import Bench, judgement_of, why_broken
from safety_harness.campaign.files import unpacked
from safety_harness.campaign.ledger import Ledger
from safety_harness.campaign.plan import Plan, read_plan
from safety_harness.campaign.rows import Judgement, Row
from safety_harness.campaign.session import LEDGER
from safety_harness.certification.document import read_evidence
from safety_harness.certification.evidence import Evidence
from safety_harness.certification.folder import JSON, read_manifest, sha256_of
from safety_harness.certification.results import claims_of
from safety_harness.certification.stored import trace_from
from safety_harness.exceptions import InputError, Place, TraceError
from safety_harness.seeds import Branch, generator
from safety_harness.statistics.sample import Outcome

MOST_NAMED = 10
SAMPLE = 20


@dataclass(frozen=True)
class Check:
    """One question: what was looked at, and in which ways it does not stand; ``notes`` are no fault."""

    name: str
    looked_at: str
    faults: tuple[str, ...]
    notes: tuple[str, ...] = ()

    @property
    def stands(self) -> bool:
        """Nothing wrong was found."""
        return not self.faults


def verify(
    folder: Path,
    *,
    runs: int = SAMPLE,
    seed: int = 0,
    execute_avoider: bool = False,
    on_progress: Callable[[str], None] = lambda words: None,
) -> Iterator[Check]:
    """Check by check; InputError for what is no report, or whose avoider may not be executed.

    ``runs`` episodes are made again, drawn at random with ``seed``.
    """
    hashes = read_manifest(folder)
    on_progress("hashes")
    yield _hashes(folder, hashes)
    evidence = read_evidence(folder / JSON)
    with Ledger.open(folder / LEDGER) as ledger, tempfile.TemporaryDirectory() as unpacking:
        plan = read_plan(unpacked(ledger.files, Path(unpacking)))
        _refuse_to_execute(plan, execute_avoider, runs)
        on_progress("numbers of the report from the ledger")
        yield _numbers(plan, ledger, evidence)
        on_progress("stored traces, judged with the present code")
        yield _judged_again(plan, ledger)
        on_progress(f"{runs} runs again")
        yield _run_again(plan, ledger, runs, seed)


def _hashes(folder: Path, hashes: dict[str, str]) -> Check:
    faults = []
    for name, digest in hashes.items():
        file = folder / name
        if not file.is_file():
            faults.append(f"{name} is missing")
        elif sha256_of(file) != digest:
            faults.append(f"{name} is not the file that was written")
    return Check("files", f"{len(hashes)} files and their hashes", _few(faults))


def _numbers(plan: Plan, ledger: Ledger, evidence: Evidence) -> Check:
    """Everything about claims is computed again from the ledger; what the plan's identity was is named."""
    faults = []
    if ledger.declared.identity.sha256 != evidence.plan.sha256:
        faults.append("the ledger is another plan's than the report's")
    again = {claim.sentence: claim for claim in claims_of(plan, ledger)}
    if list(again) != [claim.sentence for claim in evidence.claims]:
        faults.append("the claims are not those of the ledger's plan")
    for claim in evidence.claims:
        now = again.get(claim.sentence)
        if now is not None and now != claim:
            faults.append(f"{claim.sentence}: {_first_other(claim.outcomes, now.outcomes)}")
    notes = ledger.declared.identity.changes(plan.identity)
    text = f"{len(evidence.claims)} claims, with counts, bounds and verdicts"
    return Check("numbers", text, _few(faults), tuple(f"since it was made: {note}" for note in notes))


def _first_other(before: Sequence[object], now: Sequence[object]) -> str:
    for old, new in zip(before, now, strict=False):
        if old != new:
            names = [name for name in vars(old) if getattr(old, name) != getattr(new, name)]
            return f"{getattr(old, 'stratum', '')}: {', '.join(names)} come out otherwise"
    return "hazard, target, verdict or strata come out otherwise"


def _judged_again(plan: Plan, ledger: Ledger) -> Check:
    """The margin may move by rounding where the code changed; the outcome may not."""
    faults, moved, count = [], 0, 0
    for stratum, episode, _ in ledger.traces():
        data = ledger.trace(stratum, episode)
        where = f"{plan.strata[stratum].name}, run {episode}"
        if data is None:
            continue
        try:
            trace = trace_from(data)
        except TraceError as error:
            faults.append(f"{where}: {error}")
            continue
        count += 1
        broken = why_broken(trace)
        for number, claim in enumerate(plan.claims):
            evaluation = property_of(claim.claim, trace.scenario).evaluate(trace)
            now = judgement_of(evaluation, trace, broken)
            before = _recorded(ledger, stratum, number, episode)
            if before is None or before.outcome is not now.outcome:
                was = "nothing" if before is None else before.outcome.name.lower()
                faults.append(f"{where}: {claim.sentence}: {was} then, {now.outcome.name.lower()} now")
            elif not _same(before.margin, now.margin):
                moved += 1
    notes = (f"{moved} margins are not the same to the last bit",) if moved else ()
    return Check("stored traces", f"{count} stored traces, judged with the present code", _few(faults), notes)


def _recorded(ledger: Ledger, stratum: int, claim: int, episode: int) -> Judgement | None:
    question = (
        "SELECT outcome, margin, worst_time_s, exercised FROM judgement WHERE stratum = ? AND claim = ? AND "
        "episode = ?"
    )
    for outcome, margin, worst_s, exercised in ledger.all(question, stratum, claim, episode):
        return Judgement(Outcome(outcome), _number(margin), _number(worst_s), int(exercised))
    return None


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _same(before: float, now: float) -> bool:
    return before == now or (math.isnan(before) and math.isnan(now))


def _run_again(plan: Plan, ledger: Ledger, runs: int, seed: int) -> Check:
    made = [(s, e) for s, e in ledger.all("SELECT stratum, episode FROM episode ORDER BY stratum, episode")]
    if not made or runs < 1:
        return Check("runs", "no run was made again", ())
    rng = generator(seed, Branch.CAMPAIGN, 1)
    chosen = sorted(rng.choice(len(made), min(runs, len(made)), replace=False).tolist())
    bench, faults, moved = Bench(plan), [], 0
    for stratum, episode in (made[k] for k in chosen):
        row = next(iter(bench.run(stratum, [episode], keep_violations=False)))
        other = _other(plan, ledger, row)
        faults += other
        moved += not other and not _identical(plan, ledger, row)
    text = f"{len(chosen)} of {len(made)} runs made again, drawn with seed {seed}"
    notes = (
        (f"{moved} runs have the same outcomes, but not the same margins to the last bit",) if moved else ()
    )
    return Check("runs", text, _few(faults), notes)


def _other(plan: Plan, ledger: Ledger, row: Row) -> list[str]:
    """Claims of which the outcome is another now."""
    faults = []
    for number, (claim, now) in enumerate(zip(plan.claims, row.judgements, strict=True)):
        before = _recorded(ledger, row.stratum, number, row.episode)
        if before is None or before.outcome is not now.outcome:
            was = "nothing" if before is None else before.outcome.name.lower()
            where = f"{plan.strata[row.stratum].name}, run {row.episode}"
            faults.append(f"{where}: {claim.sentence}: {was} then, {now.outcome.name.lower()} now")
    return faults


def _identical(plan: Plan, ledger: Ledger, row: Row) -> bool:
    recorded = (_recorded(ledger, row.stratum, k, row.episode) for k in range(len(plan.claims)))
    pairs = zip(recorded, row.judgements, strict=True)
    return all(before is not None and _same(before.margin, now.margin) for before, now in pairs)


def _refuse_to_execute(plan: Plan, execute_avoider: bool, runs: int) -> None:
    """A report may come from anybody: a program in it is executed only when the user says so."""
    references = {plan.with_avoider(stratum.space.simplest).avoider for stratum in plan.strata}
    programs = [reference for reference in references if is_a_program(reference)]
    if programs and runs > 0 and not execute_avoider:
        raise InputError(
            place=Place(file=plan.file, field="avoider"),
            expected="--execute-avoider, since making runs again executes the program in the report",
            got=programs[0],
            hint="or --runs 0, which makes none again",
        )


def _few(faults: Sequence[str]) -> tuple[str, ...]:
    """The first of them, and how many more there are."""
    more = len(faults) - MOST_NAMED
    return (*faults[:MOST_NAMED], *([f"and {more} more"] if more > 0 else []))
