"""The commands ``safety-harness campaign``, which run a declared plan into a ledger and query the ledger."""

from __future__ import annotations

import shlex
from enum import StrEnum
from functools import partial
from pathlib import Path
from shutil import rmtree
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option, Typer

from safety_harness.base.exceptions import (
    InputError,
    LedgerError,
    SafetyHarnessError,
    ScenarioError,
    described,
)
from safety_harness.cli.console import (
    AS_EXPECTED,
    DIFFERS,
    INTERRUPTED,
    asked_for_json,
    document,
    next_step,
    result,
    say,
    say_shared_modules,
    verbatim,
)
from safety_harness.cli.options import (
    AttributionOut,
    Confirm,
    Executes,
    OfController,
    OfReference,
    Workers,
    command,
)

if TYPE_CHECKING:
    from safety_harness.extensions.assurance.campaign.ledger import Ledger
    from safety_harness.extensions.assurance.campaign.plan import Plan
    from safety_harness.extensions.assurance.campaign.summary import LedgerState

_LedgerFile = Annotated[Path, Argument(help="The ledger of a campaign.", metavar="LEDGER")]
_Cluster = Annotated[
    str | None,
    Option(
        help="Run on a Dask cluster: tcp://SCHEDULER:PORT or a scheduler file. Default: this machine.",
        metavar="ADDRESS|FILE",
    ),
]
_Part = Annotated[
    str,
    Option(
        help="Run only part K of N parts of the plan. The command merge joins the ledgers of all parts.",
        metavar="K/N",
    ),
]
_HELP = "Run a declared plan of up to millions of episodes; its ledger survives crashes."


class RareWay(StrEnum):
    """The method that estimates the probability of rare violations."""

    IMPORTANCE = "importance"
    SPLITTING = "splitting"


commands = Typer(name="campaign", no_args_is_help=True, help=_HELP, short_help=_HELP)
_command = partial(
    command, commands, interrupted="interrupted; the ledger has all committed episodes", failed=DIFFERS
)

_unwritten = partial(command, commands, interrupted="interrupted; nothing is written", failed=DIFFERS)


@_command()
def run(
    plan: Annotated[Path, Argument(help="A plan: a file, or shipped:NAME.", metavar="PLAN")],
    ledger: Annotated[
        Path | None,
        Option(
            "--out",
            "--ledger",
            help="Folder for the ledger, or the file of the ledger (.sqlite). Default: reports/PLAN.",
        ),
    ] = None,
    workers: Workers = None,
    cluster: _Cluster = None,
    part: _Part = "1/1",
    controller: OfController = None,
    require_shown: Annotated[
        bool,
        Option("--require-shown", help="End with exit code 1 unless the runs show every target of the plan."),
    ] = False,
) -> int:
    """Run the remaining episodes of a plan in many processes.

    If the ledger exists, the command keeps its episodes and runs the others. A
    page (.html) beside the ledger shows the state of the campaign, unless the
    ledger belongs to a finished report. Every finished episode stays saved,
    even after Ctrl-C or a crash of the program or the machine.

    Exit code 0: all episodes of the plan, or of the part in --part, are
    finished.
    Exit code 1: the plan is complete, but an episode or the page failed, no run
    tested a claim, or a target is not shown (--require-shown).
    Exit code 1 too: no worker remains, the avoider gave two different answers
    to the same question, or it did not always answer and no claim covers this.
    Exit code 2: bad input, the ledger of another plan, or a full disk.
    Exit code 130: interrupted; the ledger has all finished episodes.
    """
    from safety_harness.extensions.assurance.campaign.against import plan_with
    from safety_harness.extensions.assurance.campaign.plan import read_plan
    from safety_harness.extensions.assurance.campaign.session import LEDGER
    from safety_harness.scenario.model import Driver

    read = read_plan(plan)
    if controller is not None:
        read = plan_with(read.files, Driver(controller), Path("reports") / read.name)
    if require_shown and all(claim.target is None for claim in read.claims):
        raise ScenarioError.of_option("--require-shown", "a plan with a target to show", f"none in {plan}")
    path = ledger or Path("reports") / read.name
    path = path if path.suffix == ".sqlite" or path.is_file() else path / LEDGER
    code = _run_episodes(read, path, workers, cluster, part, require_shown)
    if code in (AS_EXPECTED, DIFFERS) and path.name == LEDGER and (controller, part) == (None, "1/1"):
        next_step(
            shlex.join(["safety-harness", "certify", str(plan), "--out", str(path.parent)]), "its evidence"
        )
    return code


