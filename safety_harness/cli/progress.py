"""What a search and a campaign show: lines that change on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.live import Live
from rich.text import Text

from safety_harness.campaign.plan import Plan
from safety_harness.campaign.runner import CampaignRunner
from safety_harness.cli.campaign_lines import worst_lines
from safety_harness.cli.console import say
from safety_harness.search.findings import Findings
from safety_harness.search.session import nearest_lines, summary

_EVERY_S = 30.0  # of a campaign, where there is no terminal


@contextmanager
def _lines() -> Iterator[Callable[[list[str], bool], None]]:
    """Yields what shows lines on a terminal; elsewhere it says the first of them, where that is due."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda lines, due: say(lines[0]) if due else None
        return
    with Live(console=console, refresh_per_second=4, transient=True) as live:
        yield lambda lines, due: live.update(Text("\n".join(lines)))


@contextmanager
def watching_search(budget: int) -> Iterator[Callable[[Findings], None]]:
    """Yields what is told of the findings after every batch: without a terminal said ten times a budget."""
    said = 0
    with _lines() as show:

        def told(findings: Findings) -> None:
            nonlocal said
            tenth = findings.tried * 10 // budget
            show([summary(findings, budget), *nearest_lines(findings)], tenth > said)
            said = max(said, tenth)

        yield told


@contextmanager
def watching_steps() -> Iterator[Callable[[str], None]]:
    """Yields what is told which step comes next: one line that changes, or without a terminal a line each."""
    with _lines() as show:
        yield lambda words: show([words], True)


@contextmanager
def watching_campaign(plan: Plan) -> Iterator[Callable[[CampaignRunner], None]]:
    """Yields what is told of the progress: rate, time left, worst margins, violations."""
    claims = tuple(claim.sentence for claim in plan.claims)
    units = tuple(claim.unit for claim in plan.claims)
    said_s = -math.inf
    with _lines() as show:

        def told(progress: CampaignRunner) -> None:
            nonlocal said_s
            due = time.monotonic() - said_s > _EVERY_S
            show([_head(progress), *worst_lines(claims, units, progress.tally)], due)
            said_s = time.monotonic() if due else said_s

        yield told


def _head(progress: CampaignRunner) -> str:
    tally = progress.tally
    head = f"{tally.done}/{tally.planned} episodes, {progress.rate:.1f} a second, "
    head += _time_left(progress.left_s)
    if not progress.crew.size:
        head += "; NO WORKER IS THERE"
    if progress.retried or progress.crew.replaced:
        head += f"; {progress.crew.replaced} workers replaced, {progress.retried} episodes tried again"
    return head + (f"; {tally.failed} FAILED TO RUN" if tally.failed else "")


def _time_left(seconds: float) -> str:
    if not math.isfinite(seconds):
        return "time left unknown"
    if seconds < 90.0:
        return f"{seconds:.0f} s left"
    return f"{seconds / 60.0:.0f} min left" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h left"
