"""Check that a report is sound.

The check covers the files, plan, ledger, stored traces, numbers and pages. It also repeats some runs. Each
examination states the subject of the check and the differences that it found. A later change of the software
is not a fault, but the examination reports it. A change of verdicts is a fault. ``verify`` runs a program in
a report only with permission.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from safety_harness.base.exceptions import InputError, OutputError, Place
from safety_harness.cell.simulation.worlds import named_by_user
from safety_harness.extensions.assurance.campaign.identity import edition_of, unpacked
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import Plan, read_plan
from safety_harness.extensions.assurance.campaign.session import LEDGER
from safety_harness.extensions.assurance.certification.altered import turns_of
from safety_harness.extensions.assurance.certification.evidence import read_evidence
from safety_harness.extensions.assurance.certification.findings import undeclared
from safety_harness.extensions.assurance.certification.folder import JSON, put_back_opened, read_manifest
from safety_harness.extensions.assurance.certification.lodged import (
    L,
    declaration_of,
    read_declaration,
    read_seal,
    seal_of,
)
from safety_harness.extensions.assurance.certification.verify_files import (
    Examination,
    ReportFolder,
    check_files,
    check_plan,
    check_rows,
    few,
)
from safety_harness.extensions.assurance.certification.verify_report import (
    check_numbers,
    check_pages,
    check_proof,
)
from safety_harness.extensions.assurance.certification.verify_runs import (
    Drawing,
    check_runs,
    check_searched,
    check_traces,
    programs_in,
)

NO_SEAL = (
    "a lodged seal is missing (--seal): a careful forger may have altered rows and renewed all hashes, which "
    "only stored traces and repeated runs reveal. Only the report states its times, machine and command. "
    "It alone has the work of the search, the answers of the avoider to repeated questions, and the tables "
    "of other commands"
)
NOT_DECLARED = (
    "a lodged declaration is missing (--declared): it would prove that plan, seed and targets came first"
)
_HASH = re.compile(r"[0-9a-f]{64}")


def lodged_hash(text: str | None, field: str) -> str | Path | None:
    """Return the lodged hash in ``text``, or the path of the file that contains it.

    Return None if ``text`` is None.

    Raises:
        InputError: ``text`` is neither a hash nor a file. The error states the option ``field``.

    """
    if text is None or _HASH.fullmatch(text.strip().lower()):
        return text and text.strip().lower()
    if Path(text).is_file():
        return Path(text)
    raise InputError(
        place=Place(field=field), expected="a hash of 64 hexadecimal digits, or its file", got=repr(text)[:80]
    )


def check_lodged(
    report: ReportFolder, *, seal: str | Path | None, declared: str | Path | None
) -> Examination:
    """Compare a report with its lodged seal and declaration.

    If a seal or declaration is missing, the result has an unchecked point.

    Args:
        report: The report.
        seal: The lodged seal or its hash, or None if no seal was lodged.
        declared: The lodged declaration or its hash, or None if no declaration was lodged.

    """
    faults, notes, unchecked = [], [], []
    if seal is None:
        unchecked.append(NO_SEAL)
    else:
        faults += _differs(seal, seal_of(report.folder, report.ledger), read_seal, "seal")
        notes.append("the report is unaltered since its seal")
    if declared is None:
        unchecked.append(NOT_DECLARED)
    else:
        now = declaration_of(report.plan, report.ledger.declared.identity)
        faults += _differs(declared, now, read_declaration, "declaration")
        notes.append(
            "plan, seed, avoider, targets and software are the declared ones; its runs began on "
            f"{report.recorded.provenance.began_at}: the declaration must have been lodged before"
        )
        if uncovered := undeclared(report.ledger):
            unchecked.append(uncovered)
    root = report.recorded.record.rows_sha256
    text = f"the root over all rows, {root[:16]}, and the hashes that were lodged elsewhere"
    return Examination("lodged", text, few(faults), () if faults else tuple(notes), tuple(unchecked))


def _differs(lodged: str | Path, now: L, read: Callable[[Path], L], kind: str) -> list[str]:
    """Return the differences between ``now`` and a lodged hash or file.

    Only a lodged file shows which part differs.
    """
    if isinstance(lodged, Path):
        return list(read(lodged).changes(now))
    return [] if lodged == now.sha256 else [f"the {kind} of this report is {now.sha256}, not the lodged hash"]


MISS = 0.01  # the default of --miss


def verify(
    folder: Path,
    *,
    runs: int | None = None,
    miss: float = MISS,
    seed: int = 0,
    execute_programs: bool = False,
    seal: str | None = None,
    declared: str | None = None,
    on_progress: Callable[[str], None] = lambda text: None,
) -> Iterator[Examination]:
    """Check a report in several examinations.

    If a file cannot be read, the report has a fault and the check ends.

    Args:
        folder: The report's folder.
        runs: The number of runs to repeat. The default is the number that ``miss`` requires, but at most
            ``MOST_AGAIN``.
        miss: The accepted probability that the repeated runs miss all altered rows, if these rows change a
            verdict.
        seed: The seed from which the runs to repeat are drawn.
        execute_programs: Whether programs in the report may be executed.
        seal: The hash or the file of the lodged seal, or None if no seal was lodged.
        declared: The hash or the file of the lodged declaration, or None if no declaration was lodged.
        on_progress: A callback, which receives a text before each step.

    Yields:
        The examinations in the order of the checks.

    Raises:
        InputError: The folder is no report, or the report has a program and ``execute_programs`` is false.

    """
    sealed, lodged_declaration = lodged_hash(seal, "--seal"), lodged_hash(declared, "--declared")
    hashes = read_manifest(folder)
    on_progress("files")
    yield check_files(folder, hashes)
    with ExitStack() as stack:
        try:
            recorded = read_evidence(folder / JSON)
            ledger = stack.enter_context(Ledger.open(folder / LEDGER, alone=True))
            rows = check_rows(ledger)
            unpacking = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="safety-harness-")))
            plan = (
                read_plan(unpacked(ledger.files, unpacking), edition_of(ledger.declared.identity))
                if rows.stands
                else None
            )
        except OutputError:
            raise
        except InputError as error:
            yield Examination(
                "ledger", "the evidence, the ledger and its plan", (str(error),), unchecked=(_REST,)
            )
            return
        yield rows if plan else replace(rows, unchecked=(_REST,))
        if plan is None:
            return
        # Refuse before any step that could execute a stranger's program.
        _refuse_to_execute(plan, runs, execute_programs)
        if execute_programs and runs != 0:
            named_by_user(plan.world)
            put_back_opened(folder, plan.file, unpacking, ledger)
        own = check_plan(folder, plan, ledger)
        yield own
        if not own.stands:
            yield Examination("rest", "no content that follows from the plan", unchecked=(_REST,))
            return
        report = ReportFolder(folder, hashes, recorded, plan, ledger)
        drawing = Drawing(runs=runs, miss=miss, seed=seed, programs=execute_programs, on_progress=on_progress)
        try:
            yield from _of_the_plan(report, drawing)
            yield check_lodged(report, seal=sealed, declared=lodged_declaration)
        except OutputError:
            raise
        except InputError as error:
            yield Examination("rest", "the rest of the report", (str(error),), unchecked=(_REST,))


def _of_the_plan(report: ReportFolder, drawing: Drawing) -> Iterator[Examination]:
    """Yield the examinations of a report.

    The report must have the declared plan and rows of its runs.
    """
    plan, ledger, same = report.plan, report.ledger, report.same
    drawing.on_progress("stored traces, judged with the present code")
    stored = check_traces(plan, ledger, same=same)
    yield stored
    drawing.on_progress("the report from the ledger")
    # These reruns use the stored traces, which must therefore stand.
    again = drawing.runs != 0 and stored.stands
    if (proof := check_proof(report)) is not None:
        yield proof
    numbers, gathered = check_numbers(report, again=again)
    yield numbers
    if numbers.stands:
        drawing.on_progress("the page")
        yield check_pages(report, gathered)
    if again and any(not example.shown.independent for example in gathered.examples):
        drawing.on_progress("counterexamples of the search")
        yield check_searched(gathered, same=same and not programs_in(plan), programs=drawing.programs)
    turns = turns_of(gathered.evidence.claims, early=plan.stop_early)
    drawing.on_progress("runs again")
    yield check_runs(plan, ledger, turns, drawing, same=same)


_REST = "the rest, which cannot be checked without it"


def _refuse_to_execute(plan: Plan, runs: int | None, execute_programs: bool) -> None:
    """Raise InputError if a repeated run would execute a program from the report without permission.

    The program may come from a stranger.
    """
    programs = programs_in(plan)
    if programs and runs != 0 and not execute_programs:
        raise InputError(
            place=Place(
                file=Path(plan.file.name), field="world" if programs[0] == plan.world.label else "avoider"
            ),
            expected="--execute-programs, since repeated runs execute the program in the report",
            got=programs[0],
            hint="or --runs 0, which repeats no run",
        )
