"""What a campaign shows while it runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from safety_harness.base.output import Output, time_left
from safety_harness.extensions.assurance.campaign.pilot import too_few
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.campaign.runner import CampaignRunner
from safety_harness.extensions.assurance.commands.campaign_lines import worst_lines


@contextmanager
def watching_campaign(plan: Plan, output: Output) -> Iterator[Callable[[CampaignRunner], None]]:
    """Yields what is told of the progress: rate, time left, worst margins, violations.

    It warns, once each, of claims that the planned runs will not show, as far as the first of them tell.
    """
    claims = tuple(claim.sentence for claim in plan.claims)
    units = tuple(claim.unit for claim in plan.claims)
    told: set[str] = set()

    def tell(progress: CampaignRunner) -> None:
        show([_head(progress), *worst_lines(claims, units, progress.tally)])
        for one in too_few(plan, progress.tally):
            if (name := f"{one.stratum}: {one.sentence}") not in told:
                told.add(name)
                output.say(f"warning: after {one.tried} runs: {one.line}")

    with output.block() as show:
        yield tell


def _head(progress: CampaignRunner) -> str:
    tally = progress.tally
    (done, planned), (part, of) = progress.standing, progress.part
    share = done / planned if planned else 1.0
    episodes = "episodes" if of == 1 else f"episodes of part {part + 1}/{of}"
    head = f"{done}/{planned} {episodes} ({int(100 * share)} %), {progress.rate:.1f} a second, "
    head += time_left(progress.left_s)
    if not progress.crew.size:
        head += "; NO WORKER IS THERE"
    if progress.retried or progress.crew.replaced:
        head += f"; {progress.crew.replaced} workers replaced, {progress.retried} episodes tried again"
    return head + (f"; {tally.failed} FAILED TO RUN" if tally.failed else "")
