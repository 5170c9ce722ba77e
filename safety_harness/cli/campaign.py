"""``safety-harness campaign``: run a declared plan into a ledger, and ask the ledger."""

from __future__ import annotations

import csv
import io
import sqlite3
from collections.abc import Callable, Sequence
from pathlib import Path

from safety_harness.campaign.asking import question_of, refuse_writing
from safety_harness.campaign.comparing import compare_ledgers, worse_episodes
from safety_harness.campaign.exporting import export as export_table
from safety_harness.campaign.exporting import export_traces
from safety_harness.campaign.ledger import Ledger
from safety_harness.campaign.merging import merge as merge_ledgers
from safety_harness.campaign.plan import Plan, read_plan
from safety_harness.campaign.session import LEDGER, MakesCrew, carry_on, plan_of, processes
from safety_harness.campaign.summary import fallback_of, fingerprint_of, tally_of
from safety_harness.cli.campaign_lines import (
    CampaignProgress,
    bound_lines,
    claim_lines,
    difference_lines,
    failure_lines,
    fallback_lines,
    summary,
)
from safety_harness.cli.console import (
    AS_EXPECTED,
    BAD_INPUT,
    DIFFERS,
    INTERRUPTED,
    explain,
    one_more_ctrl_c,
    result,
    say,
    say_shared_modules,
)
from safety_harness.exceptions import InputError, LedgerError, Place, SafetyHarnessError, ScenarioError
from safety_harness.properties.answered import is_claimed


def run(
    file: Path,
    *,
    ledger: Path | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    part: str = "1/1",
) -> int:
    """Run a plan, or what is left of it; returns the exit code."""

    def begin() -> int:
        plan = read_plan(file)
        path = ledger or Path("reports") / plan.name / LEDGER
        return _carry_on(plan, path, _crew(workers, cluster), _part(part, plan))

    return _explained(begin)


def resume(path: Path, *, workers: int | None = None, cluster: str | None = None, part: str = "1/1") -> int:
    """Go on with the plan of a ledger; returns the exit code."""

    def go_on() -> int:
        with Ledger.open(path) as ledger, plan_of(ledger) as plan:
            return _carry_on(plan, path, _crew(workers, cluster), _part(part, plan))

    return _explained(go_on)


def status(path: Path) -> int:
    """How a campaign stands; also while it runs."""

    def tell() -> int:
        with Ledger.open(path, check=False) as ledger:
            _tell(ledger)
        return AS_EXPECTED

    return _explained(tell)


def query(
    path: Path,
    sql: str | None = None,
    *,
    claim: str | None = None,
    stratum: str | None = None,
    outcome: str | None = None,
    below: str | None = None,
) -> int:
    """Rows as CSV to standard output: of a question in SQL, or of results that filters let through."""

    def ask() -> int:
        with Ledger.open(path, check=False) as ledger:
            if sql is None:
                question, values = question_of(ledger, claim, stratum, outcome, below)
            else:
                question, values = sql, ()
            connection = ledger.connection
            refuse_writing(connection)
            try:
                rows = connection.execute(question, values)
                if rows.description is None:
                    raise sqlite3.ProgrammingError("no question")
                result(_csv_line([column for column, *_ in rows.description]))
                for row in rows:
                    result(_csv_line(row))
            except (sqlite3.Error, sqlite3.Warning) as error:
                got = f"{question!r}: {error}"
                raise LedgerError(place=Place(file=path), expected="a question in SQL", got=got) from error
        return AS_EXPECTED

    return _explained(ask)


def export(path: Path, out: Path | None, traces: Path | None) -> int:
    """A table for other programs, the stored traces, or both."""

    def write() -> int:
        if out is None and traces is None:
            raise ScenarioError(
                place=Place(field="export"), expected="OUT, --traces FOLDER or both", got="none"
            )
        with Ledger.open(path) as ledger:
            if out is not None:
                result(f"{out}: {export_table(ledger, out)} lines")
            if traces is not None:
                result(f"{traces}: {len(export_traces(ledger, traces))} traces")
        return AS_EXPECTED

    return _explained(write)


