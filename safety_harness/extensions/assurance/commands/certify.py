"""The commands ``safety-harness certify`` and ``verify``: report a plan's evidence, and check a report."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, BadParameter, Option, Typer
from typer.core import TyperGroup

from safety_harness.cli.console import AS_EXPECTED, DIFFERS, document, next_step, result, say
from safety_harness.cli.options import Executes, OfController, Workers, command

if TYPE_CHECKING:
    from safety_harness.extensions.assurance.campaign.plan import Plan
    from safety_harness.extensions.assurance.certification.delta import EvidenceDelta


class _PlanOrCommand(TyperGroup):
    """A command group that accepts ``certify PLAN`` as well as ``certify declare PLAN``.

    If the first word is no command, the group treats it as a plan or an option.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Insert the command ``plan`` if the first word of ``args`` is no command.

        If a shell completes the first word, the shell gets all commands
        instead.
        """
        named = args[0] in self.commands if args else ctx.resilient_parsing
        return super().parse_args(ctx, args if named else ["plan", *args])

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of the commands except ``plan``, which a user does not type."""
        return [name for name in super().list_commands(ctx) if name != "plan"]

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        """Return the command, but hide the name ``plan``, which a user should not see."""
        name, command, rest = super().resolve_command(ctx, args)
        return (None if name == "plan" else name), command, rest


commands = Typer()
_HELP = "Run a declared plan and write its evidence (also: declare, seal, delta)."
of_certify = Typer(name="certify", cls=_PlanOrCommand, help=_HELP, short_help=_HELP)