@_unwritten("pilot")
def pilot_runs(
    plan: Annotated[Path, Argument(help="A plan: a file, or shipped:NAME.", metavar="PLAN")],
    runs: Annotated[
        int,
        Option(help="Number of runs in each stratum. Their seed differs from the seed of the plan.", min=1),
    ] = 30,
    workers: Workers = None,
    controller: OfController = None,
) -> int:
    """Forecast from a few runs how many runs a plan needs.

    For each claim, the command prints how many of the plan's runs will test the
    claim, and how many runs the claim needs. Then it prints how long the plan's
    runs will take. The command writes no file, and makes none of the runs that
    the plan declares.

    With the number of runs that a claim needs, the bounds show the target with
    a probability of 90 %. This assumes that the frequencies in the plan equal
    the frequencies in the pilot. Each interval by itself has a confidence of 95
    %.

    Exit code 0: according to the pilot, the planned runs are enough.
    Exit code 1: the planned runs are too few for a claim, or a run failed.
    Exit code 1 too: the avoider did not always answer, or gave two different
    answers to the same question.
    Exit code 2: bad input.
    Exit code 130: interrupted.
    """
    import os

    from safety_harness.base.output import time_words
    from safety_harness.claims.properties.tally import basis
    from safety_harness.cli.progress import counting
    from safety_harness.extensions.assurance.campaign.against import plan_with
    from safety_harness.extensions.assurance.campaign.pilot import pilot
    from safety_harness.extensions.assurance.campaign.plan import read_plan
    from safety_harness.scenario.model import Driver
    from safety_harness.scenario.typed_json import plain

    read = read_plan(plan)
    if controller is not None:
        read = plan_with(read.files, Driver(controller), Path("reports") / read.name)
    with counting(runs * len(read.strata), "runs") as show:
        trial = pilot(read, runs, lambda done: show(done, "pilot"))
    cores = workers or len(os.sched_getaffinity(0))
    seconds = trial.seconds(read, cores)
    document(**plain(trial), seconds=seconds, workers=cores, enough=trial.enough)
    result(*(f"{'ok  ' if item.enough else 'WARN'} {item.line}" for item in trial.forecasts))
    result(*(f"WARN a run failed: {item}" for item in trial.failures))
    result(*(f"WARN {item}" for item in trial.remarks), *trial.slow_answers)
    result(basis([str(read.world)], ((item.tested, item.tried) for item in trial.forecasts)))
    result(f"{read.runs} runs: about {time_words(seconds)} with {cores} processes here, without other load")
    chosen = [] if controller is None else ["--controller", controller]
    next_step(shlex.join(["safety-harness", "campaign", "run", str(plan), *chosen]))
    return AS_EXPECTED if trial.enough else DIFFERS


@_command()
def resume(
    ledger: _LedgerFile,
    workers: Workers = None,
    cluster: _Cluster = None,
    part: _Part = "1/1",
    execute_programs: Executes = False,
) -> int:
    """Continue a campaign from its ledger.

    The results equal the results of a campaign without an interruption. If the
    plan, a file or the version has changed since the campaign began, the
    command prints the change and runs no episode. If the campaign runs in your
    simulator, the command needs --execute-programs, because the ledger may come
    from a stranger.

    Exit code 0: all episodes of the plan, or of the part in --part, are
    finished.
    Exit code 1: the plan is complete, but an episode or the page failed, or no
    run tested a claim.
    Exit code 1 too: no worker remains, the avoider gave two different answers
    to the same question, or it did not always answer and no claim covers this.
    Exit code 2: bad input, a changed plan or version, or a full disk.
    Exit code 130: interrupted; the ledger has all finished episodes.
    """
    from safety_harness.extensions.assurance.campaign.ledger import Ledger
    from safety_harness.extensions.assurance.campaign.session import plan_of

    with Ledger.open(ledger) as opened, plan_of(opened) as plan:
        _refuse_to_execute(opened, execute_programs)
        return _run_episodes(plan, ledger, workers, cluster, part)


