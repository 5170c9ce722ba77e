"""The command ``safety-harness campaign attribute``, which finds the causes of a ledger's violations."""

from __future__ import annotations

from pathlib import Path

from safety_harness.base.exceptions import LedgerError
from safety_harness.cli.console import say
from safety_harness.cli.progress import TERMINAL
from safety_harness.extensions.assurance.campaign.attributed import ViolatedEpisodes, violated_episodes
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.session import plan_of
from safety_harness.extensions.assurance.certification.verify_runs import programs_in
from safety_harness.extensions.attribution.attribute import ReplaysInWorld
from safety_harness.extensions.attribution.attribute_job import attribute_all
from safety_harness.extensions.attribution.commands.attribute_lines import conclude


def attribute_ledger(path: Path, most: int, execute: bool, out: Path | None, confirm: bool) -> int:
    """Attribute the violations in a ledger, print and write the result, and return the exit code.

    Args:
        path: The ledger.
        most: The number of violations to attribute for each claim. These are the first violations of the
            claim.
        execute: Whether to execute the programs to which the campaign refers.
        out: The folder for the attribution, or None to write no files.
        confirm: Whether to repeat the runs in a reference world too.

    """
    with Ledger.open(path) as ledger, plan_of(ledger) as plan:
        programs = programs_in(plan)
        if programs and not execute:
            expected = "--execute-programs, since repeating an episode executes it"
            raise LedgerError.of_file(path, expected, f"a campaign with {', '.join(programs)}")
        violated = ViolatedEpisodes.first(ledger, most)
        say(violated.summary)
        episodes = violated_episodes(plan, violated, programs=execute)
        replays = ReplaysInWorld(plan.search_world)
        attributed = attribute_all(episodes, len(violated.claims), "episodes", confirm, TERMINAL, replays)
    return conclude(attributed, out)
