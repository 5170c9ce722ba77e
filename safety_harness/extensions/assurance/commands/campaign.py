"""``safety-harness campaign``: run a declared plan into a ledger, and ask the ledger."""

from __future__ import annotations

from enum import StrEnum
from functools import partial
from pathlib import Path
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
    Option(help="Run on a Dask cluster: tcp://SCHEDULER:PORT or a scheduler file.", metavar="ADDRESS|FILE"),
]
_Part = Annotated[str, Option(help="Only the K-th of N parts, for 'merge'.", metavar="K/N")]
_ABOUT = "Run a declared plan, hundreds or millions of episodes, into a ledger that loses nothing."


class RareWay(StrEnum):
    """How rare violations are counted."""

    IMPORTANCE = "importance"
    SPLITTING = "splitting"


commands = Typer(name="campaign", no_args_is_help=True, help=_ABOUT, short_help=_ABOUT)
_command = partial(
    command, commands, interrupted="interrupted; what was committed is in the ledger", failed=DIFFERS
)

_unwritten = partial(command, commands, interrupted="interrupted; nothing is written", failed=DIFFERS)


@_command()
def run(
    plan: Annotated[Path, Argument(help="A plan: a file, or shipped:NAME.", metavar="PLAN")],
    ledger: Annotated[
        Path | None,
        Option(
            "--out", "--ledger", help="Folder of the ledger, or the ledger itself (.sqlite): reports/PLAN."
        ),
    ] = None,
    workers: Workers = None,
    cluster: _Cluster = None,
    part: _Part = "1/1",
    controller: OfController = None,
    require_shown: Annotated[
        bool, Option("--require-shown", help="Fail unless every target of the plan is shown.")
    ] = False,
) -> int:
    """Run a plan's episodes in many processes, or what is left of them if the ledger is there already.

    Beside the ledger a page, .html, says how it stands; none is added to a finished report.
    Ctrl-C keeps every finished episode, and so does whatever kills the program or the machine.
    Exit code 0: complete, or this part is; 1: complete, but episodes failed to run, none put a claim to the
    test, the avoider did not always answer and the plan claims nothing of that, or answered otherwise when
    asked again, no worker is left, or, with --require-shown, a target is not shown; 2: bad input, another
    plan's ledger, or a disk that takes no more; 130: interrupted.
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
    path = path if path.suffix or path.is_file() else path / LEDGER
    return _carry_on(read, path, workers, cluster, part, require_shown)


@_unwritten("pilot")
def pilot_runs(
    plan: Annotated[Path, Argument(help="A plan: a file, or shipped:NAME.", metavar="PLAN")],
    runs: Annotated[int, Option(help="Of each stratum; with another seed than the plan's.", min=1)] = 30,
    workers: Workers = None,
    controller: OfController = None,
) -> int:
    """Say from a few runs how many of a plan's will test each claim, how many it takes, and how long.

    Nothing is written, and no declared run is looked at. So many runs are needed for the bounds to show the
    target with a chance of 90 %, if shares are as in the pilot; intervals hold with 95 % confidence alone.
    Exit code 0: the planned runs are enough, as far as the pilot tells; 1: for some claim they are not, a run
    failed, or the avoider did not always answer, or answered otherwise when asked again; 2: bad input; 130:
    interrupted.
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
        found = pilot(read, runs, lambda done: show(done, "pilot"))
    cores = workers or len(os.sched_getaffinity(0))
    seconds = found.seconds(read, cores)
    document(**plain(found), seconds=seconds, workers=cores, enough=found.enough)
    result(*(f"{'ok  ' if one.enough else 'WARN'} {one.line}" for one in found.forecasts))
    result(*(f"WARN a run failed: {one}" for one in found.failures))
    result(*(f"WARN {one}" for one in found.remarks), *found.slow_answers)
    result(basis([str(read.world)], ((one.tested, one.tried) for one in found.forecasts)))
    result(
        f"{read.runs} runs: about {time_words(seconds)} with {cores} processes on this machine, alone on it"
    )
    return AS_EXPECTED if found.enough else DIFFERS