def _refuse_to_execute(ledger: Ledger, execute: bool) -> None:
    """Raise LedgerError if the ledger specifies a simulator and the user did not permit its execution."""
    if (world := ledger.declared.world).program and not execute:
        expected = "--execute-programs, since the ledger names the simulator"
        raise LedgerError.of_file(ledger.path, expected, world.label)


def _run_episodes(
    plan: Plan, path: Path, workers: int | None, cluster: str | None, part: str, require_shown: bool = False
) -> int:
    """Run the missing episodes of ``plan`` into its ledger, print the state, and return the exit code.

    Args:
        plan: The plan.
        path: The ledger.
        workers: The number of processes. The default is one process per core.
        cluster: The address of a Dask scheduler, or its file. The default uses processes of this machine.
        part: A text K/N for part number K of N parts.
        require_shown: Whether the exit code reports a failure if a target is not shown.

    """
    from safety_harness.base.interrupts import one_more_ctrl_c
    from safety_harness.claims.properties.answered import is_claimed
    from safety_harness.cli.progress import TERMINAL
    from safety_harness.extensions.assurance.campaign.ledger import Ledger
    from safety_harness.extensions.assurance.campaign.session import processes, run_missing
    from safety_harness.extensions.assurance.campaign.summary import fallback_of
    from safety_harness.extensions.assurance.certification.stored import limited_lines
    from safety_harness.extensions.assurance.commands.campaign_lines import tested_lines
    from safety_harness.extensions.assurance.commands.progress import watching_campaign
    from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome
    from safety_harness.scenario.kinds import FileKind, kind_of

    make_crew = processes(workers)
    if cluster is not None:
        from safety_harness.extensions.assurance.campaign.cluster import DaskCrew

        make_crew = partial(DaskCrew, address=cluster)
    numbers = _numbers(part, plan)
    say_shared_modules()
    remark = "running episodes finish and count; Ctrl-C again drops them"
    with one_more_ctrl_c(say, remark) as interrupted, watching_campaign(plan, TERMINAL) as show:
        run_missing(plan, path, make_crew, on_progress=show, enough=interrupted, part=numbers, say=say)
        stopped = interrupted()
    result(*tested_lines(plan))
    with Ledger.open(path, check=False) as ledger:
        finished = kind_of(path.parent) is FileKind.REPORT  # a report's manifest allows no further file
        state, drawn = _say_ledger(ledger), True
        result(*(f"limits: {line}" for line in limited_lines(plan, ledger)))
        try:
            if not finished:
                _write_page(ledger, state, path.with_suffix(".html"))
        except SafetyHarnessError:
            raise
        except Exception as error:  # the runs stay valid if the page fails
            say(f"error: the page cannot be written ({described(error)}); the ledger has all runs")
            drawn = False
        tally, targets = state.tally, {claim.sentence: claim.target for claim in plan.claims}
        targeted = [(item, target) for item in state.bounds if (target := targets[item.claim]) is not None]
        unshown = require_shown and not (targeted and all(item.shows(target) for item, target in targeted))
        unlike = bool(ledger.repeated.problem or ledger.dependent)
        unanswered = fallback_of(ledger).unanswered and not is_claimed(claim.claim for claim in plan.claims)
    if stopped and not tally.complete:
        option = " --execute-programs" * plan.world.program
        say(f"interrupted; go on: safety-harness campaign resume {shlex.quote(str(path))}{option}")
        return INTERRUPTED
    if unshown:
        say("a target of the plan remains open, so --require-shown fails")
    claims = [tally.of_claim(number).counts for number in range(len(plan.claims))]
    unknown = any(item[EpisodeOutcome.UNTESTED] == sum(item.values()) for item in claims)
    failed = tally.failed or not drawn
    return DIFFERS if failed or unanswered or unlike or unknown or unshown else AS_EXPECTED


def _say_ledger(ledger: Ledger, page: Path | None = None) -> LedgerState:
    """Print the state of ``ledger`` as lines or as JSON, and return the state.

    If ``page`` is not None, the function also writes the state as a page to this file.
    """
    from safety_harness.extensions.assurance.campaign.summary import state_of
    from safety_harness.extensions.assurance.commands.campaign_lines import ledger_data, ledger_lines

    state = state_of(ledger)
    if asked_for_json():
        document(**ledger_data(ledger, state))
    else:
        result(*ledger_lines(ledger, state))
    if page is not None:
        _write_page(ledger, state, page)
    return state


