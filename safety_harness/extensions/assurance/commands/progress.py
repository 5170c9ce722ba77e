"""The progress display of a campaign."""

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
    """Yield a function that displays the progress: rate, remaining time, worst margins and violations.

    The function makes a forecast from the first runs. If the planned runs will probably not show a claim, the
    function warns once of that claim.

    Args:
        plan: The plan of the campaign.
        output: The object that receives the display and the warnings.

    """
    claims = tuple(claim.sentence for claim in plan.claims)
    units = tuple(claim.unit for claim in plan.claims)
    warned: set[str] = set()

    def show_progress(progress: CampaignRunner) -> None:
        show([_head(progress), *worst_lines(claims, units, progress.tally)])
        for forecast in too_few(plan, progress.tally):
            if (name := f"{forecast.stratum}: {forecast.sentence}") not in warned:
                warned.add(name)
                output.say(f"warning after {forecast.tried} runs: {forecast.line}")

    with output.block() as show:
        yield show_progress


def _head(progress: CampaignRunner) -> str:
    tally = progress.tally
    (done, planned), (part, parts) = progress.standing, progress.part
    share = done / planned if planned else 1.0
    episodes = "episodes" if parts == 1 else f"episodes of part {part + 1}/{parts}"
    head = f"{done}/{planned} {episodes} ({int(100 * share)} %)"
    if (rate := progress.pace.rate(progress.done_now)) is not None:
        head += f", {rate:.1f} a second, {time_left(progress.left / rate)}"
    if not progress.crew.size:
        head += "; NO WORKER IS THERE"
    if progress.retried or progress.crew.replaced:
        head += f"; {progress.crew.replaced} workers replaced, {progress.retried} episodes tried again"
    return head + (f"; {tally.failed} FAILED TO RUN" if tally.failed else "")