@_command()
def resume(
    ledger: _LedgerFile, workers: Workers = None, cluster: _Cluster = None, part: _Part = "1/1"
) -> int:
    """Go on where a campaign was left, with the results that it would have had undisturbed.

    A plan, file or version that has changed since is named, and nothing is run.
    Exit codes as for run.
    """
    from safety_harness.extensions.assurance.campaign.ledger import Ledger
    from safety_harness.extensions.assurance.campaign.session import plan_of

    with Ledger.open(ledger) as opened, plan_of(opened) as plan:
        return _carry_on(plan, ledger, workers, cluster, part)


def _carry_on(
    plan: Plan, path: Path, workers: int | None, cluster: str | None, part: str, require_shown: bool = False
) -> int:
    from safety_harness.base.interrupts import one_more_ctrl_c
    from safety_harness.claims.properties.answered import is_claimed
    from safety_harness.cli.progress import TERMINAL
    from safety_harness.extensions.assurance.campaign.ledger import Ledger
    from safety_harness.extensions.assurance.campaign.session import carry_on, processes
    from safety_harness.extensions.assurance.campaign.summary import fallback_of
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
    remark = "what is under way is finished and kept; Ctrl-C again drops it"
    with one_more_ctrl_c(say, remark) as interrupted, watching_campaign(plan, TERMINAL) as show:
        carry_on(plan, path, make_crew, on_progress=show, enough=interrupted, part=numbers, say=say)
        stopped = interrupted()
    result(*tested_lines(plan))
    with Ledger.open(path, check=False) as ledger:
        finished = kind_of(path.parent) is FileKind.REPORT  # whose files are those of its manifest
        state, drawn = _say_ledger(ledger), True
        try:
            if not finished:
                _write_page(ledger, state, path.with_suffix(".html"))
        except SafetyHarnessError:
            raise
        except Exception as error:  # no reason to keep silent about the runs
            say(f"error: the page cannot be made: {described(error)}; the ledger has all runs")
            drawn = False
        tally, targets = state.tally, {claim.sentence: claim.target for claim in plan.claims}
        asked = [(one, target) for one in state.bounds if (target := targets[one.claim]) is not None]
        unshown = require_shown and not (asked and all(one.shows(target) for one, target in asked))
        unlike = bool(ledger.repeated.problem or ledger.dependent)
        unanswered = fallback_of(ledger).unanswered and not is_claimed(claim.claim for claim in plan.claims)
    if stopped and not tally.complete:
        say(f"interrupted; go on: safety-harness campaign resume {path}")
        return INTERRUPTED
    if unshown:
        say("not every target of the plan is shown, as --require-shown asks")
    claims = [tally.of_claim(number).counts for number in range(len(plan.claims))]
    unknown = any(one[EpisodeOutcome.UNTESTED] == sum(one.values()) for one in claims)
    failed = tally.failed or not drawn
    return DIFFERS if failed or unanswered or unlike or unknown or unshown else AS_EXPECTED


def _say_ledger(ledger: Ledger, page: Path | None = None) -> LedgerState:
    """How it stands, in lines or as JSON, and as a page."""
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
    """K/N as (K - 1, N)."""
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
    html: Annotated[Path | None, Option(help="Also as a page, in this file.", metavar="FILE")] = None,
) -> int:
    """Say how a campaign stands, also while it runs; once it is complete, with its bounds.

    Exit code 0; 2: no ledger that can be read, or the page cannot be written.
    """
    from safety_harness.extensions.assurance.campaign.ledger import Ledger
    from safety_harness.extensions.assurance.campaign.session import copied_plan_of
    from safety_harness.extensions.assurance.commands.campaign_lines import tested_lines

    with Ledger.open(ledger, check=False) as opened:
        try:
            with copied_plan_of(opened) as plan:
                result(*tested_lines(plan))
        except InputError as error:
            say(f"what was tested cannot be said: {error}")
        _say_ledger(opened, html)
    return AS_EXPECTED


def _write_page(ledger: Ledger, state: LedgerState, path: Path) -> None:
    import shlex
    from datetime import UTC, datetime

    from safety_harness.base.whole_file import writing
    from safety_harness.extensions.assurance.pages.campaign_page import write_page
    from safety_harness.scenario.files import told

    words = ["safety-harness", "campaign", "status", str(told(ledger.path)), "--html", str(told(path))]
    with writing(path):
        write_page(path, ledger, state, command=shlex.join(words), generated_at=datetime.now(UTC))
    say(f"page: {path}")
    document(page=path)


