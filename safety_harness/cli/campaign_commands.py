"""``safety-harness campaign`` and its commands."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from safety_harness.cli.options import end

_LedgerFile = Annotated[Path, typer.Argument(help="The ledger of a campaign.", metavar="LEDGER")]
_Workers = Annotated[int | None, typer.Option(help="Processes; without it, one for each core.", min=1)]
_Cluster = Annotated[
    str | None,
    typer.Option(
        help="Run on a Dask cluster: tcp://SCHEDULER:PORT or a scheduler file.", metavar="ADDRESS|FILE"
    ),
]
_Part = Annotated[str, typer.Option(help="Only the K-th of N parts, for 'merge'.", metavar="K/N")]
commands = typer.Typer(
    no_args_is_help=True,
    help="Run a declared plan, hundreds or millions of episodes, into a ledger that loses nothing.",
)


@commands.command("run")
def campaign_run(
    plan: Annotated[Path, typer.Argument(help="A plan file.", metavar="PLAN")],
    ledger: Annotated[
        Path | None, typer.Option(help="The ledger; without it reports/PLAN/ledger.sqlite.")
    ] = None,
    workers: _Workers = None,
    cluster: _Cluster = None,
    part: _Part = "1/1",
) -> None:
    """Run a plan's episodes in many processes, or what is left of them if the ledger is there already.

    Ctrl-C keeps every finished episode, and so does whatever kills the program or the machine.
    Exit code 0: complete, or this part is; 1: complete, but episodes failed to run, the avoider did not
    always answer and the plan claims nothing of that, or no worker is left; 2: bad input, another plan's
    ledger, or a disk that takes no more; 130: interrupted.
    """
    from safety_harness.cli.campaign import run as run_plan

    end(run_plan(plan, ledger=ledger, workers=workers, cluster=cluster, part=part))


@commands.command("resume")
def campaign_resume(
    ledger: _LedgerFile, workers: _Workers = None, cluster: _Cluster = None, part: _Part = "1/1"
) -> None:
    """Go on where a campaign was left, with the results that it would have had undisturbed.

    A plan, file or version that has changed since is named, and nothing is run.
    Exit codes as for run.
    """
    from safety_harness.cli.campaign import resume as resume_plan

    end(resume_plan(ledger, workers=workers, cluster=cluster, part=part))


@commands.command("status")
def campaign_status(ledger: _LedgerFile) -> None:
    """Say how a campaign stands, also while it runs; once it is complete, with its bounds.

    Exit code 0; 2: no ledger that can be read.
    """
    from safety_harness.cli.campaign import status as tell_status

    end(tell_status(ledger))


@commands.command("query")
def campaign_query(
    ledger: _LedgerFile,
    sql: Annotated[
        str | None,
        typer.Argument(help="A question in SQL, of the views results and episodes.", metavar="SQL"),
    ] = None,
    claim: Annotated[
        str | None, typer.Option(help="Only of this claim, or of the one with these words.")
    ] = None,
    stratum: Annotated[str | None, typer.Option(help="Only of this stratum.")] = None,
    outcome: Annotated[
        str | None, typer.Option(help="holds, violated, untested, inconclusive or failed.")
    ] = None,
    below: Annotated[
        str | None, typer.Option(help="Only margins below this, with its unit, such as '10 mm'.")
    ] = None,
) -> None:
    """Print results as CSV, the worst margins first; or ask in SQL, which can only read.

    Exit code 0; 2: a question that cannot be answered.
    """
    from safety_harness.cli.campaign import query as ask

    end(ask(ledger, sql, claim=claim, stratum=stratum, outcome=outcome, below=below))


@commands.command("export")
def campaign_export(
    ledger: _LedgerFile,
    out: Annotated[Path | None, typer.Argument(help="A .csv or .parquet file.", metavar="OUT")] = None,
    traces: Annotated[
        Path | None, typer.Option(help="Also the stored traces, as files that replay takes, to this folder.")
    ] = None,
) -> None:
    """Write one line for each episode and claim, for other programs (Parquet: the extra "export").

    Exit code 0; 2: bad input, or it cannot be written.
    """
    from safety_harness.cli.campaign import export as export_ledger

    end(export_ledger(ledger, out, traces))


@commands.command("compare")
def campaign_compare(
    first: Annotated[Path, typer.Argument(help="The ledger before.", metavar="A")],
    second: Annotated[Path, typer.Argument(help="The ledger after.", metavar="B")],
) -> None:
    """Say what got worse from A to B, two campaigns over the same episodes with different avoiders.

    For each claim and stratum the difference in the chance of a violation with exact bounds, paired by
    episode; then the episodes that only B violates, the largest loss of margin first.
    Exit code 0; 1: B is shown to be worse somewhere; 2: campaigns that cannot be compared.
    """
    from safety_harness.cli.campaign import compare as compare_campaigns

    end(compare_campaigns(first, second))


@commands.command("merge")
def campaign_merge(
    into: Annotated[Path, typer.Argument(help="The ledger to make.", metavar="INTO")],
    ledgers: Annotated[list[Path], typer.Argument(help="Ledgers of parts of one plan.", metavar="LEDGER...")],
) -> None:
    """Make one ledger of those of several machines, each of which ran a part of the same plan.

    What two of them have must agree to the last bit.
    Exit code 0; 2: ledgers of different plans, or that disagree.
    """
    from safety_harness.cli.campaign import merge as merge_campaigns

    end(merge_campaigns(into, ledgers))
