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
    """A command group in which ``certify PLAN`` works beside ``certify declare PLAN``.

    If the first word names no command, the group takes it as a plan or an option.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Insert the command ``plan`` if the first word of ``args`` is no command.

        A shell that completes the first word gets all commands instead.
        """
        named = args[0] in self.commands if args else ctx.resilient_parsing
        return super().parse_args(ctx, args if named else ["plan", *args])

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of the commands, without ``plan``, which a user does not type."""
        return [name for name in super().list_commands(ctx) if name != "plan"]

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        """Return the command, but hide the name ``plan``, which a user should not read."""
        name, command, rest = super().resolve_command(ctx, args)
        return (None if name == "plan" else name), command, rest


commands = Typer()
_HELP = "Run a declared plan and write its evidence; declare, seal, delta."
of_certify = Typer(name="certify", cls=_PlanOrCommand, help=_HELP, short_help=_HELP)


@command(
    of_certify,
    "plan",
    interrupted="interrupted: every finished run is kept, and the same command goes on from there",
    failed=DIFFERS,
)
def certify(
    plan: Annotated[Path, Argument(help="A plan: claims, strata, runs, confidence.", metavar="PLAN")],
    out: Annotated[
        Path | None, Option(help="Folder for the report; without it reports/NAME of the plan.")
    ] = None,
    pdf: Annotated[
        bool, Option("--pdf", help="Also print the page to evidence.pdf, with an installed Chromium.")
    ] = False,
    full: Annotated[
        bool, Option("--full", help="On paper have all of the page, and not the gravest of each kind.")
    ] = False,
    workers: Workers = None,
    selftest: Annotated[
        Path | None, Option(help="selftest.json of safety-harness selftest, to be part of the report.")
    ] = None,
    oracles: Annotated[
        Path | None,
        Option(help="Independent oracles, likewise; of this version: shipped:plans/oracles.json."),
    ] = None,
    cell: Annotated[
        list[Path],
        Option(help="compare-worlds.json of safety-harness compare-worlds, likewise; may be given again."),
    ] = [],  # noqa: B006
    declared: Annotated[
        Path | None, Option(help="What certify declare wrote; without it PLAN.declared.json, if it is there.")
    ] = None,
    proof: Annotated[
        Path | None, Option(help="certificate.json of safety-harness prove, of the avoider's network.")
    ] = None,
    since: Annotated[
        Path | None,
        Option(
            help="An earlier report's folder: say what changed, and fail for what got worse.", metavar="OLD"
        ),
    ] = None,
    controller: OfController = None,
) -> int:
    """Run a declared plan and write its evidence as a report.

    The report has a page, JSON, JUnit XML, and all files for a repetition. It
    is no certificate, and says so. The command prints a line for each claim.

    certify declare PLAN, before, and certify seal REPORT, after, print hashes
    to lodge. The command refuses a plan that differs from its declaration.

    Bounds come from the plan's own independent runs. The report has the
    findings of its search too, but they estimate no probability.

    Ctrl-C keeps every finished run; the same command continues.

    The option --since OLD adds the delta to an earlier report (REPORT.delta
    with delta.html and delta.json), which then decides the exit code.

    Exit code 0: every claim has the status shown, or with --since no regression.
    Exit code 1: a claim has another status, or with --since a regression.
    Exit code 1 too: a part of the report failed.
    Exit code 2: bad input, or a target that the plan's runs cannot meet.
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
    result(*tested_lines(made.plan), *_shielded_lines(made.plan, made.folder / LEDGER))
    with Ledger.open(made.folder / LEDGER, alone=True) as opened:
        result(*(f"limits: {line}" for line in limited_lines(made.plan, opened)))
    for claim in evidence.claims:
        mark = {"holds": "ok  ", "violated": "NO  "}.get(STATE[claim.standing], "open")
        result(f"{mark} {claim.standing.value:<21} {claim.sentence}: {claim.why}")
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
        say("interrupted: the report says what is missing; the same command goes on from there")
    else:
        folder = shlex.quote(str(made.folder))
        executes = " --execute-programs" * bool(programs_in(made.plan))
        next_step(f"safety-harness verify {folder}{executes}", "does the report stand?")
        next_step(f"safety-harness certify seal {folder}", "a hash to lodge where its day cannot be changed")
    if made.delta is not None:
        _tell_delta(made.delta, made.folder)
    return made.exit_code