def _numbers(part: str, plan: Plan) -> tuple[int, int]:
    """Return (K - 1, N) for the text K/N in ``part``.

    Raises:
        ScenarioError: The text does not have the form K/N. The error is also raised if the plan may stop
            early and therefore has no fixed parts.

    """
    k, _, n = part.partition("/")
    right = k.isascii() and k.isdigit() and n.isascii() and n.isdigit() and len(part) < 12
    if not right or not 1 <= int(k) <= int(n):
        raise ScenarioError.of_option("--part", "K/N, such as 2/4", part)
    if int(n) > 1 and plan.stop_early:
        raise ScenarioError.of_option("--part", "a plan of fixed length", "one that may stop early")
    return int(k) - 1, int(n)


@_command()
def status(
    ledger: _LedgerFile,
    html: Annotated[
        Path | None, Option(help="Also write the state as a page to this file.", metavar="FILE")
    ] = None,
) -> int:
    """Print the state of a campaign, even while it runs.

    If the campaign is complete, the command also prints its bounds.

    Exit code 0: the state is printed.
    Exit code 2: the ledger cannot be read, or the page cannot be written.
    """
    from safety_harness.extensions.assurance.campaign.ledger import Ledger
    from safety_harness.extensions.assurance.campaign.session import copied_plan_of
    from safety_harness.extensions.assurance.commands.campaign_lines import tested_lines

    with Ledger.open(ledger, check=False) as opened:
        try:
            with copied_plan_of(opened) as plan:
                result(*tested_lines(plan))
        except InputError as error:
            say(f"the tested system cannot be determined: {error}")
        _say_ledger(opened, html)
    return AS_EXPECTED


def _write_page(ledger: Ledger, state: LedgerState, path: Path) -> None:
    import shlex
    from datetime import UTC, datetime

    from safety_harness.base.whole_file import writing
    from safety_harness.extensions.assurance.pages.campaign_page import write_page
    from safety_harness.scenario.files import display_path

    argv = [
        "safety-harness",
        "campaign",
        "status",
        str(display_path(ledger.path)),
        "--html",
        str(display_path(path)),
    ]
    with writing(path):
        write_page(path, ledger, state, command=shlex.join(argv), generated_at=datetime.now(UTC))
    say(f"page: {path}")
    document(page=path)


@_command()
def query(
    ledger: _LedgerFile,
    sql: Annotated[
        str | None, Argument(help="A query in SQL on the views results and episodes.", metavar="SQL")
    ] = None,
    claim: Annotated[
        str | None,
        Option(help="Print only results on this claim. Some words that occur in no other claim are enough."),
    ] = None,
    stratum: Annotated[
        str | None,
        Option(
            help="Print only results in this stratum. Some words that occur in no other stratum are enough."
        ),
    ] = None,
    outcome: Annotated[
        str | None,
        Option(
            help="Print only results with this outcome: holds, violated, untested, inconclusive or failed."
        ),
    ] = None,
    below: Annotated[
        str | None, Option(help="Print only results with a margin below this value, for example '10 mm'.")
    ] = None,
) -> int:
    """Print results as CSV, or query the ledger in SQL.

    Without a query in SQL, the rows with the worst margins come first. A query
    cannot change the ledger. In the view episodes, the columns proposals,
    overruled, overruled_replaced and overruled_stopped concern the gate. The
    view also has a column for each reason, such as overruled_uncertain.

    Exit code 0: the rows are printed.
    Exit code 2: the ledger cannot be read, or the query has an error.
    """
    import sqlite3

    from safety_harness.extensions.assurance.campaign.exporting import question_of, refuse_writing
    from safety_harness.extensions.assurance.campaign.ledger import Ledger
    from safety_harness.extensions.assurance.commands.campaign_lines import csv_line

    with Ledger.open(ledger, check=False) as opened:
        question, values = question_of(opened, claim, stratum, outcome, below) if sql is None else (sql, ())
        refuse_writing(opened.connection)
        try:
            rows = opened.connection.execute(question, values)
            if rows.description is None:
                raise sqlite3.ProgrammingError("no question")
            columns = [column for column, *_ in rows.description]
            document(columns=columns, rows=rows.fetchall() if asked_for_json() else None)
            verbatim(csv_line(columns))
            for row in rows:
                verbatim(csv_line(row))
        except (sqlite3.Error, sqlite3.Warning) as error:
            raise LedgerError.of_file(ledger, "a question in SQL", f"{question!r}: {error}") from error
    return AS_EXPECTED