@command(
    of_certify,
    "plan",
    interrupted="interrupted: every finished run is kept, and the same command continues",
    failed=DIFFERS,
)
def certify(
    plan: Annotated[
        Path, Argument(help="A plan, which states claims, strata, runs and confidence.", metavar="PLAN")
    ],
    out: Annotated[
        Path | None,
        Option(help="Folder for the report. Default: reports/NAME, where NAME is the name of the plan."),
    ] = None,
    pdf: Annotated[
        bool, Option("--pdf", help="Also print the page to evidence.pdf. This needs an installed Chromium.")
    ] = False,
    full: Annotated[
        bool,
        Option(
            "--full",
            help="Print the whole page to the PDF, and not only the most severe results of each kind.",
        ),
    ] = False,
    workers: Workers = None,
    selftest: Annotated[
        Path | None, Option(help="Include this result of the command selftest (selftest.json) in the report.")
    ] = None,
    oracles: Annotated[
        Path | None,
        Option(
            help="Include this result of independent oracles in the report. The result for this version is"
            " shipped:plans/oracles.json."
        ),
    ] = None,
    cell: Annotated[
        list[Path],
        Option(
            help="Include this result of the command compare-worlds (compare-worlds.json) in the report. "
            "May be repeated."
        ),
    ] = [],  # noqa: B006
    declared: Annotated[
        Path | None,
        Option(
            help="The declaration that certify declare wrote. Default: PLAN.declared.json, if this file "
            "exists."
        ),
    ] = None,
    proof: Annotated[
        Path | None,
        Option(
            help="Include this proof about the avoider's network in the report (certificate.json of the "
            "command prove)."
        ),
    ] = None,
    since: Annotated[
        Path | None,
        Option(
            help="Folder of an earlier report. The command also prints the changes since that report, and "
            "ends with exit code 1 if a result is worse.",
            metavar="OLD",
        ),
    ] = None,
    controller: OfController = None,
) -> int:
    """Run a declared plan and write its evidence as a report.

    The report has a page, JSON, JUnit XML, and all files that are needed to
    repeat the runs. The report is no certificate, and it states this. The
    command prints a line for each claim.

    Two other commands print hashes that you can lodge with a third party. Use
    certify declare PLAN before the runs, and certify seal REPORT after the
    runs. If the plan differs from its declaration, certify rejects the plan.

    The bounds come from the plan's own independent runs. The report also has
    the findings of a search, but these findings estimate no probability.

    If you press Ctrl-C, every finished run is saved, and the same command
    continues later.

    With --since OLD, the command also compares the report with an earlier
    report. It writes the comparison to REPORT.delta (delta.html and
    delta.json), and the comparison decides the exit code.

    Exit code 0: with --since: there is no regression; otherwise: each claim has
    the status "shown".
    Exit code 1: a claim has another status (only without --since), there is a
    regression (with --since), or a part of the report failed.
    Exit code 2: bad input, or the plan's runs cannot meet a target.
    Exit code 130: interrupted.
    """
    from safety_harness.admission.claims import property_of
    from safety_harness.claims.properties.base import close_to, far_words
    from safety_harness.claims.properties.tried import UNTRIED
    from safety_harness.cli.progress import TERMINAL
    from safety_harness.extensions.assurance.campaign.ledger import Ledger
    from safety_harness.extensions.assurance.campaign.session import LEDGER
    from safety_harness.extensions.assurance.certification.argument import STATE
    from safety_harness.extensions.assurance.certification.findings import SHOWS_GATE
    from safety_harness.extensions.assurance.certification.stored import limited_lines
    from safety_harness.extensions.assurance.certification.verdicts import overruling_line, percent
    from safety_harness.extensions.assurance.certification.verify_runs import programs_in
    from safety_harness.extensions.assurance.certify_job import certify as certify_plan
    from safety_harness.extensions.assurance.commands.campaign_lines import tested_lines
    from safety_harness.scenario.typed_json import plain
    from safety_harness.trace.answer_times import UNHEEDED

    made = certify_plan(
        plan,
        controller=controller,
        out=out,
        pdf=pdf,
        full=full,
        workers=workers,
        selftest=selftest,
        oracles=oracles,
        cells=cell,
        declared=declared,
        proof=proof,
        since=since,
        output=TERMINAL,
    )
    evidence = made.evidence
    document(**plain(evidence), page=made.page)
    say(*(f"error: {text}" for text in evidence.unmade))
    for claim in evidence.claims:
        mark = {"holds": "ok  ", "violated": "NO  "}.get(STATE[claim.standing], "open")
        result(f"{mark} {claim.standing.value:<21} {claim.sentence}: {claim.why}")
    result(*tested_lines(made.plan), *_shielded_lines(made.plan, made.folder / LEDGER))
    with Ledger.open(made.folder / LEDGER, alone=True) as opened:
        result(*(f"limits: {line}" for line in limited_lines(made.plan, opened)))
    simplest = made.plan.strata[0].space.simplest
    for planned, claim in zip(made.plan.claims, evidence.claims, strict=True):
        margins = [item.least_margin_si for item in claim.outcomes if item.least_margin_si is not None]
        far = far_words(close_to(property_of(planned.claim, simplest)), min(margins, default=None))
        say(*[f"note: {claim.sentence}: {far}"] * bool(far))
    result(*(overruling_line(item) for item in evidence.overruling if item.words))
    bounds, confidence = evidence.plan.bounds, percent(evidence.plan.confidence)
    if any(item.bound for claim in evidence.claims for item in claim.outcomes):
        result(f"all {bounds} bounds of the report hold together with {confidence} confidence")
    if evidence.fallback:
        result(evidence.fallback)
    say(
        *(
            f"note: {item.text}"
            for item in evidence.findings
            if f": {UNTRIED} " in item.text
            or UNHEEDED in item.text
            or SHOWS_GATE in item.text
            or item.place == "recorded-cells"
        )
    )
    result(evidence.basis, f"{made.page}: {evidence.standing.value}")
    if not made.complete:
        say("interrupted: the report lists the missing parts; the same command continues")
    else:
        folder = shlex.quote(str(made.folder))
        executes = " --execute-programs" * bool(programs_in(made.plan))
        next_step(f"safety-harness verify {folder}{executes}", "does the report stand?")
        next_step(f"safety-harness certify seal {folder}", "a hash to lodge where its day cannot be changed")
    if made.delta is not None:
        _tell_delta(made.delta, made.folder)
    return made.exit_code


def _shielded_lines(plan: Plan, ledger: Path) -> list[str]:
    """Return lines that state how much a shield slowed the arm in the stored random runs of each stratum."""
    from safety_harness.extensions.assurance.campaign.ledger import Ledger
    from safety_harness.extensions.assurance.certification.guard import ReportGuard
    from safety_harness.extensions.assurance.certification.stored import random_traces
    from safety_harness.report.shielding import shield_lines

    shielded = {k: item.name for k, item in enumerate(plan.strata) if item.space.simplest.shield is not None}
    if not shielded:
        return []  # without a shield, reading the traces has no use
    with Ledger.open(ledger, alone=True) as opened:
        stored, _ = random_traces(plan, opened)
    lines = []
    for k, name in shielded.items():
        traces = [item.trace for item in stored if item.stratum == k]
        text = ReportGuard().run("slowing", partial(shield_lines, traces), []) or [
            "how much it slowed is not known"
        ]
        lines.append(f"shield in {name}, {len(traces)} stored runs: {text[0]}")
    return lines