def compare(first: Path, second: Path) -> int:
    """What got worse from the first campaign to the second, paired by episode."""

    def tell() -> int:
        with Ledger.open(first) as before, Ledger.open(second) as after:
            for one_of in (before, after):
                if words := fallback_of(one_of).words:
                    result(f"{one_of.path}: {words}")
            compared = compare_ledgers(before, after)
            for line in difference_lines(compared, before.declared.confidence):
                result(line)
            for found in worse_episodes(before, after):
                was, now = (found.unit.margin_text(margin) for margin in (found.before, found.after))
                result(f"  worse: {found.stratum}, episode {found.episode}: {found.claim}: {was} -> {now}")
        return DIFFERS if any(one.low > 0.0 for one in compared) else AS_EXPECTED

    return _explained(tell)


def merge(into: Path, ledgers: Sequence[Path]) -> int:
    """One ledger of those of the parts of a plan."""

    def join() -> int:
        result(f"{into}: {merge_ledgers(into, ledgers)} episodes")
        with Ledger.open(into, check=False) as whole:
            _tell(whole)
        return AS_EXPECTED

    return _explained(join)


def _carry_on(plan: Plan, path: Path, make_crew: MakesCrew, part: tuple[int, int]) -> int:
    say_shared_modules()
    progress = CampaignProgress(plan)
    remark = "what is under way is finished and kept; Ctrl-C again drops it"
    with one_more_ctrl_c(remark) as interrupted, progress.running():
        carry_on(plan, path, make_crew, on_progress=progress.show, enough=interrupted, part=part)
        stopped = interrupted()
    with Ledger.open(path, check=False) as ledger:
        tally = tally_of(ledger)
        _tell(ledger)
        unanswered = fallback_of(ledger).unanswered and not is_claimed(claim.claim for claim in plan.claims)
    if stopped and not tally.complete:
        say(f"interrupted; go on: safety-harness campaign resume {path}")
        return INTERRUPTED
    return DIFFERS if tally.failed or unanswered else AS_EXPECTED


def _tell(ledger: Ledger) -> None:
    tally = tally_of(ledger)
    result(f"{ledger.path}: {ledger.declared.title}")
    result(summary(ledger.declared, tally))
    for line in failure_lines(ledger) + fallback_lines(ledger) + claim_lines(ledger.declared, tally):
        result(line)
    if tally.complete:
        for line in bound_lines(ledger):
            result(line)
        result(f"fingerprint of the results: {fingerprint_of(ledger)}")


def _crew(workers: int | None, cluster: str | None) -> MakesCrew:
    if cluster is None:
        return processes(workers)
    from safety_harness.campaign.cluster import DaskCrew

    return lambda plan: DaskCrew(plan, cluster)


def _part(text: str, plan: Plan) -> tuple[int, int]:
    """K/N as (K - 1, N)."""
    k, _, n = text.partition("/")
    right = k.isascii() and k.isdigit() and n.isascii() and n.isdigit() and len(text) < 12
    if not right or not 1 <= int(k) <= int(n):
        raise ScenarioError(place=Place(field="--part"), expected="K/N, such as 2/4", got=text)
    if int(n) > 1 and plan.stop_early:
        raise ScenarioError(
            place=Place(field="--part"), expected="a plan of fixed length", got="one that may stop early"
        )
    return int(k) - 1, int(n)


def _csv_line(values: Sequence[object]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="").writerow("" if value is None else value for value in values)
    return text.getvalue()


def _explained(work: Callable[[], int]) -> int:
    try:
        return work()
    except InputError as error:
        explain(error)
        return BAD_INPUT
    except SafetyHarnessError as error:
        explain(error)
        return DIFFERS
    except KeyboardInterrupt:
        say("interrupted; what was committed is in the ledger")
        return INTERRUPTED