@_command()
def export(
    ledger: _LedgerFile,
    out: Annotated[
        Path | None, Argument(help="The table to write, a .csv or .parquet file.", metavar="OUT")
    ] = None,
    traces: Annotated[
        Path | None,
        Option(
            help="Also write the stored traces to this folder, as files that the command replay can read."
        ),
    ] = None,
) -> int:
    """Write a table with a row for each episode and claim.

    A Parquet file needs the extra "export".

    Exit code 0: the files are written.
    Exit code 2: bad input, or a file cannot be written.
    """
    from safety_harness.extensions.assurance.campaign.exporting import export as export_table
    from safety_harness.extensions.assurance.campaign.exporting import export_traces
    from safety_harness.extensions.assurance.campaign.ledger import Ledger

    if out is None and traces is None:
        raise ScenarioError.of_option("export", "OUT, --traces FOLDER or both", "none")
    with Ledger.open(ledger) as opened:
        if out is not None:
            lines = export_table(opened, out)
            result(f"{out}: {lines} lines")
            document(out=out, lines=lines)
        if traces is not None:
            files = export_traces(opened, traces)
            result(f"{traces}: {len(files)} traces")
            document(traces=files)
    return AS_EXPECTED


@_command()
def compare(
    first: Annotated[
        Path,
        Argument(
            help="The ledger before a change. With --against or --controller, it is the ledger after the "
            "change.",
            metavar="A",
        ),
    ],
    second: Annotated[Path | None, Argument(help="The ledger after the change.", metavar="[B]")] = None,
    against: OfReference = None,
    controller: OfController = None,
    workers: Workers = None,
    execute_programs: Executes = False,
) -> int:
    """Compare two campaigns, A and B, over the same episodes.

    The two campaigns have different avoiders. For each claim and stratum, the
    command prints the difference in the probability of a violation, with exact
    bounds from paired episodes. It also prints how often the gate overruled the
    avoider in A and in B. Then it lists the episodes that only B violates,
    beginning with the largest loss of margin, and the margins that became
    smaller although the claim holds in A and in B. Finally, it prints how many
    episodes violate any claim in only A or only B.

    You can pass --against (an avoider) or --controller instead of B. The
    command then runs the plan of A with that system, and writes a ledger beside
    the ledger of A. If an earlier call was interrupted, the command continues
    its run. The results and the exit codes then concern A in place of B. If the
    new run fails, the command ends with the exit code of "campaign run".

    Exit code 0: the intervals do not show that B is worse.
    Exit code 1: the whole interval of a claim in a stratum shows that B is
    worse, or a claim has no run with a verdict in a stratum.
    Exit code 2: the campaigns cannot be compared.
    """
    from safety_harness.admission.avoiders import one_of, option_of
    from safety_harness.claims.properties.base import SI_UNITS
    from safety_harness.extensions.assurance.campaign.against import against_lines, plan_against
    from safety_harness.extensions.assurance.campaign.ledger import Ledger
    from safety_harness.extensions.assurance.campaign.merging import (
        compare_ledgers,
        refuse_incomparable,
        refuse_itself,
        without_a_decided_run,
        worse_episodes,
    )
    from safety_harness.extensions.assurance.campaign.overruled import compare_overruling
    from safety_harness.extensions.assurance.campaign.session import LEDGER
    from safety_harness.extensions.assurance.campaign.summary import basis_in, fallback_of, tally_of
    from safety_harness.extensions.assurance.commands.campaign_lines import difference_lines

    reference = one_of(against, controller)
    if (second is None) is (reference is None):
        raise ScenarioError.of_option("compare", "either B or --against or --controller", "both or none")
    if reference is not None:
        with Ledger.open(first) as mine:
            _refuse_to_execute(mine, execute_programs)
            home = mine.path.resolve().parent
            existing = {*home.iterdir()}
            plan = plan_against(mine, reference)
            if plan.identity.systems == mine.declared.identity.systems:
                folder = next(part for part in plan.file.resolve().parents if part.parent == home)
                if folder not in existing:  # in a report, "verify" would name its files
                    rmtree(folder)
                got = f"{reference}, the system of {first} by its hash: a comparison with itself"
                raise ScenarioError.of_option(option_of(reference), "another system", got)
        first, second = plan.file.parent / LEDGER, first
        code = _run_episodes(plan, first, workers, None, "1/1")
        if code != AS_EXPECTED:
            return code
    assert second is not None
    with Ledger.open(first) as old, Ledger.open(second) as new:
        for ledger in (old, new):
            if text := fallback_of(ledger).summary:
                result(f"{ledger.path}: {text}")
        refuse_itself(old, new)
        refuse_incomparable(old, new)
        undecided = [
            f"not comparable: {ledger.path} has no decided run of {claim}, in {stratum}"
            for ledger in (old, new)
            for stratum, claim in without_a_decided_run(ledger)
        ]
        if undecided:
            document(before=old.path, after=new.path, not_comparable=undecided)
            result(*undecided)
            return DIFFERS
        bases = [f"{row.path}: {basis_in(row, tally_of(row))}" for row in (old, new)]
        compared, overruled = compare_ledgers(old, new), compare_overruling(old, new)
        worse, lost = worse_episodes(old, new), list(against_lines(old, new))
        document(
            before=old.path,
            after=new.path,
            differences=compared,
            overruling=[
                {key: getattr(row, key) for key in ("stratum", "episodes")}
                | {"before": row.before.named, "after": row.after.named}
                for row in overruled
            ],
            worse_episodes=[
                {key: getattr(row, key) for key in ("stratum", "episode", "claim")}
                | {"before_margin_si": row.before, "after_margin_si": row.after, "unit": SI_UNITS[row.unit]}
                for row in worse
            ],
            remarks=lost,
            basis=bases,
        )
        result(*difference_lines(compared, old.declared.confidence))
        result(*(row.summary for row in overruled if row.before.proposals or row.after.proposals))
        for loss in worse:
            was, now = (loss.unit.margin_text(margin) for margin in (loss.before, loss.after))
            result(f"  worse: {loss.stratum}, episode {loss.episode}: {loss.claim}: {was} -> {now}")
        result(*lost, *bases)
    return DIFFERS if any(row.low > 0.0 for row in compared) else AS_EXPECTED


