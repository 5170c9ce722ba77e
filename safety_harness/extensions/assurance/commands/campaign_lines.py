"""The lines that the commands print about one ledger of a campaign, or about two ledgers."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence

from safety_harness.admission.driving import named_system
from safety_harness.base.proportions import share_words
from safety_harness.claims.properties.base import SI_UNITS, Unit
from safety_harness.extensions.assurance.campaign.ledger import Declared, Ledger
from safety_harness.extensions.assurance.campaign.overruled import overruling_in
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.campaign.rare import RareViolation
from safety_harness.extensions.assurance.campaign.summary import (
    CampaignTally,
    ClaimCounts,
    LedgerState,
    basis_in,
    fallback_of,
    shields_in,
)
from safety_harness.extensions.assurance.certification.verdicts import confidence_words, percent
from safety_harness.extensions.assurance.statistics.binomial import ProbabilityBounds
from safety_harness.extensions.assurance.statistics.paired import PairedComparison
from safety_harness.extensions.assurance.statistics.rounding import rounded_down, rounded_up
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome
from safety_harness.report.words import tested_words

_MOST_REASONS = 5  # reasons that are printed; a choice


def tested_lines(plan: Plan) -> list[str]:
    """Return a line for each system under test, which lists the strata that use the system.

    The line states the avoider or controller, the shield, and each value that is not the default.
    """
    tested: dict[str, list[str]] = {}
    for stratum in plan.strata:
        scenario = plan.with_avoider(stratum.space.simplest)
        tested.setdefault(tested_words(scenario, named_system(scenario)), []).append(stratum.name)
    return [f"tested in {', '.join(names)}: {text}" for text, names in tested.items()]


def ledger_lines(ledger: Ledger, state: LedgerState) -> Iterator[str]:
    """Yield the lines on the state of a campaign.

    Only a complete campaign has lines on bounds.
    """
    declared, tally = ledger.declared, state.tally
    yield f"{ledger.path}: {declared.title}"
    yield _summary(declared, tally)
    yield from (*_failure_lines(ledger), *_fallback_lines(ledger), *_overruled_lines(ledger))
    yield from (f"  {line}" for line in shields_in(ledger))
    yield f"  {ledger.repeated.line}"
    yield from (f"  computing time: {line}" for line in ledger.slow)
    yield from worst_lines(declared.claims, declared.units, tally)
    yield basis_in(ledger, tally)
    if tally.complete:
        yield from _bound_lines(ledger, state.bounds)
        yield f"fingerprint of the results: {state.fingerprint}"


def ledger_data(ledger: Ledger, state: LedgerState) -> dict[str, object]:
    """Return the content of ``ledger_lines`` as data.

    Margins are in SI units, and a missing value is null.
    """
    declared, tally = ledger.declared, state.tally
    whole = tally.complete
    strata = zip(declared.strata, tally.strata, strict=True)
    return {
        "ledger": ledger.path,
        "title": declared.title,
        "basis": basis_in(ledger, tally),
        "world": declared.world.label,
        "confidence": declared.confidence,
        "complete": whole,
        "planned": tally.planned,
        "done": tally.done,
        "failed": tally.failed,
        "strata": [
            {"stratum": name}
            | {key: getattr(row, key) for key in ("planned", "done", "failed", "stopped_after")}
            | {"claims": _claims_data(declared, row.claims)}
            for name, row in strata
        ],
        "claims": _claims_data(declared, [*map(tally.of_claim, range(len(declared.claims)))]),
        "fallback": fallback_of(ledger),
        "overruling": overruling_in(ledger).named,
        "shields": shields_in(ledger),
        "repeatability": ledger.repeated,
        "slow_answers": ledger.slow,
        "dependent": ledger.dependent or None,
        "bounds": state.bounds or None,
        "fingerprint": state.fingerprint,
    }


def _claims_data(declared: Declared, claims: Sequence[ClaimCounts]) -> list[dict[str, object]]:
    return [
        {
            "claim": sentence,
            "target": target,
            **{outcome.name.lower(): count for outcome, count in row.counts.items()},
            "worst_margin_si": row.worst,
            "unit": SI_UNITS[unit],
            "worst_episode": row.worst_episode if row.worst_episode >= 0 else None,
        }
        for sentence, unit, target, row in zip(
            declared.claims, declared.units, declared.targets, claims, strict=True
        )
    ]


def _summary(declared: Declared, tally: CampaignTally) -> str:
    """Return a line with the number of finished episodes in each stratum."""
    parts = []
    for name, stratum in zip(declared.strata, tally.strata, strict=True):
        text = f"{name} {stratum.done}/{stratum.planned}"
        if stratum.stopped_after is not None:
            text += f" (decided after {stratum.stopped_after})"
        if stratum.failed:
            text += f", {stratum.failed} FAILED TO RUN"
        parts.append(text)
    return f"episodes {tally.done}/{tally.planned} in {declared.world.label}: " + "; ".join(parts)


def worst_lines(claims: tuple[str, ...], units: tuple[Unit, ...], tally: CampaignTally) -> list[str]:
    """Return a line for each claim with its worst margin and the number of each outcome, over all strata."""
    lines = []
    for k, (claim, unit) in enumerate(zip(claims, units, strict=True)):
        claim_tally = tally.of_claim(k)
        counts = claim_tally.counts
        text = f"violated in {counts[EpisodeOutcome.VIOLATED]} of {claim_tally.tested} tested"
        rest = (
            (EpisodeOutcome.UNTESTED, "not put to the test"),
            (EpisodeOutcome.INCONCLUSIVE, "inconclusive"),
            (EpisodeOutcome.FAILED, "could not be run"),
        )
        text += "".join(f", {counts[outcome]} {label}" for outcome, label in rest if counts[outcome])
        lines.append(f"  {unit.margin_text(claim_tally.worst):>14}  {claim}: {text}")
    return lines


def _failure_lines(ledger: Ledger) -> list[str]:
    """Return the reasons why episodes failed or are incomplete, the most frequent reason first."""
    question = (
        "SELECT count(*), failure, stratum, min(episode) FROM episodes WHERE failure IS NOT NULL "
        "GROUP BY failure ORDER BY 1 DESC, 2"
    )
    reasons = list(ledger.all(question))
    lines = [
        f"  {count} times: {why} (first in {stratum}, episode {episode})"
        for count, why, stratum, episode in reasons[:_MOST_REASONS]
    ]
    more = sum(count for count, *_ in reasons[_MOST_REASONS:])
    return lines + ([f"  {more} times: another of {len(reasons) - _MOST_REASONS} reasons"] if more else [])


def _fallback_lines(ledger: Ledger) -> list[str]:
    """Return a line that states how often the fallback replaced the avoider, and for which reason.

    The list is empty if the fallback never replaced the avoider.
    """
    fallback = fallback_of(ledger)
    episodes = next(ledger.all("SELECT count(*) FROM episode"))[0]
    where = f"in {fallback.episodes} of {episodes} episodes; most often: {fallback.reason}"
    return [f"  {fallback.summary}, {where}"] if fallback.summary else []


def _overruled_lines(ledger: Ledger) -> list[str]:
    """Return lines that state how often the gate overruled proposals, in total and in each stratum.

    The list is empty if there were no proposals.
    """
    strata = ledger.declared.strata
    each = [(name, overruling_in(ledger, k)) for k, name in enumerate(strata) if len(strata) > 1]
    shares = ", ".join(f"{name} {share_words(part.overruled, part.proposals)}" for name, part in each)
    whole = overruling_in(ledger).summary
    return [f"  {whole}", *([f"    by stratum: {shares}"] if shares else [])] if whole else []


def _bound_lines(ledger: Ledger, bounds: Sequence[ProbabilityBounds]) -> list[str]:
    """Return lines with the bounds of each violation probability.

    All bounds hold simultaneously, as in a report.
    """
    if ledger.dependent:
        return [ledger.dependent]
    declared = ledger.declared
    targets = dict(zip(declared.claims, declared.targets, strict=True))
    each = confidence_words(bounds[0].confidence)
    fallback = fallback_of(ledger).summary
    lines = [
        f"how often a run that tests the claim violates it{f' ({fallback})' if fallback else ''}: all "
        f"{bounds[0].family} bounds, two a line, "
        f"hold together with {percent(declared.confidence)} confidence, each line alone with {each}"
    ]
    for row in bounds:
        target = targets[row.claim]
        goal = "" if target is None else f", asked at most {target:.4g}: {_shown(row, target)}"
        model = ", model only" if row.model_only else ""
        failed = f", {row.failed} could not be run" if row.failed else ""  # each may be a violation
        runs = f"{row.trials - row.failed} runs tested it{failed}{goal}{model}"
        known = f"{rounded_down(row.low)} to {rounded_up(row.high)} ({runs})"
        lines.append(f"  {row.stratum}: {row.claim}: " + (known if row.trials else "unknown, never tested"))
    return lines


def _shown(row: ProbabilityBounds, target: float) -> str:
    """Return whether a bound shows ``target``, in the words of the report."""
    if row.shows(target):
        return "shown"
    return "shown with doubt" if row.trials and row.model_only and row.high <= target else "NOT shown"


def rare_line(rate: RareViolation) -> str:
    """Return a line on a rare violation.

    The line has the estimated probability, and the upper end that comes from the plain draws.
    """
    estimate, where = rate.estimate, f"{rate.stratum}: {rate.claim.sentence}"
    ran = f"{estimate.evaluations:,} draws{', model only' if estimate.model_only else ''}"
    most = f"at most {rate.high:.3g} by its {estimate.plain_draws:,} plain draws alone"
    if why := estimate.no_estimate:
        return f"{where}: no estimate ({why}); {most} ({ran})"
    return (
        f"{where}: about {rate.share:.3g} of all runs violate it, at least {rate.low:.3g}; {most} ({ran}); "
        f"independent runs would take {estimate.as_many_draws:,.0f} for the same standard error"
    )


def difference_lines(rows: Sequence[PairedComparison], confidence: float) -> list[str]:
    """Return a line for each claim in each stratum.

    The line has the result of the second campaign minus the result of the first, and the interval of this
    difference. All intervals hold simultaneously with ``confidence``.
    """
    each = confidence_words(rows[0].confidence)
    head = (
        f"the {len(rows)} intervals hold together with {percent(confidence)} confidence, each alone with "
        f"{each}; p (McNemar) is of its own line alone"
    )
    return [head, *map(_difference_line, rows)]


def _difference_line(row: PairedComparison) -> str:
    how = f"from {row.low:+.3%} to {row.high:+.3%}; p {row.p_value:.3g}"
    counts = (
        f"both {row.both}, only after {row.only_first}, only before {row.only_second}, unclear {row.unclear}"
    )
    model = ", model only" if row.model_only else ""
    return (
        f"{row.stratum}: {row.claim}: violated {row.seen:+.3%} more often ({how}); of {row.episodes}: "
        f"{counts}{model}"
    )


def csv_line(values: Sequence[object]) -> str:
    """Return ``values`` as one line of CSV."""
    text = io.StringIO()
    csv.writer(text, lineterminator="").writerow("" if value is None else value for value in values)
    return text.getvalue()
