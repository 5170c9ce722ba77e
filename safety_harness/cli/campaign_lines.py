"""What is said of a campaign: while it runs, and of its ledger afterwards."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from rich.console import Console
from rich.live import Live
from rich.text import Text

from safety_harness.campaign.declared import Declared
from safety_harness.campaign.ledger import Ledger
from safety_harness.campaign.plan import Plan
from safety_harness.campaign.runner import RunnerProgress
from safety_harness.campaign.summary import fallback_of
from safety_harness.campaign.tally import CampaignTally
from safety_harness.certification.verdicts import confidence_words, percent
from safety_harness.cli.console import say
from safety_harness.properties.base import Unit
from safety_harness.report.words import rounded_down, rounded_up
from safety_harness.statistics.binomial import Sides, bounds_of
from safety_harness.statistics.paired import PairedComparison
from safety_harness.statistics.sample import EpisodeOutcome

_EVERY_S = 30.0  # where there is no terminal
_MOST_REASONS = 5


def summary(declared: Declared, tally: CampaignTally) -> str:
    """How many episodes of each stratum are done."""
    parts = []
    for name, stratum in zip(declared.strata, tally.strata, strict=True):
        words = f"{name} {stratum.done}/{stratum.planned}"
        if stratum.stopped_after is not None:
            words += f" (decided after {stratum.stopped_after})"
        if stratum.failed:
            words += f", {stratum.failed} FAILED TO RUN"
        parts.append(words)
    return f"episodes {tally.done}/{tally.planned} in {declared.world}: " + "; ".join(parts)


def claim_lines(declared: Declared, tally: CampaignTally) -> list[str]:
    """Of each claim over all strata the worst margin, and how often it was violated, tested, ..."""
    return _lines(declared.claims, declared.units, tally)


def _lines(claims: tuple[str, ...], units: tuple[Unit, ...], tally: CampaignTally) -> list[str]:
    lines = []
    for k, (claim, unit) in enumerate(zip(claims, units, strict=True)):
        one = tally.of_claim(k)
        counts = one.counts
        tested = sum(counts.values()) - counts[EpisodeOutcome.UNTESTED]
        words = f"violated in {counts[EpisodeOutcome.VIOLATED]} of {tested} tested"
        others = (
            (EpisodeOutcome.UNTESTED, "not put to the test"),
            (EpisodeOutcome.INCONCLUSIVE, "inconclusive"),
        )
        words += "".join(f", {counts[outcome]} {word}" for outcome, word in others if counts[outcome])
        lines.append(f"  {unit.margin_text(one.worst):>14}  {claim}: {words}")
    return lines


def failure_lines(ledger: Ledger) -> list[str]:
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


def fallback_lines(ledger: Ledger) -> list[str]:
    """That the fallback stood in for the avoider, how often and why; nothing if it always answered."""
    found = fallback_of(ledger)
    episodes = next(ledger.all("SELECT count(*) FROM episode"))[0]
    where = f"in {found.episodes} of {episodes} episodes; most often: {found.reason}"
    return [f"  {found.words}, {where}"] if found.words else []


def bound_lines(ledger: Ledger) -> list[str]:
    """The chance of a violation between its bounds, as a report has them: all hold together."""
    declared = ledger.declared
    pairs = [(stratum, claim) for stratum in declared.strata for claim in declared.claims]
    bounds = bounds_of([ledger.sample(*pair) for pair in pairs], declared.confidence, Sides.BOTH)
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
        known = (
            f"{rounded_down(one.low)} to {rounded_up(one.high)} ({one.trials} runs tested it{asked}{model})"
        )
        lines.append(
            f"  {one.stratum}: {one.claim}: " + (known if one.trials else "nothing known, never tested")
        )
    return lines


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


@dataclass
class CampaignProgress:
    """Told of the progress: a display that changes on a terminal, a line now and then elsewhere."""

    plan: Plan
    _live: Live | None = None
    _said_s: float = -math.inf

    @contextmanager
    def running(self) -> Iterator[CampaignProgress]:
        """While the campaign lasts."""
        console = Console(stderr=True)
        if not console.is_terminal:
            yield self
            return
        with Live(console=console, refresh_per_second=4, transient=True) as self._live:
            yield self
        self._live = None

    def show(self, progress: RunnerProgress) -> None:
        """Rate, time left, worst margins, violations."""
        head = (
            f"{progress.tally.done}/{progress.tally.planned} episodes, {progress.rate:.1f} a second, "
            f"{_time_left(progress.left_s)}"
        )
        if not progress.workers:
            head += "; NO WORKER IS THERE"
        if progress.retried or progress.replaced:
            head += f"; {progress.replaced} workers replaced, {progress.retried} episodes tried again"
        if progress.tally.failed:
            head += f"; {progress.tally.failed} FAILED TO RUN"
        claims = tuple(claim.sentence for claim in self.plan.claims)
        lines = [head, *_lines(claims, tuple(claim.unit for claim in self.plan.claims), progress.tally)]
        if self._live is not None:
            self._live.update(Text("\n".join(lines)))
        elif time.monotonic() - self._said_s > _EVERY_S:
            self._said_s = time.monotonic()
            say(head)


def _time_left(seconds: float) -> str:
    if not math.isfinite(seconds):
        return "time left unknown"
    if seconds < 90.0:
        return f"{seconds:.0f} s left"
    return f"{seconds / 60.0:.0f} min left" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h left"
