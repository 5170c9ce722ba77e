"""What is said of a campaign's ledger, and of two."""

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

_MOST_REASONS = 5


def tested_lines(plan: Plan) -> list[str]:
    """What each stratum is about: avoider or controller, shield, and each value that is not the default."""
    tested: dict[str, list[str]] = {}
    for stratum in plan.strata:
        scenario = plan.with_avoider(stratum.space.simplest)
        tested.setdefault(tested_words(scenario, named_system(scenario)), []).append(stratum.name)
    return [f"tested in {', '.join(names)}: {words}" for words, names in tested.items()]


def ledger_lines(ledger: Ledger, state: LedgerState) -> Iterator[str]:
    """How a campaign stands; once it is complete, with its bounds."""
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
    """The same for programs: margins in SI; null where there is none."""
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
            | {key: getattr(one, key) for key in ("planned", "done", "failed", "stopped_after")}
            | {"claims": _claims_data(declared, one.claims)}
            for name, one in strata
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
            **{outcome.name.lower(): count for outcome, count in one.counts.items()},
            "worst_margin_si": one.worst,
            "unit": SI_UNITS[unit],
            "worst_episode": one.worst_episode if one.worst_episode >= 0 else None,
        }
        for sentence, unit, target, one in zip(
            declared.claims, declared.units, declared.targets, claims, strict=True
        )
    ]


def _summary(declared: Declared, tally: CampaignTally) -> str:
    """How many episodes of each stratum are done."""
    parts = []
    for name, stratum in zip(declared.strata, tally.strata, strict=True):
        words = f"{name} {stratum.done}/{stratum.planned}"
        if stratum.stopped_after is not None:
            words += f" (decided after {stratum.stopped_after})"
        if stratum.failed:
            words += f", {stratum.failed} FAILED TO RUN"
        parts.append(words)
    return f"episodes {tally.done}/{tally.planned} in {declared.world.label}: " + "; ".join(parts)


def worst_lines(claims: tuple[str, ...], units: tuple[Unit, ...], tally: CampaignTally) -> list[str]:
    """Of each claim over all strata the worst margin, and how often it was violated, tested, ..."""
    lines = []
    for k, (claim, unit) in enumerate(zip(claims, units, strict=True)):
        one = tally.of_claim(k)
        counts = one.counts
        words = f"violated in {counts[EpisodeOutcome.VIOLATED]} of {one.tested} tested"
        others = (
            (EpisodeOutcome.UNTESTED, "not put to the test"),
            (EpisodeOutcome.INCONCLUSIVE, "inconclusive"),
            (EpisodeOutcome.FAILED, "could not be run"),
        )
        words += "".join(f", {counts[outcome]} {word}" for outcome, word in others if counts[outcome])
        lines.append(f"  {unit.margin_text(one.worst):>14}  {claim}: {words}")
    return lines


def _failure_lines(ledger: Ledger) -> list[str]:
    """Why episodes failed to run or left no record of a whole run, the most frequent reasons first."""
    question = (
        "SELECT count(*), failure, stratum, min(episode) FROM episodes WHERE failure IS NOT NULL "
        "GROUP BY failure ORDER BY 1 DESC, 2"
    )
    found = list(ledger.all(question))
    lines = [
        f"  {count} times: {why} (first: {stratum}, episode {episode})"
        for count, why, stratum, episode in found[:_MOST_REASONS]
    ]
    more = sum(count for count, *_ in found[_MOST_REASONS:])
    return lines + ([f"  {more} times: another of {len(found) - _MOST_REASONS} reasons"] if more else [])


def _fallback_lines(ledger: Ledger) -> list[str]:
    """That the fallback stood in for the avoider, how often and why; nothing if it always answered."""
    found = fallback_of(ledger)
    episodes = next(ledger.all("SELECT count(*) FROM episode"))[0]
    where = f"in {found.episodes} of {episodes} episodes; most often: {found.reason}"
    return [f"  {found.words}, {where}"] if found.words else []


def _overruled_lines(ledger: Ledger) -> list[str]:
    """What the gate overruled, of several strata the share in each; nothing without proposals."""
    strata = ledger.declared.strata
    each = [(name, overruling_in(ledger, k)) for k, name in enumerate(strata) if len(strata) > 1]
    by = ", ".join(f"{name} {share_words(one.overruled, one.proposals)}" for name, one in each)
    whole = overruling_in(ledger).words
    return [f"  {whole}", *([f"    by stratum: {by}"] if by else [])] if whole else []


def _bound_lines(ledger: Ledger, bounds: Sequence[ProbabilityBounds]) -> list[str]:
    """The chance of a violation between its bounds, as a report has them: all hold together."""
    if ledger.dependent:
        return [ledger.dependent]
    declared = ledger.declared
    targets = dict(zip(declared.claims, declared.targets, strict=True))
    each = confidence_words(bounds[0].confidence)
    fallback = fallback_of(ledger).words
    lines = [
        f"how often a run that tests the claim violates it{f' ({fallback})' if fallback else ''}: all "
        f"{bounds[0].family} bounds, two a line, "
        f"hold together with {percent(declared.confidence)} confidence, each line alone with {each}"
    ]
    for one in bounds:
        target = targets[one.claim]
        shown = target is not None and one.shows(target)
        asked = "" if target is None else f", asked at most {target:.4g}: {'shown' if shown else 'NOT shown'}"
        model = ", model only" if one.model_only else ""
        failed = f", {one.failed} could not be run" if one.failed else ""  # each may be a violation, or none
        runs = f"{one.trials - one.failed} runs tested it{failed}{asked}{model}"
        known = f"{rounded_down(one.low)} to {rounded_up(one.high)} ({runs})"
        lines.append(
            f"  {one.stratum}: {one.claim}: " + (known if one.trials else "nothing known, never tested")
        )
    return lines


def rare_line(one: RareViolation) -> str:
    """Return how often one claim is violated in one stratum: the estimate, and what plain draws bound."""
    found, where = one.estimate, f"{one.stratum}: {one.claim.sentence}"
    ran = f"{found.evaluations:,} draws{', model only' if found.model_only else ''}"
    most = f"at most {one.high:.3g} by its {found.plain_draws:,} plain draws alone"
    if why := found.no_estimate:
        return f"{where}: no estimate ({why}); {most} ({ran})"
    return (
        f"{where}: about {one.share:.3g} of all runs violate it, at least {one.low:.3g}; {most} ({ran}); "
        f"independent runs would take {found.as_many_draws:,.0f} for the same standard error"
    )


def difference_lines(found: Sequence[PairedComparison], confidence: float) -> list[str]:
    """Second campaign minus first, a line for each claim in each stratum, and how surely."""
    each = confidence_words(found[0].confidence)
    head = (
        f"the {len(found)} intervals hold together with {percent(confidence)} confidence, each alone with "
        f"{each}; p (McNemar) is of its own line alone"
    )
    return [head, *map(_difference_line, found)]


def _difference_line(one: PairedComparison) -> str:
    how = f"from {one.low:+.3%} to {one.high:+.3%}; p {one.p_value:.3g}"
    counts = (
        f"both {one.both}, only after {one.only_first}, only before {one.only_second}, unclear {one.unclear}"
    )
    model = ", model only" if one.model_only else ""
    return (
        f"{one.stratum}: {one.claim}: violated {one.seen:+.3%} more often ({how}); of {one.episodes}: "
        f"{counts}{model}"
    )


def csv_line(values: Sequence[object]) -> str:
    """A row as CSV."""
    text = io.StringIO()
    csv.writer(text, lineterminator="").writerow("" if value is None else value for value in values)
    return text.getvalue()