def _shielded_lines(plan: Plan, ledger: Path) -> list[str]:
    """Return how much shields slowed the arm in the stored random runs of each stratum."""
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
    new: Annotated[Path, Argument(help="The folder of the later one.", metavar="NEW")],
) -> int:
    """Compare two reports: changes and regressions, without runs.

    NEW.delta (delta.html, delta.json) has all changes: software, system,
    settings, spaces, claims, bounds and findings. It also lists the earlier
    runs that apply to the later system.

    Exit code 0: no regression.
    Exit code 1: a regression.
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
    plan: Annotated[Path, Argument(help="A plan that has not been run yet.", metavar="PLAN")],
    out: Annotated[
        Path | None, Option(help="File to write; without it PLAN.declared.json beside the plan.")
    ] = None,
) -> int:
    """Print a hash over plan, seed, avoider, targets and software.

    Lodge it before the runs, where its date cannot change. Later, verify REPORT
    --declared HASH shows that the report is of the declared plan.

    Exit code 0: the declaration is written.
    Exit code 2: bad input, or another declaration is there.
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
        f"{path}: plan, seed {read.seed}, avoider, targets and software. Lodge the hash where its day cannot "
        "be changed, before you run the plan: a signed git tag, a timestamping service, an e-mail to whoever "
        "will judge. Runs repeat themselves: let them name the seed, or they may ask if you had tried it."
    )
    return AS_EXPECTED


@command(of_certify, "seal", then="safety-harness verify {report} --seal HASH")
def seal_report(
    report: Annotated[Path, Argument(help="The folder of a report of certify.", metavar="REPORT")],
) -> int:
    """Print a hash over a report's rows, declaration and files.

    Lodge it where it cannot change. The file REPORT.seal.json has it too.
    Later, verify REPORT --seal HASH shows that no file was altered since.

    Exit code 0: the seal is written.
    Exit code 1: files of the report differ from its manifest.
    Exit code 2: bad input, or another seal is there.
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
    """Return a chance between 0 and 1 from ``given``, which is in per cent or a number."""
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
    report: Annotated[Path, Argument(help="The folder of a report of certify.", metavar="FOLDER")],
    runs: Annotated[
        int | None,
        Option(help="Runs to make again, drawn at random; without it as --miss asks, 1000 at most.", min=0),
    ] = None,
    miss: Annotated[
        float,
        Option(
            parser=_chance, help="Chance of overlooking altered rows that turn a verdict.", metavar="CHANCE"
        ),
    ] = "1%",  # type: ignore[assignment]
    seal: Annotated[
        str | None, Option(help="Hash that certify seal printed, as it was lodged elsewhere, or its file.")
    ] = None,
    declared: Annotated[
        str | None, Option(help="Hash that certify declare printed, as it was lodged elsewhere, or its file.")
    ] = None,
    seed: Annotated[
        int | None,
        Option(
            help="To repeat an earlier draw of runs; without it others each time, and it says which.", min=0
        ),
    ] = None,
    execute_programs: Executes = False,
    strict: Annotated[bool, Option(help="Exit code 1 also where something is open.")] = False,
) -> int:
    """Check a report, and repeat some of its runs.

    It checks files, plan, ledger and traces, and computes numbers and page
    again. It names later changes (source, versions, networks, platform), and
    each point that it could not check.

    If you give no lodged --seal, only repeated runs can expose altered rows.
    The command prints how few altered rows would turn a verdict, and the chance
    that the repeated runs missed them.

    Exit code 0: the report stands, and open points have a mark.
    Exit code 1: the report does not stand, or a point is open (--strict).
    Exit code 2: no report, or it has a program that may not run.
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