@_command()
def attribute(
    ledger: _LedgerFile,
    most: Annotated[
        int,
        Option(
            help="Largest number of violations to attribute for each claim, beginning with the first "
            "violation.",
            min=1,
        ),
    ] = 100,
    out: AttributionOut = None,
    confirm: Confirm = False,
    execute_programs: Executes = False,
) -> int:
    """Find the causes of a campaign's violations.

    The command draws each violated episode again from its seed, and repeats it
    as the command attribute does. Therefore the command needs no stored trace.
    It first prints how many of all violations it covers.

    Exit code 0: for each violation, the command found a cause, or the answer
    "unavoidable" or "helped by nothing tried".
    Exit code 1: an episode cannot be repeated, or its replay does not show the
    violation.
    Exit code 2: bad input.
    Exit code 130: interrupted.
    """
    from safety_harness.extensions.assurance.commands.campaign_attribute import attribute_ledger

    return attribute_ledger(ledger, most, execute_programs, out, confirm)


@_unwritten("rare")
def rare_violations(
    plan: Annotated[Path, Argument(help="A plan: a file, or shipped:NAME.", metavar="PLAN")],
    rare_way: Annotated[
        RareWay,
        Option(
            "--by",
            help="The method of estimation: importance draws scenarios near violations, and splitting "
            "moves scenarios towards violations in steps.",
        ),
    ] = (RareWay.IMPORTANCE),
    pilot: Annotated[
        int | None,
        Option(help="For importance: number of draws in each step of the pilot. Default: 500.", min=10),
    ] = None,
    runs: Annotated[
        int | None, Option(help="For importance: number of draws after the pilot. Default: 5000.", min=100)
    ] = None,
    particles: Annotated[
        int | None, Option(help="For splitting: number of runs in each level. Default: 200.", min=10)
    ] = None,
    steps: Annotated[
        int | None, Option(help="For splitting: number of moves of a run in each level. Default: 5.", min=1)
    ] = None,
    replications: Annotated[int, Option(help="Number of independent repetitions.", min=3)] = 20,
) -> int:
    """Estimate the probability of rare violations.

    Use this command for probabilities below 1 in 100. It uses importance
    sampling or splitting. The estimate is the fraction of all runs of a stratum
    that violate the claim, including runs that do not test it. The command also
    prints a lower and an upper bound. A search cannot see a region that it did
    not reach. Therefore the upper bound comes from the plain draws alone, and
    is exact but wide.

    Importance sampling needs the fewest runs, but it gives no estimate if the
    estimate would not be reliable. In this case, splitting gives an estimate
    from more runs. The command writes no file.

    Exit code 0: every claim has an estimate, and no lower bound exceeds its
    target.
    Exit code 1: a claim has no estimate, or its lower bound exceeds its target.
    Exit code 1 too: the avoider did not always answer, or gave two different
    answers to the same question.
    Exit code 2: bad input, a run that failed, or a run that tested a claim
    without a verdict.
    Exit code 130: interrupted.
    """
    from safety_harness.base.exceptions import StatisticsError
    from safety_harness.claims.properties.tally import basis
    from safety_harness.cli.progress import TERMINAL
    from safety_harness.extensions.assurance.campaign.plan import read_plan
    from safety_harness.extensions.assurance.campaign.rare import rare_violations as estimated
    from safety_harness.extensions.assurance.campaign.watch import AvoiderWatch
    from safety_harness.extensions.assurance.commands.campaign_lines import rare_line
    from safety_harness.extensions.assurance.statistics.importance import Importance
    from safety_harness.extensions.assurance.statistics.rare import Splitting

    read = read_plan(plan)
    given = {
        RareWay.IMPORTANCE: {"pilot": pilot, "runs": runs},
        RareWay.SPLITTING: {"particles": particles, "steps": steps},
    }
    for method, options in given.items():
        if method is not rare_way and (name := next((key for key, count in options.items() if count), "")):
            raise StatisticsError.of_option(f"--{name}", f"--by {method} with it", f"--by {rare_way}")
    chosen = {name: count for name, count in given[rare_way].items() if count is not None}
    if rare_way is RareWay.IMPORTANCE:
        how: Importance | Splitting = Importance(**chosen, replications=replications)
    else:
        how = Splitting(**{"particles": 200, "steps": 5} | chosen, replications=replications)
    rates, unlike, watch = [], False, AvoiderWatch()
    with TERMINAL.messages() as show:
        for rate in estimated(read, how, lambda done: show(f"{done:,} draws of a claim in a stratum"), watch):
            rates.append(rate)
            result(rare_line(rate))
            target = rate.claim.target
            unlike |= bool(rate.estimate.no_estimate) or (target is not None and rate.low > target)
            document(
                estimates=[
                    {"stratum": each.stratum, "claim": each.claim.sentence, "target": each.claim.target}
                    | {key: getattr(each, key) for key in ("share", "low", "high", "admitted", "estimate")}
                    for each in rates
                ],
                confidence=read.confidence,
            )
    remarks = list(watch.remarks(read))
    rests_on = basis([str(read.world)], "every draw counts, whether it exercised the claim or not")
    result(*remarks, *watch.time_lines, rests_on)
    document(remarks=remarks, slow_answers=watch.time_lines, basis=rests_on)
    return DIFFERS if unlike or remarks else AS_EXPECTED


@_command()
def merge(
    into: Annotated[Path, Argument(help="The new ledger, which must not exist yet.", metavar="INTO")],
    ledgers: Annotated[
        list[Path], Argument(help="The ledgers of the parts of one plan.", metavar="LEDGER...")
    ],
) -> int:
    """Merge the ledgers of several machines into one ledger.

    Each machine ran a part of the same plan. If an episode is in two ledgers,
    its results must agree to the last bit.

    Exit code 0: the ledger is written.
    Exit code 2: the ledgers have different plans or disagree, or the new ledger
    already exists.
    """
    from safety_harness.extensions.assurance.campaign.ledger import Ledger
    from safety_harness.extensions.assurance.campaign.merging import merge as merge_ledgers

    result(f"{into}: {merge_ledgers(into, ledgers)} episodes")
    with Ledger.open(into, check=False) as whole:
        _say_ledger(whole)
    return AS_EXPECTED
