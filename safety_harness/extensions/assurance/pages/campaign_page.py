"""The ledger of a campaign as a self-contained page: bounds, worst episodes, and failed episodes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from safety_harness.admission.trial import judge
from safety_harness.base.proportions import share_words
from safety_harness.base.whole_file import write_whole
from safety_harness.claims.properties.base import Unit
from safety_harness.extensions.assurance.campaign.ledger import Declared, Ledger
from safety_harness.extensions.assurance.campaign.overruled import overruling_in
from safety_harness.extensions.assurance.campaign.summary import (
    CampaignTally,
    LedgerState,
    basis_in,
    fallback_of,
)
from safety_harness.extensions.assurance.statistics.binomial import ProbabilityBounds
from safety_harness.extensions.assurance.statistics.rounding import rounded_down, rounded_up
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome
from safety_harness.extensions.pages.page_parts import render_page
from safety_harness.extensions.pages.replay import Replays
from safety_harness.report.evidence import JudgedRun
from safety_harness.report.words import with_minus
from safety_harness.scenario.files import display_path
from safety_harness.trace.store import load_trace

MOST_EPISODES = 1000  # episodes with violations on the page; the ledger has all
MOST_SHOWN = 5  # violations shown as replays
SHOWN, REFUTED, NOT_SHOWN, NO_TARGET = "shown", "refuted", "not shown", "no target"
CSS = {SHOWN: "holds", REFUTED: "violated", NOT_SHOWN: "inconclusive", NO_TARGET: "none"}
_WORST = (
    "SELECT j.stratum, j.episode, j.claim, j.margin, j.worst_time_s, t.episode IS NOT NULL FROM judgement j "
    "LEFT JOIN trace t ON t.stratum = j.stratum AND t.episode = j.episode "
    f"WHERE j.outcome = {int(EpisodeOutcome.VIOLATED)} "
    "ORDER BY row_number() OVER (PARTITION BY j.claim ORDER BY j.margin, j.stratum, j.episode), j.claim "
    f"LIMIT {MOST_EPISODES}"  # the worst of each claim first, since margins of different units do not compare
)
_FAILED = (
    "SELECT failure, count(*), min(episode) FROM episode WHERE failure IS NOT NULL GROUP BY 1 ORDER BY 2 DESC"
)
Cells = tuple[Any, ...]


def write_page(
    path: Path, ledger: Ledger, state: LedgerState, *, command: str, generated_at: datetime
) -> None:
    """Write the page of ``ledger``.

    If the function fails, it leaves no partial page.

    Args:
        path: The file of the page.
        ledger: The open ledger.
        state: The state of the ledger.
        command: The command that makes the page again.
        generated_at: The time that the page states.

    Raises:
        OSError: The page cannot be written.

    """
    declared, tally = ledger.declared, state.tally
    rows = list(_claims(declared, tally, state.bounds))
    verdicts = [str(row[2]) for row in rows]
    worst = list(ledger.all(_WORST))
    shown = list(_shown(ledger, worst))
    page = render_page(
        "campaign.html.j2",
        package="safety_harness.extensions.assurance",
        replays=bool(shown),
        shown=shown,
        made=(generated_at, command),
        declared=declared,
        basis=basis_in(ledger, tally),
        tally=tally,
        answer=_answer(tally, verdicts),
        remarks=[
            item
            for item in (
                ledger.dependent,
                fallback_of(ledger).summary,
                ledger.repeated.words,
                *ledger.slow,
                *ledger.wrists,
            )
            if item
        ],
        rows=rows,
        css=CSS,
        verdicts=verdicts,
        strata=list(_strata(ledger, tally)),
        failures=list(ledger.all(_FAILED)),
        worst=[_worst(declared, *item) for item in worst],
        violations=sum(
            tally.of_claim(k).counts[EpisodeOutcome.VIOLATED] for k in range(len(declared.claims))
        ),
        ledger=display_path(ledger.path),
        plan=display_path(declared.plan_file),
        fingerprint=state.fingerprint,
    )
    write_whole(path, page)


def _answer(tally: CampaignTally, verdicts: list[str]) -> str:
    if not tally.complete:
        return f"not complete: {tally.done} of {tally.planned} episodes"
    targets = [verdict for verdict in verdicts if verdict != NO_TARGET]
    if not targets:
        return f"{tally.done} episodes, no target declared"
    text = f"{targets.count(SHOWN)} of {len(targets)} targets shown"
    return text + (f", {targets.count(REFUTED)} refuted" if REFUTED in targets else "")


def _verdict(target: float | None, bound: ProbabilityBounds | None) -> str:
    if target is None:
        return NO_TARGET
    if bound is None or not bound.trials:
        return NOT_SHOWN
    return SHOWN if bound.shows(target) else REFUTED if bound.low > target else NOT_SHOWN


def _claims(
    declared: Declared, tally: CampaignTally, bounds: tuple[ProbabilityBounds, ...]
) -> Iterator[Cells]:
    """Yield a row of cells for each claim in each stratum."""
    bound_of = {(item.stratum, item.claim): item for item in bounds}
    for name, stratum in zip(declared.strata, tally.strata, strict=True):
        of_claims = zip(declared.claims, declared.units, declared.targets, stratum.claims, strict=True)
        for claim, unit, target, result in of_claims:
            counts, bound = result.counts, bound_of.get((name, claim))
            known = bound is not None and bound.trials > 0
            yield (
                name,
                claim,
                _verdict(target, bound),
                counts[EpisodeOutcome.HOLDS] + counts[EpisodeOutcome.VIOLATED],
                counts[EpisodeOutcome.VIOLATED],
                counts[EpisodeOutcome.INCONCLUSIVE] + counts[EpisodeOutcome.FAILED],
                rounded_down(bound.low) if bound is not None and known else "–",
                rounded_up(bound.high) if bound is not None and known else "–",
                "–" if target is None else f"{target:.4g}",
                _margin(unit, result.worst),
                result.worst_episode if result.worst_episode >= 0 else "–",
            )


def _strata(ledger: Ledger, tally: CampaignTally) -> Iterator[Cells]:
    for number, (name, part) in enumerate(zip(ledger.declared.strata, tally.strata, strict=True)):
        gate = overruling_in(ledger, number)
        overruled = share_words(gate.overruled, gate.proposals) if gate.proposals else "no proposals"
        early = "" if part.stopped_after is None else f"decided after {part.stopped_after}"
        yield name, part.done, part.planned, part.failed, overruled, early or "–"


def _worst(
    plan: Declared, stratum: int, episode: int, claim: int, margin: float, time_s: float | None, kept: bool
) -> Cells:
    at = "–" if time_s is None else f"{time_s:.3f} s"
    trace = "kept" if kept else "repeatable from its seed"
    return (plan.strata[stratum], episode, plan.claims[claim], _margin(plan.units[claim], margin), at, trace)


def _shown(ledger: Ledger, worst: Iterable[Cells]) -> Iterator[dict[str, object]]:
    """Yield replays of the worst violations that have a stored trace."""
    kept, replays = [row for row in worst if row[-1]], Replays()
    with TemporaryDirectory() as folder:
        for number, (stratum, episode, claim, margin, *_) in enumerate(kept[:MOST_SHOWN], start=1):
            data = ledger.trace(stratum, episode)
            assert data is not None
            file = Path(folder) / f"{number}.trace"
            file.write_bytes(data)
            trace, sentence = load_trace(file), ledger.declared.claims[claim]
            run = JudgedRun(trace, judge(trace), "").under_claim(sentence)
            yield {
                "id": f"shown-{number}",
                "what": f"{ledger.declared.strata[stratum]}, episode {episode}",
                "words": f"{sentence}: {_margin(ledger.declared.units[claim], margin)}",
                "replay": replays.arguments(run, f"shown-{number}"),
            }


def _margin(unit: Unit, margin: float | None) -> str:
    return "–" if margin is None or margin != margin else with_minus(unit.margin_text(margin))