def _tell_delta(delta: EvidenceDelta, report: Path) -> None:
    """Print the changes since an earlier report."""
    from safety_harness.extensions.assurance.certification.delta_page import PAGE, folder_of_delta
    from safety_harness.scenario.typed_json import plain

    document(delta=plain(delta))
    result(*(f"WORSE {text}" for text in delta.regressions))
    result(*(f"closed {text}" for text in delta.closed))
    spaces = [item for item in delta.parts if item.part == "space"]
    result(*(f"another space, {item.name}: {item.before} before, {item.after} now" for item in spaces))
    again = [item.what for item in delta.carried if not item.carries]
    result(f"to be run again: {', '.join(again) or 'nothing'}", delta.line, *delta.bases)
    result(f"{folder_of_delta(report) / PAGE}")


@command(of_certify, "delta")
def tell_delta(
    old: Annotated[Path, Argument(help="The folder of the earlier report.", metavar="OLD")],
    new: Annotated[Path, Argument(help="The folder of the later report.", metavar="NEW")],
) -> int:
    """Compare two reports, and print changes and regressions.

    The command runs no scenario. It writes all changes to NEW.delta (delta.html
    and delta.json): changes of the software, the system, the settings, the
    spaces, the claims, the bounds and the findings. It also lists the earlier
    runs that still apply to the later system.

    Exit code 0: there is no regression.
    Exit code 1: there is a regression.
    Exit code 2: a folder is no report, is not finished, or has altered files.
    """
    from safety_harness.extensions.assurance.certification.delta import EarlierReport
    from safety_harness.extensions.assurance.certify_job import compare_reports
    from safety_harness.scenario.files import display_path

    earlier, later = EarlierReport.read(old), EarlierReport.read(new)
    made_by = shlex.join(
        ["safety-harness", "certify", "delta", str(display_path(old)), str(display_path(new))]
    )
    delta = compare_reports(earlier, later, made_by)
    _tell_delta(delta, later.folder)
    return DIFFERS if delta.regressions else AS_EXPECTED


@command(of_certify, then="safety-harness certify {plan}")
def declare(
    plan: Annotated[Path, Argument(help="A plan whose runs have not begun yet.", metavar="PLAN")],
    out: Annotated[
        Path | None, Option(help="File for the declaration. Default: PLAN.declared.json beside the plan.")
    ] = None,
) -> int:
    """Print a hash of the plan, seed, avoider, targets and software.

    Lodge the hash before the runs, at a place where its date cannot change.
    Later, verify REPORT --declared HASH checks that the report belongs to the
    declared plan.

    Exit code 0: the declaration is written.
    Exit code 2: bad input, or another declaration already exists.
    """
    from safety_harness.extensions.assurance.campaign.plan import read_plan
    from safety_harness.extensions.assurance.certification.lodged import declaration_file, write_declaration
    from safety_harness.extensions.assurance.certification.results import refuse_hopeless

    read = read_plan(plan)
    refuse_hopeless(read)
    path = out or declaration_file(plan)
    made = write_declaration(read, path)
    result(made.sha256)
    document(sha256=made.sha256, declaration=path)
    say(
        f"{path} covers plan, seed {read.seed}, avoider, targets and software. Lodge the hash where its day "
        "cannot be changed, before you run the plan: a signed git tag, a timestamping service, an e-mail to "
        "the assessor. Let the assessor choose the seed, because you could have tried this one before."
    )
    programs = [file.name for file in read.files if file.name.endswith(".py")]
    if programs:
        say(f"not covered: other files that {programs[0]} reads when it runs, such as weights")
    return AS_EXPECTED


@command(of_certify, "seal", then="safety-harness verify {report} --seal HASH")
def seal_report(
    report: Annotated[Path, Argument(help="The folder of a report that certify wrote.", metavar="REPORT")],
) -> int:
    """Print a hash of a report's rows, declaration and files.

    Lodge the hash at a place where it cannot change. The file REPORT.seal.json
    also contains the hash. Later, verify REPORT --seal HASH checks that no file
    has changed since the seal was made.

    Exit code 0: the seal is written.
    Exit code 1: files of the report differ from its manifest.
    Exit code 2: bad input, or another seal already exists.
    """
    from safety_harness.extensions.assurance.certification.folder import read_manifest
    from safety_harness.extensions.assurance.certification.lodged import seal_file, write_seal
    from safety_harness.extensions.assurance.certification.verify_files import check_files

    check = check_files(report, read_manifest(report))
    result(*(f"DIFF {line}" for line in check.faults))
    document(faults=check.faults)
    if not check.stands:
        return DIFFERS
    made = write_seal(report)
    result(made.sha256)
    document(sha256=made.sha256, rows_sha256=made.rows, seal=seal_file(report))
    say(
        f"{seal_file(report)}: the root over all rows, {made.rows[:16]}, the declaration and the hash of "
        "every file. Lodge the hash elsewhere (a signed git tag, a timestamping service, e-mail): verify "
        "--seal finds whatever is altered from now on."
    )
    return AS_EXPECTED