@_command()
def query(
    ledger: _LedgerFile,
    sql: Annotated[
        str | None, Argument(help="A question in SQL, of the views results and episodes.", metavar="SQL")
    ] = None,
    claim: Annotated[str | None, Option(help="Only of this claim, or of the one with these words.")] = None,
    stratum: Annotated[str | None, Option(help="Only of this stratum.")] = None,
    outcome: Annotated[str | None, Option(help="holds, violated, untested, inconclusive or failed.")] = None,
    below: Annotated[
        str | None, Option(help="Only margins below this, with its unit, such as '10 mm'.")
    ] = None,
) -> int:
    """Print results as CSV, the worst margins first; or ask in SQL, which can only read.

    Of what the gate overruled the view episodes has the columns proposals, overruled, overruled_replaced,
    overruled_stopped and one for each reason, such as overruled_uncertain.
    Exit code 0; 2: a question that cannot be answered.
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
    out: Annotated[Path | None, Argument(help="A .csv or .parquet file.", metavar="OUT")] = None,
    traces: Annotated[
        Path | None, Option(help="Also the stored traces, as files that replay takes, to this folder.")
    ] = None,
) -> int:
    """Write one line for each episode and claim, for other programs (Parquet: the extra "export").

    Exit code 0; 2: bad input, or it cannot be written.
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
    first: Annotated[Path, Argument(help="The ledger before; with --against, that after.", metavar="A")],
    second: Annotated[Path | None, Argument(help="The ledger after.", metavar="[B]")] = None,
    against: OfReference = None,
    controller: OfController = None,
    workers: Workers = None,
) -> int:
    """Say what got worse from A to B, two campaigns over the same episodes with different avoiders.

    With --against (an avoider) or --controller in place of B the plan of A is run with that first, beside the
    ledger, or what is left of it; then it says what is worse in A.
    For each claim and stratum the difference in the chance of a violation with exact bounds, paired by
    episode; how much more the gate overruled; then the episodes that only B violates, the largest loss of
    margin first; last margins that B lost though both hold, and in one sentence the episodes that only one of
    them violates any claim in.
    Exit code 0; 1: B is shown to be worse somewhere; 2: campaigns that cannot be compared; of a run that did
    not end well, its own.
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
            plan = plan_against(mine, reference)
            if plan.identity.systems == mine.declared.identity.systems:
                got = f"{reference}, which {first} is of by its hash: a comparison with itself finds nothing"
                raise ScenarioError.of_option(option_of(reference), "another system", got)
        first, second = plan.file.parent / LEDGER, first
        code = _carry_on(plan, first, workers, None, "1/1")
        if code != AS_EXPECTED:
            return code
    assert second is not None
    with Ledger.open(first) as before, Ledger.open(second) as after:
        for ledger in (before, after):
            if words := fallback_of(ledger).words:
                result(f"{ledger.path}: {words}")
        refuse_itself(before, after)
        refuse_incomparable(before, after)
        undecided = [
            f"not comparable: {ledger.path} has no run of which it is known whether it violates {claim}, "
            f"in {stratum}"
            for ledger in (before, after)
            for stratum, claim in without_a_decided_run(ledger)
        ]
        if undecided:
            document(before=before.path, after=after.path, not_comparable=undecided)
            result(*undecided)
            return DIFFERS
        bases = [f"{one.path}: {basis_in(one, tally_of(one))}" for one in (before, after)]
        compared, overruled = compare_ledgers(before, after), compare_overruling(before, after)
        worse, lost = worse_episodes(before, after), list(against_lines(before, after))
        document(
            before=before.path,
            after=after.path,
            differences=compared,
            overruling=[
                {key: getattr(one, key) for key in ("stratum", "episodes")}
                | {"before": one.before.named, "after": one.after.named}
                for one in overruled
            ],
            worse_episodes=[
                {key: getattr(one, key) for key in ("stratum", "episode", "claim")}
                | {"before_margin_si": one.before, "after_margin_si": one.after, "unit": SI_UNITS[one.unit]}
                for one in worse
            ],
            remarks=lost,
            basis=bases,
        )
        result(*difference_lines(compared, before.declared.confidence))
        result(*(one.words for one in overruled if one.before.proposals or one.after.proposals))
        for found in worse:
            was, now = (found.unit.margin_text(margin) for margin in (found.before, found.after))
            result(f"  worse: {found.stratum}, episode {found.episode}: {found.claim}: {was} -> {now}")
        result(*lost, *bases)
    return DIFFERS if any(one.low > 0.0 for one in compared) else AS_EXPECTED


@_command()
def attribute(
    ledger: _LedgerFile,
    most: Annotated[int, Option(help="Violations of each claim: the first so many.", min=1)] = 100,
    out: AttributionOut = None,
    confirm: Confirm = False,
    execute_programs: Executes = False,
) -> int:
    """Say whose fault the violations of a campaign are: its episodes run again, as attribute does.

    An episode is drawn again from its seed, so that no trace need be stored.  How many of how many violations
    are attributed is said first.
    Exit code 0: every one has an answer, or there is none; 1: one is not attributed; 2: bad input; 130:
    interrupted.
    """
    from safety_harness.extensions.assurance.commands.campaign_attribute import attribute_ledger

    return attribute_ledger(ledger, most, execute_programs, out, confirm)


@_unwritten("rare")
def rare_violations(
    plan: Annotated[Path, Argument(help="A plan: a file, or shipped:NAME.", metavar="PLAN")],
    by: Annotated[RareWay, Option(help="Draws from where violations are, or the way there in steps.")] = (
        RareWay.IMPORTANCE
    ),
    pilot: Annotated[
        int | None, Option(help="Of importance: draws of each step to where violations are: 500.", min=10)
    ] = None,
    runs: Annotated[int | None, Option(help="Of importance: draws after the pilot: 5000.", min=100)] = None,
    particles: Annotated[int | None, Option(help="Of splitting: runs on each level: 200.", min=10)] = None,
    steps: Annotated[int | None, Option(help="Of splitting: moves of each on a level: 5.", min=1)] = None,
    replications: Annotated[int, Option(help="Independent repetitions.", min=3)] = 20,
) -> int:
    """Estimate how often rare violations come, by importance sampling or splitting: below one in a hundred.

    The estimate is the share of all runs of a stratum, also those that do not test the claim, with its lower
    end. No search can see a region that it did not reach, so the upper end comes from the plain draws alone:
    it is exact and wide. Importance sampling takes the fewest runs, and states no estimate where it cannot be
    trusted; splitting then takes more. Nothing is written. Exit code 0; 1: for some claim there is no
    estimate, or its target is exceeded, or the avoider did not always answer, or answered otherwise when
    asked again; 2: bad input, or a run that says nothing; 130: interrupted.
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
    for way, options in given.items():
        if way is not by and (name := next((key for key, count in options.items() if count), "")):
            raise StatisticsError.of_option(f"--{name}", f"--by {way} with it", f"--by {by}")
    said = {name: count for name, count in given[by].items() if count is not None}
    if by is RareWay.IMPORTANCE:
        how: Importance | Splitting = Importance(**said, replications=replications)
    else:
        how = Splitting(**{"particles": 200, "steps": 5} | said, replications=replications)
    found, unlike, watch = [], False, AvoiderWatch()
    with TERMINAL.words() as show:
        for one in estimated(read, how, lambda done: show(f"{done:,} draws of a claim in a stratum"), watch):
            found.append(one)
            result(rare_line(one))
            target = one.claim.target
            unlike |= bool(one.estimate.no_estimate) or (target is not None and one.low > target)
            document(
                estimates=[
                    {"stratum": each.stratum, "claim": each.claim.sentence, "target": each.claim.target}
                    | {key: getattr(each, key) for key in ("share", "low", "high", "admitted", "estimate")}
                    for each in found
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
    into: Annotated[Path, Argument(help="The ledger to make.", metavar="INTO")],
    ledgers: Annotated[list[Path], Argument(help="Ledgers of parts of one plan.", metavar="LEDGER...")],
) -> int:
    """Make one ledger of those of several machines, each of which ran a part of the same plan.

    What two of them have must agree to the last bit.
    Exit code 0; 2: ledgers of different plans, or that disagree.
    """
    from safety_harness.extensions.assurance.campaign.ledger import Ledger
    from safety_harness.extensions.assurance.campaign.merging import merge as merge_ledgers

    result(f"{into}: {merge_ledgers(into, ledgers)} episodes")
    with Ledger.open(into, check=False) as whole:
        _say_ledger(whole)
    return AS_EXPECTED
