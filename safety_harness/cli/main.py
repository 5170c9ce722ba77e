"""The commands of ``safety-harness``, together; each imports what it needs when it is called."""

from __future__ import annotations

import typer

from safety_harness.cli.campaign_commands import commands as of_campaigns
from safety_harness.cli.evidence_commands import commands as of_evidence
from safety_harness.cli.learning_commands import commands as of_learning
from safety_harness.cli.scenario_commands import commands as of_scenarios
from safety_harness.cli.search_commands import commands as of_search
from safety_harness.exceptions import SafetyHarnessError

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Verify a hand-avoidance controller of a robot arm: run scenarios, judge them, search what breaks "
    "it, and certify; make the data of a learned avoider, train, evaluate and export it.",
)
for group in (of_scenarios, of_search, of_evidence):
    app.add_typer(group)
app.add_typer(of_campaigns, name="campaign")
app.add_typer(of_learning)


def main() -> None:
    """Entry point: one of our own errors is explained, and never a traceback."""
    try:
        app()
    except SafetyHarnessError as error:
        from safety_harness.cli.console import BAD_INPUT, explain

        explain(error)
        raise SystemExit(BAD_INPUT) from None