@contextmanager
def _shown_if_interrupted(lines: list[str]) -> Iterator[None]:
    """Print ``lines`` if Ctrl-C interrupts the work, so that finished checks are not lost."""
    try:
        yield
    except KeyboardInterrupt:
        result(*lines)
        raise


def _chance(given: str | float) -> float:
    """Return the probability between 0 and 1 that ``given`` states as a percentage or a number."""
    text = str(given)
    try:
        value = float(text.removesuffix("%")) / (100.0 if text.endswith("%") else 1.0)
    except ValueError:
        value = -1.0
    if not 0.0 < value < 1.0:
        raise BadParameter(f"{text!r} is no chance: expected 1% or 0.01, say")
    return value


@command(commands, interrupted="interrupted: what was not checked yet is not known to stand", failed=DIFFERS)
def verify(
    report: Annotated[Path, Argument(help="The folder of a report that certify wrote.", metavar="FOLDER")],
    runs: Annotated[
        int | None,
        Option(
            help="Number of randomly drawn runs to repeat. Default: as many as --miss requires, but at "
            "most 1000.",
            min=0,
        ),
    ] = None,
    miss: Annotated[
        float,
        Option(
            parser=_chance,
            help="Accepted probability that the repeated runs miss all altered rows, if these rows change "
            "a verdict.",
            metavar="CHANCE",
        ),
    ] = "1%",  # type: ignore[assignment]
    seal: Annotated[
        str | None, Option(help="The lodged hash that certify seal printed, or the lodged file of the seal.")
    ] = None,
    declared: Annotated[
        str | None,
        Option(help="The lodged hash that certify declare printed, or the lodged file of the declaration."),
    ] = None,
    seed: Annotated[
        int | None,
        Option(
            help="Seed of the random draw of runs, for example to repeat an earlier draw. Default: a new "
            "seed each time, which the command prints.",
            min=0,
        ),
    ] = None,
    execute_programs: Executes = False,
    strict: Annotated[bool, Option(help="End with exit code 1 also if a point is open.")] = False,
) -> int:
    """Check a report, and repeat some of its runs.

    The command checks files, plan, ledger and traces, and computes the numbers
    and the page again. It reports later changes of the source, the versions,
    the networks and the platform. It also reports each point that it could not
    check.

    Without a lodged seal (--seal), only repeated runs can reveal altered rows.
    The command prints the smallest number of altered rows that would change a
    verdict. It also prints the probability that the repeated runs missed all of
    these rows.

    Exit code 0: the check found no fault, and open points are marked.
    Exit code 1: the check found a fault, or a point is open (only with
    --strict).
    Exit code 2: the folder is no report, or the report has a program that may
    not be executed.
    Exit code 130: interrupted.
    """
    import secrets
    from dataclasses import asdict

    from safety_harness.cli.progress import paced_lines
    from safety_harness.extensions.assurance.certification.evidence import read_evidence
    from safety_harness.extensions.assurance.certification.folder import JSON
    from safety_harness.extensions.assurance.certification.lodged import seal_file
    from safety_harness.extensions.assurance.certification.verify import verify as verify_report

    checks: list[dict[str, Any]] = []
    lines: list[str] = []
    with paced_lines() as show, _shown_if_interrupted(lines):
        for check in verify_report(
            report,
            runs=runs,
            miss=_chance(miss),  # its default is a text, which the help shows
            seed=secrets.randbelow(2**31) if seed is None else seed,
            execute_programs=execute_programs,
            seal=seal,
            declared=declared,
            on_progress=show,
        ):
            checks.append(asdict(check) | {"stands": check.stands})
            mark = "DIFF" if not check.stands else "open" if check.unchecked else "ok  "
            remarks = (*check.faults, *check.notes, *(f"not checked: {item}" for item in check.unchecked))
            lines += [f"{mark} {check.looked_at}", *(f"     {remark}" for remark in remarks)]
    stands, whole = all(item["stands"] for item in checks), not any(item["unchecked"] for item in checks)
    document(stands=stands, checks=checks)
    if stands:
        evidence = read_evidence(report / JSON)
        open_ones = "" if whole else ", except for the open points"
        result(f"the report stands{open_ones}: {evidence.standing.value}", *lines, evidence.basis)
    else:
        result("the report does not stand", *lines)
    if stands and seal is None:
        sealed = seal_file(report)
        rest = ["verify", report, "--seal", sealed] if sealed.is_file() else ["certify", "seal", report]
        next_step(shlex.join(["safety-harness", *map(str, rest)]))
    return AS_EXPECTED if stands and (whole or not strict) else DIFFERS
