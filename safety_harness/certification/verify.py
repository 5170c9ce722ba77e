"""Does a report stand?  Files, plan, ledger, stored traces, numbers, pages, and runs made again.

Each question is answered with what was looked at and what is otherwise.  A change of the software since is
named and is no fault by itself: what it changes in verdicts is.  Nothing in a report is executed unasked.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from safety_harness.campaign.files import unpacked
from safety_harness.campaign.ledger import Ledger
from safety_harness.campaign.plan import Plan, read_plan
from safety_harness.campaign.session import LEDGER
from safety_harness.certification.check import Check
from safety_harness.certification.document import read_evidence
from safety_harness.certification.evidence import Evidence
from safety_harness.certification.folder import JSON, read_manifest
from safety_harness.certification.verify_files import check_files, check_plan, check_rows, same_software
from safety_harness.certification.verify_report import check_numbers, check_pages
from safety_harness.certification.verify_runs import check_runs, check_traces, programs_in
from safety_harness.exceptions import InputError, OutputError, Place

SAMPLE = 20


def verify(
    folder: Path,
    *,
    runs: int = SAMPLE,
    seed: int = 0,
    execute_avoider: bool = False,
    on_progress: Callable[[str], None] = lambda words: None,
) -> Iterator[Check]:
    """Check by check; InputError for what is no report, or whose avoider may not be executed.

    ``runs`` episodes are made again, drawn at random with ``seed``.  A file of a report that cannot be read
    is a fault of the report, and ends what can be checked.
    """
    hashes = read_manifest(folder)
    on_progress("files")
    yield check_files(folder, hashes)
    with ExitStack() as stack:
        try:
            recorded = read_evidence(folder / JSON)
            ledger = stack.enter_context(Ledger.open(folder / LEDGER, alone=True))
            rows = check_rows(ledger)
            unpacking = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="safety-harness-")))
            plan = read_plan(unpacked(ledger.files, unpacking)) if rows.stands else None
        except OutputError:
            raise
        except InputError as error:
            yield Check("ledger", "the evidence, the ledger and its plan", (str(error),), unchecked=(_REST,))
            return
        yield rows if plan else Check(rows.name, rows.looked_at, rows.faults, unchecked=(_REST,))
        if plan is None:
            return
        _refuse_to_execute(plan, runs, execute_avoider)
        declared = check_plan(folder, plan, ledger)
        yield declared
        if not declared.stands:
            yield Check("rest", "nothing that follows from the plan", unchecked=(_REST,))
            return
        asked = Asked(runs, seed, execute_avoider, on_progress)
        try:
            yield from _of_the_plan(plan, ledger, folder, recorded, hashes, asked)
        except OutputError:
            raise
        except InputError as error:
            yield Check("rest", "the rest of the report", (str(error),), unchecked=(_REST,))


@dataclass(frozen=True)
class Asked:
    """How many runs are made again, drawn with which seed, also programs; who is told of the progress."""

    runs: int
    seed: int
    programs: bool
    on_progress: Callable[[str], None]


def _of_the_plan(
    plan: Plan, ledger: Ledger, folder: Path, recorded: Evidence, hashes: dict[str, str], asked: Asked
) -> Iterator[Check]:
    """What follows from a plan that is the declared one, and a ledger whose rows are of its runs."""
    same = same_software(plan, ledger)
    programs = bool(programs_in(plan))
    asked.on_progress("stored traces, judged with the present code")
    stored = check_traces(plan, ledger, same=same)
    yield stored
    asked.on_progress("the report from the ledger")
    again = asked.runs > 0 and stored.stands
    numbers, gathered = check_numbers(plan, ledger, folder, recorded, hashes, same=same, again=again)
    yield numbers
    if numbers.stands:
        asked.on_progress("the page")
        yield check_pages(folder, recorded, gathered, same=same)
    asked.on_progress(f"{asked.runs} runs again")
    yield check_runs(
        plan, ledger, asked.runs, asked.seed, same=same and not programs, programs=asked.programs
    )


_REST = "the rest, which cannot be checked without it"


def _refuse_to_execute(plan: Plan, runs: int, execute_avoider: bool) -> None:
    """A report may come from anybody: a program in it is executed only when the user says so."""
    programs = programs_in(plan)
    if programs and runs > 0 and not execute_avoider:
        raise InputError(
            place=Place(file=plan.file, field="avoider"),
            expected="--execute-avoider, since making runs again executes the program in the report",
            got=programs[0],
            hint="or --runs 0, which makes none again",
        )
